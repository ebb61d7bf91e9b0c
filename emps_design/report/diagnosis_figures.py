"""Pictures of a diagnosis: where the residual is, the force before and after, what was tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.report.display import words
from emps_design.report.style import BLACK, BLUE, GREY, RED, YELLOW, look, subplots, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EVERYWHERE = 0.5  # a mark over more than this share of a view points at nothing
_SCALE = {"m": (1e3, "mm"), "m/s": (1e3, "mm/s")}


def where_figure(diagnosis: Any) -> Figure:
    """Draw the first view of ``diagnosis`` large: mean residual force before and after over one quantity."""
    with look():
        figure, axes = subplots(height=3.3)
        _draw_view(axes, diagnosis.views[0])
        axes.legend(loc="best")
    return figure


def views_figure(views: Sequence[Any]) -> Figure:
    """Draw every view, two beside each other."""
    rows = -(-len(views) // 2)
    with look():
        figure, grid = subplots(rows, 2, height=2.5 * rows, squeeze=False)
        for axes, view in zip(grid.flat, views, strict=False):
            _draw_view(axes, view)
        for axes in grid.flat[len(views) :]:
            axes.axis("off")
        grid.flat[0].legend(loc="best")
    return figure


def _draw_view(axes: Axes, view: Any) -> None:
    factor, unit = _SCALE.get(view.unit, (1.0, view.unit))
    x = np.asarray(view.x) * factor
    for low, high in view.marks:
        if (high - low) * factor > EVERYWHERE * np.ptp(x):
            continue
        axes.axvspan(low * factor, high * factor, color=YELLOW, alpha=0.45, linewidth=0)
    if view.band is not None:
        center = np.zeros_like(x)
        low = center if view.quantity == "frequency" else center - view.band
        axes.fill_between(x, low, center + view.band, color="#9CA3AF", alpha=0.4, linewidth=0, label="healthy record")
    for y, color, label in ((view.before, RED, "before"), (view.after, BLUE, "after")):
        xs, ys = thin(x, y)
        axes.plot(xs, ys, color=color, linewidth=1.4, label=label)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set_xlabel(f"{view.quantity} [{unit}]")
    axes.set_ylabel("amplitude [N]" if view.quantity == "frequency" else "residual force [N]")
    if view.quantity == "frequency" and x.size and x[0] > 0:
        axes.set_xscale("log")
    if view.title:
        axes.set_title(view.title)
    axes.margins(x=0.01)


def before_after_figure(diagnosis: Any) -> Figure:
    """Draw the confirming record: force measured and simulated, then what each model leaves."""
    trace = diagnosis.trace
    t = np.asarray(trace.t)
    low, high = trace.window or _stretch(t, np.asarray(trace.measured) - np.asarray(trace.baseline))
    inside = (t >= low) & (t <= high)
    with look():
        figure, (top, bottom) = subplots(2, 1, height=5.0, sharex=False)
        for y, color, label, width in (
            (trace.measured, BLACK, "measured", 1.9),
            (trace.baseline, RED, "baseline model", 1.2),
            (trace.extended, BLUE, "extended model", 1.2),
        ):
            top.plot(*thin(t[inside], np.asarray(y)[inside]), color=color, linewidth=width, label=label)
        top.set_ylabel("motor force [N]")
        top.set_xlabel("time [s]")
        top.set_title(f"Force, {low:.3g} s to {high:.3g} s")
        top.legend(ncols=3, loc="upper right")
        for y, color, label in ((trace.baseline, RED, "baseline model"), (trace.extended, BLUE, "extended model")):
            error = np.asarray(trace.measured) - np.asarray(y)
            bottom.plot(*thin(t, error), color=color, linewidth=0.9, label=label)
        bottom.axhline(0.0, color=GREY, linewidth=0.8)
        bottom.axvspan(low, high, color=YELLOW, alpha=0.3, linewidth=0)
        bottom.set_ylabel("measured − simulated [N]")
        bottom.set_xlabel("time [s]")
        bottom.set_title("What each model leaves")
        bottom.legend(ncols=2, loc="upper right")
        for axes in (top, bottom):
            axes.margins(x=0.01)
            axes.set_ylim(axes.get_ylim()[0], axes.get_ylim()[1] + 0.22 * np.ptp(axes.get_ylim()))
    return figure


def _stretch(t: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """The tenth of the record in which ``error`` is largest: where there is something to see."""
    length = max(2, t.size // 10)
    energy = np.concatenate([[0.0], np.cumsum(np.square(error))])
    start = int(np.argmax(energy[length:] - energy[:-length]))
    return float(t[start]), float(t[min(start + length, t.size - 1)])


def candidates_figure(candidates: Sequence[Mapping[str, Any]], gap: Mapping[str, Any]) -> Figure:
    """Draw the force error that each of the best twelve candidates leaves, with the baseline and the noise floor."""
    shown = [c for c in candidates if c.get("gap") is not None][:12]
    baseline = (gap.get("train") or {}).get("baseline")
    limit = 1.5 * max([baseline or 0.0, *(c["gap"] for c in shown if c.get("accepted"))]) or None
    bars = [min(c["gap"], limit) if limit else c["gap"] for c in shown]
    with look():
        figure, axes = subplots(height=1.1 + 0.27 * max(len(shown), 2))
        names = [c.get("label") or words(c["effect"]) for c in shown]
        colors = [BLUE if c.get("accepted") else "#B8BFC9" for c in shown]
        axes.barh(range(len(shown)), bars, color=colors, height=0.68, zorder=2)
        axes.set_yticks(range(len(shown)), names)
        axes.invert_yaxis()
        for row, candidate in enumerate(shown):
            axes.annotate(
                f"{candidate['gap']:.3g} N" + (" (bar cut)" if bars[row] < candidate["gap"] else ""),
                (bars[row], row),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=8.5,
            )
        if baseline is not None:
            axes.axvline(baseline, color=RED, linestyle="--", linewidth=1.3, label="model as it was")
        if gap.get("floor") is not None:
            axes.axvline(gap["floor"], color=GREY, linestyle=":", linewidth=1.5, label="noise floor")
        axes.grid(axis="y", visible=False)
        axes.set_xlabel("force error left [N rms]")
        axes.margins(x=0.12)
        axes.set_xlim(left=0)
        if axes.get_legend_handles_labels()[0]:
            figure.legend(loc="outside upper right", ncols=2)
    return figure
