"""Axes unlike the demo, and short records of them: slow force noise, errors of the encoder, rests.

None of them, and no seed from :data:`FIRST_SEED` on, was looked at while the estimators were made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.axis import Axis
from emps_design.laws import Law
from emps_design.records import Record
from emps_design.simulation import Plant

FIRST_SEED = 10_000


@dataclass(frozen=True)
class Case:
    """An axis under a position controller, what disturbs it, and how it is moved; SI.

    ``bandwidth`` [rad/s] of the velocity loop; ``resolution`` of the encoder and standard deviation ``encoder_noise``
    of what it adds before it rounds [m]; ``push`` [N] of the force noise and its correlation time ``push_time`` [s];
    ``rest`` [s] between two strokes, ``laps`` of two strokes at each of three speeds; ``any_phase`` moves each record
    against the steps of the encoder.
    """

    name: str
    mechanics: tuple[float, float, float, float]
    rate: float
    bandwidth: float
    speed: float
    acceleration: float
    push: float
    push_time: float
    resolution: float = 0.0
    encoder_noise: float = 0.0
    rest: float = 0.0
    laps: int = 1
    any_phase: bool = False

    def axis(self) -> Axis:
        """The axis, with a force gain of 1 N/V."""
        mass, viscous, coulomb, offset = self.mechanics
        return Axis(
            name=self.name,
            mechanics={"mass": mass, "viscous": viscous, "coulomb": coulomb, "offset": offset},
            drive={"force_gain": 1.0, "voltage_limit": 100.0 * (mass * self.acceleration + coulomb)},
            sampling={"period": 1.0 / self.rate, "encoder_resolution": self.resolution},
            controller={
                "kind": "position_pd",
                "kp": 0.25 * self.bandwidth,
                "kv": mass * self.bandwidth - viscous,
            },
        )

    def reference(self) -> np.ndarray:
        """Trapezoids of velocity with rounded corners, forth and back, (n,) [m]."""
        period = 1.0 / self.rate
        settle = round(20.0 / self.bandwidth / period)
        cruise, pause = round(2.0 * self.speed / self.acceleration / period), round(self.rest / period)
        pieces = [np.zeros(settle)]
        for speed in self.speed * np.array((1.0, 0.5, 0.25) * self.laps):
            ramp = np.linspace(0.0, speed, max(4, round(speed / self.acceleration / period)))
            stroke = np.concatenate([ramp, np.full(cruise, speed), ramp[::-1], np.zeros(pause)])
            pieces += [stroke, -stroke]
        bell = np.hanning(max(5, round(0.15 * self.speed / self.acceleration / period)))
        velocity = np.convolve(np.concatenate([*pieces, np.zeros(settle)]), bell / bell.sum(), "same")
        return np.cumsum(velocity) * period


CASES = (
    Case("0.05 kg, 4 kHz, 0.5 um", (0.05, 0.15, 0.06, 0.01), 4e3, 400.0, 0.4, 12.0, 3e-3, 0.01, 5e-7, laps=3),
    Case("0.6 kg, 4 kHz, 1 um", (0.6, 3.0, 0.9, -0.2), 4e3, 250.0, 0.25, 3.0, 0.03, 0.02, 1e-6, rest=0.05, laps=2),
    Case("3 kg, 2 kHz, 2 um rms", (3.0, 10.0, 2.0, 0.3), 2e3, 150.0, 0.5, 3.0, 0.1, 0.03, 1e-7, 2e-6, 0.1, 2),
    Case("25 kg, 1 kHz, 20 um", (25.0, 90.0, 4.0, 0.5), 1e3, 80.0, 0.3, 1.2, 0.2, 0.05, 2e-5, rest=0.1),
    Case("60 kg, 500 Hz, rests of 1 s", (60.0, 30.0, 12.0, 0.0), 500.0, 60.0, 0.15, 0.6, 0.5, 0.05, 1e-7, rest=1.0),
    Case("300 kg, 1 kHz, viscous", (300.0, 2500.0, 60.0, 8.0), 1e3, 60.0, 0.2, 0.5, 4.0, 0.05, 1e-6, rest=0.2),
    Case("2 t, 250 Hz, 5 um rms", (2e3, 900.0, 150.0, -40.0), 250.0, 20.0, 0.4, 0.4, 8.0, 0.1, 1e-6, 5e-6, 0.3, 2),
    Case("20 t, 100 Hz, 50 um", (2e4, 1.2e4, 1.5e3, 200.0), 100.0, 8.0, 0.5, 0.2, 60.0, 0.3, 5e-5, rest=0.5, laps=2),
)
# Coarse encoders and hardly any other noise: their steps are what the estimates are off by.
QUIET = (
    Case(
        "0.4 kg, 4 kHz, 5 um, quiet", (0.4, 2.0, 0.5, 0.1), 4e3, 120.0, 0.2, 2.5, 2e-3, 0.03, 5e-6, laps=2,
        any_phase=True,
    ),
    Case(
        "40 kg, 1 kHz, 50 um, quiet", (40.0, 150.0, 8.0, -1.0), 1e3, 40.0, 0.15, 0.9, 0.05, 0.05, 5e-5, rest=0.1,
        any_phase=True,
    ),
    Case(
        "500 kg, 500 Hz, 100 um, quiet", (500.0, 900.0, 50.0, 5.0), 500.0, 25.0, 0.12, 0.4, 0.3, 0.1, 1e-4, rest=0.3,
        any_phase=True,
    ),
)  # fmt: skip


def encoder_pd(k, reference, q, f_ext, limit, gains, memory):
    """The two-tap position controller on what the encoder says: its noise (from gains[4] on), then its steps."""
    q = q + gains[4 + k]
    if gains[3] > 0.0:
        q = gains[3] * np.floor(q / gains[3] + 0.5)
    if k == 0:
        memory[0] = q
        memory[1] = q
    v = 0.5 * (q - memory[1]) * gains[2]
    memory[1] = memory[0]
    memory[0] = q
    return gains[0] * (reference - q) - gains[1] * v


class Records:
    """Records of one case by seed; what they share is made once."""

    def __init__(self, case: Case):
        self.case, self.axis, self.reference = case, case.axis(), case.reference()
        self.plant = Plant.of(self.axis)

    def __call__(self, seed: int) -> Record:
        """One record; the same seed gives the same bits."""
        from scipy.signal import lfilter

        case, n, period = self.case, self.reference.size, self.axis.sampling.period
        random = np.random.default_rng(seed)
        decay = np.exp(-period / case.push_time)
        white = case.push * np.sqrt(1.0 - decay**2) * random.standard_normal(n)
        push = lfilter([1.0], [1.0, -decay], white, zi=[decay * case.push * random.standard_normal()])[0]
        noise = case.encoder_noise * random.standard_normal(n)
        kp, kv = (self.axis.controller.parameters[name] for name in ("kp", "kv"))
        gains = np.array([kp * kv, kv, 1.0 / period, case.resolution])
        law = Law(encoder_pd, np.concatenate([gains, noise]), 2)
        reference = self.reference + (case.resolution * random.random() if case.any_phase else 0.0)
        run = self.plant.closed_loop(reference, disturbance=push, law=law, quantise=False)
        q = case.resolution * np.floor((run.position + noise) / case.resolution + 0.5)
        return Record(t=run.t, q_ref=reference, q=q, u=run.u, period=period, name=f"{case.name}, {seed}")
