"""Feed-forward along a reference, and changes of the feedback for what no feed-forward compensates.

Feed-forward is the command that the motion needs by the model, added to that of the law. Terms are ``inertia``,
``viscous``, ``coulomb`` and ``constant`` of the baseline, ``lead`` for the delay between command and force, and one
for each effect of the axis that acts on the carriage as a force of position and velocity. Every term evaluates the
effect's own kernel on the reference. Friction takes the sign of the reference velocity and is proportional to it
below a small speed, so it does not chatter at a reversal. The law acts on the position error alone: its response to
the reference itself (the braking of a velocity feedback) is already part of the feed-forward.

Changes of the feedback are a filter for a coupling and a gain limit for a play. A play transmits no force within its
gap. For an oscillation it acts as a spring and a damper of which the share N is effective: its describing function,
from N = 0 (the oscillation stays within the gap) to N = 1 (the gap is negligible), without the phase of the damper.
No limit cycle is expected as long as the sampled loop with such a coupling is stable for every N; the gain limit is
the gain at which it first is not. Dry friction is neglected, which is conservative.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis, AxisEffect
from emps_design.effects import Effect
from emps_design.effects.effect import COULOMB, MASS, OFFSET, VISCOUS
from emps_design.effects.two_mass import LOWEST, RESONANCES, is_coupling, linear_coupling
from emps_design.errors import EmpsError
from emps_design.laws import get_law, table_of
from emps_design.messages import grave, note
from emps_design.units import Units

BASELINE = {"inertia": MASS, "viscous": VISCOUS, "coulomb": COULOMB, "constant": OFFSET}
LEAD = "lead"
REVERSAL = 2e-3  # of the reference's highest speed: below it friction is fed forward in proportion to the speed

PHASE_MARGIN_DEG = 60.0
SHARES = 12  # of the describing function, between the slowest coupling that an axis may have and the whole one
HIGHEST = 100.0  # factors of the gain looked at, and its inverse


@dataclass(frozen=True)
class FeedForward:
    """Feed-forward of the ``terms`` of an ``axis``; ``baseline`` and ``parameters`` replace the axis's own."""

    axis: Axis
    terms: tuple[str, ...]
    baseline: np.ndarray = field(repr=False)
    parameters: tuple[np.ndarray, ...] = field(repr=False)
    back_emf: float = 0.0  # N/(m/s), braking of a motor without a current loop: part of the viscous term
    late: float = 0.0  # s, from command to force, without the hold and the computation delay
    reversal: float = 0.0  # m/s, friction is proportional to velocity below it; 0: a share of the highest speed

    @classmethod
    def of(cls, axis: Axis, terms: Sequence[str]) -> FeedForward:
        """The feed-forward of ``terms`` with the numbers of ``axis``."""
        parameters = tuple(entry.effect.values(entry.parameters) for entry in axis.effects)
        braked = axis.drive.braking if "viscous" in terms else 0.0
        return cls(axis, tuple(terms), axis.mechanics.array(), parameters, braked, lateness(axis))

    def along(self, q_ref: np.ndarray) -> np.ndarray:
        """Return the command (n,) that is added along ``q_ref`` (n,) [m] to that of the law on its error.

        >>> from emps_design.machines import machine
        >>> ahead = FeedForward.of(machine("emps2019"), ("constant",)).along(np.zeros(5))
        >>> ahead.round(4).tolist()
        [-0.09, -0.09, -0.09, -0.09, -0.09]
        """
        period = self.axis.sampling.period
        q, v, a = motion_ahead(q_ref, period, self.wait)
        return replace(self, reversal=self.reversal or reversal_of(q_ref, period)).command(q, v, a)

    @property
    def wait(self) -> float:
        """Time [s] from a sample to the middle of the period in which its command acts."""
        sampling = self.axis.sampling
        return (0.5 + sampling.computation_delay) * sampling.period + (self.late if LEAD in self.terms else 0.0)

    def command(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Command (n,) that the motion ``q`` [m], ``v`` [m/s], ``a`` [m/s^2] (n,) needs, by the terms."""
        from emps_design.simulation.kernels.inverse import force_along, table

        direction = np.clip(v / self.reversal, -1.0, 1.0) if self.reversal > 0.0 else np.zeros(q.size)
        chosen = self.effects()
        hooks, starts = table([effect for _, effect, _ in chosen])
        p, force = np.concatenate([np.zeros(0), *(values for _, _, values in chosen)]), np.empty(q.size)
        force_along(q, v, a, direction, self.own(), self.baseline, hooks, starts, p, np.zeros(1), force)
        return (force + self.back_emf * v if self.back_emf else force) / self.axis.drive.gain

    def own(self) -> np.ndarray:
        """The baseline (4,), 0 for each parameter that is not among the terms."""
        return np.array([self.baseline[at] if name in self.terms else 0.0 for name, at in BASELINE.items()])

    def effects(self) -> list[tuple[str, Effect, np.ndarray]]:
        """Name, effect and parameters of every effect among the terms."""
        each = zip(named_effects(self.axis), self.parameters, strict=True)
        return [(name, entry.effect, values) for (name, entry), values in each if name in self.terms]


def reversal_of(q_ref: np.ndarray, period: float) -> float:
    """The speed [m/s] below which friction is fed forward in proportion, along a reference ``q_ref`` (n,) [m]."""
    return REVERSAL * float(np.abs(motion_ahead(q_ref, period, 0.0)[1]).max(initial=0.0))


def named_effects(axis: Axis) -> list[tuple[str, AxisEffect]]:
    """Each effect of ``axis`` with a name: its kind, numbered where there are several of one."""
    kinds, named = [entry.kind for entry in axis.effects], []
    for place, entry in enumerate(axis.effects):
        number = f"_{kinds[: place + 1].count(entry.kind)}" if kinds.count(entry.kind) > 1 else ""
        named.append((f"{entry.kind}{number}", entry))
    return named


def terms_of(axis: Axis) -> tuple[tuple[str, ...], dict[str, str]]:
    """Every term that ``axis`` has, and a line for each of its effects that cannot be compensated."""
    terms, not_compensated = [*BASELINE], {}
    for name, entry in named_effects(axis):
        reason = why_not(entry.effect, axis.units)
        if not reason:
            terms.append(name)
        elif entry.effect.delay is None and entry.effect.solver.lag is None:
            not_compensated[name] = reason
    return (*terms, *([LEAD] if lateness(axis) > 0.0 else [])), not_compensated


def lateness(axis: Axis) -> float:
    """Time [s] by which the force lags the command: current loop, lags and delays among the effects."""
    b, late = axis.mechanics.array(), axis.drive.current_time_constant
    for entry in axis.effects:
        p = entry.effect.values(entry.parameters)
        for hook in (entry.effect.delay, entry.effect.solver.lag):
            late += hook(0.0, 0.0, 0.0, 0.0, np.zeros(0), p, b) if hook is not None else 0.0
    return float(late)


def why_not(effect: Effect, units: Units) -> str:
    """Return why no force of the present position and velocity stands for ``effect``; empty if one does."""
    if effect.rate is not None:
        return "it has a state of its own, which position and velocity do not give"
    if effect.channel != "plant":
        return f"it acts in the {effect.channel}, not as a {units.word('force')} of position and velocity"
    if effect.over == "t":
        return "it goes by the time of one record, which a controller does not know"
    return ""


def motion_ahead(q_ref: np.ndarray, period: float, wait: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration (n,) of ``q_ref`` (n,) a time ``wait`` [s] later, at rest before and after.

    >>> q, v, a = motion_ahead(np.array([0.0, 1.0, 2.0, 3.0]), 1.0, 0.5)
    >>> q.tolist(), v.tolist()
    ([0.5, 1.5, 2.5, 3.0], [0.75, 1.0, 0.75, 0.5])
    """
    edged = np.concatenate([q_ref[:1], q_ref, q_ref[-1:]])
    v = (edged[2:] - edged[:-2]) / (2.0 * period)
    a = (edged[2:] - 2.0 * edged[1:-1] + edged[:-2]) / period**2
    at = np.arange(q_ref.size) + wait / period
    index = np.arange(q_ref.size)
    return np.interp(at, index, q_ref), np.interp(at, index, v), np.interp(at, index, a)


def feedback_cures(axis: Axis) -> list[dict[str, Any]]:
    """Return one cure for each coupling and each play among the effects of ``axis``: numbers and a line of advice.

    >>> from emps_design.machines import machine
    >>> play = {"kind": "backlash", "gap": 1e-4, "frequency": 60.0, "damping": 0.1, "share": 0.4}
    >>> (cure,) = feedback_cures(machine("emps2019").replace(effects=[play]))
    >>> cure["gain"], cure["limit"] > cure["now"] > 243.0
    ('kv', True)
    """
    cures = []
    for place, entry in enumerate(axis.effects):
        if is_coupling(entry.effect):
            try:
                cure = _gain(axis, place) if entry.effect.play else _filter(axis)
            except EmpsError as error:  # a user's law may have no linear form
                cure = {"cure": None, "advice": note("no-cure", f"no advice, {error}")}
            cures.append({"effect": entry.kind, **cure, "advice": cure["advice"].of(entry.kind)})
    return cures


def _filter(axis: Axis) -> dict[str, Any]:
    """The command filter that gives a velocity loop of ``axis`` its largest crossover."""
    from emps_design.control.velocity.gains import own_filters, own_structure
    from emps_design.control.velocity.limits import suggest_filter

    structure = own_structure(axis)
    suggestion = suggest_filter(axis, PHASE_MARGIN_DEG, structure, own_filters(axis))
    loop = f"a velocity loop ({structure.label}) of {PHASE_MARGIN_DEG:g} deg phase margin"
    before, added = suggestion["without"], suggestion["filter"]
    reached = "has no crossover" if before["crossover"] is None else f"reaches {before['crossover']:.4g} rad/s"
    if added is None:
        advice = note("no-filter-helps", f"{loop} {reached}, and no one filter more raises that by a tenth")
    else:
        shape = f", damping {added['damping']:g}, depth {added['depth']:g}" if added["kind"] == "notch" else ""
        text = (
            f"{loop} {reached} without, and {suggestion['with']['crossover']:.4g} rad/s with a {added['kind']} at "
            f"{added['frequency']:.4g} Hz{shape}"
        )
        advice = note("filter-helps", text, **added)
    return {"cure": "filter", "structure": structure.form, **suggestion, "advice": advice}


def _gain(axis: Axis, place: int) -> dict[str, Any]:
    """The gain of the law of ``axis`` up to which no limit cycle is expected from its play at ``place``."""
    factor, name = largest_factor(axis, place), get_law(axis.controller.kind).gain
    now: Any = table_of(axis) if name else None
    for part in name.split(".") if name else ():
        now = getattr(now, part)
    number = now if isinstance(now, int | float) else None
    limit = factor * number if number is not None and 0.0 < factor < math.inf else None
    own = name or "the gain of the law"
    if not factor:
        text = (
            f"a limit cycle is possible with every {own} down to 1/{HIGHEST:g} of what it is, dry friction left "
            "out; lower the gain of the position or the integral, or preload the play"
        )
        advice = grave("limit-cycle-at-any-gain", text, gain=own)
    elif factor == math.inf:
        text = f"no limit cycle is expected with {own} up to {HIGHEST:g} times what it is"
        advice = note("no-limit-cycle", text, gain=own)
    else:
        bound = f"{factor:.3g} times what it is" if limit is None else f"{limit:.4g}, now {number:.4g}"
        text = f"keep {own} below {bound}; from there on a limit cycle is possible, dry friction left out"
        if factor < 1.0:
            advice = grave("limit-cycle-at-this-gain", text, gain=own, factor=factor)
        else:
            advice = note("limit-cycle-above", text, gain=own, factor=factor)
    return {
        "cure": "limit of the gain", "gain": name or None, "now": number, "limit": limit,
        "factor": factor if math.isfinite(factor) else None,
        "method": "describing function of the play in the sampled loop", "advice": advice,
    }  # fmt: skip


def largest_factor(axis: Axis, place: int) -> float:
    """Smallest factor on the gain of the law of ``axis`` that makes its loop with the play at ``place`` unstable.

    Below 1 if the loop is unstable with the present gain; infinite if it is stable up to :data:`HIGHEST` times that
    gain; 0 if it is unstable even at 1 / :data:`HIGHEST` of it.
    """
    loops = _with_shares(axis, place)

    def stable(factor: float) -> bool:
        from emps_design.control.sampled import axis_loop

        drive = {"force_gain": axis.drive.force_gain * factor, "back_emf": axis.drive.back_emf / factor}
        return all(axis_loop(loop.replace(drive=drive)).stable for loop in loops)

    ladder = np.geomspace(1.0, HIGHEST, 14)
    if stable(1.0):
        last = next((i for i, factor in enumerate(ladder) if not stable(factor)), None)
        if last is None:
            return math.inf
        low, high = ladder[last - 1], ladder[last]
    else:
        first = next((i for i, factor in enumerate(ladder) if stable(1.0 / factor)), None)
        if first is None:
            return 0.0
        low, high = 1.0 / ladder[first], 1.0 / ladder[first - 1]
    while high > 1.001 * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)


def _with_shares(axis: Axis, place: int) -> list[Axis]:
    """Return ``axis`` with linear couplings for the play, one per share N, and once without its load (N = 0)."""
    play = axis.effects[place]
    p = dict(zip((p.name for p in play.effect.parameters), play.effect.values(play.parameters), strict=True))
    others = [{"kind": other.kind, **other.parameters} for i, other in enumerate(axis.effects) if i != place]
    softest = LOWEST if p["frequency"] > LOWEST else max(RESONANCES[0], 0.1 * p["frequency"])
    low = min(1.0, (softest / p["frequency"]) ** 2 * (1.0 + 1e-9))
    coupled = [
        axis.replace(effects=[*others, linear_coupling(p["frequency"] * n**0.5, p["damping"] * n**0.5, p["share"])])
        for n in np.geomspace(low, 1.0, SHARES)
    ]
    alone = {"mass": axis.mechanics.mass * (1.0 - p["share"])}
    return [*coupled, axis.replace(effects=others, mechanics=alone)]
