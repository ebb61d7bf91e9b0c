"""A servo axis in closed loop, written straight from the contract's equations; shares no code with the package."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass
class Loop:
    """A controller by its equations, on a mass with friction; commands are forces."""

    kp: float | None = 30.0
    every: int = 1
    kv: float = 400.0
    ti: float | None = None
    form: str = "pi"
    share: float = 0.0
    acceleration: float = 0.0
    coulomb: float = 0.0
    lowpass: float | None = None
    notches: tuple[tuple[float, float, float], ...] = ()
    limit: float = math.inf
    two_tap: bool = False
    estimator: tuple[str, float] | None = None  # ("slope", points), ("filtered", Hz), ("tracking", rad/s)
    delay: int = 0
    proportional: bool = False  # u = kp (r - q), nothing else
    velocity_reference: bool = False
    profile: bool = False  # feeds forward the velocity and acceleration that the reference has at the sample
    period: float = 1e-3
    step: float = 1e-7  # of the encoder
    mass: float = 5.0
    friction: tuple[float, float] = (20.0, 6.0)
    noise: float = 0.0  # of the recorded command
    seed: int = 0
    samples: int = 6000

    def run(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Reference, position and recorded command, (samples,) each."""
        T, rng = self.period, np.random.default_rng(self.seed)
        r = self._reference()
        q_of, x, speed = [], 0.0, 0.0
        q1 = q2 = 0.0
        r1 = r2 = 0.0 if self.velocity_reference else r[0]
        held = integral = 0.0
        sections = [_section(*one, T) for one in ([("l", self.lowpass)] if self.lowpass else [])]
        sections += [_section("n", *one, T) for one in self.notches]
        memory = [[0.0, 0.0, 0.0, 0.0] for _ in sections]
        commands: list[float] = []
        seen, estimate = [0.0] * 64, _Estimate(self.estimator, T)
        pushes = rng.normal(0.0, 2.0, self.samples // 50 + 1)
        own, own_steps = (self._speed(np.arange(self.samples) + ahead) for ahead in (0.0, 1e-3))
        for k in range(self.samples):
            q = round(x / self.step) * self.step
            v = (q - q2) / (2.0 * T) if self.two_tap else (q - q1) / T
            if self.estimator:
                seen = [*seen[1:], q]
                v = estimate(seen)
            if self.velocity_reference:
                vr, ar = r[k], (r[k] - r1) / T
            else:
                vr, ar = (r[k] - r1) / T, (r[k] - 2.0 * r1 + r2) / T**2
                if self.kp is not None and k % self.every == 0:
                    held = self.kp * (r[k] - q)
            if self.profile:
                vr, ar = own[k], (own_steps[k] - own[k]) / (1e-3 * T)
            share = 1.0 if self.velocity_reference else self.share
            e = held + share * vr - v
            wanted = integral + (self.kv * T / self.ti * e if self.ti else 0.0)
            w = wanted + (-self.kv * v if self.form == "ip" else self.kv * e)
            w += self.acceleration * ar + self.coulomb * float(np.sign(vr))
            if self.proportional:
                w = self.kp * (r[k] - q)
            for (b, a), m in zip(sections, memory, strict=True):
                y = b[0] * w + b[1] * m[0] + b[2] * m[1] - a[1] * m[2] - a[2] * m[3]
                m[:] = [w, m[0], y, m[2]]
                w = y
            u = min(max(w, -self.limit), self.limit)
            if u == w:
                integral = wanted
            q2, q1, r2, r1 = q1, q, r1, r[k]
            q_of.append(q)
            commands.append(u)
            force = commands[max(k - self.delay, 0)] + pushes[k // 50]
            for _ in range(4):
                drag = self.friction[0] * speed + self.friction[1] * math.tanh(speed / 1e-3)
                speed += T / 4 * (force - drag) / self.mass
                x += T / 4 * speed
        recorded = np.array(([0.0] * self.delay + commands)[: self.samples])
        return r, np.array(q_of), recorded + rng.normal(0.0, self.noise, self.samples)

    def _reference(self) -> np.ndarray:
        """The way along :meth:`_speed`; that speed itself where it is the reference."""
        k = np.arange(self.samples)
        speed = self._speed(k)
        if self.velocity_reference:
            return speed
        steps = speed * self.period
        if self.profile:  # Simpson: as good as the integral
            steps[1:] = self.period / 6.0 * (speed[:-1] + 4.0 * self._speed(k[1:] - 0.5) + speed[1:])
        return np.round(np.cumsum(steps) / 1e-9) * 1e-9

    def _speed(self, k: np.ndarray) -> np.ndarray:
        """Strokes of several speeds that start and stop smoothly, with a rest in between, at samples ``k`` (n,)."""
        t = k / (self.samples - 1)
        speed = 0.3 * np.sin(2.0 * np.pi * 2.0 * t) + 0.15 * np.sin(2.0 * np.pi * 9.0 * t)
        away = np.clip(np.minimum(t, np.abs(t - 0.5) - 0.03) / 0.05, 0.0, 1.0)
        return speed * np.sin(0.5 * np.pi * away) ** 2 * 2.0 / (self.samples * self.period)


class _Estimate:
    """A velocity from the last positions: a line through them, a low-pass behind a difference, a tracking loop."""

    def __init__(self, estimator, period):
        self.kind, self.number = estimator or ("", 0.0)
        self.period, self.before, self.v, self.x = period, 0.0, 0.0, 0.0

    def __call__(self, seen):
        T, q = self.period, seen[-1]
        if self.kind == "slope":
            own = seen[-int(self.number) :]
            middle = 0.5 * (len(own) - 1)
            squares = sum((i - middle) ** 2 for i in range(len(own)))
            return sum((i - middle) * x for i, x in enumerate(own)) / (squares * T)
        if self.kind == "filtered":
            half, difference = math.pi * self.number * T, (q - seen[-2]) / T  # of 2/T (1 - z^-1)/(1 + z^-1) = s
            self.v = (half * (difference + self.before) + (1.0 - half) * self.v) / (1.0 + half)
            self.before = difference
            return self.v
        pole = math.exp(-self.number * T)
        error = q - self.x - T * self.v
        self.x += T * self.v + (1.0 - pole**2) * error
        self.v += (1.0 - pole) ** 2 / T * error
        return self.v


def _section(kind, frequency, *rest):
    """Bilinear transform without prewarping, by substituting s = 2/T (1 - z^-1)/(1 + z^-1)."""
    *shape, T = rest
    w = 2.0 * math.pi * frequency
    if kind == "l":
        top, bottom = np.poly1d([w]), np.poly1d([1.0, w])
    else:
        damping, depth = shape
        top = np.poly1d([1.0, 2.0 * depth * damping * w, w * w])
        bottom = np.poly1d([1.0, 2.0 * damping * w, w * w])

    def transformed(p):
        """(1 + z^-1)^2 p(s), in ascending powers of z^-1."""
        total = np.zeros(3)
        for power, one in enumerate(p.coeffs[::-1]):
            factors = [[1.0, -1.0]] * power + [[1.0, 1.0]] * (2 - power)
            total += float(one) * (2.0 / T) ** power * np.convolve(*factors)
        return total

    b, a = transformed(top), transformed(bottom)
    return b / a[0], a / a[0]
