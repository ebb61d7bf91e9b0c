"""What may be asked of the velocity loop, and the nearest that works where it cannot be had."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.plant.discretisation import sample_axis
from emps_design.control.plant.magnitudes import check_scale
from emps_design.control.velocity.gains import crossover_of_bandwidth
from emps_design.control.velocity.sweeps import sweep_stability, sweep_velocity_loop
from emps_design.errors import InputError


def check_specification(crossover: float | None, bandwidth: float | None, phase_margin_deg: float) -> dict[str, float]:
    """Return the specification as a dict of what was given, or raise :class:`InputError`.

    Exactly one of ``crossover`` and ``bandwidth`` [rad/s], positive; ``phase_margin_deg`` [deg] a number.

    >>> check_specification(100.0, None, 60.0)
    {'crossover': 100.0, 'phase_margin_deg': 60.0}
    """
    if (crossover is None) == (bandwidth is None):
        found = "neither" if crossover is None else "both"
        raise InputError(f"specification: found {found} of crossover and bandwidth, expected exactly one [rad/s]")
    name, value = ("crossover", crossover) if crossover is not None else ("bandwidth", float(bandwidth or 0.0))
    if not math.isfinite(value) or value <= 0.0:
        raise InputError(f"{name}: found {value:g} rad/s, expected a positive number of rad/s")
    check_scale(name, value, "rad/s")
    if not math.isfinite(phase_margin_deg):
        raise InputError(f"phase margin: found {phase_margin_deg:g} deg, expected degrees between 0 and 90")
    return {name: float(value), "phase_margin_deg": float(phase_margin_deg)}


def nearest_that_works(
    works: Callable[[np.ndarray, np.ndarray], np.ndarray], requested: dict[str, float]
) -> dict[str, Any]:
    """Return the nearest pair for which ``works(frequencies, phase_margins_deg)`` holds, {} where none was found.

    Looks along both lines through the request: the same frequency with another phase margin, in steps of 0.5 deg, and
    the same phase margin with another frequency, in steps of 1 % (of 10 % far below). Where both lines have one, the
    other is under "or". ``works`` takes and returns arrays (n,).

    >>> nearest_that_works(lambda w, phase: phase < 80.0, {"crossover": 100.0, "phase_margin_deg": 85.2})
    {'crossover': 100.0, 'phase_margin_deg': 79.5}
    """
    name = "crossover" if "crossover" in requested else "bandwidth"
    frequency, phase = requested[name], requested["phase_margin_deg"]
    pairs = []
    phases = 0.5 * np.arange(1, 180)
    found = phases[works(np.full(phases.size, frequency), phases)]
    if found.size:
        near = float(found[np.argmin(np.abs(found - phase))])
        pairs.append((abs(near - phase) / 45.0, {name: frequency, "phase_margin_deg": near}))
    if 0.0 < phase < 90.0:
        steps = np.concatenate([-np.arange(1, 500), np.arange(1, 500), -np.arange(500, 5000, 10)])
        frequencies = np.array([_round(frequency * 1.01**step) for step in steps])
        found = frequencies[works(frequencies, np.full(frequencies.size, phase))]
        if found.size:
            distance = np.abs(np.log(found / frequency))
            near = float(found[np.argmin(distance)])
            pairs.append((float(np.min(distance)), {name: near, "phase_margin_deg": phase}))
    pairs.sort(key=lambda pair: pair[0])
    if not pairs:
        return {}
    return {**pairs[0][1], **({"or": pairs[1][1]} if len(pairs) > 1 else {})}


def stable_pairs(
    axis: Axis, requested: dict[str, float], velocity: float = 0.1
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return the question whether (7) has gains for pairs like ``requested`` and the sampled loop is stable with them.

    ``velocity`` [m/s]: where the effects of ``axis`` are linearised.

    >>> from emps_design.machines import machine
    >>> works = stable_pairs(machine("emps2018"), {"crossover": 100.0, "phase_margin_deg": 60.0})
    >>> works(np.array([100.0, 1000.0, 100.0]), np.array([60.0, 60.0, 2.0])).tolist()
    [True, False, False]
    """
    plant = sample_axis(axis, velocity)

    def works(frequency: np.ndarray, phase: np.ndarray) -> np.ndarray:
        if "bandwidth" in requested:
            pairs = zip(frequency.tolist(), phase.tolist(), strict=True)
            frequency = np.array([crossover_of_bandwidth(w, angle) for w, angle in pairs])
        sweep = sweep_velocity_loop(axis, frequency, phase)
        return sweep_stability(plant, sweep.k_v1, sweep.t_v)

    return works


def in_words(nearest: dict[str, Any]) -> str:
    """The nearest pair in words, for one-line messages.

    >>> in_words({"crossover": 100.0, "phase_margin_deg": 79.5})
    'nearest that works: 79.5 deg at a crossover of 100 rad/s'
    """
    if not nearest:
        return "no pair nearby works"

    def words(pair: dict[str, Any]) -> str:
        name = "crossover" if "crossover" in pair else "bandwidth"
        return f"{pair['phase_margin_deg']:g} deg at a {name} of {pair[name]:.5g} rad/s"

    return f"nearest that works: {words(nearest)}" + (f", or {words(nearest['or'])}" if "or" in nearest else "")


def _round(value: float) -> float:
    """Four significant digits, to be read; steps of 1 % leave room for that."""
    return float(f"{value:.4g}")
