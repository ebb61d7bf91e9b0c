"""Pictures of a record: what was measured, and the force that the identified model explains."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from emps_design.report.style import BLACK, BLUE, GREY, RED, YELLOW, look, subplots, thin
from emps_design.units import Units

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.identification.identify import Identification
    from emps_design.records import Record


def record_figure(record: Record, units: Units | None = None) -> Figure:
    """Draw position and command of ``record``, and the external force where one was measured, in the axis's units."""
    units = units or Units()
    unit, factor = units.display(0.5, "m")
    rows = [(f"{units.words('position')} [{unit}]", factor * record.q, BLUE)]
    rows.append((units.label("voltage [V]"), record.u, BLACK))
    if record.f_ext is not None:
        rows.append((units.label("external force [N]"), record.f_ext, RED))
    with look():
        figure, grid = subplots(len(rows), 1, height=1.35 * len(rows) + 0.3, sharex=True)
        for axes, (label, y, color) in zip(grid, rows, strict=True):
            axes.plot(*thin(record.t, y), color=color, linewidth=1.0)
            axes.set_ylabel(label)
            axes.margins(x=0.01)
        grid[-1].set_xlabel("time [s]")
        figure.align_ylabels(grid)
    return figure


def force_figure(found: Identification) -> Figure:
    """Draw measured and identified force over the record, one part of it enlarged, and the residual.

    Samples that the identification left out are gaps.
    """
    t, measured, model = (np.asarray(found.series[key]) for key in ("t", "measured", "model"))
    used = np.asarray(found.series["used"], dtype=bool)
    error = np.where(used, measured - model, np.nan)
    low, high = _window(t, measured)
    inside = (t >= low) & (t <= high)
    with look():
        figure, (top, middle, bottom) = subplots(3, 1, height=6.2)
        for axes, rows in ((top, slice(None)), (middle, inside)):
            for label, force, color, width in (
                ("measured", measured, BLACK, 1.8),
                ("identified model", model, RED, 1.1),
            ):
                x, y = thin(t[rows], force[rows])
                left_out = np.interp(x, t, used) < 0.5
                axes.plot(x, np.where(left_out, np.nan, y), color=color, linewidth=width, label=label)
            axes.set_ylabel("motor force [N]")
            axes.margins(x=0.01)
        top.axvspan(low, high, color=YELLOW, alpha=0.35, linewidth=0)
        top.set(title="the whole record", ylim=(top.get_ylim()[0], top.get_ylim()[1] + 0.25 * np.ptp(top.get_ylim())))
        top.legend(loc="upper right", ncols=2)
        middle.set_title(f"{low:.3g} s to {high:.3g} s")
        bottom.plot(t, error, color=BLUE, linewidth=0.9)
        bottom.axhline(0.0, color=GREY, linewidth=0.8)
        bottom.set(title="residual", ylabel="measured − model [N]", xlabel="time [s]")
        bottom.margins(x=0.01)
        figure.align_ylabels((top, middle, bottom))
    return figure


def _window(t: np.ndarray, force: np.ndarray) -> tuple[float, float]:
    """An eighth of the record around its largest force, where something happens."""
    length = (t[-1] - t[0]) / 8.0
    centre = float(t[int(np.argmax(np.abs(force)))])
    low = min(max(float(t[0]), centre - 0.5 * length), float(t[-1]) - length)
    return low, low + length
