"""One effect at the operating point of a linear plant: in steady motion, from position 0 on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from emps_design.effects.effect import COULOMB, Effect, Kernel

PLACES = 64  # along one repeat of an effect
SETTLED = 2.0  # s, after which own states that Newton does not bring to rest are near it
CORNER = 1e-3  # relative difference of the slopes on either side of a place, above which it is a corner


class Member:
    """One effect at the operating point: its hooks called as plain functions, differentiated by central differences."""

    def __init__(self, effect: Effect, p: np.ndarray, b: np.ndarray):
        self.effect, self.p, self.b = effect, p, b
        self.x = np.array(effect.initial(0.0, p, b) if effect.initial else (), dtype=float)
        self.settled = True
        names = [parameter.name for parameter in effect.parameters]
        self.repeat = float(p[names.index(effect.repeats)]) if effect.repeats else 0.0
        self.places = np.arange(PLACES) / PLACES * self.repeat if effect.repeats else np.zeros(1)

    def settle(self, v: float, tau: float) -> None:
        """Bring the own states to rest at the operating point; keep the initial ones where that fails."""
        if self.effect.rate is None:
            return
        for begin in (lambda: self.x, lambda: self._after(SETTLED, v, tau)):  # a load within its play moves first
            x = self._at_rest(begin(), v, tau)
            scale = np.abs(self._rate_jacobian(v, tau, x)) @ np.abs(x) + abs(v) + 1e-12
            self.settled = bool(np.all(np.isfinite(x)) and np.all(np.abs(self._rate(0.0, v, tau, x)) <= 1e-6 * scale))
            if self.settled:
                self.x = x
                return

    def _at_rest(self, x: np.ndarray, v: float, tau: float) -> np.ndarray:
        """Own states that do not change (Newton from ``x``)."""
        for _ in range(50):
            step = np.linalg.lstsq(self._rate_jacobian(v, tau, x), -self._rate(0.0, v, tau, x), rcond=None)[0]
            x = x + step
            if np.all(np.abs(step) <= 1e-12 + 1e-9 * np.abs(x)):
                break
        return x

    def _after(self, seconds: float, v: float, tau: float) -> np.ndarray:
        """Own states after so long at the operating point."""
        from scipy.integrate import solve_ivp

        return solve_ivp(lambda t, x: self._rate(0.0, v, tau, x), (0.0, seconds), self.x, "LSODA", rtol=1e-6).y[:, -1]

    def force(self, q: float, v: float, tau: float, x: np.ndarray) -> float:
        """Everything the effect adds to the resisting force while sliding [N], its mean over one repeat."""
        return float(np.mean([self.force_at(q + place, v, tau, x) for place in self.places]))

    def force_at(self, q: float, v: float, tau: float, x: np.ndarray) -> float:
        """Everything the effect adds to the resisting force while sliding at ``q`` [N]."""
        arguments = (q, v, 0.0, tau, x, self.p, self.b)
        total = self.effect.force(*arguments) if self.effect.force else 0.0
        if self.effect.dry:
            total += np.sign(v) * self.effect.dry(*arguments)
        if self.effect.takes_dry:
            total -= np.sign(v) * self.b[COULOMB]
        return float(total)

    def sensor(self, q: float, v: float, tau: float, x: np.ndarray) -> float:
        """What the effect adds to the encoder's reading [m]."""
        return self._hook(self.effect.sensor, q, v, tau, x)

    def inertia(self, v: float, tau: float) -> float:
        """What the effect adds to the mass [kg]."""
        return self._hook(self.effect.inertia, 0.0, v, tau, self.x)

    def delay(self, v: float, tau: float) -> float:
        """By how much the effect delays the voltage [s]."""
        return self._hook(self.effect.delay, 0.0, v, tau, self.x)

    def lag(self, v: float, tau: float) -> float:
        """The time constant [s] with which the motor force follows the voltage."""
        return self._hook(self.effect.lag, 0.0, v, tau, self.x)

    def _hook(self, hook: Kernel | None, q: float, v: float, tau: float, x: np.ndarray) -> float:
        return 0.0 if hook is None else float(hook(q, v, 0.0, tau, x, self.p, self.b))

    def slopes(self, function: Callable[..., float], v: float, tau: float) -> tuple[float, float, float, np.ndarray]:
        """Slopes of ``function(q, v, tau, x)`` over each of the four."""
        return (
            self._over_position(lambda q: function(q, v, tau, self.x)),
            _slope(lambda value: function(0.0, value, tau, self.x), v, 1e-4 * abs(v)),
            _slope(lambda value: function(0.0, v, value, self.x), tau, 1e-3),
            np.array([_slope(lambda value: function(0.0, v, tau, value), *at) for at in self._each_state()]),
        )

    def rate_slopes(self, v: float, tau: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Slopes of the derivatives of the own states over position, velocity, motor force and the states."""
        return (
            _slope(lambda q: self._rate(q, v, tau, self.x), 0.0, 1e-6),
            _slope(lambda value: self._rate(0.0, value, tau, self.x), v, 1e-4 * abs(v)),
            _slope(lambda value: self._rate(0.0, v, value, self.x), tau, 1e-3),
            self._rate_jacobian(v, tau, self.x),
        )

    def _over_position(self, function: Callable[[float], float]) -> float:
        """Slope of ``function(q)`` [../m]: none where it repeats along the travel, the flatter side's at a corner."""
        if self.repeat:
            return 0.0
        here, step = function(0.0), 1e-6
        before, after = (here - function(-step)) / step, (function(step) - here) / step
        if abs(after - before) > CORNER * max(abs(before), abs(after)):
            return min(before, after, key=abs)
        return 0.5 * (before + after)

    def steepest(self, v: float, tau: float) -> float:
        """Largest slope over position [N/m] of a force that repeats along the travel; 0 for any other."""
        if not self.repeat or not (self.effect.force or self.effect.dry):
            return 0.0
        step = 1e-4 * self.repeat
        slopes = [_slope(lambda q: self.force_at(q, v, tau, self.x), place, step) for place in self.places]
        return float(np.max(np.abs(slopes)))

    def left_out(self, v: float, tau: float) -> list[str]:
        """What the slopes of this effect do not show."""
        effect, warnings = self.effect, []
        if effect.guard is not None or effect.jump_time is not None:
            warnings.append(f"{effect.name}: not smooth, counted by its slope in steady motion at {v:g} m/s only")
        if effect.command is not None:
            warnings.append(f"{effect.name}: a signal added to the voltage, left out of the linear design")
        if not self.settled:
            warnings.append(f"{effect.name}: has no steady state at {v:g} m/s, linearised at its initial one")
        if self.repeat:
            where = f"{effect.name}: repeats every {self.repeat:.4g} m, {abs(v) / self.repeat:.4g} Hz at {v:g} m/s"
            at_place, what = self.force_at, "a disturbance of +-{:.3g} N, not a spring"
            if effect.sensor is not None:
                at_place, what = self.sensor, "an error of the reading of +-{:.3g} m, not a gain"
            size = 0.5 * float(np.ptp([at_place(q, v, tau, self.x) for q in self.places]))
            warnings.append(f"{where}; its slope averages out there: in the linear design it is {what.format(size)}")
        return warnings

    def _rate(self, q: float, v: float, tau: float, x: np.ndarray) -> np.ndarray:
        dx = np.zeros(self.x.size)
        if self.effect.rate is not None:
            self.effect.rate(q, v, 0.0, tau, x, self.p, self.b, self.b[COULOMB], dx)
        return dx

    def _rate_jacobian(self, v: float, tau: float, x: np.ndarray) -> np.ndarray:
        columns = [_slope(lambda value: self._rate(0.0, v, tau, value), *at) for at in self._each_state(x)]
        return np.array(columns).T.reshape(self.x.size, self.x.size)

    def _each_state(self, x: np.ndarray | None = None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (x, step vector) for a central difference in each own state."""
        x = self.x if x is None else x
        for place in range(x.size):
            step = np.zeros(x.size)
            step[place] = max(1e-9, 1e-4 * abs(x[place]))
            yield x, step


def _slope(function: Callable[[Any], Any], at: Any, step: Any) -> Any:
    """Central difference of ``function`` at ``at``; ``step`` is a number, or a vector with one entry that is not 0."""
    return (function(at + step) - function(at - step)) / (2.0 * np.max(step))
