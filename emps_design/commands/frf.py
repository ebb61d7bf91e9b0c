"""Estimate the frequency response from force to velocity from records in closed loop, with coherence and deviations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import MATLAB, PICTURES, TABLE
from emps_design.files import write_aside
from emps_design.frequency_response.estimate import METHODS, ResponseEstimate, estimate_response
from emps_design.frequency_response.response import write_response
from emps_design.frequency_response.signals import INSTRUMENTS
from emps_design.inputs import axis_option, read_record
from emps_design.request import HERTZ, Request, option

LONG = 1_000_000  # samples above which a progress bar is shown


@dataclass(frozen=True)
class FrfRequest(Request):
    """Options of ``frf``: the records, their axis, the method and the band."""

    records: tuple[Any, ...] = option(
        ...,
        "record files: .mat, .csv or .npz",
        argument=True,
        metavar="RECORD...",
        typed=list[Path],
        read=read_record,
    )
    axis: Axis = axis_option("TOML file or embedded machine; its force gain and computation delay are used")
    method: str = option(
        "auto",
        "auto, periodic, stepped, local-polynomial or welch",
        choices=("auto", *METHODS),
        metavar="METHOD",
    )
    instrument: str = option(
        "",
        "signal that moves the axis: excitation (default if recorded), reference, or, in open loop, command",
        choices=("", *INSTRUMENTS),
        metavar="SIGNAL",
    )
    low: float = option(0.0, "lowest frequency [Hz]", flags=("--from",), **HERTZ)
    high: float | None = option(None, "highest frequency [Hz]; 0.8 of Nyquist at most", flags=("--to",), **HERTZ)
    out: Path | None = option(
        None, "write the response to this file: .csv, or .mat for MATLAB", writes={".csv": TABLE, ".mat": MATLAB}
    )
    plot: Path | None = option(None, "plot the response to this file: .png, .svg or .pdf", writes=PICTURES)


def answer(request: FrfRequest) -> Reply:
    """The response with its deviations, written and plotted to the files of the request, if any."""
    records, axis = request.records, request.axis
    progress = request.progress if sum(map(len, records)) >= LONG else None
    estimate = estimate_response(
        records, axis, request.method, request.instrument, request.low, request.high, progress=progress
    )
    if request.out is not None:
        write_response(request.out, estimate.response)
    if request.plot is not None:
        _draw(request.plot, estimate)
    return Reply(estimate.to_dict(), estimate.view(), axis.units, warnings=estimate.all_warnings)


def _draw(path: Path, estimate: ResponseEstimate) -> None:
    from emps_design.report.loop_figures import response_figure
    from emps_design.report.style import draw, labelled

    figure = labelled(response_figure(estimate.comparison, estimate.spectral_ratio), estimate.axis.units)
    with write_aside(path) as aside:
        draw(figure, aside, path.suffix[1:])
