"""Text output of a loop on measured responses: each margin with its 95 % band, and the worst of several."""

from __future__ import annotations

from typing import Any

from emps_design.cli.output import new_console

ROWS = (
    ("phase margin", "phase_margin_deg", "deg", 1.0),
    ("crossover", "crossover", "rad/s", 1.0),
    ("delay margin", "delay_margin", "ms", 1e3),
    ("gain margin", "gain_margin", "ratio", 1.0),
    ("disk margin", "disk_margin", "", 1.0),
    ("largest sensitivity, below", "sensitivity_peak_below", "ratio", 1.0),
    ("largest sensitivity, above", "sensitivity_peak_above", "ratio", 1.0),
)


def print_measured(measured: dict[str, Any], loop: str = "velocity loop") -> None:
    """Print what ``gains`` found on measured responses, ``document["measured"]``, for this ``loop``."""
    from rich import box
    from rich.table import Table

    console = new_console()
    title = f"On the measured plant, {loop} at the plant input"
    table = Table(title=title, title_justify="left", box=box.SIMPLE)
    table.add_column("")
    responses = measured["responses"]
    for one in responses:
        table.add_column(one["name"] if one["stable"] else f"{one['name']}: UNSTABLE", justify="right")
    if len(responses) > 1:
        table.add_column("worst", justify="right")
    table.add_column("unit")
    limits = measured.get("requested", {})
    if limits:
        table.add_column("asked for", justify="right")
    for label, key, unit, scale in ROWS:
        if key not in limits and all(one[key] is None for one in responses):
            continue
        cells = [_cell(one[key], one["bands"][key], scale) for one in responses]
        worst = [_cell(measured[key], None, scale)] if len(responses) > 1 else []
        asked = [f"at most {limits[key]:.4g}" if key in limits else ""] if limits else []
        table.add_row(label, *cells, *worst, unit, *asked)
    console.print(table)
    console.print("in brackets: 95 % band from the data's deviations; below, above: the first antiresonance")


def _cell(value: float | None, band: list[float] | None, scale: float) -> str:
    if value is None:
        return "-"
    return f"{scale * value:.4g}" + (f" [{scale * band[0]:.4g}, {scale * band[1]:.4g}]" if band else "")
