"""Gains with which the sampled loop meets its specification, its largest crossover, and the binding limit.

The crossover is increased at constant phase margin, with retuned gains, until the sampled loop violates the margins
:data:`GAIN_MARGIN` and :data:`~emps_design.control.velocity.specification.ROOM`, or the command exceeds its limit. The
cause is a resonance if the loop reaches its limit near one; otherwise it is the lag of hold, delay, current loop,
estimator and filters, called delay.

Retuned gains solve two linear equations. At one frequency the open loop at the plant input is k_v1 P + (k_v1/t_v) c
P, with P the sampled plant including hold, delays, current loop and velocity estimator, and c = T z/(z - 1) the
integrator. It must be -exp(j phi) at the crossover: two real equations, linear in k_v1 and k_v1/t_v. The same holds for
the loop broken at the velocity error.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import SampledPlant, sample_axis
from emps_design.control.margins import bisect, disk_size
from emps_design.control.velocity.design import VelocityLoopDesign, command_in_a_step, encoder_voltage_noise
from emps_design.control.velocity.gains import IP, MINUS_3_DB, PLACES, Structure, own_filters, own_structure
from emps_design.control.velocity.sampled import SampledVelocityLoop, sweep_sampled_margins, sweep_stability
from emps_design.control.velocity.specification import (
    ROOM,
    Pairs,
    check_specification,
    nearest_that_works,
    proposal_in_words,
)
from emps_design.errors import InputError, SpecificationError
from emps_design.laws.library.cascade import Filter
from emps_design.request import typed

RETUNE_GRID = 240  # number of crossovers on the grid for one bandwidth
BANDWIDTH_CLOSE = 1.0 + 2.8e-11  # ratio of the ends of the bracket at which the search for a bandwidth ends

GAIN_MARGIN = 2.0
INTEGRAL = 10.0  # largest crossover times integral time; above it a constant force is hardly compensated
NOISE = 0.05  # largest rms of the command due to encoder quantisation, as a share of the command limit
DELAY = "delay: hold, delay, current loop, estimator and filters use up the phase"
PAYS = 1.1  # least factor on the crossover for which a filter is proposed
GRID = 160
SLOWEST = 0.05  # lowest crossover at which limits are checked, as a share of the largest
COARSE, CLOSE = 12, 0.005  # number of crossovers at which a limit is checked, and relative accuracy of its ends
NOTCHES = ((0.3, 0.1), (0.7, 0.1), (0.7, 0.3))  # damping and depth
LOWPASSES = (2.0, 4.0, 8.0)  # corner frequencies, as multiples of the crossover


class PlantResponse(Protocol):
    """A sampled plant, computed or measured, from the command to the estimated velocity."""

    @property
    def period(self) -> float:
        """Sampling period [s]."""

    def response(self, w: np.ndarray) -> np.ndarray:
        """Estimated velocity over command at ``w`` [rad/s], in the shape of ``w``."""

    def integrator(self, w: np.ndarray) -> np.ndarray:
        """T z / (z - 1) at ``w`` [rad/s], the sampled 1/s of a law [s], in the shape of ``w``."""


def retuned_gains(
    plant: PlantResponse,
    crossover: np.ndarray | float,
    phase_margin_deg: np.ndarray | float,
    at: str = "plant-input",
) -> tuple[np.ndarray, np.ndarray]:
    """Return k_v1 [V/(m/s)] and t_v [s] for the ``plant``, NaN where they would not be positive.

    ``crossover`` [rad/s] and ``phase_margin_deg`` [deg] are those of the sampled loop broken ``at`` "plant-input" or
    "velocity-error"; they broadcast. The gains do not ensure stability: check the poles.

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> k_v1, t_v = retuned_gains(plant, 100.0, 60.0)
    >>> round(SampledVelocityLoop(plant, float(k_v1), float(t_v)).margins.phase_margin_deg, 6)
    60.0
    """
    w = np.asarray(crossover, dtype=float)
    inside = (w > 0.0) & (w < math.pi / plant.period)
    w = np.where(inside, w, 1.0)
    P, c = plant.response(w), plant.integrator(w)
    target = -np.exp(1j * np.radians(np.asarray(phase_margin_deg, dtype=float)))
    # plant input: P k + c P k/t = target;  velocity error: c P k/t = target (1 + k P)
    first, second = (P if at == "plant-input" else -target * P), c * P
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = first.real * second.imag - first.imag * second.real
        k_v1 = (target.real * second.imag - target.imag * second.real) / determinant
        integral = (first.real * target.imag - first.imag * target.real) / determinant
        works = inside & (k_v1 > 0.0) & (integral > 0.0) & np.isfinite(k_v1) & np.isfinite(integral)
        return np.where(works, k_v1, np.nan), np.where(works, k_v1 / integral, np.nan)


@typed
def retune_velocity_loop(
    axis: Axis,
    crossover: float | None = None,
    bandwidth: float | None = None,
    phase_margin_deg: float = 60.0,
    at: str = "plant-input",
    velocity: float = 0.1,
    structure: Structure | str | None = None,
    filters: Sequence[Filter | str] | None = None,
) -> VelocityLoopDesign:
    """Return the design whose *sampled* loop has a given phase margin and a given crossover or -3 dB bandwidth.

    Arguments as for :func:`~emps_design.control.velocity.design.design_velocity_loop`, and ``at``, the place where the
    loop is broken. Raises :class:`SpecificationError` if no positive gains meet it, if the loop with them is unstable,
    or if another crossover has less phase margin.

    >>> from emps_design.machines import machine
    >>> design = retune_velocity_loop(machine("emps2018"), crossover=150.0, phase_margin_deg=50.0)
    >>> margins = design.sampled.margins
    >>> round(margins.crossover, 6), round(margins.phase_margin_deg, 6)
    (150.0, 50.0)
    """
    if at not in PLACES:
        raise InputError(f"place of the margin: found {at!r}, expected one of {', '.join(PLACES)}")
    requested = check_specification(crossover, bandwidth, phase_margin_deg)
    structure, filters = own_structure(axis, structure), own_filters(axis, filters)
    plant = sample_axis(axis, velocity, filters)
    pairs = retuned_pairs(plant, requested, at, structure)
    name, frequency = next(iter(requested.items()))
    loop = pairs.loop(frequency, phase_margin_deg) if 0.0 < phase_margin_deg < 180.0 else None
    if loop is not None and pairs.met(loop, frequency, phase_margin_deg):
        return VelocityLoopDesign(
            axis, loop.k_v1, loop.t_v, requested, at, velocity, structure=structure, filters=filters
        )
    if loop is not None:
        reason = "the loop crosses 0 dB more than once, and another crossing has less phase margin"
        again = loop.margins.crossover or 0.0
        resonance = plant.resonance_beside(again)
        if resonance is not None:
            hertz = 2.0 * math.pi
            reason += f": at {again / hertz:.4g} Hz, near the resonance at {resonance / hertz:.4g} Hz"
    else:
        reason = _limit(plant, requested, at, structure)
    nearest = nearest_that_works(pairs, requested)
    raise SpecificationError(
        f"retune: no gains give the sampled loop {phase_margin_deg:g} deg at a {name} of {frequency:g} rad/s; "
        f"{reason}; {proposal_in_words(nearest, pairs)}",
        nearest,
    )


def retuned_pairs(plant: SampledPlant, requested: dict[str, float], at: str, structure: Structure = IP) -> Pairs:
    """Return the pairs of the kind ``requested`` with gains for the sampled loop of ``plant`` broken ``at``.

    >>> from emps_design.machines import machine
    >>> requested = {"bandwidth": 50.0, "phase_margin_deg": 60.0}
    >>> pairs = retuned_pairs(sample_axis(machine("emps2018")), requested, "plant-input")
    >>> pairs.judge(np.array([50.0, 60.0]), np.array([60.0, 60.0])).tolist()
    [2, 0]
    """
    place = structure.place(at)
    if "bandwidth" in requested:
        return Pairs(
            plant,
            lambda w, phase: bandwidth_gains(plant, w, phase, place, structure),
            lambda w, phase: w,
            at,
            True,
            structure,
        )

    def passes(w: np.ndarray, phase: np.ndarray) -> np.ndarray:
        if at == "velocity-error" or structure.form == "pi":
            return w
        # With an ideal plant t_v w = tan(phase) there, and the closed-loop bandwidth is about 1/t_v.
        return w * np.clip(1.0 / np.tan(np.radians(phase)), 0.01, 1.0)

    return Pairs(plant, lambda w, phase: retuned_gains(plant, w, phase, place), passes, at, structure=structure)


def bandwidth_gains(
    plant: SampledPlant,
    bandwidth: np.ndarray,
    phase_margin_deg: np.ndarray,
    at: str = "plant-input",
    structure: Structure = IP,
) -> tuple[np.ndarray, np.ndarray]:
    """Return k_v1 [V/(m/s)] and t_v [s] of the sampled loops with that -3 dB ``bandwidth`` [rad/s], NaN for none.

    With rising crossover the bandwidth first rises and then falls, since the plant's lag leaves ever less phase for the
    integral action. The slowest stable loop of those whose bandwidth rises is taken, of the others if there is none.
    Arrays (n,).

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> k_v1, t_v = bandwidth_gains(plant, np.array([50.0]), np.array([60.0]))
    >>> round(SampledVelocityLoop(plant, float(k_v1[0]), float(t_v[0])).bandwidth, 6)
    50.0
    """
    B, phase = np.broadcast_arrays(np.asarray(bandwidth, float), np.asarray(phase_margin_deg, float))

    def excess_gain(w: np.ndarray, B: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Gain of the closed loop with crossover ``w`` at ``B``, minus -3 dB as a ratio."""
        loops = SampledVelocityLoop(plant, *retuned_gains(plant, w, phase, at), structure)
        with np.errstate(invalid="ignore"):
            return np.abs(loops.closed_loop_response(B)) - MINUS_3_DB

    nyquist = 0.999 * math.pi / plant.period
    k_v1_of, t_v_of = np.full(B.size, np.nan), np.full(B.size, np.nan)
    lowest, highest = B / 50.0, np.minimum(100.0 * B, nyquist)
    inside = np.flatnonzero((lowest < highest) & (nyquist > B))
    shares = np.linspace(0.0, 1.0, RETUNE_GRID)
    grid = lowest[inside, None] * (highest[inside] / lowest[inside])[:, None] ** shares
    excess = excess_gain(grid, B[inside, None], phase[inside, None])
    rising = (excess[:, :-1] < 0.0) & (excess[:, 1:] >= 0.0)
    falling = (excess[:, :-1] >= 0.0) & (excess[:, 1:] < 0.0)
    for way, turn in itertools.product((rising, falling), range(1, 4)):  # the first crossing whose loop is stable
        here = way & (np.cumsum(way, axis=1) == turn)
        rows, places = np.nonzero(here)
        missing = np.isnan(k_v1_of[inside[rows]])
        rows, places = rows[missing], places[missing]
        if not rows.size:
            continue
        which = inside[rows]
        low, high = grid[rows, places], grid[rows, places + 1]
        for _ in range(50):
            middle = np.sqrt(low * high)
            below = (excess_gain(middle, B[which], phase[which]) < 0.0) == (way is rising)
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        k_v1, t_v = retuned_gains(plant, high, phase[which], at)
        good = sweep_stability(plant, k_v1, t_v)
        k_v1_of[which[good]], t_v_of[which[good]] = k_v1[good], t_v[good]
    return k_v1_of, t_v_of


def _limit(plant: SampledPlant, requested: dict[str, float], at: str, structure: Structure) -> str:
    """Return which limit binds, from the plant's phase at the crossover."""
    if not 0.0 < requested["phase_margin_deg"] < 180.0:
        return "a phase margin must be between 0 and 180 deg"
    place = structure.place(at)
    if "bandwidth" in requested:
        most = _largest_bandwidth(plant, requested["phase_margin_deg"], place, structure)
        if requested["bandwidth"] > most > 0.0:
            return f"with that phase margin at the {at.replace('-', ' ')} the largest bandwidth is {most:.5g} rad/s"
        return "the gains would not be positive, or the loop would be unstable"
    if place != "plant-input":
        return "the gains would not be positive, or the loop would be unstable"
    w, phase = requested["crossover"], requested["phase_margin_deg"]
    if w >= math.pi / plant.period:
        return f"the crossover is above the Nyquist frequency, {math.pi / plant.period:.5g} rad/s"
    grid = np.geomspace(1e-5 * w, w, 2000)
    plant_phase = math.degrees(np.unwrap(np.angle(plant.response(grid)))[-1])
    low, high = 90.0 + plant_phase + math.degrees(0.5 * w * plant.period), 180.0 + plant_phase
    if phase >= high and high <= 0.0:
        return "the upper limit binds: hold, delays, current loop and estimator leave no phase margin there"
    if phase >= high:
        return (
            f"the upper limit binds: hold, delays, current loop and estimator leave at most {high:.4g} deg there, "
            "even without integral action"
        )
    if phase <= low:
        return f"the lower limit binds: below {low:.4g} deg k_v1 is not positive"
    return "the sampled loop with those gains is unstable"


def _largest_bandwidth(plant: SampledPlant, phase_margin_deg: float, at: str, structure: Structure) -> float:
    """The largest -3 dB bandwidth [rad/s] of a stable sampled loop with that phase margin, 0 if there is none."""

    def works(bandwidth: np.ndarray) -> np.ndarray:
        phase = np.full(bandwidth.size, phase_margin_deg)
        return np.isfinite(bandwidth_gains(plant, bandwidth, phase, at, structure)[0])

    grid = np.geomspace(1e-5, 0.99, 400) * math.pi / plant.period
    feasible = np.flatnonzero(works(grid))
    if not feasible.size:
        return 0.0
    low, high = grid[feasible[-1]], grid[min(feasible[-1] + 1, grid.size - 1)]
    return float(bisect(lambda bandwidth: not works(np.array([bandwidth]))[0], low, high, BANDWIDTH_CLOSE)[0])


@dataclass(frozen=True)
class Reach:
    """The fastest loop with a phase margin: ``crossover`` [rad/s] (0: none), gains, and the binding ``limit``."""

    crossover: float
    k_v1: float
    t_v: float
    limit: str


def reach(
    plant: SampledPlant, phase_margin_deg: float, gain_margin: float = GAIN_MARGIN, disk_margin: float = 0.0
) -> Reach:
    """Return the fastest sampled loop around ``plant`` with that phase margin at the plant input.

    Its gain margin [ratio] is at least ``gain_margin``, its disk margin at least ``disk_margin``.

    >>> from emps_design.machines import machine
    >>> fastest = reach(sample_axis(machine("emps2018")), 60.0)
    >>> round(fastest.crossover, -1), fastest.limit[:5]
    (220.0, 'delay')
    """
    nyquist = math.pi / plant.period
    best = Reach(0.0, math.nan, math.nan, DELAY)
    low, high = 1e-4 * nyquist, 0.9 * nyquist
    for _ in range(2):  # over all frequencies, then near the limit
        w = np.geomspace(low, high, GRID)
        k_v1, t_v = retuned_gains(plant, w, phase_margin_deg)
        margins = sweep_sampled_margins(plant, k_v1, t_v, 200, exact_delay=False)
        good = margins["stable"] & (np.abs(margins["phase_margin_deg"] - phase_margin_deg) < 1e-6)
        good &= ~(margins["gain_margin"] < gain_margin) & ~(margins["delay_margin"] < ROOM * plant.period)
        good &= t_v * w <= INTEGRAL
        if disk_margin > 0.0:
            good[good] &= _disk_margins(plant, k_v1[good], t_v[good]) >= disk_margin
        if not good.any():
            break
        last = int(np.flatnonzero(good)[-1])
        after = min(last + 1, GRID - 1)
        beyond = SampledVelocityLoop(plant, float(k_v1[after]), float(t_v[after]))
        limit = _binding_limit(
            plant, gain_margin, w[after], {key: values[after] for key, values in margins.items()}, beyond
        )
        best = Reach(float(w[last]), float(k_v1[last]), float(t_v[last]), limit)
        low, high = w[last], w[after]
    return best


def _disk_margins(plant: SampledPlant, k_v1: np.ndarray, t_v: np.ndarray) -> np.ndarray:
    """Disk margins (n,) of stable loops, on a grid that is refined at resonances."""
    loops = SampledVelocityLoop(plant, k_v1[:, None], t_v[:, None])
    return 1.0 / disk_size(loops.plant_input_response(plant.frequencies(1000))).max(axis=1)


def _binding_limit(
    plant: SampledPlant, gain_margin: float, w: float, margins: dict[str, float], loop: SampledVelocityLoop
) -> str:
    """Return the limit that ``loop``, the first one beyond it, violates: a resonance near its crossover, or delay."""
    at = w
    if margins["stable"]:
        if margins["crossover"] > 1.05 * w:
            at = margins["crossover"]
        elif margins["gain_margin"] < gain_margin:
            at = margins["gain_margin_frequency"]
    elif math.isfinite(loop.k_v1):
        grid = plant.frequencies()
        at = float(grid[np.argmin(np.abs(1.0 + loop.plant_input_response(grid)))])
    resonance = plant.resonance_beside(at)
    return DELAY if resonance is None else f"resonance at {resonance / (2.0 * math.pi):.4g} Hz"


def limits(
    axis: Axis, plant: SampledPlant, fastest: Reach, phase_margin_deg: float, structure: Structure, velocity: float
) -> dict[str, Any]:
    """Return the crossover [rad/s] at which each limit binds, and the limit that binds first.

    ``loop`` is the crossover of the ``fastest`` loop. ``encoder_noise``: the rms of the command reaches :data:`NOISE`
    of its limit. ``voltage``: the command in a step of the reference by ``velocity`` [m/s] reaches its limit. None if a
    limit does not bind below the fastest loop. The command of a step may decrease again in a faster loop, so this limit
    may bind in a range only, which ``binding`` gives. The check starts at :data:`SLOWEST` of the fastest crossover; a
    limit that binds there also binds below.
    """
    ends: dict[str, float | None] = {"encoder_noise": None, "voltage": None}
    if not fastest.crossover:
        return {"loop": 0.0, **ends, "binding": fastest.limit}
    limit = axis.drive.command_limit

    def loop(w: float) -> SampledVelocityLoop | None:
        k_v1, t_v = (float(gain) for gain in retuned_gains(plant, w, phase_margin_deg))
        candidate = SampledVelocityLoop(plant, k_v1, t_v, structure)
        return candidate if math.isfinite(k_v1) and candidate.stable else None

    def noisy(w: float) -> bool:
        candidate = loop(w)
        return candidate is not None and encoder_voltage_noise(axis, candidate)["rms"] > NOISE * limit

    def saturates(w: float) -> bool:
        candidate = loop(w)
        return candidate is not None and command_in_a_step(axis, candidate, abs(velocity)) > limit

    grid = np.geomspace(SLOWEST * fastest.crossover, fastest.crossover, COARSE)
    step = axis.units.quantity(abs(velocity), "m/s", "g")
    noise, voltage = _exceeded(noisy, grid), _exceeded(saturates, grid)
    named = {
        f"encoder noise: more than {100.0 * NOISE:g} % of the command limit": noise,
        f"{axis.units.word('voltage')}: a step of {step} exceeds the limit": voltage,
        fastest.limit: (fastest.crossover, None),
    }
    ranges = ((name, where) for name, where in named.items() if where is not None)
    name, (first, last) = min(ranges, key=lambda entry: entry[1][0])
    begin = "from below" if first == grid[0] else "from"
    until = "rad/s on" if last is None else f"to {last:.4g} rad/s"
    ends = {"encoder_noise": noise and noise[0], "voltage": voltage and voltage[0]}
    return {"loop": fastest.crossover, **ends, "binding": f"{name}, {begin} {first:.4g} {until}"}


def _exceeded(exceeds: Callable[[float], bool], grid: np.ndarray) -> tuple[float, float | None] | None:
    """Return the first range along ``grid`` (n,) in which a limit is exceeded; an end of None is that of the grid.

    None if the limit is not exceeded.
    """
    there = [exceeds(float(w)) for w in grid]
    if True not in there:
        return None
    first = there.index(True)
    begin = _change(exceeds, grid[first - 1], grid[first]) if first else float(grid[0])
    if False not in there[first:]:
        return begin, None
    last = there.index(False, first)
    return begin, _change(exceeds, grid[last - 1], grid[last])


def _change(exceeds: Callable[[float], bool], low: float, high: float) -> float:
    """Frequency [rad/s] between ``low`` and ``high`` at which ``exceeds`` changes, to :data:`CLOSE`."""
    before = exceeds(low)
    return float(bisect(lambda w: exceeds(w) != before, low, high, 1.0 + CLOSE)[1])


def suggest_filter(
    axis: Axis,
    phase_margin_deg: float,
    structure: Structure = IP,
    filters: tuple[Filter, ...] = (),
    velocity: float = 0.1,
) -> dict[str, Any]:
    """Return the limits of the loop of ``axis`` at that phase margin, and the additional filter that helps most.

    ``without`` and ``with`` have the largest crossover [rad/s] within the same limits of the margins, the binding limit
    and the noise of the command. ``with_equal_margins`` has the largest crossover with the filter and at least the gain
    and disk margin of ``without``, which may be far above the limits. ``filter`` is the one with the largest crossover
    at equal margins, among those that increase it by :data:`PAYS` within the limits; None if there is none.

    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> suggestion = suggest_filter(machine("emps2018").replace(effects=bent), 50.0)
    >>> suggestion["filter"]["kind"], suggestion["with"]["crossover"] > 1.5 * suggestion["without"]["crossover"]
    ('notch', True)
    """
    plant = sample_axis(axis, velocity, filters)
    without = reach(plant, phase_margin_deg)
    margins = SampledVelocityLoop(plant, without.k_v1, without.t_v).margins if without.crossover else None
    equal = {"gain_margin": GAIN_MARGIN, "disk_margin": 0.0}
    if margins is not None:
        equal = {"gain_margin": margins.gain_margin or GAIN_MARGIN, "disk_margin": margins.disk_margin or 0.0}
    # The filter, the plant with it, the fastest loop within the limits, and the fastest with the margins of no filter.
    best: tuple[Filter, SampledPlant, Reach, Reach] | None = None
    for candidate in _candidates(plant, without.crossover):
        filtered = sample_axis(axis, velocity, (*filters, candidate))
        within = reach(filtered, phase_margin_deg)
        if within.crossover > PAYS * without.crossover:
            alike = reach(filtered, phase_margin_deg, **equal)
            if best is None or alike.crossover > best[3].crossover:
                best = candidate, filtered, within, alike

    def document(fastest: Reach, plant: SampledPlant) -> dict[str, Any]:
        loop = SampledVelocityLoop(plant, fastest.k_v1, fastest.t_v, structure) if fastest.crossover else None
        return {
            "crossover": fastest.crossover or None,
            "limits": limits(axis, plant, fastest, phase_margin_deg, structure, velocity),
            "k_v1": fastest.k_v1 if loop else None,
            "t_v": fastest.t_v if loop else None,
            "margins": loop.margins.to_dict() if loop else None,
            "bandwidth": loop.bandwidth if loop else None,
            "command_noise": encoder_voltage_noise(axis, loop)["rms"] if loop else None,
        }

    return {
        "phase_margin_deg": phase_margin_deg,
        "gain_margin_at_least": GAIN_MARGIN,
        "without": document(without, plant),
        "filter": best[0].model_dump(exclude_none=True) if best else None,
        "with_equal_margins": document(best[3], best[1]) if best else None,
        "with": document(best[2], best[1]) if best else None,
    }


def faster_in_words(loop: SampledVelocityLoop, phase_margin_deg: float, fastest: float | None) -> str:
    """Return the limits that a stable ``loop`` with a crossover above ``fastest`` [rad/s] violates; "" if none.

    ``fastest`` is the largest crossover within the limits at that phase margin, None if there is none.

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> k_v1, t_v = (float(gain) for gain in retuned_gains(plant, 240.0, 60.0))
    >>> faster_in_words(SampledVelocityLoop(plant, k_v1, t_v), 60.0, reach(plant, 60.0).crossover)
    'the crossover of 240 rad/s is above the largest within the limits: crossover times t_v 16.1, above 10'
    """
    margins = loop.margins
    if margins.crossover is None or (fastest is not None and margins.crossover <= fastest * (1.0 + CLOSE)):
        return ""
    beyond = []
    if margins.gain_margin is not None and margins.gain_margin < GAIN_MARGIN:
        beyond.append(f"gain margin {margins.gain_margin:.3g}, below {GAIN_MARGIN:g}")
    if margins.phase_margin_deg is not None and margins.phase_margin_deg < phase_margin_deg - 1e-3:
        beyond.append(f"phase margin {margins.phase_margin_deg:.3g} deg at the plant input, below {phase_margin_deg:g}")
    if margins.delay_margin_samples is not None and margins.delay_margin_samples < ROOM:
        beyond.append(f"delay margin {margins.delay_margin_samples:.2g} samples, below {ROOM:g}")
    if loop.t_v * margins.crossover > INTEGRAL:
        beyond.append(f"crossover times t_v {loop.t_v * margins.crossover:.3g}, above {INTEGRAL:g}")
    if not beyond:
        return ""
    above = f"the crossover of {margins.crossover:.4g} rad/s is above the largest within the limits"
    return f"{above}: {' and '.join(beyond)}"


def first_try(axis: Axis, crossover: float, kind: str) -> Filter:
    """Return an initial filter: a "notch" at the lowest resonance of ``axis``, a "lowpass" above ``crossover`` [rad/s].

    For a rigid axis the notch is above the crossover too.

    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> round(first_try(machine("emps2018").replace(effects=bent), 60.0, "notch").frequency, 1)
    48.4
    """
    corner = LOWPASSES[-1] * crossover / (2.0 * math.pi)
    if kind == "lowpass":
        return Filter(kind=kind, frequency=corner)
    at_resonances = [candidate for candidate in _candidates(sample_axis(axis), crossover) if candidate.kind == kind]
    damping, depth = NOTCHES[0]
    return (*at_resonances, Filter(kind=kind, frequency=corner, damping=damping, depth=depth))[0]


def _candidates(plant: SampledPlant, crossover: float) -> list[Filter]:
    """Return candidate filters: notches at the resonances of the sampled plant, low-passes above the crossover."""
    T, filters = plant.period, []
    for w, _ in plant.resonances:
        if w * T < 0.9 * math.pi:
            centre = math.tan(0.5 * w * T) / (math.pi * T)  # the bilinear transform maps it to w
            filters += [Filter(kind="notch", frequency=centre, damping=z, depth=depth) for z, depth in NOTCHES]
    corners = [times * crossover / (2.0 * math.pi) for times in LOWPASSES]
    return filters + [Filter(kind="lowpass", frequency=f) for f in corners if 0.0 < f < 0.4 / T]
