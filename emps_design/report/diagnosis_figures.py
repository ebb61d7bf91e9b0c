"""Pictures of a diagnosis: where the residual is, the force before and after, what was tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.discrepancy.explain.residual_views import SPECTRAL
from emps_design.report.display import words
from emps_design.report.style import BLACK, BLUE, GREY, RED, YELLOW, look, plain_subplots, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BESIDE = (60, 1)  # widths of a map and of the bar that reads it
DECADE = 10.0
EVERYWHERE = 0.5  # a mark over more than this share of a view points at nothing
_SCALE = {"m": (1e3, "mm"), "m/s": (1e3, "mm/s")}


def where_figure(diagnosis: Any) -> Figure:
    """Draw the first view of ``diagnosis`` large: mean residual force before and after over one quantity."""
    with look():
        figure, axes = plain_subplots(height=3.3)
        _draw_view(axes, diagnosis.views[0])
        axes.legend(loc="best")
    return figure


def views_figure(views: Sequence[Any]) -> Figure:
    """Draw every view, two beside each other."""
    rows = -(-len(views) // 2)
    with look():
        figure, grid = plain_subplots(rows, 2, height=2.5 * rows, squeeze=False)
        for axes, view in zip(grid.flat, views, strict=False):
            _draw_view(axes, view)
        for axes in grid.flat[len(views) :]:
            axes.axis("off")
        grid.flat[0].legend(loc="best")
    return figure


def map_figure(missing: Mapping[str, Any]) -> Figure:
    """Draw the mean missing force over position and velocity, as ``unexplained.map`` of a diagnosis has it."""
    force = np.array(missing["force"], float)
    most = float(np.nanmax(np.abs(force)))
    with look():
        figure, (axes, bar) = plain_subplots(1, 2, height=3.6, width_ratios=BESIDE)
        places = (1e3 * np.array(missing["position"]), 1e3 * np.array(missing["velocity"]))
        shown = axes.pcolormesh(*places, force, cmap="PuOr", vmin=-most, vmax=most, shading="nearest", rasterized=True)
        figure.colorbar(shown, cax=bar, label="missing force [N]")
        axes.set(xlabel="position [mm]", ylabel="velocity [mm/s]")
        axes.grid(visible=False)
    return figure


def spectrum_figure(spectrum: Mapping[str, Any]) -> Figure:
    """Draw the spectrum of the missing force over time, as ``spectrum_over_time`` of a diagnosis has it."""
    force = np.array(spectrum["force"], float)
    with look():
        figure, (axes, bar) = plain_subplots(1, 2, height=3.0, width_ratios=BESIDE)
        shown = axes.pcolormesh(
            spectrum["time"], spectrum["frequency"], force, cmap="Purples", vmin=0.0, shading="nearest", rasterized=True
        )
        figure.colorbar(shown, cax=bar, label="missing force [N rms in a line]")
        axes.set(xlabel="time [s]", ylabel="frequency [Hz]")
        axes.grid(visible=False)
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
        low = center if view.quantity in SPECTRAL else center - view.band
        axes.fill_between(x, low, center + view.band, color="#9CA3AF", alpha=0.4, linewidth=0, label="healthy record")
    # Where nothing was added there is one model, and one line.
    both = not np.array_equal(view.before, view.after, equal_nan=True)
    for y, color, label in ((view.before, RED, "before" if both else "model"), (view.after, BLUE, "after"))[: 1 + both]:
        xs, ys = thin(x, y)
        axes.plot(xs, ys, color=color, linewidth=1.4, label=label)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set(
        xlabel=f"{view.quantity} [{unit}]",
        ylabel="amplitude [N]" if view.quantity in SPECTRAL else "residual force [N]",
    )
    if view.quantity in SPECTRAL and x.size and x[0] > 0:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")  # 10 rather than 10 to a power, which has to be set as mathematics
        axes.xaxis.set_minor_formatter("{x:g}" if x[-1] < DECADE * x[0] else "")
    if view.title:
        axes.set_title(view.title)
    axes.margins(x=0.01)


def before_after_figure(diagnosis: Any) -> Figure:
    """Draw the confirming record: force measured and simulated, then what each model leaves."""
    trace = diagnosis.trace
    t = np.asarray(trace.t)
    used = np.asarray(trace.used)
    miss = np.where(used, np.asarray(trace.measured) - np.asarray(trace.baseline), 0.0)
    low, high = trace.window or _window(t, miss)
    inside = (t >= low) & (t <= high)
    models = [(trace.baseline, RED, "baseline model"), (trace.extended, BLUE, "extended model")]
    if np.array_equal(trace.baseline, trace.extended):
        models = models[:1]
    with look():
        figure, (top, bottom) = plain_subplots(2, 1, height=5.0, sharex=False)
        top.plot(*thin(t[inside], trace.measured[inside]), color=BLACK, linewidth=1.9, label="measured")
        for y, color, label in models:
            top.plot(*thin(t[inside], np.asarray(y)[inside]), color=color, linewidth=1.2, label=label)
        top.set(ylabel="motor force [N]", xlabel="time [s]", title=f"Force, {low:.3g} s to {high:.3g} s")
        top.legend(ncols=3, loc="upper right")
        for y, color, label in models:
            error = np.asarray(trace.measured) - np.asarray(y)
            bottom.plot(*thin(t[used], error[used]), color=color, linewidth=0.9, label=label)
        bottom.axhline(0.0, color=GREY, linewidth=0.8)
        bottom.axvspan(low, high, color=YELLOW, alpha=0.3, linewidth=0)
        bottom.set(ylabel="measured − simulated [N]", xlabel="time [s]", title="What each model leaves")
        bottom.legend(ncols=2, loc="upper right")
        for axes in (top, bottom):
            axes.margins(x=0.01)
            axes.set_ylim(axes.get_ylim()[0], axes.get_ylim()[1] + 0.22 * np.ptp(axes.get_ylim()))
    return figure


def _window(t: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """The tenth of the record in which ``error`` is largest: where there is something to see."""
    length = max(2, t.size // 10)
    energy = np.concatenate([[0.0], np.cumsum(np.square(error))])
    start = int(np.argmax(energy[length:] - energy[:-length]))
    return float(t[start]), float(t[min(start + length, t.size - 1)])


def candidates_figure(candidates: Sequence[Mapping[str, Any]], gap: Mapping[str, Any]) -> Figure:
    """Draw the force error that each of the best twelve candidates leaves, or its statistic where none was fitted."""
    fitted = [c for c in candidates if c.get("gap") is not None]
    if not fitted:
        tried = [c for c in candidates if c.get("statistic") is not None][:12]
        threshold = max((c["threshold"] for c in tried if c.get("threshold") is not None), default=None)
        lines = [(threshold, RED, "--", "to beat")]
        return _bars(tried, [c["statistic"] for c in tried], "statistic of the first guess", "", None, lines)
    shown, baseline = fitted[:12], (gap.get("train") or {}).get("baseline")
    limit = 1.5 * max([baseline or 0.0, *(c["gap"] for c in shown if c.get("accepted"))]) or None
    lines = [(baseline, RED, "--", "model as it was"), (gap.get("floor"), GREY, ":", "noise floor")]
    return _bars(shown, [c["gap"] for c in shown], "force error left [N rms]", " N", limit, lines)


def _bars(
    shown: Sequence[Mapping[str, Any]],
    values: Sequence[float],
    axis_label: str,
    unit: str,
    limit: float | None,
    lines: Sequence[tuple[float | None, str, str, str]],
) -> Figure:
    """Bars with their values, cut at ``limit``, and vertical lines (where, colour, style, label) to compare with."""
    bars = [min(value, limit) if limit else value for value in values]
    with look():
        figure, axes = plain_subplots(height=1.0 + 0.27 * max(len(shown), 2), above=18.0)
        colors = [BLUE if c.get("accepted") else "#B8BFC9" for c in shown]
        axes.barh(range(len(shown)), bars, color=colors, height=0.68, zorder=2)
        axes.set_yticks(range(len(shown)), [c.get("label") or words(c["effect"]) for c in shown])
        axes.invert_yaxis()
        for row, (bar, value) in enumerate(zip(bars, values, strict=True)):
            text = f"{value:.3g}{unit}" + (" (bar cut)" if bar < value else "")
            axes.annotate(text, (bar, row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8.5)
        for where, color, style, label in lines:
            if where is not None:
                axes.axvline(where, color=color, linestyle=style, linewidth=1.4, label=label)
        axes.grid(axis="y", visible=False)
        axes.set_xlabel(axis_label)
        axes.margins(x=0.12)
        axes.set_xlim(left=0)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)
    return figure
