"""A trajectory that excites an axis, and simulated records of it with a force noise that is slow."""

from functools import cache

import numpy as np
import pytest

from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant

PERIOD = 1e-3
SPEEDS = (0.04, 0.08, 0.12)  # m/s


@cache
def trajectory(laps: int = 2) -> np.ndarray:
    """Trapezoids of velocity, forth and back at three speeds, with rests of 60 ms and jerk over 40 ms."""
    pieces = [np.zeros(300)]
    for speed in SPEEDS * laps:
        ramp, cruise = int(speed / 0.5 / PERIOD), int(1.4 / PERIOD) - int(speed / 0.5 / PERIOD)
        for sign in (1.0, -1.0):
            up = sign * np.linspace(0.0, speed, ramp)
            pieces += [up, np.full(cruise, sign * speed), up[::-1], np.zeros(60)]
    bell = np.hanning(40)
    return np.cumsum(np.convolve(np.concatenate(pieces), bell / bell.sum(), "same")) * PERIOD


def slow_noise(n: int, rng: np.random.Generator, std: float = 1.0, time: float = 0.1) -> np.ndarray:
    """First-order autoregressive force of standard deviation ``std`` [N] and correlation time ``time`` [s]."""
    from scipy.signal import lfilter

    a = np.exp(-PERIOD / time)
    start = [a * std * rng.standard_normal()]
    return lfilter([1.0], [1.0, -a], std * np.sqrt(1 - a * a) * rng.standard_normal(n), zi=start)[0]


@cache
def plant():
    return Plant.of(machine("emps2019"))


def simulated(seed: int, laps: int = 2, std: float = 1.0, time: float = 0.1) -> Record:
    """A record of the embedded machine with slow force noise and 4 mV of voltage noise."""
    rng = np.random.default_rng(seed)
    q_ref = trajectory(laps)
    push = slow_noise(q_ref.size, rng, std, time) if std > 0 else None
    run = plant().closed_loop(q_ref, disturbance=push, voltage_noise=4e-3 * rng.standard_normal(q_ref.size))
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=PERIOD, name=f"simulated-{seed}")


@pytest.fixture(scope="session")
def truth():
    mechanics = machine("emps2019").mechanics
    return dict(zip(("mass", "viscous", "coulomb", "constant_force"), mechanics.array(), strict=True))


@pytest.fixture(scope="session")
def record() -> Record:
    return simulated(0)


@pytest.fixture(scope="session")
def simulate():
    """The function that makes a simulated record: ``simulate(seed, laps, std, time)``."""
    return simulated


@pytest.fixture(scope="session")
def reference_plant():
    """The embedded machine, ready to be simulated."""
    return plant()
