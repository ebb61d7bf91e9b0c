"""Noise and nonlinear distortion told apart, from the lines of the base period that were left without excitation.

A linear plant answers there with noise only, known from the lines between. Where only odd lines are excited, a
nonlinearity that is even in the motion answers at even lines and an odd one, such as dry friction that reverses, at odd
lines, those left out among them. Feedback makes the command move there too, so the linear answer to it is taken off
first. Source: R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapter 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.frequency_response.periodic import Spectra

SEEN = 2.0  # times the noise power from which on a distortion counts
CHANCE = 4.0  # or so many deviations of what the noise power differs by by chance, where that is less
FEWEST = 4  # lines of a kind


@dataclass(frozen=True, eq=False)
class Distortion:
    """Amplitudes relative to the linear answer: of odd and even distortion and of the noise of one period.

    None where no line of that kind was left without excitation. ``odd_lines`` (m,) [Hz] and ``odd_power`` (m,),
    relative, noise taken off, say where the odd distortion is.
    """

    noise: float
    odd: float | None
    even: float | None
    odd_lines: np.ndarray
    odd_power: np.ndarray

    def odd_variance(self, frequency: np.ndarray, power: np.ndarray) -> np.ndarray:
        """Relative variance (n,) that odd distortion adds to a response; more averages do not lower it.

        ``power`` (n,) of the motion: what moves less than the lines beside it is distorted the more.
        """
        if self.odd is None or not self.odd > 0.0:
            return np.zeros(frequency.size)
        from scipy.ndimage import median_filter

        half = 4
        near = np.clip(np.arange(self.odd_lines.size)[:, None] + np.arange(-half, half + 1), 0, self.odd_lines.size - 1)
        smooth = np.maximum(np.mean(self.odd_power[near], axis=1), 0.0)
        usual = median_filter(power, 2 * half + 1, mode="nearest")
        return np.interp(frequency, self.odd_lines, smooth) * np.maximum(usual / power, 1.0)

    @property
    def words(self) -> list[str]:
        """What to say of it."""
        found = []
        for name, level in (("odd", self.odd), ("even", self.even)):
            if level is not None and level > 0.05:
                found.append(
                    f"{name} nonlinear distortion of {100 * level:.2g} % of the linear answer, noise of one period "
                    f"{100 * self.noise:.2g} %"
                )
        return found

    def to_dict(self) -> dict[str, Any]:
        """The three levels."""
        return {"noise": self.noise, "odd": self.odd, "even": self.even}


def distortion_of(found: list[Spectra], excited: np.ndarray, step: float, g: np.ndarray) -> Distortion | None:
    """Compare the lines without excitation with noise and with the linear answer at the excited lines beside them.

    ``excited`` (m,) says which lines of the base period are, ``step`` [Hz] apart; ``g`` is increment over command
    there. None where every line is.
    """
    line = found[0].line
    inside = (line > line[excited][0]) & (line < line[excited][-1]) & ~excited
    if not np.any(inside):
        return None
    nearest = np.array([int(np.argmin(np.abs(line[excited] - k))) for k in line[inside]])
    there = g[nearest]
    power, noise, linear = np.zeros((3, there.size))
    for one in found:
        rest = one.z[inside, 0] - there * one.z[inside, 1]
        C = one.noise[inside]
        own = C[:, 0, 0].real + np.abs(there) ** 2 * C[:, 1, 1].real - 2.0 * (C[:, 0, 1] * there.conj()).real
        power = power + np.abs(rest) ** 2
        noise = noise + own
        linear = linear + np.abs(there * one.z[excited, 1][nearest]) ** 2
    odd = line[inside] % 2 == 1
    only_odd = bool(np.all(line[excited] % 2 == 1))

    def level(which: np.ndarray) -> float | None:
        if np.count_nonzero(which) < FEWEST:
            return None
        share = (power - noise)[which] / linear[which]
        by_noise = noise[which] / linear[which]
        # The mean of so many powers, each of a line and a pass, differs by chance by one over the root of their number.
        count = len(found) * float(np.sum(by_noise) ** 2 / np.sum(by_noise**2))
        seen = np.mean(power[which] / linear[which]) > min(SEEN, 1.0 + CHANCE / np.sqrt(count)) * np.mean(by_noise)
        return float(np.sqrt(max(np.mean(share), 0.0))) if seen else 0.0

    return Distortion(
        float(np.sqrt(np.mean(noise * np.mean([one.periods for one in found]) / linear))),
        level(odd),
        level(~odd) if only_odd else None,
        step * line[inside][odd],
        ((power - noise) / linear)[odd],
    )
