"""The section on the controller that the axis file has: its loops within one another, each with its margins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.report.display import angle, delay, frequency, ratio
from emps_design.report.page import Callout, Section, Table, Text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from emps_design.control.loop.nested import NestedLoop


def controller_section(loops: Sequence[NestedLoop], kept: Sequence[NestedLoop] = ()) -> Section:
    """Return the section on the nested ``loops`` of a controller, the whole last: stability first, then margins.

    ``kept`` are the loops with the velocity loop of the design in the place of its own.
    """
    whole = loops[-1].margins
    verdict = Callout("good", "stable.") if whole.stable else Callout("stop", "the controller's loop is unstable.")
    return Section(
        "Controller of the axis",
        Text(
            "The loops as the axis file says them, not those designed above: the velocity loop with the position loop "
            "open, the position loop with the velocity loop closed, and the whole where a delay or a current loop sits."
        ),
        verdict,
        _table(loops, "Sampled, each at the rate at which it runs, with filters, delay and current loop."),
        *([_table(kept, "The same with the velocity loop designed above in the place of its own.")] if kept else []),
    )


def _table(loops: Sequence[NestedLoop], caption: str) -> Table:
    heads = ["loop", "broken at the", "stable", "crossover", "phase margin", "gain margin", "delay margin"]
    return Table(heads, [_row(loop) for loop in loops], caption)


def _row(loop: NestedLoop) -> list[str]:
    margins = loop.margins
    if not margins.stable:
        return [loop.name, loop.broken, "unstable", "", "", "", ""]
    late = delay(margins.delay_margin, margins.period)
    shown = (frequency(margins.crossover), angle(margins.phase_margin_deg), ratio(margins.gain_margin), late)
    return [loop.name, loop.broken, "stable", *shown]
