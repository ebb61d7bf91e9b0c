"""What the operator does: guide the carriage with a compliant hand, or push with a given force; then let go."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from emps_design.errors import InputError


@dataclass(frozen=True)
class Task:
    """An operator's task, sampled with the controller.

    ``push`` (n,) [N] is added by the operator, nothing from ``release`` on; ``wish`` (n,) [m] is where the hand means
    to be, nan from ``release`` on. ``hand``: its stiffness [N/m] and damping [N/(m/s)]; the force it makes is held over
    each period. The carriage is let go at sample ``release``; verdicts look at the samples from ``end`` on.
    """

    name: str
    push: np.ndarray
    wish: np.ndarray
    hand: tuple[float, float]
    release: int
    end: int
    period: float

    @property
    def time(self) -> np.ndarray:
        """Sample times [s], shape (n,)."""
        return np.arange(len(self.push)) * self.period

    @property
    def reversed(self) -> Task:
        """The same task the other way round."""
        return replace(self, push=-self.push, wish=-self.wish)

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self.push) * self.period


def guided_task(
    period: float, duration: float = 10.0, hand: tuple[float, float] = (1000.0, 100.0), scale: float = 1.0
) -> Task:
    """A hand of stiffness 1000 N/m and damping 100 N/(m/s) guides the carriage over +-0.12 m, and lets go in motion.

    The wish is 0.10 m at about 0.4 Hz plus 0.02 m at about 1 Hz, times ``scale``, faded in over half a second, with
    whole periods up to the release at half time, where it is fastest; the effort is whatever the law makes it.
    """
    if not np.isfinite(scale) or scale <= 0.0:
        raise InputError(f"scale: found {scale:g}, expected a number above 0")
    n, release, end = _samples(period, duration)
    t = np.arange(n) * period
    until = release * period
    position = sum(
        amplitude * np.sin(2 * np.pi * max(1, round(rate * until)) * t / until)
        for amplitude, rate in ((0.10, 0.4), (0.02, 1.0))
    )
    rise = np.clip(t / min(0.5, 0.5 * until), 0.0, 1.0)
    position = scale * position * rise**2 * (3.0 - 2.0 * rise)
    return Task("guided", np.zeros(n), np.where(np.arange(n) < release, position, np.nan), hand, release, end, period)


def pushed_task(period: float, duration: float = 10.0, force: float = 40.0) -> Task:
    """Pushes of ``force`` [N] to and fro with 0.25 s ramps, the last one ending at half time, as in Fig. 12.

    The force must exceed the break-away force, or nothing moves: the law compensates no Coulomb friction at rest.
    """
    if not np.isfinite(force) or force <= 0.0:
        raise InputError(f"force: found {force:g} N, expected a push of more than 0 N")
    n, release, end = _samples(period, duration)
    t = np.arange(n) * period / (release * period / 5.0)  # the plan is written for 5 s
    corners = [0.0, 0.25, 0.5, 1.5, 2.0, 3.25, 3.75, 4.75, 5.0]
    levels = [0.0, 0.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0, 0.0]
    push = force * np.interp(t, corners, levels, right=0.0)
    return Task("pushed", push, np.full(n, np.nan), (0.0, 0.0), release, end, period)


def _samples(period: float, duration: float) -> tuple[int, int, int]:
    n = round(duration / period)
    if not np.isfinite(duration) or n < 100:
        raise InputError(f"duration: found {duration:g} s, expected at least 100 periods of {period:g} s")
    return n, n // 2, n - n // 10
