"""Records of the embedded machine with slow force noise, as real ones have it."""

import numpy as np

from emps_design.records import Record
from emps_design.simulation import Plant

SPEEDS = (0.04, 0.08, 0.12)  # m/s
PERIOD = 1e-3  # s
VOLTAGE_NOISE = 4e-3  # V


def noisy_record(plant: Plant, seed: int, laps: int = 2, std: float = 1.0, noise_time: float = 0.1) -> Record:
    """A record of ``plant`` along :func:`trajectory`, with slow force noise of ``std`` [N] and noise of the voltage."""
    rng = np.random.default_rng(seed)
    q_ref = trajectory(laps)
    push = slow_noise(q_ref.size, rng, std, noise_time) if std > 0 else None
    run = plant.closed_loop(q_ref, disturbance=push, voltage_noise=VOLTAGE_NOISE * rng.standard_normal(q_ref.size))
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=PERIOD, name=f"simulated-{seed}")


def trajectory(laps: int = 2, rest: float = 0.06) -> np.ndarray:
    """Trapezoids of velocity, forth and back at three speeds, with jerk over 40 ms and ``rest`` [s], (n,) [m]."""
    pieces = [np.zeros(300)]
    for speed in SPEEDS * laps:
        ramp, cruise = int(speed / 0.5 / PERIOD), int(1.4 / PERIOD) - int(speed / 0.5 / PERIOD)
        for sign in (1.0, -1.0):
            up = sign * np.linspace(0.0, speed, ramp)
            pieces += [up, np.full(cruise, sign * speed), up[::-1], np.zeros(round(rest / PERIOD))]
    bell = np.hanning(40)
    return np.cumsum(np.convolve(np.concatenate(pieces), bell / bell.sum(), "same")) * PERIOD


def slow_noise(n: int, rng: np.random.Generator, std: float, noise_time: float) -> np.ndarray:
    """First-order autoregressive force of standard deviation ``std`` [N], correlated over ``noise_time`` [s], (n,)."""
    from scipy.signal import lfilter

    a = np.exp(-PERIOD / noise_time)
    start = [a * std * rng.standard_normal()]
    return lfilter([1.0], [1.0, -a], std * np.sqrt(1 - a * a) * rng.standard_normal(n), zi=start)[0]
