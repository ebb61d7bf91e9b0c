"""A measured frequency response, force to velocity of the continuous plant, with deviations, files and resonances.

A CSV file has the columns ``frequency_hz, magnitude, phase_deg, coherence, std``; the first three are needed. A MATLAB
file (v5, that is ``save -v7`` or ``-v6``, and v7.3) has real arrays with these names, or a structure with what an
``frd`` object ``sys`` holds, since the object itself is stored in a form that MATLAB alone reads:

    s = struct('ResponseData', sys.ResponseData, 'Frequency', sys.Frequency, 'FrequencyUnit', sys.FrequencyUnit);

Written MATLAB files have both, the structure as ``response``. Back in MATLAB:

    sys = frd(response.ResponseData, response.Frequency, 'FrequencyUnit', response.FrequencyUnit);

Resonances. Around each peak of |j w G| that exceeds its flanks by more than the deviations explain, a rational function
of frequency, a parabola over a straight line with complex coefficients, is fitted to the response; around each dip, to
its inverse. The root of the denominator is the pole, or the zero: its real part is the natural frequency, its imaginary
part gives the damping, which is never negative on a machine. The fit is an iterated linear one, weighted by the last
denominator (C. K. Sanathanan and J. Koerner, IEEE Trans. Automatic Control 8, 1963). Where dry friction makes the
response rough, a single line that stands out is no peak, and the misfit raises the deviation.

The phase of the response gives the delay of the force and its sign before any fit.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from emps_design.errors import InputError, nearest_name, one_line
from emps_design.files import read_bytes, write_aside
from emps_design.messages import Message, note
from emps_design.records.archives import is_v5, is_v73, read_v5, read_v73
from emps_design.records.tables import read_plain_table
from emps_design.view import Table, View, Viewed

if TYPE_CHECKING:
    import control

BAND = float(np.sqrt(-np.log(0.05)))  # radius of the 95 % circle of a complex number, in standard deviations
FEWEST = 4  # lines; less is no response

COLUMNS = ("frequency_hz", "magnitude", "phase_deg", "coherence", "std")
NEEDED = COLUMNS[:3]
MAX_BYTES = 50_000_000
RADIANS = {"": 1.0, "rad/s": 1.0, "rad/TimeUnit": 1.0, "Hz": 2.0 * np.pi, "kHz": 2e3 * np.pi, "rpm": np.pi / 30.0}
EXPECTED = "expected a frequency response, .csv or .mat"

WEIGHED = 0.1  # relative deviation below which lines weigh alike: resonances turn the phase more than noise
LOW = 4  # the lowest of so many parts of the lines gives the sign

ORDER = 2
TURNS = 12
NARROWEST = 5  # lines on either side of the extreme
WIDEST = 0.1  # share of its frequency on either side
SYSTEMATIC = 1e-3  # relative error of the fit that is always allowed
CLEAR = 1.3  # least ratio of an extreme to the medians of both flanks
ROUGH = 0.05  # deviation above which a single line is no extreme
FAR = 0.5  # share of the frequency that the flanks extend to
UNLIKELY = 3.0  # deviations by which a damping may be below 0
VAGUE = 0.02  # share of its frequency; a root that is less certain is none
BROAD = 0.3  # damping ratio above which there is no clear extreme


@dataclass(frozen=True, eq=False)
class FrequencyResponse(Viewed):
    """Lines of a response from force to velocity, in SI units.

    ``frequency`` (n,) [Hz] ascending; ``response`` (n,) complex [(m/s)/N]; ``std`` (n,) the standard deviation of the
    complex number over its modulus: real and imaginary part each have 1/sqrt(2) of it, and the true value lies within a
    radius of 1.73 ``std`` in 95 % of the cases; ``coherence`` (n,) the share of the power of a period or block that
    repeats.

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
    warnings: tuple[Message, ...] = ()

    @classmethod
    def of(
        cls, frequency: Any, response: Any, std: Any = None, coherence: Any = None, name: str = "response"
    ) -> FrequencyResponse:
        """Build a response from arrays; without ``std`` it counts as exact. Raises :class:`InputError`."""
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
        exact = note("no-deviations", f"{name}: no standard deviations, so margins have no bands")
        return cls(f, g, s, c, name, () if np.any(s > 0.0) else (exact,))

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
        """Unwrapped phase [deg], at the first line between -270 and 90."""
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

        return control.frd(self.response, self.w, inputs=["force"], outputs=["velocity"], name=self.name)

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

    def view(self) -> View:
        """Number and band of the lines, and their usual deviation."""
        rows = (
            ("lines", len(self), ""),
            ("from", float(self.frequency[0]), "Hz"),
            ("to", float(self.frequency[-1]), "Hz"),
            ("relative standard deviation, median", float(np.median(self.std)), ""),
        )
        return (Table(("", "value", "unit"), rows, self.name),)


def write_response(path: str | Path, response: FrequencyResponse) -> None:
    """Write ``response`` to ``path`` (.csv, or .mat in v5), completely or not at all.

    >>> import tempfile
    >>> f = np.array([1.0, 2.0, 3.0, 4.0])
    >>> path = Path(tempfile.mkdtemp()) / "mass.csv"
    >>> write_response(path, FrequencyResponse.of(f, 1.0 / (2j * np.pi * f), np.full(4, 0.02)))
    >>> read_response(path).std.tolist()
    [0.02, 0.02, 0.02, 0.02]
    """
    path = Path(path)
    if path.suffix not in (".csv", ".mat"):
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected .csv or .mat")
    columns = response.to_dict()
    with write_aside(path) as aside:
        if path.suffix == ".mat":
            with aside.open("wb") as file:
                arrays: dict[str, Any] = {name: np.asarray(values)[:, None] for name, values in columns.items()}
                arrays["response"] = {
                    "ResponseData": response.response[None, None],
                    "Frequency": response.frequency[:, None],
                    "FrequencyUnit": "Hz",
                    "Ts": 0.0,
                }
                scipy.io.savemat(file, arrays)
        else:
            table = np.column_stack([columns[name] for name in COLUMNS])
            np.savetxt(aside, table, fmt="%.10g", delimiter=",", header=",".join(COLUMNS), comments="")


def read_response(path: str | Path) -> FrequencyResponse:
    """Read the response at ``path``; raises :class:`InputError`, a message of one line, for any other content."""
    path = Path(path)
    content = read_bytes(path, MAX_BYTES, EXPECTED)
    if is_v73(content[:4096]):
        columns = read_v73(io.BytesIO(content), str(path), MAX_BYTES, structures=True)
    elif is_v5(content[:128]):
        columns = read_v5(io.BytesIO(content), str(path), MAX_BYTES, structures=True)
    else:
        columns = read_plain_table(content, str(path), EXPECTED, NEEDED)
    if not all(name in columns for name in NEEDED):
        columns = _of_frd(columns, path) or columns
    columns = {name.lower(): np.ravel(values) for name, values in columns.items()}
    missing = [name for name in NEEDED if name not in columns]
    if missing:
        hint = nearest_name(missing[0], list(columns))
        raise InputError(
            f"{path}: missing {', '.join(missing)}, found {', '.join(columns) or 'nothing'}{hint}; {EXPECTED}, with "
            f"{', '.join(COLUMNS)}"
        )
    sizes = {columns[name].size for name in NEEDED}
    if len(sizes) > 1:
        raise InputError(
            f"{path}: found columns of {', '.join(map(str, sorted(sizes)))} numbers, expected as many each"
        )
    phase = np.radians(columns["phase_deg"].astype(float))
    response = columns["magnitude"].astype(float) * np.exp(1j * phase)
    try:
        return FrequencyResponse.of(
            columns["frequency_hz"], response, columns.get("std"), columns.get("coherence"), one_line(path.stem)
        )
    except InputError as error:
        raise InputError(f"{path}: {str(error).partition(': ')[2]}") from error


def _of_frd(columns: dict[str, np.ndarray], path: Path) -> dict[str, np.ndarray]:
    """The columns of the first structure with the fields of an ``frd`` object; empty without one."""
    name = next((name.removesuffix(".ResponseData") for name in columns if name.endswith(".ResponseData")), None)
    if name is None or f"{name}.Frequency" not in columns:
        return {}
    data, frequency = columns[f"{name}.ResponseData"], np.ravel(columns[f"{name}.Frequency"]).astype(float)
    if data.size != frequency.size:
        raise InputError(
            f"{path}: {name}: found {data.size} numbers in ResponseData, expected {frequency.size} as in Frequency: "
            "one input and one output"
        )
    unit = "".join(map(chr, np.ravel(columns.get(f"{name}.FrequencyUnit", np.zeros(0, int))).astype(int)))
    if unit not in RADIANS:
        known = ", ".join(repr(key) for key in RADIANS if key)
        raise InputError(f"{path}: {name}: found FrequencyUnit {unit!r}, expected one of {known}")
    response = np.ravel(data)
    return {
        "frequency_hz": frequency * RADIANS[unit] / (2.0 * np.pi),
        "magnitude": np.abs(response),
        "phase_deg": np.degrees(np.angle(response)),
    }


def neighbours(count: int, reach: int) -> np.ndarray:
    """Indices (n, 2 ``reach`` + 1) of each of ``count`` lines and those beside it; beyond an end the line there.

    >>> neighbours(3, 1).tolist()
    [[0, 0, 1], [0, 1, 2], [1, 2, 2]]
    """
    return np.clip(np.arange(count)[:, None] + np.arange(-reach, reach + 1), 0, count - 1)


def turning_delay(response: FrequencyResponse) -> float:
    """Return the delay [s] with which a mass would have the phase slope of ``response``.

    >>> w = 2.0 * np.pi * np.arange(1.0, 250.0)
    >>> late = np.exp(-3e-3j * w) / (100j * w + 200.0)
    >>> round(turning_delay(FrequencyResponse.of(w / (2.0 * np.pi), late)) * 1e3, 2)
    3.02
    """
    phase = np.unwrap(np.angle(1j * response.response))
    weight = 1.0 / np.hypot(response.std, WEIGHED)
    rows = np.column_stack([np.ones(phase.size), -response.w]) * weight[:, None]
    return float(np.linalg.lstsq(rows, phase * weight)[0][1])


def has_wrong_sign(response: FrequencyResponse) -> bool:
    """Whether the velocity opposes the force at the low lines, without regard to the delay.

    There j w G lies between 1/m, a mass, and j w/F, viscous friction: its phase is within 45 degrees of 45.

    >>> f = np.arange(1.0, 50.0)
    >>> [has_wrong_sign(FrequencyResponse.of(f, sign / (100j * f + 200.0))) for sign in (1.0, -1.0)]
    [False, True]
    """
    low = slice(0, max(4, len(response) // LOW))
    turned = 1j * response.response * np.exp(1j * response.w * turning_delay(response))
    mean = np.sum((turned / np.abs(turned) / np.hypot(response.std, WEIGHED))[low])
    return bool(np.real(mean * np.exp(-0.25j * np.pi)) < -0.5 * np.abs(mean))


@dataclass(frozen=True)
class Resonance:
    """``kind`` is ``resonance`` or ``antiresonance``; ``frequency`` and its ``std`` [Hz], ``damping`` ratio."""

    kind: str
    frequency: float
    std: float
    damping: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {"kind": self.kind, "frequency_hz": self.frequency, "std_hz": self.std, "damping": self.damping}


def resonances(response: FrequencyResponse) -> tuple[Resonance, ...]:
    """Return the resonances and antiresonances of ``response`` by frequency.

    >>> f = np.arange(5.0, 100.0)
    >>> s = 2j * np.pi * f
    >>> two = lambda at: s**2 + 0.04 * 2.0 * np.pi * at * s + (2.0 * np.pi * at) ** 2
    >>> for root in resonances(FrequencyResponse.of(f, two(30.3) / two(44.7) / s, np.full(f.size, 1e-3))):
    ...     print(root.kind, round(root.frequency, 1), round(root.damping, 3))
    antiresonance 30.3 0.02
    resonance 44.7 0.02
    """
    flat = np.abs(response.w * response.response)
    roots = []
    for kind, size in (("antiresonance", 1.0 / flat), ("resonance", flat)):
        for at in _peaks(size, response.frequency, response.std):
            root = _root(response, at, kind)
            if root is not None:
                roots.append(root)
    return tuple(sorted(roots, key=lambda root: root.frequency))


def _peaks(size: np.ndarray, frequency: np.ndarray, std: np.ndarray) -> list[int]:
    """Indices of the peaks of ``size`` that exceed their flanks by more than noise."""
    places = []
    for at in range(2, size.size - 2):
        near = np.abs(frequency - frequency[at]) <= WIDEST * frequency[at]
        near[max(0, at - NARROWEST) : at + NARROWEST + 1] = True
        if size[at] < np.max(size[near]):
            continue
        far = np.abs(frequency - frequency[at]) <= FAR * frequency[at]
        below, above = size[:at][far[:at]], size[at + 1 :][far[at + 1 :]]
        if below.size < 2 or above.size < 2:
            continue
        spread = float(np.max(std[max(0, at - 2) : at + 3]))
        height = size[at] if spread < ROUGH else max(size[at - 1], size[at + 1])
        if height > max(CLEAR, 1.0 + 6.0 * spread) * max(np.median(below), np.median(above)):
            places.append(at)
    return places


def _root(response: FrequencyResponse, at: int, kind: str) -> Resonance | None:
    """The zero or the pole next to line ``at``; None where the fit does not confirm it."""
    f, centre = response.frequency, float(response.frequency[at])
    near = np.abs(f - centre) <= WIDEST * centre
    near[max(0, at - NARROWEST) : at + NARROWEST + 1] = True
    x = f[near] / centre - 1.0
    y = 1j * response.w[near] * response.response[near]
    y = y if kind == "resonance" else 1.0 / y
    y = y / np.max(np.abs(y))
    spread = np.hypot(response.std[near], SYSTEMATIC) * np.abs(y)
    powers = x[:, None] ** np.arange(ORDER + 1)
    below = np.ones(x.size, complex)
    for _ in range(TURNS):
        rows = np.column_stack([powers, -y * x]) / (spread * below)[:, None]
        theta = np.linalg.lstsq(rows, y / (spread * below), rcond=1e-12)[0]
        below = 1.0 + theta[-1] * x
    if theta[-1] == 0.0 or not np.all(np.isfinite(theta)) or np.any(below == 0.0):
        return None
    root = -1.0 / theta[-1]
    if abs(root) > np.max(np.abs(x)):
        return None
    fitted = powers @ theta[:-1] / below
    rows = np.column_stack([powers, -fitted * x]) / (spread * below)[:, None]
    inverse = np.linalg.pinv(rows)[-1]
    misfit = float(np.sqrt(np.sum(np.abs((y - fitted) / spread) ** 2) / (x.size - theta.size)))
    std = float(np.sqrt(0.5) * np.linalg.norm(inverse) * abs(root) ** 2) * max(1.0, misfit)
    place = 1.0 + root
    damping = float(place.imag / place.real)
    if std > VAGUE or abs(damping) > BROAD or damping < -UNLIKELY * std:  # negative damping would be unstable
        return None
    return Resonance(kind, float(centre * place.real), centre * std, abs(damping))
