"""Feed-forward along a reference, and changes of the feedback for effects that feed-forward cannot compensate.

Feed-forward is the command that the motion requires according to the model; it is added to the output of the law. Its
terms are ``inertia``, ``viscous``, ``coulomb`` and ``constant`` of the baseline, ``lead`` for the delay between command
and force, and one term for each effect of the axis that acts on the carriage as a force of position and velocity. A
term evaluates the kernel of the effect on the reference. Friction has the sign of the reference velocity, and is
proportional to the velocity below a small speed, so that it does not chatter at a reversal. The law acts on the
position error only: its response to the reference itself (the braking of a velocity feedback) is already part of the
feed-forward.

Changes of the feedback are a filter for a coupling and a gain limit for backlash. Backlash transmits no force within
its gap. For an oscillation it acts as a spring and a damper of which the share N is effective. N is its describing
function, from N = 0 (the oscillation stays within the gap) to N = 1 (the gap is negligible), without the phase of the
damper. No limit cycle is expected while the sampled loop with such a coupling is stable for every N; the gain limit is
the smallest gain with an unstable loop. Dry friction is neglected, which is conservative.
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
REVERSAL = 2e-3  # share of the reference's largest speed below which fed-forward friction is proportional to the speed

PHASE_MARGIN_DEG = 60.0
SHARES = 12  # number of values N of the describing function, from the softest coupling of an axis to N = 1
HIGHEST = 100.0  # largest factor on the gain, and inverse of the smallest


@dataclass(frozen=True)
class FeedForward:
    """Feed-forward with ``terms`` for an ``axis``; ``baseline`` and ``parameters`` replace those of the axis."""

    axis: Axis
    terms: tuple[str, ...]
    baseline: np.ndarray = field(repr=False)
    parameters: tuple[np.ndarray, ...] = field(repr=False)
    back_emf: float = 0.0  # N/(m/s), braking of a motor without a current loop: part of the viscous term
    late: float = 0.0  # s, from command to force, without the hold and the computation delay
    reversal: float = 0.0  # m/s, friction is proportional to the velocity below it; 0: a share of the largest speed

    @classmethod
    def of(cls, axis: Axis, terms: Sequence[str]) -> FeedForward:
        """The feed-forward of ``terms`` with the parameters of ``axis``."""
        parameters = tuple(entry.effect.values(entry.parameters) for entry in axis.effects)
        braking = axis.drive.braking if "viscous" in terms else 0.0
        return cls(axis, tuple(terms), axis.mechanics.array(), parameters, braking, lateness(axis))

    def along(self, q_ref: np.ndarray) -> np.ndarray:
        """Return the command (n,) to add to the output of the law along ``q_ref`` (n,) [m].

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
        """Command (n,) that the motion ``q`` [m], ``v`` [m/s], ``a`` [m/s^2] (n,) requires according to the terms."""
        from emps_design.simulation.kernels.inverse import force_along, table

        direction = np.clip(v / self.reversal, -1.0, 1.0) if self.reversal > 0.0 else np.zeros(q.size)
        effects = self.effects()
        hooks, starts = table([effect for _, effect, _ in effects])
        p, force = np.concatenate([np.zeros(0), *(values for _, _, values in effects)]), np.empty(q.size)
        force_along(q, v, a, direction, self.own_baseline(), self.baseline, hooks, starts, p, np.zeros(1), force)
        return (force + self.back_emf * v if self.back_emf else force) / self.axis.drive.gain

    def own_baseline(self) -> np.ndarray:
        """The baseline (4,), with 0 for each parameter that is not among the terms."""
        return np.array([self.baseline[at] if name in self.terms else 0.0 for name, at in BASELINE.items()])

    def effects(self) -> list[tuple[str, Effect, np.ndarray]]:
        """Name, effect and parameters of every effect among the terms."""
        each = zip(named_effects(self.axis), self.parameters, strict=True)
        return [(name, entry.effect, values) for (name, entry), values in each if name in self.terms]


def reversal_of(q_ref: np.ndarray, period: float) -> float:
    """The speed [m/s] below which fed-forward friction is proportional to it, for a reference ``q_ref`` (n,) [m]."""
    return REVERSAL * float(np.abs(motion_ahead(q_ref, period, 0.0)[1]).max(initial=0.0))


def named_effects(axis: Axis) -> list[tuple[str, AxisEffect]]:
    """Each effect of ``axis`` with a name: its kind, numbered if there are several of that kind."""
    kinds, named = [entry.kind for entry in axis.effects], []
    for place, entry in enumerate(axis.effects):
        number = f"_{kinds[: place + 1].count(entry.kind)}" if kinds.count(entry.kind) > 1 else ""
        named.append((f"{entry.kind}{number}", entry))
    return named


def terms_of(axis: Axis) -> tuple[tuple[str, ...], dict[str, str]]:
    """The terms of ``axis``, and by name the reason for each effect that cannot be compensated."""
    terms, not_compensated = [*BASELINE], {}
    for name, entry in named_effects(axis):
        reason = why_not(entry.effect, axis.units)
        if not reason:
            terms.append(name)
        elif entry.effect.delay is None and entry.effect.solver.lag is None:
            not_compensated[name] = reason
    return (*terms, *([LEAD] if lateness(axis) > 0.0 else [])), not_compensated


def lateness(axis: Axis) -> float:
    """Lag [s] of the force behind the command: current loop, lags and delays of the effects."""
    b, late = axis.mechanics.array(), axis.drive.current_time_constant
    for entry in axis.effects:
        p = entry.effect.values(entry.parameters)
        for hook in (entry.effect.delay, entry.effect.solver.lag):
            late += hook(0.0, 0.0, 0.0, 0.0, np.zeros(0), p, b) if hook is not None else 0.0
    return float(late)


def why_not(effect: Effect, units: Units) -> str:
    """Return why ``effect`` is not a force of the present position and velocity; "" if it is."""
    if effect.rate is not None:
        return "it has a state that does not follow from position and velocity"
    if effect.channel != "plant":
        return f"it acts in the {effect.channel}, not as a {units.word('force')} of position and velocity"
    if effect.over == "t":
        return "it depends on the time within one record, which a controller does not know"
    return ""


def motion_ahead(q_ref: np.ndarray, period: float, wait: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration (n,) of ``q_ref`` (n,) after a time ``wait`` [s]; at rest before and after.

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
    """Return one remedy for each coupling and each backlash of ``axis``: numbers and a sentence of advice.

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
            except EmpsError as error:  # a user's law may not be linear
                cure = {"cure": None, "advice": note("no-cure", f"no advice, {error}")}
            cures.append({"effect": entry.kind, **cure, "advice": cure["advice"].of(entry.kind)})
    return cures


def _filter(axis: Axis) -> dict[str, Any]:
    """The command filter with which a velocity loop of ``axis`` has its largest crossover."""
    from emps_design.control.velocity.gains import own_filters, own_structure
    from emps_design.control.velocity.limits import suggest_filter

    structure = own_structure(axis)
    suggestion = suggest_filter(axis, PHASE_MARGIN_DEG, structure, own_filters(axis))
    loop = f"a velocity loop ({structure.label}) of {PHASE_MARGIN_DEG:g} deg phase margin"
    before, added = suggestion["without"], suggestion["filter"]
    reached = "has no crossover" if before["crossover"] is None else f"reaches {before['crossover']:.4g} rad/s"
    if added is None:
        advice = note("no-filter-helps", f"{loop} {reached}; no additional filter increases that by 10 %")
    else:
        shape = f", damping {added['damping']:g}, depth {added['depth']:g}" if added["kind"] == "notch" else ""
        text = (
            f"{loop} {reached} without a filter, and {suggestion['with']['crossover']:.4g} rad/s with a "
            f"{added['kind']} at {added['frequency']:.4g} Hz{shape}"
        )
        advice = note("filter-helps", text, **added)
    return {"cure": "filter", "structure": structure.form, **suggestion, "advice": advice}


def _gain(axis: Axis, place: int) -> dict[str, Any]:
    """The limit of the law's gain below which the backlash at ``place`` of ``axis`` causes no limit cycle."""
    factor, name = largest_factor(axis, place), get_law(axis.controller.kind).gain
    now: Any = table_of(axis) if name else None
    for part in name.split(".") if name else ():
        now = getattr(now, part)
    number = now if isinstance(now, int | float) else None
    limit = factor * number if number is not None and 0.0 < factor < math.inf else None
    gain = name or "the gain of the law"
    if not factor:
        text = (
            f"without dry friction a limit cycle is possible with every {gain} down to 1/{HIGHEST:g} of its value; "
            "reduce the gain of the position or the integral, or preload the transmission"
        )
        advice = grave("limit-cycle-at-any-gain", text, gain=gain)
    elif factor == math.inf:
        text = f"no limit cycle is expected with {gain} up to {HIGHEST:g} times its value"
        advice = note("no-limit-cycle", text, gain=gain)
    else:
        bound = f"{factor:.3g} times its value" if limit is None else f"{limit:.4g}, now {number:.4g}"
        text = f"keep {gain} below {bound}; above it a limit cycle is possible without dry friction"
        if factor < 1.0:
            advice = grave("limit-cycle-at-this-gain", text, gain=gain, factor=factor)
        else:
            advice = note("limit-cycle-above", text, gain=gain, factor=factor)
    return {
        "cure": "limit of the gain", "gain": name or None, "now": number, "limit": limit,
        "factor": factor if math.isfinite(factor) else None,
        "method": "describing function of the backlash in the sampled loop", "advice": advice,
    }  # fmt: skip


def largest_factor(axis: Axis, place: int) -> float:
    """Smallest factor on the gain of the law with which the loop with the backlash at ``place`` is unstable.

    It is below 1 if the loop is unstable with the present gain, infinite if the loop is stable up to :data:`HIGHEST`
    times that gain, and 0 if it is unstable even at 1 / :data:`HIGHEST` of it.
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
    """Return ``axis`` with a linear coupling for the backlash, one for each N, and once without its load (N = 0)."""
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
