"""The style of every picture on paper: sizes, layout, reproducible files.

The layout of plain figures follows from the size of their type, which is faster than from the extents of all artists.
"""

from __future__ import annotations

import re
import threading
from contextlib import contextmanager
from functools import cache
from io import BytesIO, StringIO
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.layout_engine import LayoutEngine
from matplotlib.textpath import text_to_path

from emps_design.figures import Grid, draw_on
from emps_design.units import Units

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.text import Text


# Points, 72 an inch.
LINE = 1.2  # height of a line of text, relative to the size of its type
GAP = 4.0  # between a label and its neighbour, and at the edge
TICK = 7.0  # from the line of an axis to its numbers
END = 12.0  # room for half a number beyond the end of a horizontal axis

WIDTH = 8.8  # inches, the text column of a page
POINTS = 72  # an inch: the unit of an SVG

# Metadata on date and program, left out of the pictures, by format.
UNDATED: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # shipped with matplotlib, so that every machine draws the same
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#4B5563",
    "axes.linewidth": 0.8,
    "grid.color": "#E5E7EB",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.6,
    "legend.frameon": True,
    "legend.framealpha": 0.9,
    "legend.edgecolor": "#D1D5DB",
    "legend.fontsize": 8.5,
    "legend.borderpad": 0.4,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "figure.facecolor": "white",
    "mathtext.fontset": "dejavusans",
    "svg.fonttype": "path",
    "svg.hashsalt": "emps-design",
    "path.simplify_threshold": 0.4,
}


_SETTINGS = threading.RLock()  # matplotlib's settings belong to the process; the studio draws in several threads


class FigureMargins(LayoutEngine):
    """Layout engine for one grid of axes whose only surroundings are labels and titles.

    ``above`` [points] is kept free over the first row.
    """

    _adjust_compatible = True
    _colorbar_gridspec = False

    def __init__(self, above: float = 0.0):
        super().__init__()
        self.above = above

    def execute(self, fig: Figure) -> None:
        """Place the axes of ``fig`` and their labels; heights first, because the numbers of an axis depend on them."""
        cells = [(axes, spec) for axes in fig.axes if (spec := axes.get_subplotspec()) is not None]
        rows, columns = cells[0][1].get_gridspec().get_geometry()
        width, height = 72.0 * fig.get_size_inches()
        top, bottom = np.zeros(rows), np.zeros(rows)
        at_left, at_right = np.zeros(columns), np.full(columns, END)
        for axes, cell in cells:
            _widen(top, cell.rowspan.start, _above(axes))
            _widen(bottom, cell.rowspan.start, _height(axes.xaxis) + _label(axes.xaxis))
        top[0] += self.above
        low, high, between = _edges(bottom[::-1], top[::-1], height)
        fig.subplots_adjust(bottom=low, top=high, hspace=between)
        sides = [(at_right if _on_right(axes) else at_left, cell.colspan.start) for axes, cell in cells]
        for (axes, _), (side, column) in zip(cells, sides, strict=True):
            _widen(side, column, _width(axes.yaxis) + _label(axes.yaxis))
        low, high, between = _edges(at_left, at_right, width)
        fig.subplots_adjust(left=low, right=high, wspace=between)
        for (axes, _), (side, column) in zip(cells, sides, strict=True):
            across, up = width * axes.get_position().width, height * axes.get_position().height
            axes.xaxis.set_label_coords(0.5, -(_height(axes.xaxis) + GAP) / up)
            beside = (side[column] - _label(axes.yaxis) + GAP) / across
            axes.yaxis.set_label_coords(1.0 + beside if side is at_right else -beside, 0.5)


def _widen(margins: np.ndarray, place: int, points: float) -> None:
    margins[place] = max(margins[place], points)


def _edges(before: np.ndarray, after: np.ndarray, length: float) -> tuple[float, float, float]:
    """Return both edges of a row of plots relative to ``length`` [points], and the space between relative to a plot."""
    low, high = GAP + before[0], length - GAP - after[-1]
    between = GAP + float(np.max(after[:-1] + before[1:], initial=0.0))
    each = (high - low - (before.size - 1) * between) / before.size
    return low / length, high / length, between / each


def _above(axes: Axes) -> float:
    """Return the height [points] above ``axes`` of its title and of the power of ten of its numbers."""
    titled = axes.get_title("left") or axes.get_title()
    return GAP + (_line(axes.title) if titled else 0.0) + (_line(axes.yaxis.get_offset_text()) if _power(axes) else 0.0)


def _power(axes: Axes) -> str:
    formatter = axes.yaxis.get_major_formatter()
    formatter.set_locs(list(axes.yaxis.get_majorticklocs()))
    return formatter.get_offset()


def _on_right(axes: Axes) -> bool:
    return bool(axes.yaxis.get_tick_params().get("labelright"))


def _line(text: Text) -> float:
    return LINE * text.get_fontproperties().get_size_in_points()


def _label(axis: Axis) -> float:
    """Return the height [points] of the label of ``axis``, beyond its numbers."""
    return GAP + _line(axis.label) if axis.get_label_text() else 0.0


def _numbered(axis: Axis) -> bool:
    shown = axis.get_tick_params()
    return axis.axes.axison and any(shown.get(f"label{side}") for side in ("left", "right", "bottom"))


def _height(axis: Axis) -> float:
    """Return the distance [points] from the line of a horizontal ``axis`` to the far side of its numbers."""
    return TICK + _line(axis.get_offset_text()) if _numbered(axis) else 0.0


def _width(axis: Axis) -> float:
    """Return the distance [points] from the line of a vertical ``axis`` to the far side of its longest tick label."""
    if not _numbered(axis):
        return 0.0
    low, high = sorted(axis.get_view_interval())
    places = list(axis.get_majorticklocs())
    texts = axis.get_major_formatter().format_ticks(places)
    shown = {text for place, text in zip(places, texts, strict=True) if text and low <= place <= high}
    font = axis.get_offset_text().get_fontproperties()
    widths = (text_to_path.get_text_width_height_descent(text, font, "$" in text)[0] for text in shown)
    return TICK + max(widths, default=0.0)


@contextmanager
def look() -> Iterator[None]:
    """Draw with the package's settings, independent of the user's matplotlib settings."""
    import matplotlib as mpl

    with _SETTINGS, mpl.rc_context():
        dict.update(cast(Any, mpl.rcParams), _settings())
        yield


@cache
def _settings() -> dict[str, Any]:
    """Return all settings of matplotlib, validated once, except the backend, which belongs to the process."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(RC)
        return {name: value for name, value in dict.items(cast(Any, mpl.rcParams)) if not name.startswith("backend")}


def subplots(
    rows: int = 1,
    columns: int = 1,
    height: float = 3.2,
    width: float = WIDTH,
    layout: Any = "constrained",
    **options: Any,
) -> tuple[Figure, Any]:
    """Return a figure of the page's width [in] without a display, and its axes; call inside :func:`look`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout=layout)
    return figure, figure.subplots(rows, columns, **options)


def plain_subplots(
    rows: int = 1, columns: int = 1, height: float = 3.2, above: float = 0.0, **options: Any
) -> tuple[Figure, Any]:
    """As :func:`subplots`, for axes with nothing around them but labels and titles.

    Their layout takes a fraction of the time; ``above`` [points] is kept free over them.
    """

    return subplots(rows, columns, height, layout=FigureMargins(above), **options)


def drawn(grid: Grid) -> Figure:
    """Draw ``grid`` with matplotlib."""
    outside = grid.legend or any(axes.hertz or axes.square for axes in grid.axes)
    with look():
        figure, places = subplots(
            len(grid.rows),
            len(grid.rows[0]),
            grid.height,
            layout="constrained" if outside else FigureMargins(),
            squeeze=False,
            sharex="col" if grid.share_x else "none",
            height_ratios=grid.heights or None,
        )
        for place, axes in zip(places.flat, grid.axes, strict=True):
            draw_on(place, axes)
        if grid.legend:
            handles, labels = figure.axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc=cast(Any, grid.legend), ncols=grid.columns)
        figure.align_ylabels(places[:, 0])
    return figure


def labelled(figure: Figure, units: Units) -> Figure:
    """Change all text in ``figure`` to the ``units`` of an axis, and return the figure."""
    from matplotlib.text import Text

    if units.plain:
        return figure
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            _rescale(axis, units)
    for text in figure.findobj(Text):
        written = text.get_text()
        if (label := units.label(written)) != written:
            text.set_text(label)
    return figure


def _rescale(axis: Any, units: Units) -> None:
    """Show the numbers of ``axis`` in the display unit of ``units`` if its scale differs, such as deg for mm."""
    label = axis.get_label_text()
    unit, factor = units.read(label.partition("[")[2].partition("]")[0])
    if factor == 1.0 or axis.get_scale() not in ("linear", "log"):
        return
    from matplotlib.ticker import AutoLocator, FuncFormatter, LogLocator, NullLocator

    class Scaled(AutoLocator if axis.get_scale() == "linear" else LogLocator):  # type: ignore[misc]
        def tick_values(self, vmin: float, vmax: float) -> Any:
            return np.asarray(super().tick_values(vmin * factor, vmax * factor)) / factor

    axis.set_major_locator(Scaled())
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, place: f"{round(value * factor, 9):g}".replace("-", "−")))
    axis.set_label_text(re.sub(r"\[.*\]", f"[{unit}]", label))


def svg(figure: Figure, key: str = "") -> str:
    """Return ``figure`` as inline SVG: the same bytes every time, ids made unique by ``key``.

    >>> with look():
    ...     figure, axes = subplots(height=1.0)
    >>> svg(figure, "a") == svg(figure, "a") and svg(figure, "a").startswith("<svg")
    True
    """
    out = StringIO()
    with look():
        _laid_out(figure).savefig(out, format="svg", metadata=UNDATED["svg"])
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"\n\s*", "\n", text)
    if key:
        text = re.sub(r'\bid="([^"]+)"', rf'id="{key}-\1"', text)
        text = re.sub(r'href="#([^"]+)"', rf'href="#{key}-\1"', text)
        text = re.sub(r"url\(#([^)]+)\)", rf"url(#{key}-\1)", text)
    return text.strip()


def _laid_out(figure: Figure) -> Figure:
    """Lay out ``figure`` for SVG and return it: otherwise saving would draw everything twice."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    if (engine := figure.get_layout_engine()) is not None:
        FigureCanvasSVG(figure)
        dpi, figure.dpi = figure.dpi, POINTS
        engine.execute(figure)
        figure.dpi = dpi
        figure.set_layout_engine(None)
    return figure


def png(figure: Figure, dpi: int = 150) -> bytes:
    """Return ``figure`` as the bytes of a PNG picture."""
    out = BytesIO()
    with look():
        figure.savefig(out, format="png", dpi=dpi, metadata=UNDATED["png"])
    return out.getvalue()


def draw(figure: Figure, path: Path, form: str) -> None:
    """Write ``figure`` to ``path`` in one of the formats of ``UNDATED``; the same figure gives the same bytes."""
    with look():
        figure.savefig(path, format=form, metadata=UNDATED[form])
