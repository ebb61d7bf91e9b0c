"""The sampled loop of the impedance law on an axis with effects, each linearised in steady motion.

The same recursions as in :mod:`impedance_sampled`, around the plant of :mod:`discretisation`. The law takes its current
from the current loop's model, as it does in the simulation of such an axis: an actuator that does something else than
its model (lag, delay, gain) then shows in the poles.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.axis import Axis
from emps_design.control.impedance.law import ImpedanceLaw
from emps_design.control.impedance.sampled import SampledLoop, exponential
from emps_design.control.plant.discretisation import sample_axis
from emps_design.control.plant.linear_plant import POSITION


def extended_loop(axis: Axis, law: ImpedanceLaw, velocity: float = 0.1) -> SampledLoop:
    """Build the sampled loop of ``law`` on ``axis``, its effects linearised at ``velocity`` [m/s].

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> coupling = {"kind": "flexible_coupling", "frequency": 50.0, "damping": 0.05, "share": 0.2}
    >>> law = impedance_law(axis, 50.0, 100.0)
    >>> extended_loop(axis, law).stable, extended_loop(axis.replace(effects=[coupling]), law).stable
    (True, False)
    """
    plant, period, gain = sample_axis(axis, velocity), axis.sampling.period, axis.drive.force_gain
    sprung = law.stiffness > 0.0
    keep = np.arange(plant.C.size) if sprung else plant.kept
    row, d0, d1 = plant.increment
    split = bool(np.any(plant.G1))
    own_delay = axis.sampling.computation_delay  # what the law's model of the current loop knows of
    history = max(plant.delay + split, own_delay)
    n = keep.size
    newest, middle, oldest, af, tf, tm, past = range(n, n + 7)
    size = past + history
    unit = np.eye(size)

    taps = 0.5 * (unit[newest] + unit[middle]) if law.velocity_estimator == "two_tap" else unit[newest]
    before = 0.5 * (unit[middle] + unit[oldest]) if law.velocity_estimator == "two_tap" else unit[middle]
    keep_a, keep_t = (math.exp(-w * period) for w in law.filters)
    slow_a = keep_a * unit[af] + (1.0 - keep_a) * (taps - before) / period**2
    slow_tau = keep_t * unit[tf] + (1.0 - keep_t) * unit[tm]
    estimate, r = law.estimate, law.ratio
    viscous = estimate.viscous[0 if velocity > 0 else 1]
    if law.force_sensor:
        command, feed = (viscous - r * law.damping) * taps / period, (r - 1.0) / gain
    else:
        command = r * (viscous - law.damping) * taps / period
        command = command + (r - 1.0) * (estimate.mass * slow_a - law.current_factor * slow_tau)
        feed = 0.0
    if sprung:  # what the encoder reads
        reading = np.zeros(size)
        reading[:n] = plant.C
        command = command - r * law.stiffness * reading

    volts = [command / gain, *unit[past:]]
    acting, earlier = volts[plant.delay], volts[plant.delay + 1] if split else np.zeros(size)
    fed = feed if plant.delay == 0 else 0.0
    held, pushed = _held_force(plant.linear.A, plant.linear.E, period)
    matrix, column = np.zeros((size, size)), np.zeros(size)
    matrix[:n] = plant.Phi[np.ix_(keep, keep)] @ unit[:n]
    matrix[:n] += np.outer(plant.G0[keep], acting) + np.outer(plant.G1[keep], earlier)
    column[:n] = plant.G0[keep] * fed + held[keep]
    matrix[newest] = row[keep] @ unit[:n] + d0 * acting + d1 * earlier
    column[newest] = d0 * fed + plant.C @ held
    matrix[middle], matrix[oldest] = unit[newest], unit[middle]
    matrix[af], matrix[tf] = slow_a, slow_tau
    lag = axis.drive.current_time_constant
    e = math.exp(-period / lag) if lag > 0.0 else 0.0
    matrix[tm] = e * unit[tm] + (1.0 - e) * gain * volts[own_delay]
    column[tm] = (1.0 - e) * gain * (feed if own_delay == 0 else 0.0)
    if history:
        matrix[past:] = volts[:history]
        column[past] = feed

    step = plant.Phi[POSITION] - np.eye(plant.C.size)[POSITION]
    out = step[keep] @ unit[:n] + plant.G0[POSITION] * acting + plant.G1[POSITION] * earlier
    direct = pushed + plant.G0[POSITION] * fed
    return SampledLoop(matrix, column, out / period, float(direct) / period, period)


def _held_force(A: np.ndarray, E: np.ndarray, period: float) -> tuple[np.ndarray, float]:
    """What a force held over one period adds to the states, and to the position among them."""
    n = len(E)
    generator = np.zeros((1, n + 1, n + 1))
    generator[0, :n, :n], generator[0, :n, n] = A, E
    held = exponential(generator * period)[0, :n, n]
    return held, float(held[POSITION])
