"""What the identification of a controller shows: the verdict, the table, its numbers, and the compared structures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from emps_design.view import Line, Table, View

if TYPE_CHECKING:
    from emps_design.identification.controller.wording import LawEstimate


def law_view(estimate: LawEstimate) -> View:
    """What ``estimate`` shows."""
    return tuple(_parts(estimate))


def _parts(estimate: LawEstimate) -> Iterator[Line | Table]:
    yield Line(estimate.verdict + (f": {estimate.reason}" if estimate.reason else ""), "strong")
    if estimate.controller is not None:
        for line in ("", *estimate.to_toml().splitlines(), ""):
            yield Line(line, "code")
        rows = [
            (name, f"{value:.7g}", f"{std:.2g}", f"{abs(100 * std / value):.2g}" if value else "")
            for name, value, std in estimate.numbers
        ]
        yield Table(("number", "value", "std", "std [%]"), rows)
    elif estimate.closest is not None:
        yield Line(f"the closest law, which is not the machine's: {estimate.closest_in_words}")
    if estimate.residual_rms is not None and estimate.residual_share is not None:
        rms = f"{estimate.residual_rms:.4g} {estimate.command_unit}".rstrip()
        own = f"; the record allows {estimate.allowed_rms:.4g}" if estimate.allowed_rms is not None else ""
        yield Line(f"leaves {rms} rms, {100 * estimate.residual_share:.3g} % of the command's deviation{own}")
    for note in estimate.notes:
        yield Line(note)
    if len(estimate.tried) > 1:
        compared = [
            (row["terms"], f"{row['residual_rms']:.4g}", f"{row['criterion']:+.1f}", f"{row['apart']:.1f}")
            for row in estimate.tried
        ]
        unit = f" [{estimate.command_unit}]" if estimate.command_unit else ""
        yield Table(("structure", f"left, whitened{unit}", "criterion", "apart [std]"), compared, "tried")
