"""What a diagnosis must offer for its page: plain data, the arrays of its pictures, and the extended axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np


class View(Protocol):
    """The mean residual force over one quantity, before and after the missing effects were added.

    ``quantity`` is the word on the axis ("velocity", "position", "time", "frequency", "period of position", ...),
    ``unit`` its SI unit; ``x``, ``before``, ``after`` (n,) with forces in N (amplitudes over a frequency or a period);
    ``band`` (n,) or None: half-width of what a healthy record shows [N]; ``marks``: intervals (lo, hi) of ``x`` to
    point at; ``title``: a few words, such as "forwards only", or "". NaN leaves a gap in the line.
    """

    quantity: str
    unit: str
    x: np.ndarray
    before: np.ndarray
    after: np.ndarray
    band: np.ndarray | None
    marks: Sequence[tuple[float, float]]
    title: str


class Trace(Protocol):
    """Force of the confirming record: ``t`` [s]; ``measured``, ``baseline``, ``extended`` [N], all (n,).

    ``name`` is the record's; ``window`` the seconds (lo, hi) worth a closer look, or None for the whole record.
    """

    name: str
    t: np.ndarray
    measured: np.ndarray
    baseline: np.ndarray
    extended: np.ndarray
    window: tuple[float, float] | None


class Diagnosis(Protocol):
    """What the page draws.

    ``to_dict()`` is the contract's document (``schema``, ``verdict``, ``findings``, ``gap``, ``gap_inverse_60hz``,
    ``model_file``), with ``sentence`` and, where known, the keys below; what is absent is left out of the page.

    | key | content |
    |---|---|
    | ``sentence`` | str, the answer in one sentence |
    | ``simulation`` | "closed loop", or "inverse model" where the controller is not known |
    | ``findings[i].label`` | str, the effect in words (else its name is used) |
    | ``unexplained`` | for ``unnamed``: {text, map: {position [m], velocity [m/s], force [N]}, ...} |
    | ``spectrum_over_time`` | {time [s], frequency [Hz], force [N]}: what the baseline misses |
    | ``candidates`` | [{effect, label, gap [N], statistic, threshold, accepted: bool, note}], best first |
    | ``parameters`` | {name: {unit, axis, baseline: {value, std}, extended: {value, std}}} |
    | ``not_excluded`` | [{effect, label, size, unit, text}]: the smallest size that would have been seen |
    | ``remedies`` | [str], what a control engineer does about it |
    | ``experiment`` | {text, program, file, between, distance [N], over_noise, needed, menu: [{program, text, |
    |  | distance [N], over_noise}]}: what would separate what these data cannot; all but ``text`` may be None |
    | ``design`` | [{quantity, unit, before, after, note}], what the better model changes in margins and gains |
    | ``records`` | [{name, role, sha256}] with role "train" or "holdout" |
    | ``inputs`` | {name: sha256} of every file read, the axis file included |
    | ``calibration`` | str, how the threshold was found |
    | ``assumptions``, ``warnings`` | [str] |

    ``experiment``, where there is one, has the reference ``q_ref`` (n,) [m] over ``t`` (n,) [s], or None.
    ``axis``, where there is one, is the extended axis: without ``design`` the page designs on it and on the baseline.
    ``views``: the first is the picture of *where*; ``trace``: None where no record confirms.
    """

    views: Sequence[View]
    trace: Trace | None

    def to_dict(self) -> Mapping[str, Any]:
        """The contract's document with the keys above."""
        ...
