"""A measured response beside the model of its axis, and beside the masses that fit it; where they differ."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.loop.transfer import transfer
from emps_design.control.plant.linear_plant import VELOCITY, linear_plant
from emps_design.frequency_response.coupling import MassChain, fit_chain
from emps_design.frequency_response.response import BAND, FrequencyResponse
from emps_design.stretches import stretches

ROOM = 0.05  # relative difference that is no matter, however certain


def axis_response(axis: Axis, frequency: np.ndarray, velocity: float = 0.1) -> np.ndarray:
    """Return force to velocity (n,) of ``axis`` at ``frequency`` (n,) [Hz].

    Its effects are linearised at ``velocity`` [m/s]. A lag of the current loop is in it, as in what is measured; hold
    and computation delay are not.

    >>> from emps_design.machines import machine
    >>> round(float(abs(axis_response(machine("emps2019"), np.array([50.0]))[0])) * 100 * np.pi, 6)  # 1/mass
    0.010514
    """
    plant = linear_plant(axis, velocity)
    s = 2j * np.pi * np.asarray(frequency)
    force_to_velocity = transfer(plant.A, plant.B, np.eye(plant.C.size)[VELOCITY], 0.0, s) / axis.drive.gain
    return force_to_velocity * np.exp(-s * plant.delay)


@dataclass(frozen=True)
class Agreement:
    """Of ``lines`` lines ``inside`` are within the 95 % circle of the data; the largest difference ``largest``
    (relative) at ``frequency`` [Hz]; ``bands`` [Hz] where it is more than the data's deviations and 5 %."""

    lines: int
    inside: int
    largest: float
    frequency: float
    bands: tuple[tuple[float, float], ...]

    @property
    def sentence(self) -> str:
        """The agreement in one line."""
        inside = f"within the 95 % circle of the data at {self.inside} of {self.lines} lines"
        if not self.bands:
            return f"the model is {inside}, and nowhere more than 5 % beyond it"
        where = ", ".join(f"{low:.4g} Hz" if low == high else f"{low:.4g} to {high:.4g} Hz" for low, high in self.bands)
        return f"the model is {inside}; it differs at {where}, most at {self.frequency:.4g} Hz, by {self.largest:.0%}"

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "lines": self.lines,
            "inside": self.inside,
            "largest": {"difference": self.largest, "frequency_hz": self.frequency},
            "bands_hz": [list(band) for band in self.bands],
        }


def agreement(response: FrequencyResponse, model: np.ndarray) -> Agreement:
    """Compare ``response`` with what a ``model`` (n,) gives at its lines.

    >>> f = np.arange(1.0, 9.0)
    >>> measured = FrequencyResponse.of(f, 1.0 / (1j * f), np.full(8, 0.01))
    >>> agreement(measured, measured.response * np.where(f == 4.0, 2.0, 1.0)).sentence
    'the model is within the 95 % circle of the data at 7 of 8 lines; it differs at 4 Hz, most at 4 Hz, by 100%'
    """
    apart = np.abs(model / response.response - 1.0)
    circle = np.maximum(BAND * response.std, ROOM)
    beyond = apart > circle
    # One line in twenty is by chance; two beside one another, or one far outside, are not.
    beyond &= (apart > 2.0 * circle) | np.append(beyond[1:], False) | np.append(False, beyond[:-1])
    lines = response.frequency
    bands = [(float(lines[start]), float(lines[stop - 1])) for start, stop in stretches(beyond)]
    widest = sorted(sorted(bands, key=lambda band: band[1] / band[0])[-3:])
    worst = int(np.argmax(apart))
    inside = int(np.count_nonzero(apart <= BAND * response.std))
    return Agreement(len(response), inside, float(apart[worst]), float(response.frequency[worst]), tuple(widest))


@dataclass(frozen=True, eq=False)
class Comparison:
    """A measured ``response`` and the ``axis`` that it is of."""

    response: FrequencyResponse
    axis: Axis

    @cached_property
    def model(self) -> np.ndarray:
        """What the axis's model gives at the lines (n,)."""
        return axis_response(self.axis, self.response.frequency)

    @cached_property
    def agreement(self) -> Agreement:
        """Where the model and the response differ."""
        return agreement(self.response, self.model)

    @cached_property
    def chain(self) -> MassChain:
        """Masses, springs and dampers that the response asks for."""
        return fit_chain(self.response)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {"coupling": self.chain.to_dict(), "model": {"axis": self.axis.name, **self.agreement.to_dict()}}
