"""The largest crossover of a velocity loop, what limits it, and whether a filter of the command raises it.

The crossover is raised at constant phase margin, with the gains of :mod:`.retune`, until the sampled loop no longer has
the margins :data:`GAIN_MARGIN` and :data:`~emps_design.control.velocity.specification.ROOM`, or the command exceeds its
limit. The cause is a resonance if the loop reaches its limit close to one, and otherwise the lag of hold, delay,
current loop, estimator and filters, called delay.
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
INTEGRAL = 10.0  # largest crossover times integral time: beyond, a constant force is hardly compensated
NOISE = 0.05  # of the command's limit: largest rms of the command due to encoder quantisation
DELAY = "delay: hold, delay, current loop, estimator and filters leave no more phase"
PAYS = 1.1  # factor by which a filter has to raise the crossover to be proposed
GRID = 160
SLOWEST = 0.05  # of the fastest loop's crossover: the lowest one at which limits are checked
COARSE, CLOSE = 12, 0.005  # crossovers at which a limit is checked, and relative accuracy of its ends
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
    """Return the fastest sampled loop around ``plant`` with that phase margin at the plant input and other margins.

    ``gain_margin`` [ratio] and ``disk_margin`` are the least that it may have.

    >>> from emps_design.machines import machine
    >>> fastest = reach(sample_axis(machine("emps2018")), 60.0)
    >>> round(fastest.crossover, -1), fastest.limit[:5]
    (220.0, 'delay')
    """
    nyquist = math.pi / plant.period
    best = Reach(0.0, math.nan, math.nan, DELAY)
    low, high = 1e-4 * nyquist, 0.9 * nyquist
    for _ in range(2):  # all frequencies, then around the limit
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
        limit = _what_ends(
            plant, gain_margin, w[after], {key: values[after] for key, values in margins.items()}, beyond
        )
        best = Reach(float(w[last]), float(k_v1[last]), float(t_v[last]), limit)
        low, high = w[last], w[after]
    return best


def _disk_margins(plant: SampledPlant, k_v1: np.ndarray, t_v: np.ndarray) -> np.ndarray:
    """Disk margins (n,) of stable loops, on a grid that is fine where the plant resonates."""
    loops = SampledVelocityLoop(plant, k_v1[:, None], t_v[:, None])
    return 1.0 / disk_size(loops.plant_input_response(plant.frequencies(1000))).max(axis=1)


def _what_ends(
    plant: SampledPlant, gain_margin: float, w: float, margins: dict[str, float], loop: SampledVelocityLoop
) -> str:
    """Return the limit that the first too fast ``loop`` violates: a resonance near that frequency, or delay."""
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
    """Return the crossover [rad/s] at which each limit binds, and the one that binds first.

    ``loop`` is that of the ``fastest`` loop; ``encoder_noise``: the rms of the command reaches :data:`NOISE` of its
    limit; ``voltage``: a step of the reference by ``velocity`` [m/s] reaches the limit; None if a limit does not bind
    below the fastest. The command of a step may fall again in a faster loop and so bind in a range only: ``binding``
    names it. The check starts at :data:`SLOWEST` of the fastest crossover; what binds there binds below too.
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

    def too_much(w: float) -> bool:
        candidate = loop(w)
        return candidate is not None and command_in_a_step(axis, candidate, abs(velocity)) > limit

    grid = np.geomspace(SLOWEST * fastest.crossover, fastest.crossover, COARSE)
    noise, voltage = _exceeded(noisy, grid), _exceeded(too_much, grid)
    named = {
        f"encoder noise: more than {100.0 * NOISE:g} % of the limit of the command": noise,
        f"voltage: a step of {abs(velocity):g} m/s takes more than the limit": voltage,
        fastest.limit: (fastest.crossover, None),
    }
    ranges = ((name, where) for name, where in named.items() if where is not None)
    name, (first, last) = min(ranges, key=lambda entry: entry[1][0])
    begin = "from below" if first == grid[0] else "from"
    until = "rad/s on" if last is None else f"to {last:.4g} rad/s"
    ends = {"encoder_noise": noise and noise[0], "voltage": voltage and voltage[0]}
    return {"loop": fastest.crossover, **ends, "binding": f"{name}, {begin} {first:.4g} {until}"}


def _exceeded(exceeds: Callable[[float], bool], grid: np.ndarray) -> tuple[float, float | None] | None:
    """Return where along ``grid`` (n,) a limit is first exceeded, and up to where (None: the end); None if nowhere."""
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
    """Return the limits of the loop of ``axis`` at that phase margin, and the additional filter that helps most.

    ``without`` and ``with`` have the largest crossover [rad/s] within the same limits of the margins, the binding limit
    and the noise of the command. ``with_equal_margins`` has the crossover with the filter and gain and disk margin no
    less than ``without`` the filter, which may be far above the limits. ``filter`` is the one that raises the crossover
    most at equal margins, of those that raise it by :data:`PAYS` within the limits; None if there is none.

    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> suggestion = suggest_filter(machine("emps2018").replace(effects=bent), 50.0)
    >>> suggestion["filter"]["kind"], suggestion["with"]["crossover"] > 1.5 * suggestion["without"]["crossover"]
    ('notch', True)
    """

    plant = sample_axis(axis, velocity, filters)
    own = reach(plant, phase_margin_deg)
    kept = SampledVelocityLoop(plant, own.k_v1, own.t_v).margins if own.crossover else None
    equal = {"gain_margin": GAIN_MARGIN, "disk_margin": 0.0}
    if kept is not None:
        equal = {"gain_margin": kept.gain_margin or GAIN_MARGIN, "disk_margin": kept.disk_margin or 0.0}
    # The filter, the plant with it, the fastest loop within the limits, and the fastest with the margins of no filter.
    best: tuple[Filter, SampledPlant, Reach, Reach] | None = None
    for candidate in _candidates(plant, own.crossover):
        filtered = sample_axis(axis, velocity, (*filters, candidate))
        within = reach(filtered, phase_margin_deg)
        if within.crossover > PAYS * own.crossover:
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
        "without": document(own, plant),
        "filter": best[0].model_dump(exclude_none=True) if best else None,
        "with_equal_margins": document(best[3], best[1]) if best else None,
        "with": document(best[2], best[1]) if best else None,
    }


def faster_in_words(loop: SampledVelocityLoop, phase_margin_deg: float, fastest: float | None) -> str:
    """Return which limits a stable ``loop`` with a crossover above ``fastest`` [rad/s] exceeds; empty if none.

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
    """Return filters to try: notches at the resonances of the sampled plant, and low-passes above the crossover."""
    T, filters = plant.period, []
    for w, _ in plant.resonances:
        if w * T < 0.9 * math.pi:
            centre = math.tan(0.5 * w * T) / (math.pi * T)  # the bilinear transform maps it to w
            filters += [Filter(kind="notch", frequency=centre, damping=z, depth=depth) for z, depth in NOTCHES]
    corners = [times * crossover / (2.0 * math.pi) for times in LOWPASSES]
    return filters + [Filter(kind="lowpass", frequency=f) for f in corners if 0.0 < f < 0.4 / T]
