"""Specifications of the velocity loop, the nearest feasible one, and the limits of the closed forms.

A pair of a frequency and a phase margin *works* if there are gains for it with which the sampled loop is stable, has a
delay margin of at least ``ROOM`` samples, and is above -3 dB at ``PASSED`` of the frequency. A pair at the limit of
stability, or with hardly any integral action, might be nearer but would be useless.

The ``..._in_words`` functions make the messages on what the closed forms neglect, and on what effects change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import SampledPlant, oscillations, sample_axis
from emps_design.control.linear_plant import Environment, LinearPlant, attached
from emps_design.control.margins import Margins
from emps_design.control.sampled import margins_in_words
from emps_design.control.velocity.gains import IP, MINUS_3_DB, Structure, sweep_velocity_loop
from emps_design.control.velocity.sampled import SampledVelocityLoop, sweep_sampled_margins
from emps_design.errors import InputError, SpecificationError
from emps_design.laws.library.cascade import Filter
from emps_design.messages import Message, grave, note, warning
from emps_design.quantities import check_magnitude
from emps_design.units import Units

ROOM = 1.0  # samples of delay margin
PASSED = 0.5  # share of the frequency at which the sampled closed loop must be above -3 dB


def check_specification(crossover: float | None, bandwidth: float | None, phase_margin_deg: float) -> dict[str, float]:
    """Return the specification as a dict, or raise :class:`InputError`.

    Exactly one of ``crossover`` and ``bandwidth`` [rad/s] is a positive number; ``phase_margin_deg`` is finite.

    >>> check_specification(100.0, None, 60.0)
    {'crossover': 100.0, 'phase_margin_deg': 60.0}
    """
    if (crossover is None) == (bandwidth is None):
        present = "neither" if crossover is None else "both"
        raise InputError(f"specification: found {present} of crossover and bandwidth, expected exactly one [rad/s]")
    name, value = ("crossover", crossover) if crossover is not None else ("bandwidth", float(bandwidth or 0.0))
    if not math.isfinite(value) or value <= 0.0:
        raise InputError(f"{name}: found {value:g} rad/s, expected a positive number of rad/s")
    check_magnitude(name, value, "rad/s", positive=True)
    if not math.isfinite(phase_margin_deg):
        raise InputError(f"phase margin: found {phase_margin_deg:g} deg, expected an angle between 0 and 90 deg")
    return {name: float(value), "phase_margin_deg": float(phase_margin_deg)}


@dataclass(frozen=True)
class Pairs:
    """Pairs of a frequency and a phase margin, and the sampled loops with their gains.

    ``gains(frequencies, phase_margins_deg)`` returns k_v1 [V/(m/s)] and t_v [s] (n,), NaN where there are none.
    ``passes(frequencies, phase_margins_deg)`` [rad/s] is the nominal bandwidth of such a pair. With ``at`` the sampled
    loop broken there must have the phase margin; "" for the gains of (7). With ``bandwidth`` the frequency is the -3 dB
    frequency that the sampled closed loop must have.
    """

    plant: SampledPlant
    gains: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    passes: Callable[[np.ndarray, np.ndarray], np.ndarray]
    at: str = ""
    bandwidth: bool = False
    structure: Structure = IP

    def loop(self, frequency: float, phase: float) -> SampledVelocityLoop | None:
        """The sampled loop of one pair; None if it has no gains or is unstable."""
        k_v1, t_v = (float(gain[0]) for gain in self.gains(np.array([frequency]), np.array([phase])))
        loop = SampledVelocityLoop(self.plant, k_v1, t_v, self.structure) if math.isfinite(k_v1) else None
        return loop if loop is not None and loop.stable else None

    def met(self, loop: SampledVelocityLoop, frequency: float, phase: float) -> bool:
        """Whether the sampled ``loop`` meets the pair, as far as ``at`` and ``bandwidth`` require it."""
        if self.bandwidth and abs((loop.bandwidth or 0.0) / frequency - 1.0) > 1e-6:
            return False
        if not self.at:
            return True
        margins = loop.margins_at(self.at)
        return margins.phase_margin_deg is not None and abs(margins.phase_margin_deg - phase) < 1e-6

    def judge(self, frequency: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Rate each pair (n,): 0 without gains or unstable, 1 stable, 2 works."""
        k_v1, t_v = self.gains(frequency, phase)
        margins = sweep_sampled_margins(
            self.plant, k_v1, t_v, frequencies=200, at=self.at or "plant-input", exact_delay=False
        )
        good = margins["stable"].copy()
        if self.at:
            good &= np.abs(margins["phase_margin_deg"] - phase) < 1e-6  # NaN compares False
        room = ~(margins["delay_margin"] < ROOM * self.plant.period)  # NaN: unbounded
        return good.astype(int) + (good & room & self._passes(k_v1, t_v, self.passes(frequency, phase)))

    def _passes(self, k_v1: np.ndarray, t_v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Whether the closed loops are above -3 dB at ``PASSED`` of ``w`` [rad/s]."""
        w = np.minimum(PASSED * w, 0.5 * math.pi / self.plant.period)
        with np.errstate(invalid="ignore"):
            loops = SampledVelocityLoop(self.plant, k_v1, t_v, self.structure)
            return np.abs(loops.closed_loop_response(w)) >= MINUS_3_DB


def pairs_by_closed_form(
    axis: Axis,
    requested: dict[str, float],
    velocity: float = 0.1,
    structure: Structure = IP,
    filters: tuple[Filter, ...] = (),
) -> Pairs:
    """Return the pairs of the kind ``requested`` with the gains of (7), the effects linearised at ``velocity`` [m/s].

    Each ``structure`` has its closed form; the sampled loops include the ``filters``.

    >>> from emps_design.machines import machine
    >>> pairs = pairs_by_closed_form(machine("emps2018"), {"crossover": 100.0, "phase_margin_deg": 60.0})
    >>> pairs.judge(np.array([100.0, 1000.0, 100.0]), np.array([60.0, 60.0, 2.0])).tolist()
    [2, 0, 0]
    """

    def gains(frequency: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inside = (phase > 0.0) & (phase < structure.largest_phase_margin)
        phase = np.where(inside, phase, 45.0)
        if "bandwidth" in requested:
            crossover = structure.crossover_of_bandwidth(axis.mechanics.mass, axis.damping, frequency, phase)
            inside &= np.isfinite(crossover)
            frequency = np.where(np.isfinite(crossover), crossover, frequency)
        sweep = sweep_velocity_loop(axis, frequency, phase, structure)
        return np.where(inside, sweep.k_v1, np.nan), np.where(inside, sweep.t_v, np.nan)

    plant = sample_axis(axis, velocity, filters)
    return Pairs(plant, gains, lambda frequency, phase: frequency, structure=structure)


def nearest_that_works(pairs: Pairs, requested: dict[str, float]) -> dict[str, Any]:
    """Return the pair of ``pairs`` nearest to ``requested`` that works, {} if there is none.

    The search varies the phase margin at the same frequency, and the frequency at the same phase margin; if both give a
    pair, the second is under "or". If neither does, both change. If no pair works, the nearest stable pair is returned.

    >>> from emps_design.machines import machine
    >>> requested = {"crossover": 100.0, "phase_margin_deg": 88.0}
    >>> nearest_that_works(pairs_by_closed_form(machine("emps2018"), requested), requested)
    {'crossover': 100.0, 'phase_margin_deg': 77.5, 'or': {'crossover': 19.56, 'phase_margin_deg': 88.0}}
    """
    name = "crossover" if "crossover" in requested else "bandwidth"
    requested_frequency, phase = requested[name], requested["phase_margin_deg"]
    lines = [(np.full(PHASES.size, requested_frequency), PHASES)]
    if 0.0 < phase < 180.0:
        frequencies = np.unique([_round(requested_frequency * 1.01**step) for step in FINE])
        lines.append((frequencies, np.full(frequencies.size, phase)))
    coarse = np.unique([_round(requested_frequency * 1.1**step) for step in COARSE])
    X, Y = np.meshgrid(coarse, PHASES[PHASES % 5.0 == 0.0])
    places = [*lines, (X.ravel(), Y.ravel())]  # and the plane
    judge = lru_cache(lambda place: pairs.judge(*places[place]))  # the plane only if neither line has a pair
    on_lines, anywhere = range(len(lines)), [len(lines)]
    for level, chosen in ((2, on_lines), (2, anywhere), (1, on_lines), (1, anywhere)):
        nearest = [
            _nearest(pairs, requested_frequency, phase, *places[place], judge(place) >= level) for place in chosen
        ]
        solutions = sorted((solution for solution in nearest if solution is not None), key=lambda solution: solution[0])
        if solutions:
            first, *others = [{name: w, "phase_margin_deg": angle} for _, w, angle in solutions]
            return {**first, **({"or": others[0]} if others else {})}
    return {}


# Phase margins to propose [deg], finer towards 90, since with large friction the feasible range is small; and exponents
# of the frequency steps: 1 % near the request, 10 % further away. (np.unique would import numpy.ma.)
_BELOW_90 = (90.0 - n * 10.0**-m for n in range(1, 10) for m in range(1, 6))
PHASES = np.array(sorted({round(phase, 6) for phase in (*(0.5 * np.arange(1, 360)).tolist(), *_BELOW_90)}))
FINE = np.array(sorted({*range(-250, 250), *range(-1500, 500, 10)}))
COARSE = np.arange(-120, 41)


def _nearest(
    pairs: Pairs, requested: float, phase: float, frequencies: np.ndarray, phases: np.ndarray, good: np.ndarray
) -> tuple[float, float, float] | None:
    """Distance, frequency and phase margin of the nearest pair that is ``good`` (n,)."""
    distance = np.abs(np.log(frequencies / requested)) + np.abs(phases - phase) / 45.0
    candidates = np.flatnonzero(good)
    for place in candidates[np.argsort(distance[candidates], kind="stable")][:20]:
        w, angle = float(frequencies[place]), float(phases[place])
        loop = pairs.loop(w, angle)
        if loop is not None and pairs.met(loop, w, angle):
            return float(distance[place]), w, angle
    return None


def proposal_in_words(nearest: dict[str, Any], pairs: Pairs | None = None) -> str:
    """Return the nearest pair as a clause for messages; with ``pairs`` its margins in the sampled loop are added.

    >>> proposal_in_words({"crossover": 100.0, "phase_margin_deg": 79.5})
    'nearest that works: 79.5 deg at a crossover of 100 rad/s'
    """
    if not nearest:
        return "no pair of frequency and phase margin works"
    both = [nearest, nearest["or"]] if "or" in nearest else [nearest]
    words, delay_margins = [], []
    for pair in both:
        name = "crossover" if "crossover" in pair else "bandwidth"
        text = f"{pair['phase_margin_deg']:.7g} deg at a {name} of {pair[name]:.5g} rad/s"
        loop = pairs.loop(pair[name], pair["phase_margin_deg"]) if pairs else None
        if loop is not None:
            achieved = ", ".join(_achieved(loop))
            text += f" (sampled: {achieved})" if achieved else ""
            delay_margins.append(loop.margins.delay_margin_samples)
        words.append(text)
    barely = any(margin is not None and margin < ROOM for margin in delay_margins)
    return f"nearest that {'is stable, but barely' if barely else 'works'}: {', or '.join(words)}"


def _achieved(loop: SampledVelocityLoop) -> Iterator[str]:
    """Margins and bandwidth of a proposal in the sampled loop, as short texts."""
    margins = loop.margins
    if margins.phase_margin_deg is not None:
        yield f"{margins.phase_margin_deg:.3g} deg"
    if margins.delay_margin_samples is not None:
        yield f"delay margin {margins.delay_margin_samples:.3g} samples"
    if loop.bandwidth is not None:
        yield f"-3 dB at {loop.bandwidth:.4g} rad/s"


def _round(value: float) -> float:
    """Round to four significant digits, less than a step of 1 %."""
    return float(f"{value:.4g}")


def infeasible(
    axis: Axis, requested: dict[str, float], velocity: float, structure: Structure, filters: tuple[Filter, ...]
) -> SpecificationError:
    """Return the error for a pair outside the feasible range: the binding limit and the nearest pair that works."""
    name, phase = next(iter(requested)), requested["phase_margin_deg"]
    pairs = pairs_by_closed_form(axis, requested, velocity, structure, filters)
    nearest = nearest_that_works(pairs, requested)
    limit = structure.binding_limit(phase)
    return SpecificationError(
        f"phase margin: found {phase:g} deg at a {name} of {requested[name]:g} rad/s; {limit}; "
        f"{proposal_in_words(nearest, pairs)}",
        nearest,
    )


def room_in_words(loop: SampledVelocityLoop) -> list[Message]:
    """Return a message if a stable sampled ``loop`` has a delay margin below ``ROOM`` samples.

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> [len(room_in_words(SampledVelocityLoop(plant, k_v1, 0.05))) for k_v1 in (550.0, 2500.0)]
    [0, 1]
    """
    margins = loop.margins
    if not loop.stable or margins.delay_margin_samples is None or margins.delay_margin_samples >= ROOM:
        return []
    text = (
        f"the sampled loop is barely stable: {margins.delay_margin_samples:.2g} samples of additional delay make it "
        f"unstable (phase margin {margins.phase_margin_deg:.3g} deg at the plant input)"
    )
    return [grave("barely-stable", text, samples=margins.delay_margin_samples)]


def law_in_words(loop: SampledVelocityLoop, by_closed_form: bool) -> list[Message]:
    """Return messages on consequences of structure and filters of ``loop`` for the closed forms and for the drive."""
    notes = []
    if loop.plant.filters and by_closed_form:
        notes.append(_no_filters("; `retune` meets the request there"))
    if loop.structure.reference_filter:
        text = (
            f"an axis file cannot hold a reference filter: set 1/(1 + t_v s), {1e3 * loop.t_v:.4g} ms, in the drive, "
            'or use form = "ip", which has the same response'
        )
        notes.append(note("reference-filter", text, t_v=loop.t_v))
    return notes


def _no_filters(more: str = "") -> Message:
    """The message that only the sampled loop includes filters, followed by ``more``."""
    return note("filters-left-out", f"the closed forms neglect filters; the sampled loop includes them{more}")


def ideal_loop_in_words(left_out: Sequence[str], with_lags: Margins) -> Message:
    """Return a message on what the closed forms neglect, with the margins of the continuous loop ``with_lags``.

    >>> ideal_loop_in_words((), Margins(stable=True))
    "the continuous loop's gain margin is unbounded: its phase never reaches -180 deg"
    """
    ideal = "the continuous loop's gain margin is unbounded: its phase never reaches -180 deg"
    if not left_out:
        return note("ideal-loop", ideal)
    ideal = f"{ideal}; this neglects {' and '.join(left_out)}; with all lags"
    if not with_lags.stable:
        return grave("unstable-with-lags", f"{ideal} the loop is unstable")
    return note("loop-with-lags", f"{ideal} it has {margins_in_words(with_lags)} at the velocity error")


def effects_in_words(axis: Axis, loop: SampledVelocityLoop, velocity: float) -> list[Message]:
    """Return messages on the influence of the effects of ``axis``, which ``loop`` includes and the closed form not.

    ``loop`` is linearised at ``velocity`` [m/s]; the other direction is checked too.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018-two-quadrant")
    >>> loop = SampledVelocityLoop(sample_axis(axis), 550.0, 8.5e-3)
    >>> effects_in_words(axis, loop, 0.1)[0][:72]
    'with its effects the carriage has 115.7 kg and a friction slope of 475 N'
    """
    if not axis.effects:
        return []
    back_speed = axis.units.quantity(-velocity, "m/s", "g")
    closed_form = "(7)" if loop.structure.form == "ip" else "the closed form"
    notes = carriage_in_words(axis, loop.plant.linear, velocity, closed_form)
    if loop.stable:
        back = replace(loop, plant=sample_axis(axis, -velocity, loop.plant.filters))
        here, there = loop.margins.phase_margin_deg, back.margins.phase_margin_deg
        if not back.stable:
            text = f"the sampled loop is unstable at {back_speed}"
            notes.append(grave("unstable-backward", text, velocity=-velocity))
        elif here is not None and there is not None and there < here - 0.5:
            text = f"at {back_speed} the sampled loop has only {there:.3g} deg of phase margin"
            notes.append(warning("less-margin-backward", text, velocity=-velocity, phase_margin_deg=there))
        notes += _where_it_is_steepest(loop, axis.units)
    return notes


def carriage_in_words(axis: Axis, linear: LinearPlant, velocity: float, closed_form: str = "(7)") -> list[Message]:
    """Return messages on what ``closed_form`` neglects in ``linear``: another mass and friction slope, resonances.

    Mass and slope are those of slow motion; of two masses, the one before the coupling is given too.

    >>> from emps_design.control.linear_plant import linear_plant
    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> axis = machine("emps2018").replace(effects=bent)
    >>> carriage_in_words(axis, linear_plant(axis), 0.1)
    ['(7) assumes one rigid mass of 115.7 kg; the sampled loop has the resonance at 47.99 Hz, with 34.72 kg before it']
    """
    notes, mass, damping, shown = list[Message](), axis.mechanics.mass, axis.damping, axis.units.quantity
    moved, slope = linear.in_slow_motion
    if abs(moved - mass) > 0.01 * mass or abs(slope - damping) > 0.01 * damping:
        text = (
            f"with its effects the {axis.units.word('carriage')} has {shown(moved, 'kg')} and a friction slope of "
            f"{shown(slope, 'N/(m/s)')} at {shown(velocity, 'm/s', 'g')}; {closed_form} uses {shown(mass, 'kg')} and "
            f"{shown(damping, 'N/(m/s)')}, the sampled loop includes all effects"
        )
        notes.append(note("mass-with-effects", text, mass=moved, slope=slope, velocity=velocity))
    for w, _ in oscillations(linear.A):
        before = f", with {shown(linear.mass, 'kg')} before it" if linear.mass < 0.99 * moved else ""
        frequency = w / (2.0 * math.pi)
        text = (
            f"{closed_form} assumes one rigid {axis.units.word('mass')} of {shown(mass, 'kg')}; the sampled loop has "
            f"the resonance at {frequency:.4g} Hz{before}"
        )
        notes.append(note("resonance", text, frequency=frequency))
    return notes


def closed_form_in_words(axis: Axis, plant: SampledPlant, velocity: float) -> list[Message]:
    """Return messages on what a closed form of mass and viscous friction neglects in ``plant``: effects and filters.

    >>> from emps_design.machines import machine
    >>> late = machine("emps2018").replace(effects=[{"kind": "actuator_delay", "delay": 1e-3}])
    >>> closed_form_in_words(late, sample_axis(late), 0.1)
    ['the closed form neglects the effects of the axis; the sampled loop includes them']
    """
    notes = [_no_filters()] if plant.filters else []
    if not axis.effects:
        return notes
    notes_on_carriage = carriage_in_words(axis, plant.linear, velocity, "the closed form")
    text = "the closed form neglects the effects of the axis; the sampled loop includes them"
    return notes + (notes_on_carriage or [note("effects-in-sampled-loop", text)])


def _where_it_is_steepest(loop: SampledVelocityLoop, units: Units) -> list[Message]:
    """Return messages if slow motion is less stable, since the slope of force over position does not average out."""
    steepest = loop.plant.linear.steepest
    if steepest == 0.0:
        return []
    here, notes = loop.margins.phase_margin_deg, []
    place = "angle" if units.rotary else "position"
    for stiffness in (steepest, -steepest):
        linear = attached(loop.plant.linear, Environment(stiffness=stiffness))
        slow = replace(loop, plant=loop.plant.sampling(linear))
        slope = units.quantity(stiffness, "N/m", ".3g")
        where = f"in slow motion, where the {units.word('force')} over {place} has a slope of {slope},"
        there = slow.margins.phase_margin_deg
        if not slow.stable:
            notes.append(grave("unstable-in-slow-motion", f"{where} the sampled loop is unstable", slope=stiffness))
        elif here is not None and there is not None and there < here - 0.5:
            text = f"{where} the sampled loop has only {there:.3g} deg of phase margin"
            notes.append(warning("less-margin-in-slow-motion", text, slope=stiffness, phase_margin_deg=there))
    return notes
