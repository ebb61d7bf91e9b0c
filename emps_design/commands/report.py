"""Write the whole design as one self-contained page: specification and result, loops, force loop, record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from emps_design.commands import Reply
from emps_design.commands.destinations import PAGE
from emps_design.files import write_aside
from emps_design.report.request import ReportRequest
from emps_design.request import option
from emps_design.view import Line

CROSSOVER = 100.0  # rad/s, the paper's, for a command line without a specification


@dataclass(frozen=True, kw_only=True)
class PageRequest(ReportRequest):
    """Options of ``report``: those of a report, and the file of the page."""

    out: Path = option(..., "HTML file to write", writes={".html": PAGE, ".htm": PAGE})


def answer(request: PageRequest) -> Reply:
    """The results on the page, which is written to the output file."""
    from emps_design.report.assemble import assemble_report

    if request.crossover is None and request.bandwidth is None:
        request = replace(request, crossover=CROSSOVER)
    with write_aside(request.out) as aside:
        report = assemble_report(request)
        aside.write_text(report.page.html(), encoding="utf-8")
    document = {"out": str(request.out), **report.to_dict()}
    reason = f"{report.reason}; the page starts with this" if report.reason else ""
    return Reply(document, (Line(str(request.out), "code"),), report.page.units, reason, report.warnings)
