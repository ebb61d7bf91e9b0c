"""The blocks about a controller that was told from a record: its table, its numbers, what it leaves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from emps_design.report.page import Callout, Listing, Table, Text

if TYPE_CHECKING:
    from emps_design.identification.controller import LawEstimate


def law_blocks(found: LawEstimate) -> tuple[Any, ...]:
    """Return the blocks of a page about ``found``: verdict, table, deviations, residual, notes."""
    if found.controller is None:
        near = f"The closest law, which is not the machine's: {found.closest_in_words}." if found.closest else ""
        said = (near, *found.notes) if near else found.notes
        return (Callout("warning", f"{found.verdict}: {found.reason}."), *map(Text, said))
    rows = [
        [name, value, std, f"{abs(100.0 * std / value):.2g} %" if value else ""] for name, value, std in found.numbers
    ]
    left = []
    if found.residual_rms is not None and found.residual_share is not None:
        share = f"{100.0 * found.residual_share:.3g} % of the command's deviation"
        left.append(Text(f"The law leaves {found.residual_rms:.4g} {found.command_unit} rms of the command, {share}."))
    words = f"{found.verdict}{f', {found.reason}' if found.reason else ''}."
    return (
        Callout("good" if found.verdict == "told" else "warning", words),
        Listing(found.to_toml()),
        Table(["number", "value", "standard deviation", ""], rows, "Numbers of the controller, as in the axis file."),
        *left,
        *map(Text, found.notes),
    )
