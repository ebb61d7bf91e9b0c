"""The page of an import: which column was taken for what, and what the record looks like."""

from __future__ import annotations

from emps_design.importing.account import HEADINGS, Account
from emps_design.report.display import quantity
from emps_design.report.page import Callout, Page, Picture, Section, Table, Text
from emps_design.report.record_figures import record_figure


def import_page(account: Account) -> Page:
    """Return the page on an import: what was taken for what, and a picture of the record."""
    record, units, said = account.record, account.axis.units, account.notes
    notes = Callout("warning", "What was done and noticed", items=said)
    section = Section(
        f"Record {record.name}",
        Text(
            f"{len(record)} samples of {quantity(record.period, 's')}, {quantity(record.duration, 's', 3)} in all, "
            f"read for the axis {account.axis.name}."
        ),
        Table(HEADINGS, account.rows),
        Picture(record_figure(record, units), "The record as it was read.", "Record"),
        notes if said else None,
    )
    return Page(f"Import of {record.name}", "", (), (section,), units=units)
