"""The page of an import: which column was taken for what, and what the record looks like."""

from __future__ import annotations

from typing import Any

from emps_design.records import Record
from emps_design.report.display import number, quantity
from emps_design.report.page import Callout, Page, Picture, Section, Table, Text
from emps_design.report.record_figures import record_figure
from emps_design.units import Units


def import_page(record: Record, document: dict[str, Any], units: Units) -> Page:
    """Return the page on an imported ``record``; ``document`` is what was taken for what, in ``units``."""
    rows = [
        (c["title"], c["unit_in_file"], c["name"], number(c["lowest"]), number(c["highest"]), c["unit"], c["how"])
        for c in document["columns"]
    ]
    headings = ("column in the file", "unit", "is", "lowest", "highest", "unit", "found")
    notes = Callout("warning", "What was done and noticed", items=tuple(document["warnings"]))
    section = Section(
        f"Record {record.name}",
        Text(
            f"{len(record)} samples of {quantity(record.period, 's')}, {quantity(record.duration, 's', 3)} in all, "
            f"read for the axis {document['axis']}."
        ),
        Table(headings, rows),
        Picture(record_figure(record, units), "The record as it was read.", "Record"),
        notes if document["warnings"] else None,
    )
    return Page(f"Import of {record.name}", "", (), (section,), units=units)
