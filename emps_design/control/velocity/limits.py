"""How fast a velocity loop may be made, what ends that, and whether a filter of the command moves the end.

The crossover is raised with the phase margin held, by the gains of :mod:`.retune`, until the sampled loop no longer has
what :data:`GAIN_MARGIN` and :data:`~emps_design.control.velocity.specification.ROOM` ask for, or the command no longer
stays within its limit. What ends it is a resonance where the loop comes to its limit beside one, and otherwise the lag
of hold, delay, current loop, estimator and filters, in one word: delay.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import SampledPlant, sample_axis
from emps_design.control.margins import disk_size
from emps_design.control.velocity.design import command_in_a_step, encoder_voltage_noise
from emps_design.control.velocity.gains import IP, Structure
from emps_design.control.velocity.retune import retuned_gains
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.control.velocity.specification import ROOM
from emps_design.control.velocity.sweeps import sweep_sampled_margins
from emps_design.laws.library.cascade import Filter

GAIN_MARGIN = 2.0
INTEGRAL = 10.0  # crossover times integral time, at most: beyond, next to nothing holds against a constant force
NOISE = 0.05  # of the command's limit: rms of what the encoder's steps make of the command
DELAY = "delay: hold, delay, current loop, estimator and filters leave no more phase"
PAYS = 1.1  # by how much a filter has to raise the crossover to be worth its place
GRID = 160
SLOWEST = 0.05  # of the fastest loop's crossover, from which on its limits are looked at
COARSE, CLOSE = 12, 0.005  # crossovers at which a limit is looked at, and how closely its ends are then found
NOTCHES = ((0.3, 0.1), (0.7, 0.1), (0.7, 0.3))  # damping and depth
LOWPASSES = (2.0, 4.0, 8.0)  # corners, in crossovers


@dataclass(frozen=True)
class Reach:
    """The fastest loop with a phase margin: ``crossover`` [rad/s] (0: none), gains, and the ``limit`` that binds."""

    crossover: float
    k_v1: float
    t_v: float
    limit: str


def reach(
    plant: SampledPlant, phase_margin_deg: float, gain_margin: float = GAIN_MARGIN, disk_margin: float = 0.0
) -> Reach:
    """The fastest sampled loop around ``plant`` with that phase margin at the plant input, its other margins kept too.

    ``gain_margin`` [ratio] and ``disk_margin`` are the least that it may have.

    >>> from emps_design.machines import machine
    >>> found = reach(sample_axis(machine("emps2018")), 60.0)
    >>> round(found.crossover, -1), found.limit[:5]
    (220.0, 'delay')
    """
    nyquist = math.pi / plant.period
    best = Reach(0.0, math.nan, math.nan, DELAY)
    low, high = 1e-4 * nyquist, 0.9 * nyquist
    for _ in range(2):  # once along everything, once where it ends
        w = np.geomspace(low, high, GRID)
        k_v1, t_v = retuned_gains(plant, w, phase_margin_deg)
        found = sweep_sampled_margins(plant, k_v1, t_v, 200, exact_delay=False)
        good = found["stable"] & (np.abs(found["phase_margin_deg"] - phase_margin_deg) < 1e-6)
        good &= ~(found["gain_margin"] < gain_margin) & ~(found["delay_margin"] < ROOM * plant.period)
        good &= t_v * w <= INTEGRAL
        if disk_margin > 0.0:
            good[good] &= _disk_margins(plant, k_v1[good], t_v[good]) >= disk_margin
        if not good.any():
            break
        last = int(np.flatnonzero(good)[-1])
        after = min(last + 1, GRID - 1)
        beyond = SampledVelocityLoop(plant, float(k_v1[after]), float(t_v[after]))
        limit = _what_ends(plant, gain_margin, w[after], {key: values[after] for key, values in found.items()}, beyond)
        best = Reach(float(w[last]), float(k_v1[last]), float(t_v[last]), limit)
        low, high = w[last], w[after]
    return best


def _disk_margins(plant: SampledPlant, k_v1: np.ndarray, t_v: np.ndarray) -> np.ndarray:
    """Disk margins (n,) of stable loops, on a grid that is fine where the plant resonates."""
    loops = SampledVelocityLoop(plant, k_v1[:, None], t_v[:, None])
    return 1.0 / disk_size(loops.plant_input_response(plant.frequencies(1000))).max(axis=1)


def _what_ends(
    plant: SampledPlant, gain_margin: float, w: float, found: dict[str, float], loop: SampledVelocityLoop
) -> str:
    """What the first ``loop`` that is too fast runs into: a resonance beside the place where it does, or delay."""
    at = w
    if found["stable"]:
        if found["crossover"] > 1.05 * w:
            at = found["crossover"]
        elif found["gain_margin"] < gain_margin:
            at = found["gain_margin_frequency"]
    elif math.isfinite(loop.k_v1):
        grid = plant.frequencies()
        at = float(grid[np.argmin(np.abs(1.0 + loop.plant_input_response(grid)))])
    resonance = plant.resonance_beside(at)
    return DELAY if resonance is None else f"resonance at {resonance / (2.0 * math.pi):.4g} Hz"


def limits(
    axis: Axis, plant: SampledPlant, found: Reach, phase_margin_deg: float, structure: Structure, velocity: float
) -> dict[str, Any]:
    """Crossovers [rad/s] up to which each limit lets the loop go, and the one that binds.

    ``encoder_noise``: rms of the command at :data:`NOISE` of its limit; ``voltage``: a step of the reference by
    ``velocity`` [m/s] reaches the limit. None where a limit does not bind below the first. A command that a step takes
    less of again in a faster loop may bind in a range only: ``binding`` says which. They are looked at from
    :data:`SLOWEST` of the first on; one that binds there binds already below.
    """
    ends: dict[str, float | None] = {"encoder_noise": None, "voltage": None}
    if not found.crossover:
        return {"loop": 0.0, **ends, "binding": found.limit}
    limit = axis.drive.command_limit

    def loop(w: float) -> SampledVelocityLoop | None:
        k_v1, t_v = (float(gain) for gain in retuned_gains(plant, w, phase_margin_deg))
        one = SampledVelocityLoop(plant, k_v1, t_v, structure)
        return one if math.isfinite(k_v1) and one.stable else None

    def noisy(w: float) -> bool:
        one = loop(w)
        return one is not None and encoder_voltage_noise(axis, one)["rms"] > NOISE * limit

    def too_much(w: float) -> bool:
        one = loop(w)
        return one is not None and command_in_a_step(axis, one, abs(velocity)) > limit

    grid = np.geomspace(SLOWEST * found.crossover, found.crossover, COARSE)
    noise, voltage = _exceeded(noisy, grid), _exceeded(too_much, grid)
    named = {
        f"encoder noise: more than {100.0 * NOISE:g} % of the limit of the command": noise,
        f"voltage: a step of {abs(velocity):g} m/s takes more than the limit": voltage,
        found.limit: (found.crossover, None),
    }
    ranges = ((name, where) for name, where in named.items() if where is not None)
    name, (first, last) = min(ranges, key=lambda one: one[1][0])
    begin = "from below" if first == grid[0] else "from"
    until = "rad/s on" if last is None else f"to {last:.4g} rad/s"
    ends = {"encoder_noise": noise and noise[0], "voltage": voltage and voltage[0]}
    return {"loop": found.crossover, **ends, "binding": f"{name}, {begin} {first:.4g} {until}"}


def _exceeded(exceeds: Callable[[float], bool], grid: np.ndarray) -> tuple[float, float | None] | None:
    """Where a limit is first exceeded along ``grid`` (n,), and where no longer; None: nowhere, or to its end."""
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
    """Where between ``low`` and ``high`` [rad/s] the answer changes, to :data:`CLOSE`."""
    before = exceeds(low)
    while high > low * (1.0 + CLOSE):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if exceeds(middle) == before else (low, middle)
    return float(high)


def suggest_filter(
    axis: Axis,
    phase_margin_deg: float,
    structure: Structure = IP,
    filters: tuple[Filter, ...] = (),
    velocity: float = 0.1,
) -> dict[str, Any]:
    """What limits the loop of ``axis`` at that phase margin, and the one more filter that raises the crossover most.

    ``without`` and ``with`` have the largest crossover [rad/s] within the same limits of the margins, what binds and
    the noise of the command. ``with_equal_margins`` has that of the filter with gain and disk margin no less than
    ``without`` has, which may be far above the limits. ``filter`` is None where none pays: of those that raise the
    crossover within the limits by :data:`PAYS`, it is the one that raises it most at equal margins.

    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> found = suggest_filter(machine("emps2018").replace(effects=bent), 50.0)
    >>> found["filter"]["kind"], found["with"]["crossover"] > 1.5 * found["without"]["crossover"]
    ('notch', True)
    """

    plant = sample_axis(axis, velocity, filters)
    own = reach(plant, phase_margin_deg)
    kept = SampledVelocityLoop(plant, own.k_v1, own.t_v).margins if own.crossover else None
    equal = {"gain_margin": GAIN_MARGIN, "disk_margin": 0.0}
    if kept is not None:
        equal = {"gain_margin": kept.gain_margin or GAIN_MARGIN, "disk_margin": kept.disk_margin or 0.0}
    # The filter, the plant with it, what it reaches within the limits, and what at the margins that there are without.
    best: tuple[Filter, SampledPlant, Reach, Reach] | None = None
    for one in _candidates(plant, own.crossover):
        filtered = sample_axis(axis, velocity, (*filters, one))
        within = reach(filtered, phase_margin_deg)
        if within.crossover > PAYS * own.crossover:
            alike = reach(filtered, phase_margin_deg, **equal)
            if best is None or alike.crossover > best[3].crossover:
                best = one, filtered, within, alike

    def document(found: Reach, plant: SampledPlant) -> dict[str, Any]:
        loop = SampledVelocityLoop(plant, found.k_v1, found.t_v, structure) if found.crossover else None
        return {
            "crossover": found.crossover or None,
            "limits": limits(axis, plant, found, phase_margin_deg, structure, velocity),
            "k_v1": found.k_v1 if loop else None,
            "t_v": found.t_v if loop else None,
            "margins": loop.margins.to_dict() if loop else None,
            "bandwidth": loop.bandwidth if loop else None,
            "command_noise": encoder_voltage_noise(axis, loop)["rms"] if loop else None,
        }

    return {
        "phase_margin_deg": phase_margin_deg,
        "gain_margin_at_least": GAIN_MARGIN,
        "without": document(own, plant),
        "filter": best[0].model_dump(exclude_none=True) if best else None,
        "with_equal_margins": document(best[3], best[1]) if best else None,
        "with": document(best[2], best[1]) if best else None,
    }


def faster_in_words(loop: SampledVelocityLoop, phase_margin_deg: float, fastest: float | None) -> str:
    """Say which limit a stable ``loop`` exceeds that crosses over above the ``fastest`` [rad/s]; "" where none does.

    ``fastest`` is the largest crossover within the limits at that phase margin, None for none.

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> k_v1, t_v = (float(gain) for gain in retuned_gains(plant, 240.0, 60.0))
    >>> faster_in_words(SampledVelocityLoop(plant, k_v1, t_v), 60.0, reach(plant, 60.0).crossover)
    'these gains cross over at 240 rad/s, faster than the fastest within the limits: crossover times t_v 16.1, above 10'
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
        beyond.append(f"room for {margins.delay_margin_samples:.2g} samples of delay, below {ROOM:g}")
    if loop.t_v * margins.crossover > INTEGRAL:
        beyond.append(f"crossover times t_v {loop.t_v * margins.crossover:.3g}, above {INTEGRAL:g}")
    if not beyond:
        return ""
    at = f"these gains cross over at {margins.crossover:.4g} rad/s, faster than the fastest within the limits"
    return f"{at}: {' and '.join(beyond)}"


def first_try(axis: Axis, crossover: float, kind: str) -> Filter:
    """A filter to start from: a "notch" at the lowest resonance of ``axis``, a "lowpass" above ``crossover`` [rad/s].

    Of a rigid axis the notch is above the crossover too.

    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> round(first_try(machine("emps2018").replace(effects=bent), 60.0, "notch").frequency, 1)
    48.4
    """
    corner = LOWPASSES[-1] * crossover / (2.0 * math.pi)
    if kind == "lowpass":
        return Filter(kind=kind, frequency=corner)
    at_resonances = [one for one in _candidates(sample_axis(axis), crossover) if one.kind == kind]
    damping, depth = NOTCHES[0]
    return (*at_resonances, Filter(kind=kind, frequency=corner, damping=damping, depth=depth))[0]


def _candidates(plant: SampledPlant, crossover: float) -> list[Filter]:
    """Filters to try: notches at the resonances, where the discretisation puts them, and low-passes above."""
    T, found = plant.period, []
    for w, _ in plant.resonances:
        if w * T < 0.9 * math.pi:
            centre = math.tan(0.5 * w * T) / (math.pi * T)  # the bilinear transform brings it to w
            found += [Filter(kind="notch", frequency=centre, damping=z, depth=depth) for z, depth in NOTCHES]
    corners = [times * crossover / (2.0 * math.pi) for times in LOWPASSES]
    return found + [Filter(kind="lowpass", frequency=f) for f in corners if 0.0 < f < 0.4 / T]
