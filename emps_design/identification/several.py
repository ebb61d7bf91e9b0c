"""Several records of one axis: mean and spread, cross-validation, drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.terms import TERMS
from emps_design.errors import AxisError, InputError
from emps_design.identification.identify import identify
from emps_design.identification.result import AUTO, BY_INSTRUMENTS, BY_LEAST_SQUARES, BY_OUTPUT_ERROR, Identification
from emps_design.progress import Progress
from emps_design.records import Record
from emps_design.records.record import joined

DRIFT_LEVEL = 0.01
OUTPUT_ERROR = "output_error"
TOGETHER = "the records go one way each, and are fitted together"
# How an estimator is called in a result, and how it is asked for: the more particular the later.
NAMES = {
    "least_squares": BY_LEAST_SQUARES,
    "instrumental_variables": BY_INSTRUMENTS,
    OUTPUT_ERROR: BY_OUTPUT_ERROR,
}


@dataclass(frozen=True)
class SeveralIdentifications:
    """Identifications of several records in the order of recording.

    ``cross_validation[i, j]`` [N] is the rms force error on record j with the parameters of record i; its diagonal is
    each record's own error.
    """

    identifications: tuple[Identification, ...]
    cross_validation: np.ndarray
    warnings: tuple[str, ...]
    model: str
    axis: Axis = field(repr=False)

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(one.record for one in self.identifications)

    @property
    def estimator(self) -> str:
        """What all were identified by."""
        return self.identifications[0].estimator

    @property
    def proposed(self) -> tuple[str, ...]:
        """The terms that one of the records or more asked for."""
        return self.identifications[0].proposed

    @property
    def values(self) -> np.ndarray:
        """Parameters, one row per record, shape (records, p)."""
        return np.array([one.values() for one in self.identifications])

    def table(self) -> list[dict[str, Any]]:
        """One row per parameter: mean, spread between records, mean deviation within one, drift per record."""
        from scipy.stats import linregress

        rows = []
        for i, quantity in enumerate(self.identifications[0].fitted.quantities):
            column = self.values[:, i]
            found = [one.parameters[quantity.name].std_long_run for one in self.identifications]
            within = np.array(found, dtype=float)  # NaN where a record does not determine it
            slope, p_value = (0.0, 1.0) if len(column) >= 3 else (None, None)  # two records tell no drift
            if len(column) >= 3 and np.ptp(column) > 0:
                line = linregress(np.arange(len(column)), column)
                slope, p_value = float(line.slope), float(line.pvalue)
            rows.append(
                {
                    "name": quantity.name,
                    "unit": quantity.unit,
                    "mean": float(column.mean()),
                    "spread": float(column.std(ddof=1)),
                    "std": float(np.mean(within)),
                    "drift": slope,
                    "drift_p_value": p_value,
                    "drift_significant": p_value is not None
                    and p_value < DRIFT_LEVEL / len(self.identifications[0].parameters),
                    "values": column.tolist(),
                }
            )
        return rows

    def mean(self) -> Identification:
        """The identification whose parameters are the means, with the spread as deviation; from the first record.

        Its intervals are those in which the parameters of one more record lie with 95 % (Student's t of so many).
        """
        from scipy.stats import t

        first, count = self.identifications[0], len(self.identifications)
        reach = float(t.ppf(0.975, count - 1)) * np.sqrt(1.0 + 1.0 / count)
        parameters = {}
        for row in self.table():
            half = float(reach * row["spread"])
            parameters[row["name"]] = replace(
                first.parameters[row["name"]],
                value=row["mean"],
                std=row["spread"],
                std_long_run=row["spread"],
                interval_95=(row["mean"] - half, row["mean"] + half),
                std_hac=None,
                std_bootstrap=None,
            )
        return replace(first, record=f"mean of {len(self.records)} records", sha256="", parameters=parameters)

    def to_axis(self, name: str | None = None) -> Axis:
        """The axis with the mean parameters."""
        return self.mean().to_axis(name)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        return {
            "records": list(self.records),
            "model": self.model,
            "estimator": self.estimator,
            "axis": self.axis.name,
            "proposed": list(self.proposed),
            "parameters": {row.pop("name"): row for row in self.table()},
            "cross_validation": self.cross_validation.tolist(),
            "cross_validation_unit": self.axis.units.unit("N"),
            "own_rms_error": np.diag(self.cross_validation).tolist(),
            "identifications": [one.to_dict() for one in self.identifications],
            "warnings": list(self.warnings),
        }


def identify_several(
    records: Sequence[Record], axis: Axis | None = None, progress: Progress | None = None, **options: Any
) -> SeveralIdentifications:
    """Identify each of ``records`` and judge every set of parameters on every record.

    ``options`` are those of :func:`.identify`; with the estimator ``auto`` all by the one that one of the records asks
    for, and with the terms that any of them proposes, so that they can be compared. Raises :class:`InputError` for
    fewer than two records, :class:`AxisError` where a record does not determine a parameter.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> found = identify_several([synthetic_record(axis, seed, laps=1) for seed in range(2)], axis)
    >>> found.cross_validation.shape, round(found.table()[0]["mean"])
    ((2, 2), 95)
    """
    if len(records) < 2:
        raise InputError(f"records: found {len(records)}, expected two or more; use identify for one")
    if axis is None:
        from emps_design.machines import machine

        axis = machine("emps2019")
    found = _identified(records, axis, progress, options)
    problems = []
    for record, one in zip(records, found, strict=True):
        missing = [name for name, estimate in one.parameters.items() if not estimate.determined]
        if missing:
            raise AxisError(
                f"{record.name}: {', '.join(missing)} not determined, so there is no mean to take; leave this record "
                "out, or record motion that excites them"
            )
        # What each is judged by is the inverse model, whatever the estimator: output error has other columns.
        judge = one
        if one.estimator == OUTPUT_ERROR:
            terms = list(one.fitted.terms)
            judge = identify(record, axis, **{**options, "estimator": BY_LEAST_SQUARES, "with_": terms})
        problems.append(judge)
    matrix = np.array([[_error(one, judge) for judge in problems] for one in found])
    warnings = tuple(f"{one.record}: {text}" for one in found for text in one.warnings)
    return SeveralIdentifications(tuple(found), matrix, warnings, found[0].model, axis)


def _error(found: Identification, judge: Identification) -> float:
    """Force error [N rms] of the parameters ``found`` on the record of ``judge``, by its inverse model."""
    left = judge.series["measured"] - judge.series["columns"] @ found.solution(judge.fitted)
    return float(np.sqrt(np.sum(left**2) / judge.samples))


def identify_together(records: Sequence[Record], axis: Axis, **options: Any) -> Identification:
    """Identify ``axis`` from ``records`` as from one: for those that go one way each, and tell all of it together.

    ``options`` are those of :func:`.identify`, by least squares. Raises :class:`InputError` for another estimator.
    """
    estimator = options.pop("estimator", BY_LEAST_SQUARES)
    if estimator not in (AUTO, BY_LEAST_SQUARES):
        raise InputError(f"`estimator`: found {estimator!r}, expected 'ls' for records that go one way each")
    found = identify(joined(records, axis.units.rotary), axis, estimator=BY_LEAST_SQUARES, **options)
    return replace(found, warnings=(*found.warnings, TOGETHER))


def _identified(
    records: Sequence[Record], axis: Axis, progress: Progress | None, options: dict[str, Any]
) -> list[Identification]:
    """Each of ``records`` by one estimator, the most particular that one of them asks for, and with the same terms."""
    found = []
    for index, record in enumerate(records):
        if progress is not None:
            progress(f"identify {record.name}", index / len(records))
        found.append(identify(record, axis, **options))
    taken = max((one.estimator for one in found), key=list(NAMES).index)
    proposed = tuple(term for term in TERMS if any(term in one.proposed for one in found))
    again = {**options, "estimator": NAMES[taken]}
    if proposed:
        again["with_"] = list(proposed)
    for index, one in enumerate(found):
        if one.estimator != taken or one.proposed != proposed:
            found[index] = replace(identify(records[index], axis, **again), proposed=proposed)
    return found
