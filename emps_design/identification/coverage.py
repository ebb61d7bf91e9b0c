"""How often intervals hold the truth: simulated records of an axis with known parameters and slow force noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.identification.identify import identify
from emps_design.identification.instruments import identify_with_instruments
from emps_design.identification.output_error import identify_by_output_error
from emps_design.identification.result import Identification
from emps_design.records import Record
from emps_design.simulation import Plant

SPEEDS = (0.04, 0.08, 0.12)  # m/s
PERIOD = 1e-3  # s
VOLTAGE_NOISE = 4e-3  # V
CUTOFF_HZ = 30.0
ESTIMATORS: dict[str, Callable[..., Identification]] = {
    "ls": partial(identify, chain="hold"),
    "iv": identify_with_instruments,
    "oe": identify_by_output_error,
}


@dataclass(frozen=True)
class Coverage:
    """Share of ``runs`` in which a 95 % interval held the truth, by parameter.

    ``noise_time`` [s] is the correlation time of the force noise; ``long_run`` are the intervals of ``identify``,
    ``plain`` those of (15).
    """

    runs: int
    noise_time: float
    estimator: str
    long_run: dict[str, float]
    plain: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """Plain data: one row per parameter, shares in per cent."""
        return {
            "runs": self.runs,
            "rows": [
                {
                    "estimator": self.estimator,
                    "noise_time": self.noise_time,
                    "parameter": name,
                    "identify_percent": 100.0 * self.long_run[name],
                    "equation_15_percent": 100.0 * self.plain[name],
                }
                for name in self.long_run
            ],
        }


def coverage(
    axis: Axis,
    runs: int = 200,
    noise_time: float = 0.1,
    estimator: str = "ls",
    progress: Callable[[str, float], None] | None = None,
) -> Coverage:
    """Identify ``runs`` simulated records and count how often the 95 % intervals hold the truth.

    Each record has its own force noise of 1 N and correlation time ``noise_time`` [s]. ``estimator`` is ``ls`` (chain
    ``hold``), ``iv`` or ``oe``, at 30 Hz.

    >>> from emps_design.machines import machine
    >>> found = coverage(machine("emps2019"), runs=2)
    >>> found.runs, sorted(found.long_run) == sorted(found.plain)
    (2, True)
    """
    plant, names = Plant.of(axis), ("mass", "viscous", "coulomb", "constant_force")
    truth = dict(zip(names, axis.mechanics.array().tolist(), strict=True))
    inside, plain = (dict.fromkeys(names, 0) for _ in range(2))
    for seed in range(runs):
        if progress is not None:
            progress(f"{estimator}, {runs} records, force noise of {noise_time:g} s", seed / runs)
        found = ESTIMATORS[estimator](noisy_record(plant, seed, noise_time=noise_time), axis, cutoff_hz=CUTOFF_HZ)
        for name, value in truth.items():
            estimate = found.parameters[name]
            low, high = estimate.interval_95
            inside[name] += low <= value <= high
            plain[name] += abs(estimate.value - value) <= 1.96 * estimate.std
    shares = ({name: count / runs for name, count in counts.items()} for counts in (inside, plain))
    return Coverage(runs, noise_time, estimator, *shares)


def noisy_record(plant: Plant, seed: int, laps: int = 2, std: float = 1.0, noise_time: float = 0.1) -> Record:
    """A record of ``plant`` along :func:`trajectory`, with slow force noise of ``std`` [N] and noise of the voltage."""
    rng = np.random.default_rng(seed)
    q_ref = trajectory(laps)
    push = slow_noise(q_ref.size, rng, std, noise_time) if std > 0 else None
    run = plant.closed_loop(q_ref, disturbance=push, voltage_noise=VOLTAGE_NOISE * rng.standard_normal(q_ref.size))
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=PERIOD, name=f"simulated-{seed}")


def trajectory(laps: int = 2) -> np.ndarray:
    """Trapezoids of velocity, forth and back at three speeds, with rests of 60 ms and jerk over 40 ms, (n,) [m].

    >>> bool(abs(trajectory(1)[-1] - trajectory(1)[0]) < 1e-9)
    True
    """
    pieces = [np.zeros(300)]
    for speed in SPEEDS * laps:
        ramp, cruise = int(speed / 0.5 / PERIOD), int(1.4 / PERIOD) - int(speed / 0.5 / PERIOD)
        for sign in (1.0, -1.0):
            up = sign * np.linspace(0.0, speed, ramp)
            pieces += [up, np.full(cruise, sign * speed), up[::-1], np.zeros(60)]
    bell = np.hanning(40)
    return np.cumsum(np.convolve(np.concatenate(pieces), bell / bell.sum(), "same")) * PERIOD


def slow_noise(n: int, rng: np.random.Generator, std: float, noise_time: float) -> np.ndarray:
    """First-order autoregressive force of standard deviation ``std`` [N], correlated over ``noise_time`` [s], (n,)."""
    from scipy.signal import lfilter

    a = np.exp(-PERIOD / noise_time)
    start = [a * std * rng.standard_normal()]
    return lfilter([1.0], [1.0, -a], std * np.sqrt(1 - a * a) * rng.standard_normal(n), zi=start)[0]
