"""A measured frequency response: force to velocity of the continuous plant, with its deviations.

Files of a frequency response: CSV, and MATLAB files with the same names.

A CSV has the columns ``frequency_hz, magnitude, phase_deg, coherence, std``; the first three are needed. A MATLAB file
(v5, that is ``save -v7`` or ``-v6``, and v7.3) has real arrays with these names, or a structure with what an ``frd``
object ``sys`` holds, since the object itself is stored in a form that MATLAB alone reads:

    s = struct('ResponseData', sys.ResponseData, 'Frequency', sys.Frequency, 'FrequencyUnit', sys.FrequencyUnit);

What is written has both, the structure as ``response``. Back in MATLAB:

    sys = frd(response.ResponseData, response.Frequency, 'FrequencyUnit', response.FrequencyUnit);

Resonances and antiresonances of a measured response, with their deviations.

Around each peak of |j w G| that stands out of what is usual beside it by more than the deviations explain, a parabola
in frequency over a straight line, with complex coefficients, is fitted to the response; around each dip, to its
inverse. The root of the line is the pole, or the zero: its real part in frequency is the natural frequency, its
imaginary part the damping, which no machine has below 0. The fit is linear once the denominator of the last turn weighs
the equations (C. K. Sanathanan and J. Koerner, IEEE Trans. Automatic Control 8, 1963). Where the response is rough, as
dry friction makes it, one line that stands out is no peak, and what the fit leaves raises the deviation.

What the phase of a response says before anything is fitted to it: how late the force comes, and with which sign.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.errors import InputError, nearest_name, one_line
from emps_design.files import read_bytes, write_aside
from emps_design.notebook import table
from emps_design.records.archives import is_v5, is_v73, read_v5, read_v73
from emps_design.records.tables import read_plain_table

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
LOW = 4  # one of so many lines tells the sign

ORDER = 2
TURNS = 12
NARROWEST = 5  # lines on either side of the extreme
WIDEST = 0.1  # share of its frequency on either side
SYSTEMATIC = 1e-3  # relative, what the fit may differ from a response by
CLEAR = 1.3  # ratio to both flanks, as they usually are, that makes an extreme
ROUGH = 0.05  # deviation from which on one line alone makes none
FAR = 0.5  # share of the frequency within which the flanks are looked for
UNLIKELY = 3.0  # deviations by which a damping may be below 0
VAGUE = 0.02  # share of its frequency; a root that is less certain is none
BROAD = 0.3  # damping ratio from which on there is no extreme to speak of


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


def write_response(path: str | Path, response: FrequencyResponse) -> None:
    """Write ``response`` to ``path`` (.csv, or .mat in v5), whole or not at all.

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
            from scipy.io import savemat

            with aside.open("wb") as file:
                arrays: dict[str, Any] = {name: np.asarray(values)[:, None] for name, values in columns.items()}
                arrays["response"] = {
                    "ResponseData": response.response[None, None],
                    "Frequency": response.frequency[:, None],
                    "FrequencyUnit": "Hz",
                    "Ts": 0.0,
                }
                savemat(file, arrays)
        else:
            table = np.column_stack([columns[name] for name in COLUMNS])
            np.savetxt(aside, table, fmt="%.10g", delimiter=",", header=",".join(COLUMNS), comments="")


def read_response(path: str | Path) -> FrequencyResponse:
    """Read the response at ``path``; raises :class:`InputError` in one line for anything else."""
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
    """The columns of the first structure that has the fields of an ``frd`` object; none where there is none."""
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
        known = ", ".join(repr(one) for one in RADIANS if one)
        raise InputError(f"{path}: {name}: found FrequencyUnit {unit!r}, expected one of {known}")
    response = np.ravel(data)
    return {
        "frequency_hz": frequency * RADIANS[unit] / (2.0 * np.pi),
        "magnitude": np.abs(response),
        "phase_deg": np.degrees(np.angle(response)),
    }


def turning_delay(response: FrequencyResponse) -> float:
    """Return the delay [s] by which the phase of a mass would turn as that of ``response`` does.

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
    """Whether the velocity goes against the force at the low lines, whatever the delay.

    There j w G lies between 1/m, a mass, and j w/F, a friction: within 45 degrees about 45.

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
    >>> for one in resonances(FrequencyResponse.of(f, two(30.3) / two(44.7) / s, np.full(f.size, 1e-3))):
    ...     print(one.kind, round(one.frequency, 1), round(one.damping, 3))
    antiresonance 30.3 0.02
    resonance 44.7 0.02
    """
    flat = np.abs(response.w * response.response)
    found = []
    for kind, size in (("antiresonance", 1.0 / flat), ("resonance", flat)):
        for at in _peaks(size, response.frequency, response.std):
            one = _root(response, at, kind)
            if one is not None:
                found.append(one)
    return tuple(sorted(found, key=lambda one: one.frequency))


def _peaks(size: np.ndarray, frequency: np.ndarray, std: np.ndarray) -> list[int]:
    """Places of the peaks of ``size`` that stand clear of their flanks by more than noise."""
    found = []
    for at in range(2, size.size - 2):
        near = np.abs(frequency - frequency[at]) <= WIDEST * frequency[at]
        near[max(0, at - NARROWEST) : at + NARROWEST + 1] = True
        if size[at] < np.max(size[near]):
            continue
        far = np.abs(frequency - frequency[at]) <= FAR * frequency[at]
        left, right = size[:at][far[:at]], size[at + 1 :][far[at + 1 :]]
        if left.size < 2 or right.size < 2:
            continue
        spread = float(np.max(std[max(0, at - 2) : at + 3]))
        height = size[at] if spread < ROUGH else max(size[at - 1], size[at + 1])
        if height > max(CLEAR, 1.0 + 6.0 * spread) * max(np.median(left), np.median(right)):
            found.append(at)
    return found


def _root(response: FrequencyResponse, at: int, kind: str) -> Resonance | None:
    """The zero or the pole next to line ``at``; None where it is not there after all."""
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
    if std > VAGUE or abs(damping) > BROAD or damping < -UNLIKELY * std:  # which would swing up by itself
        return None
    return Resonance(kind, float(centre * place.real), centre * std, abs(damping))
