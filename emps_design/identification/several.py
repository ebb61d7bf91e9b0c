"""Identification from several records of one axis: mean and spread, cross-validation, drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from emps_design.advice import advised
from emps_design.axis import Axis
from emps_design.effects.terms import TERMS
from emps_design.errors import AxisError, InputError
from emps_design.identification.identify import identify
from emps_design.identification.result import (
    AUTO,
    BY_INSTRUMENTS,
    BY_LEAST_SQUARES,
    BY_OUTPUT_ERROR,
    DEFAULTS,
    Identification,
    IdentificationRequest,
    label,
    parameter_names,
    proposed_line,
    written,
)
from emps_design.messages import Message, warning
from emps_design.quantities import decimals
from emps_design.records import Record
from emps_design.records.record import joined
from emps_design.request import takes
from emps_design.view import Line, Table, View, Viewed

DRIFT_LEVEL = 0.01
OUTPUT_ERROR = "output_error"
# The estimator's name in a result, and the option that requests it; the more specific ones come later.
NAMES = {
    "least_squares": BY_LEAST_SQUARES,
    "instrumental_variables": BY_INSTRUMENTS,
    OUTPUT_ERROR: BY_OUTPUT_ERROR,
}


@dataclass(frozen=True)
class SeveralIdentifications(Viewed):
    """Identifications of several records, in the order of recording.

    ``cross_validation[i, j]`` [N] is the rms force error on record j with the parameters of record i; the diagonal
    holds the error of each record with its own parameters.
    """

    identifications: tuple[Identification, ...]
    cross_validation: np.ndarray
    warnings: tuple[Message, ...]
    model: str
    axis: Axis = field(repr=False)

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(identification.record for identification in self.identifications)

    @property
    def estimator(self) -> str:
        """The estimator, the same for all records."""
        return self.identifications[0].estimator

    @property
    def proposed(self) -> tuple[str, ...]:
        """The terms that at least one record called for."""
        return self.identifications[0].proposed

    @property
    def values(self) -> np.ndarray:
        """Parameters, one row per record, shape (records, p)."""
        return np.array([identification.values() for identification in self.identifications])

    def table(self) -> list[dict[str, Any]]:
        """One row per parameter: mean, spread between records, mean deviation within one, drift per record."""
        rows = []
        for i, quantity in enumerate(self.identifications[0].fitted.quantities):
            column = self.values[:, i]
            stds = [identification.parameters[quantity.name].std_long_run for identification in self.identifications]
            within = np.array(stds, dtype=float)  # NaN where a record does not determine it
            slope, p_value = (0.0, 1.0) if len(column) >= 3 else (None, None)  # two records tell no drift
            if len(column) >= 3 and np.ptp(column) > 0:
                line = scipy.stats.linregress(np.arange(len(column)), column)
                slope, p_value = float(line.slope), float(line.pvalue)
            rows.append(
                {
                    "name": quantity.name,
                    "unit": self.axis.units.unit(quantity.unit),
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
        """The first record's identification with the mean parameters, and their spread as deviations.

        A further record's parameters lie in its intervals with 95 % probability (Student's t).
        """
        first, count = self.identifications[0], len(self.identifications)
        reach = float(scipy.stats.t.ppf(0.975, count - 1)) * np.sqrt(1.0 + 1.0 / count)
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

    def view(self) -> View:
        """Means over the records, their spread and drift, and the force error of each record's parameters on each."""
        document, units = self.to_dict(), self.axis.units
        own, names = parameter_names(document["proposed"]), document["records"]
        rows = []
        for name, row in document["parameters"].items():
            places = decimals(max(abs(row["mean"]), row["std"]))
            spread, std = (written(row[key], places) for key in ("spread", "std"))
            mark = " **" if row["drift_significant"] else ""
            drift = None if row["drift"] is None else f"{row['drift']:+.{places}f}{mark}"
            rows.append((label(name, own, units), f"{row['mean']:.{places}f}", spread, std, drift, row["unit"]))
        judged = [
            (f"{number} {name}", *(f"{error:.3f}" for error in errors))
            for number, (name, errors) in enumerate(zip(names, document["cross_validation"], strict=True), 1)
        ]
        unit = document["cross_validation_unit"]
        return (
            Table(
                ("parameter", "mean", "spread", "std *", "drift/record", "unit"),
                rows,
                f"{len(names)} records, {document['model']} model, {document['estimator'].replace('_', ' ')}",
            ),
            *proposed_line(document["proposed"]),
            Line(
                "spread: std between records; std *: mean within one, for a correlated residual; drift **: p < 1 % "
                "over all parameters together"
            ),
            Table(
                ("", *(str(number) for number in range(1, len(names) + 1))),
                judged,
                f"{units.words('force')} error [{unit} rms]: identified on the record of the row, validated on that of "
                "the column",
            ),
        )

    def to_axis(self, name: str | None = None) -> Axis:
        """The axis with the mean parameters."""
        return self.mean().to_axis(name)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        document = {
            "records": list(self.records),
            "model": self.model,
            "estimator": self.estimator,
            "axis": self.axis.name,
            "proposed": list(self.proposed),
            "parameters": {row.pop("name"): row for row in self.table()},
            "cross_validation": self.cross_validation.tolist(),
            "cross_validation_unit": self.axis.units.unit("N"),
            "own_rms_error": np.diag(self.cross_validation).tolist(),
            "identifications": [identification.to_dict() for identification in self.identifications],
            "warnings": list(self.warnings),
        }
        return advised("identify", document, self.axis.units)


@takes(IdentificationRequest)
def identify_several(
    records: Sequence[Record], axis: Axis | None = None, request: IdentificationRequest = DEFAULTS
) -> SeveralIdentifications:
    """Identify each of ``records`` and judge every set of parameters on every record.

    With the estimator ``auto`` all records are fitted by the most specific
    estimator that one of them needs, and with the terms that any of them calls for, so that they can be compared.
    Raises :class:`InputError` for fewer than two records, :class:`AxisError` where a record leaves a parameter
    undetermined.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> several = identify_several([synthetic_record(axis, seed, laps=1) for seed in range(2)], axis)
    >>> several.cross_validation.shape, round(several.table()[0]["mean"])
    ((2, 2), 95)
    """
    if len(records) < 2:
        raise InputError(f"records: found {len(records)}, expected two or more; use identify for one")
    if axis is None:
        from emps_design.machines import machine

        axis = machine("emps2019")
    fits = _identified(records, axis, request)
    problems = []
    for record, fit in zip(records, fits, strict=True):
        missing = [name for name, estimate in fit.parameters.items() if not estimate.determined]
        if missing:
            listed = ", ".join(map(fit.axis.units.word, missing))
            raise AxisError(
                f"{record.name}: {listed} not determined, so there is no mean; leave this record out, or record motion "
                "that excites them"
            )
        # Every record is judged by the inverse model, whatever the estimator: output error has other columns.
        judge = fit
        if fit.estimator == OUTPUT_ERROR:
            judge = identify(record, axis, replace(request, estimator=BY_LEAST_SQUARES, with_=fit.fitted.terms))
        problems.append(judge)
    matrix = np.array([[_error(fit, judge) for judge in problems] for fit in fits])
    warnings = tuple(message.of(fit.record) for fit in fits for message in fit.warnings)
    return SeveralIdentifications(tuple(fits), matrix, warnings, fits[0].model, axis)


def _error(fit: Identification, judge: Identification) -> float:
    """Force error [N rms] of the parameters ``found`` on the record of ``judge``, by its inverse model."""
    residual = judge.series["measured"] - judge.series["columns"] @ fit.solution(judge.fitted)
    return float(np.sqrt(np.sum(residual**2) / judge.samples))


@takes(IdentificationRequest)
def identify_together(records: Sequence[Record], axis: Axis, request: IdentificationRequest) -> Identification:
    """Identify ``axis`` from ``records`` as from one: for records that each move one way, but together both ways.

    It is by least squares; raises :class:`InputError` for another estimator.
    """
    if request.estimator not in (AUTO, BY_LEAST_SQUARES):
        raise InputError(f"`estimator`: found {request.estimator!r}, expected 'ls' for records with one direction each")
    fit = identify(joined(records, axis.units.rotary), axis, replace(request, estimator=BY_LEAST_SQUARES))
    together = warning("fitted-together", "the records have one direction each and are fitted together")
    return replace(fit, warnings=(*fit.warnings, together))


def _identified(records: Sequence[Record], axis: Axis, request: IdentificationRequest) -> list[Identification]:
    """Each of ``records`` by one estimator, the most specific that one of them needs, and with the same terms."""
    fits = []
    for index, record in enumerate(records):
        request.progress(f"identify {record.name}", index / len(records))
        fits.append(identify(record, axis, request))
    taken = max((fit.estimator for fit in fits), key=list(NAMES).index)
    proposed = tuple(term for term in TERMS if any(term in fit.proposed for fit in fits))
    # The estimator is no longer the user's choice, so what it makes of the options is none of theirs either.
    again = replace(request, estimator=NAMES[taken], with_=proposed or request.with_, given=frozenset())
    for index, fit in enumerate(fits):
        if fit.estimator != taken or fit.proposed != proposed:
            fits[index] = replace(identify(records[index], axis, again), proposed=proposed)
    return fits
