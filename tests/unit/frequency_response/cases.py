"""Experiments on simulated axes, and the exact response that they are judged by."""

import numpy as np

from emps_design.control.linear_plant import VELOCITY, linear_plant
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant

COUPLING = {"kind": "flexible_coupling", "frequency": 60.0, "damping": 0.02, "share": 0.4}


def two_mass():
    """The embedded machine with a load behind a coupling."""
    return machine("emps2019").replace(effects=[COUPLING])


def exact(axis, frequency, velocity=0.05):
    """Force to velocity of the continuous plant of ``axis`` at ``frequency`` [Hz], from its linearisation."""
    plant = linear_plant(axis, velocity)
    s = 2j * np.pi * np.asarray(frequency)
    states = np.linalg.solve(s[:, None, None] * np.eye(plant.C.size) - plant.A, plant.B[:, None])[..., 0]
    return states[:, VELOCITY] * np.exp(-s * plant.delay) / axis.drive.gain


def multi_sine(samples, lines, rng, corner=60):
    """One period of a random-phase multi-sine on ``lines``, its amplitude falling above ``corner``, peak 1."""
    k = np.arange(samples)
    sines = [
        np.cos(2 * np.pi * line * k / samples + phase) / np.hypot(1.0, line / corner)
        for line, phase in zip(lines, rng.uniform(0, 2 * np.pi, len(lines)), strict=True)
    ]
    total = np.sum(sines, axis=0)
    return total / np.max(np.abs(total))


def passes(period, flat, count, speed, gap=0.1, ramp=0.2):
    """Reference [m] of so many passes of ``flat`` samples at ``speed``, forth and back, and where each is steady."""
    up, rest = np.linspace(0.0, 1.0, round(ramp / period)), np.zeros(round(gap / period))
    velocity, starts = [rest], []
    for i in range(count):
        starts.append(sum(map(len, velocity)) + up.size)
        velocity += [(-1) ** i * np.concatenate([up, np.ones(flat), up[::-1]]), rest]
    return np.cumsum(speed * np.concatenate(velocity)) * period, starts


def experiment(axis, seed=0, samples=1000, periods=4, count=4, volts=0.4, top=250.0, newtons=0.5, speed=0.05):
    """A record of ``axis`` under a multi-sine added to its controller's output, on a carriage that runs."""
    rng, period = np.random.default_rng(seed), axis.sampling.period
    lines = np.arange(3, int(top * samples * period), 2)
    lines = lines[np.arange(lines.size) % 4 != 3]
    settle, length = 200, samples * (periods + 1)
    q_ref, starts = passes(period, settle + length, count, speed)
    excitation, one = np.zeros(q_ref.size), volts * multi_sine(samples, lines, rng)
    for start in starts:
        excitation[start + settle : start + settle + length] = np.tile(one, periods + 1)
    return run(axis, q_ref, excitation, newtons * rng.standard_normal(q_ref.size))


def run(axis, q_ref, excitation, force):
    """The record of ``axis`` in closed loop."""
    found = Plant.of(axis).closed_loop(q_ref, disturbance=force, voltage_noise=excitation)
    added = excitation if np.any(excitation) else None
    return Record.from_arrays(axis.sampling.period, found.q_ref, found.q, found.u, name="case", excitation=added)
