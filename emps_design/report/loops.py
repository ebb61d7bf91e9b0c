"""The loops of a design as curves ready to draw: responses that the library gives, on one frequency grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from emps_design.report.style import BLUE, RED

if TYPE_CHECKING:
    from emps_design.control.loop.margins import Margins
    from emps_design.control.velocity.design import VelocityLoopDesign


@dataclass(frozen=True)
class LoopCurve:
    """One open loop: its label and colour, frequencies ``w`` [rad/s], complex response ``L``, and its margins."""

    label: str
    color: str
    w: np.ndarray
    L: np.ndarray
    margins: Margins
    response: Callable[[np.ndarray], np.ndarray]

    @property
    def magnitude_db(self) -> np.ndarray:
        """Magnitude [dB]."""
        return 20.0 * np.log10(np.abs(self.L))

    @property
    def phase_deg(self) -> np.ndarray:
        """Phase [deg], unwrapped from the low-frequency end, which lies within (-270, 90]."""
        phase = np.degrees(np.unwrap(np.angle(self.L)))
        return phase - 360.0 * np.ceil((phase[0] - 90.0) / 360.0)


@dataclass(frozen=True)
class BrokenLoop:
    """One place where the loop is broken, continuous and sampled."""

    title: str
    continuous: LoopCurve
    sampled: LoopCurve

    @property
    def curves(self) -> tuple[LoopCurve, LoopCurve]:
        """Both readings, continuous first."""
        return self.continuous, self.sampled


def frequency_grid(design: VelocityLoopDesign, points: int = 400) -> np.ndarray:
    """Frequencies [rad/s] from two decades below the crossover to ten times the Nyquist frequency or above it."""
    nyquist = np.pi / design.axis.sampling.period
    high = max(nyquist, 30.0 * design.crossover)
    return np.geomspace(0.02 * design.crossover, high, points)


def broken_loops(design: VelocityLoopDesign, points: int = 400) -> tuple[BrokenLoop, BrokenLoop]:
    """Return the loop broken at the velocity error and at the plant input, each continuous and sampled.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> error, plant = broken_loops(design_velocity_loop(machine("emps2018"), 100.0, phase_margin_deg=60.0))
    >>> round(plant.sampled.margins.phase_margin_deg, 1)
    39.2
    """
    w = frequency_grid(design, points)
    nyquist = np.pi / design.axis.sampling.period
    # At Nyquist itself the response is real and its phase jumps; the curve stops a hair below.
    below = np.append(w[w < 0.998 * nyquist], 0.998 * nyquist)
    error, plant = design.velocity_error_loop(), design.plant_input_loop()

    def curve(label: str, color: str, grid: np.ndarray, response: Callable, margins: Margins) -> LoopCurve:
        return LoopCurve(label, color, grid, response(grid), margins, response)

    sampled = design.sampled
    return (
        BrokenLoop(
            "broken at the velocity error",
            curve("continuous", BLUE, w, lambda omega: error(1j * np.asarray(omega)), design.velocity_error),
            curve("sampled", RED, below, sampled.velocity_error_response, sampled.velocity_error),
        ),
        BrokenLoop(
            "broken at the plant input",
            curve("continuous", BLUE, w, lambda omega: plant(1j * np.asarray(omega)), design.plant_input),
            curve("sampled", RED, below, sampled.plant_input_response, sampled.margins),
        ),
    )
