"""Identify the parameters of an axis from one record, or from several with their spread."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import AXIS
from emps_design.commands.options import write_axis
from emps_design.errors import EmpsError, InputError, one_line
from emps_design.identification.excitation import goes_one_way
from emps_design.identification.identify import identify
from emps_design.identification.result import AUTO, BY_LEAST_SQUARES, HOLDOUT, Identification, IdentificationRequest
from emps_design.identification.several import SeveralIdentifications, identify_several, identify_together
from emps_design.inputs import axis_option, read_record
from emps_design.records import Record
from emps_design.request import Request, option, options_of


@dataclass(frozen=True)
class _Records(Request):
    """Records of an axis."""

    records: tuple[Record, ...] = option(
        ...,
        "record file: .mat, .csv or .npz; several: mean, spread, drift, cross-validation",
        argument=True,
        metavar="RECORD...",
        typed=list[Path],
        read=read_record,
    )
    axis: Axis = axis_option(
        "TOML file or embedded machine: G_tau, limits, controller, and effects that are already known"
    )


@dataclass(frozen=True)
class IdentifyRequest(IdentificationRequest, _Records):
    """Options of ``identify``: records of an axis, the method, and a file for the result."""

    holdout: Record | None = option(None, HOLDOUT, typed=Path | None, read=read_record)
    out: Path | None = option(None, "write the identified axis to this TOML file", writes=AXIS)

    def __post_init__(self) -> None:
        super().__post_init__()
        count = len(self.records)
        if count == 1:
            return
        if self.estimator not in (AUTO, BY_LEAST_SQUARES):
            raise InputError(f"`estimator`: {self.estimator} takes one record, found {count}; use ls for several")
        self.refuse(
            ["bootstrap", "holdout"], f"requires a single record, found {count}; several records are cross-validated"
        )

    @property
    def method(self) -> IdentificationRequest:
        """The options of the method, for :func:`.identify`."""
        options: dict[str, Any] = {entry.name: getattr(self, entry.name) for entry in options_of(IdentificationRequest)}
        return IdentificationRequest(**options, progress=self.progress)


def answer(request: IdentifyRequest) -> Reply:
    """The parameters with their deviations; the axis file is written where they make a valid axis."""
    identification, error = _identified(request), None
    if request.out is not None:
        try:
            write_axis(request.out, identification.to_axis(name=one_line(request.out.stem)))
        except EmpsError as invalid:  # the parameters are shown even if they make no valid axis
            error = invalid
    return Reply(
        identification.to_dict(),
        identification.view(),
        request.axis.units,
        warnings=identification.warnings,
        error=error,
    )


def _identified(request: IdentifyRequest) -> Identification | SeveralIdentifications:
    """One record; several separately; or several together if one of them moves in one direction only."""
    records, axis = request.records, request.axis
    if len(records) == 1:
        return identify(records[0], axis, request.method)
    if any(map(goes_one_way, records)):
        return identify_together(records, axis, request.method)
    return identify_several(records, axis, request.method)
