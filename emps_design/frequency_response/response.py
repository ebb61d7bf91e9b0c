"""A measured frequency response: force to velocity of the continuous plant, with its deviations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.errors import InputError
from emps_design.notebook import table

if TYPE_CHECKING:
    import control

BAND = float(np.sqrt(-np.log(0.05)))  # radius of the 95 % circle of a complex number, in standard deviations
FEWEST = 4  # lines; less is no response


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Lines of a response from force to velocity, in SI units.

    ``frequency`` (n,) [Hz] ascending; ``response`` (n,) complex [(m/s)/N]; ``std`` (n,) the standard deviation of the
    complex number over its modulus: a real and an imaginary part each have it over sqrt(2), and the truth lies within
    1.73 of them in 95 % of the cases; ``coherence`` (n,) the share of one period's, or one block's, power that repeats.

    >>> w = 2.0 * np.pi * np.array([1.0, 2.0, 4.0, 8.0])
    >>> mass = FrequencyResponse.of(w / (2.0 * np.pi), 1.0 / (3j * w), np.full(4, 0.01))
    >>> round(float(mass.phase_deg[0]), 6), mass.to_frd().omega.round(2).tolist()
    (-90.0, [6.28, 12.57, 25.13, 50.27])
    """

    frequency: np.ndarray
    response: np.ndarray
    std: np.ndarray
    coherence: np.ndarray
    name: str = "response"
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, frequency: Any, response: Any, std: Any = None, coherence: Any = None, name: str = "response"
    ) -> FrequencyResponse:
        """Build one from arrays, checked; without ``std`` it counts as exact. Raises :class:`InputError`."""
        f, g = np.ravel(np.asarray(frequency, dtype=float)), np.ravel(np.asarray(response, dtype=complex))
        s = np.zeros(f.size) if std is None else np.ravel(np.asarray(std, dtype=float))
        c = np.ones(f.size) if coherence is None else np.ravel(np.asarray(coherence, dtype=float))
        for label, values in (("response", g), ("std", s), ("coherence", c)):
            if values.size != f.size:
                raise InputError(f"{name}: {label}: found {values.size} numbers, expected {f.size} as in frequency")
        if f.size < FEWEST:
            raise InputError(f"{name}: found {f.size} line{'' if f.size == 1 else 's'}, expected at least {FEWEST}")
        for label, values, lowest in (("frequency", f, 0.0), ("std", s, 0.0), ("coherence", c, 0.0)):
            bad = np.flatnonzero(~np.isfinite(values) | (values < lowest))
            if bad.size:
                raise InputError(
                    f"{name}: {label}, line {bad[0] + 1}: found {values[bad[0]]:g}, expected a number of at least 0"
                )
        bad = np.flatnonzero(~np.isfinite(g) | (g == 0.0))
        if bad.size:
            raise InputError(f"{name}: response, line {bad[0] + 1}: found {g[bad[0]]}, expected a number other than 0")
        if f[0] == 0.0 or np.any(np.diff(f) <= 0.0):
            at = 0 if f[0] == 0.0 else int(np.argmax(np.diff(f) <= 0.0)) + 1
            raise InputError(f"{name}: frequency, line {at + 1}: found {f[at]:g} Hz, expected rising, above 0")
        warnings = () if np.any(s > 0.0) else (f"{name}: no standard deviations, so margins have no bands",)
        return cls(f, g, s, c, name, warnings)

    def __len__(self) -> int:
        return self.frequency.size

    @property
    def w(self) -> np.ndarray:
        """Frequency [rad/s]."""
        return 2.0 * np.pi * self.frequency

    @property
    def magnitude(self) -> np.ndarray:
        """Modulus [(m/s)/N]."""
        return np.abs(self.response)

    @property
    def phase_deg(self) -> np.ndarray:
        """Phase [deg], without jumps, that of the first line between -270 and 90."""
        phase = np.degrees(np.unwrap(np.angle(self.response)))
        return phase - 360.0 * np.ceil((phase[0] - 90.0) / 360.0)

    def between(self, low: float, high: float) -> FrequencyResponse:
        """The lines from ``low`` to ``high`` [Hz]."""
        kept = (self.frequency >= low) & (self.frequency <= high)
        if np.count_nonzero(kept) < FEWEST:
            raise InputError(
                f"{self.name}: found {np.count_nonzero(kept)} lines from {low:g} to {high:g} Hz, expected at least "
                f"{FEWEST}; it has {len(self)} from {self.frequency[0]:.4g} to {self.frequency[-1]:.4g} Hz"
            )
        return self._at(kept)

    def every(self, step: int) -> FrequencyResponse:
        """Every ``step``-th line."""
        return self if step == 1 else self._at(np.arange(0, len(self), step))

    def _at(self, kept: np.ndarray) -> FrequencyResponse:
        return replace(
            self,
            frequency=self.frequency[kept],
            response=self.response[kept],
            std=self.std[kept],
            coherence=self.coherence[kept],
        )

    def to_frd(self) -> control.FrequencyResponseData:
        """The response as ``control.FrequencyResponseData``."""
        import control

        return control.frd(self.response, self.w, name=self.name)

    @classmethod
    def from_frd(cls, frd: control.FrequencyResponseData, std: Any = None) -> FrequencyResponse:
        """Read ``control.FrequencyResponseData`` of one input [N] and one output [m/s]."""
        data = np.asarray(frd.frdata)
        if data.shape[:2] != (1, 1):
            raise InputError(f"frd: found {data.shape[1]} inputs and {data.shape[0]} outputs, expected one of each")
        return cls.of(np.asarray(frd.omega) / (2.0 * np.pi), data[0, 0], std, name=frd.name or "response")

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the columns of the table."""
        return {
            "frequency_hz": self.frequency,
            "magnitude": self.magnitude,
            "phase_deg": self.phase_deg,
            "coherence": self.coherence,
            "std": self.std,
        }

    def _repr_html_(self) -> str:
        rows = (
            ("lines", len(self), ""),
            ("from", float(self.frequency[0]), "Hz"),
            ("to", float(self.frequency[-1]), "Hz"),
            ("relative standard deviation, median", float(np.median(self.std)), ""),
        )
        return table(self.name, rows)
