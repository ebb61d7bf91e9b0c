"""Masses behind one another, springs and dampers between them: their response, what they are together, what is told.

The force acts on the first mass, whose velocity is measured; springs k and dampers c lead to the next ones:

    G(s) = e^{-s delay} / (F_v + Z_1),    Z_i = m_i s + 1 / (1/(k_i/s + c_i) + 1/Z_{i+1}),    Z_n = m_n s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.two_mass import linear_coupling

MISSED = 5.0  # deviations of misfit from which on a chain is none of the response
VAGUE = 10.0  # relative deviation from which on a parameter is not determined
CERTAINLY = 3.0  # deviations below 0 from which on a friction or a delay cannot be


@dataclass(frozen=True, eq=False)
class MassChain:
    """Masses [kg] (n,), springs [N/m] and dampers [N/(m/s)] (n - 1,), viscous friction [N/(m/s)], delay [s].

    ``covariance`` is that of the logarithms of masses, springs and dampers, then of friction and delay; ``misfit`` the
    rms of the residuals over the deviations of the data; ``criterion`` that of Schwarz for each number of masses tried.
    """

    masses: np.ndarray
    springs: np.ndarray
    dampers: np.ndarray
    viscous: float
    delay: float
    covariance: np.ndarray
    misfit: float
    criterion: tuple[float, ...] = ()

    @cached_property
    def theta(self) -> np.ndarray:
        """Logarithms of masses, springs and dampers, then friction and delay."""
        logs = np.log(np.concatenate([self.masses, self.springs, self.dampers]))
        return np.concatenate([logs, [self.viscous, self.delay]])

    def response(self, w: np.ndarray) -> np.ndarray:
        """Force to velocity at ``w`` (n,) [rad/s]."""
        return chain_response(self.theta, self.masses.size, 1j * np.asarray(w))

    @property
    def label(self) -> str:
        """How many masses."""
        return ("one mass", "two masses", "three masses")[self.masses.size - 1]

    @property
    def effect(self) -> dict[str, Any] | None:
        """The ``[[effects]]`` table of the coupling between two masses; None for another number."""
        if self.masses.size != 2:
            return None
        values = self.parameters
        return linear_coupling(values["frequency"][0], values["damping"][0], values["share"][0])

    def on(self, axis: Axis) -> Axis:
        """``axis`` with mass, viscous friction and coupling as the response has them; of three masses not the coupling.

        Its drive, with whatever delay and back-EMF it has, stays as it is: what that brakes is part of the response's.
        """
        values, effect = self.parameters, self.effect
        kept = [one for one in axis.effects if effect is None or one.kind != effect["kind"]]
        mechanics = {"mass": values["mass"][0], "viscous": max(values["viscous"][0] - axis.drive.braking, 0.0)}
        return axis.replace(mechanics=mechanics, effects=[*kept, *([effect] if effect else [])])

    @property
    def parameters(self) -> dict[str, tuple[float, float, str]]:
        """Name, value, standard deviation and unit: of two masses those of the effect of a coupling too."""
        n = self.masses.size
        found = {
            "mass": (*self._of(lambda theta: float(np.sum(np.exp(theta[:n])))), "kg"),
            "viscous": (*self._of(lambda theta: theta[-2]), "N/(m/s)"),
            "delay": (*self._of(lambda theta: theta[-1]), "s"),
        }
        if n == 2:
            for i, name in enumerate(("frequency", "damping", "share")):
                found[name] = (*self._of(lambda theta, i=i: coupling_of(theta)[i]), ("Hz", "", "")[i])
        if n > 2:
            units = ("kg", "N/m", "N/(m/s)")
            for start, name, unit in zip((0, n, 2 * n - 1), ("mass", "spring", "damper"), units, strict=True):
                for i in range(n if name == "mass" else n - 1):
                    found[f"{name}_{i + 1}"] = (*self._of(lambda theta, k=start + i: float(np.exp(theta[k]))), unit)
            for i in range(n - 1):
                found[f"resonance_{i + 1}"] = (*self._of(lambda theta, i=i: float(natural(theta, n, 0)[i])), "Hz")
                found[f"antiresonance_{i + 1}"] = (*self._of(lambda theta, i=i: float(natural(theta, n, 1)[i])), "Hz")
        return found

    def determines(self, name: str) -> bool:
        """Whether the response says anything of a parameter: of what is positive, its size."""
        value, std, _ = self.parameters[name]
        return bool(np.isfinite(std)) and (name in ("viscous", "delay") or std < VAGUE * value)

    def _of(self, quantity: Callable[..., float]) -> tuple[float, float]:
        """A function of the parameters and its deviation, to first order."""
        steps = np.sqrt(np.diag(self.covariance)) * 1e-3 + 1e-300
        units = np.eye(steps.size)
        slope = np.array(
            [
                (quantity(self.theta + h * e) - quantity(self.theta - h * e)) / (2.0 * h)
                for h, e in zip(steps, units, strict=True)
            ]
        )
        with np.errstate(over="ignore", invalid="ignore"):
            std = float(np.sqrt(slope @ self.covariance @ slope))
        return float(quantity(self.theta)), std if np.isfinite(std) else np.inf

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against the chain: a response that it misses, friction or a delay that cannot be."""
        words = []
        if self.misfit > MISSED:
            words.append(
                f"{self.label} with a delay miss the response by {self.misfit:.2g} deviations, expected about 1: their "
                "values and intervals say nothing"
            )
        values = self.parameters
        for name, what in (("viscous", "friction that falls with speed"), ("delay", "a force before its command")):
            value, std, _ = values[name]
            if value < -CERTAINLY * std:
                words.append(
                    f"{self.label}: found a {name} {-value / std:.3g} deviations below 0, expected at least 0: {what}; "
                    "check sign and unit of the command, and the computation delay of the axis"
                )
        return tuple(words)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "masses": self.masses.size,
            "effect": self.effect,
            "parameters": {
                name: {"value": value, "std": std, "unit": unit} for name, (value, std, unit) in self.parameters.items()
            },
            "misfit": self.misfit,
            "criterion": list(self.criterion),
            "warnings": list(self.warnings),
        }


def chain_response(theta: np.ndarray, n: int, s: np.ndarray) -> np.ndarray:
    """Force to velocity (..., m) at ``s`` (m,) [rad/s] of ``n`` masses; ``theta`` (..., p) as in :class:`MassChain`."""
    masses, springs, dampers = (np.moveaxis(part, -1, 0)[..., None] for part in split(theta, n))
    impedance = masses[-1] * s
    for mass, spring, damper in zip(masses[-2::-1], springs[::-1], dampers[::-1], strict=True):
        impedance = mass * s + 1.0 / (1.0 / (spring / s + damper) + 1.0 / impedance)
    return np.exp(-s * theta[..., -1:]) / (theta[..., -2:-1] + impedance)


def split(theta: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, springs and dampers of ``theta`` (..., p)."""
    values = np.exp(np.clip(theta[..., :-2], -200.0, 200.0))
    return values[..., :n], values[..., n : 2 * n - 1], values[..., 2 * n - 1 :]


def coupling_of(theta: np.ndarray) -> tuple[float, float, float]:
    """Resonance [Hz] and damping of two free masses, and the share of the second."""
    masses, springs, dampers = split(theta, 2)
    total = float(np.sum(masses))
    reduced = float(np.prod(masses)) / total
    w = float(np.sqrt(springs[0] / reduced))
    return w / (2.0 * np.pi), float(dampers[0]) / (2.0 * reduced * w), float(masses[1]) / total


def natural(theta: np.ndarray, n: int, held: int) -> np.ndarray:
    """Natural frequencies [Hz] of the free chain without its rest, or with the first mass ``held``: antiresonances."""
    masses, springs, _ = split(theta, n)
    stiffness = np.zeros((n, n))
    for i, spring in enumerate(springs):
        stiffness[i : i + 2, i : i + 2] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
    root = 1.0 / np.sqrt(masses[held:])
    squares = np.linalg.eigvalsh(stiffness[held:, held:] * root[:, None] * root)
    return np.sqrt(np.maximum(squares[1 - held :], 0.0)) / (2.0 * np.pi)
