"""Places of axes that follow from the size of their type, not from boxes around all that would be drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.layout_engine import LayoutEngine
from matplotlib.textpath import text_to_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.text import Text

# Points, 72 an inch.
LINE = 1.2  # height of a line of text over the size of its type
GAP = 4.0  # between a label and what it stands beside, and at the edge
TICK = 7.0  # from the line of an axis to its numbers
END = 12.0  # for the half of a number that stands under the end of a horizontal axis


class Margins(LayoutEngine):
    """Lay out one grid of axes with labels and titles, and nothing else outside of them.

    ``above`` [points] is kept free over the first row.
    """

    _adjust_compatible = True
    _colorbar_gridspec = False

    def __init__(self, above: float = 0.0):
        super().__init__()
        self.above = above

    def execute(self, fig: Figure) -> None:
        """Set the places of the axes of ``fig`` and of their labels; heights first: a taller axis has other numbers."""
        cells = [(axes, spec) for axes in fig.axes if (spec := axes.get_subplotspec()) is not None]
        rows, columns = cells[0][1].get_gridspec().get_geometry()
        width, height = 72.0 * fig.get_size_inches()
        top, bottom, left, right = np.zeros(rows), np.zeros(rows), np.zeros(columns), np.full(columns, END)
        for axes, cell in cells:
            _widen(top, cell.rowspan.start, _above(axes))
            _widen(bottom, cell.rowspan.start, _height(axes.xaxis) + _label(axes.xaxis))
        top[0] += self.above
        low, high, between = _edges(bottom[::-1], top[::-1], height)
        fig.subplots_adjust(bottom=low, top=high, hspace=between)
        sides = [(right if _on_right(axes) else left, cell.colspan.start) for axes, cell in cells]
        for (axes, _), (side, column) in zip(cells, sides, strict=True):
            _widen(side, column, _width(axes.yaxis) + _label(axes.yaxis))
        low, high, between = _edges(left, right, width)
        fig.subplots_adjust(left=low, right=high, wspace=between)
        for (axes, _), (side, column) in zip(cells, sides, strict=True):
            across, up = width * axes.get_position().width, height * axes.get_position().height
            axes.xaxis.set_label_coords(0.5, -(_height(axes.xaxis) + GAP) / up)
            beside = (side[column] - _label(axes.yaxis) + GAP) / across
            axes.yaxis.set_label_coords(1.0 + beside if side is right else -beside, 0.5)


def _widen(margins: np.ndarray, place: int, points: float) -> None:
    margins[place] = max(margins[place], points)


def _edges(before: np.ndarray, after: np.ndarray, length: float) -> tuple[float, float, float]:
    """Both edges of a line of plots as shares of ``length`` [points], and the space between two as a share of one."""
    low, high = GAP + before[0], length - GAP - after[-1]
    between = GAP + float(np.max(after[:-1] + before[1:], initial=0.0))
    each = (high - low - (before.size - 1) * between) / before.size
    return low / length, high / length, between / each


def _above(axes: Axes) -> float:
    """Points taken over ``axes`` by its title and by the power of ten of its numbers."""
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
    """Points taken by the label of ``axis``, beyond its numbers."""
    return GAP + _line(axis.label) if axis.get_label_text() else 0.0


def _numbered(axis: Axis) -> bool:
    shown = axis.get_tick_params()
    return axis.axes.axison and any(shown.get(f"label{side}") for side in ("left", "right", "bottom"))


def _height(axis: Axis) -> float:
    """Points from the line of a horizontal ``axis`` to the far side of its numbers."""
    return TICK + _line(axis.get_offset_text()) if _numbered(axis) else 0.0


def _width(axis: Axis) -> float:
    """Points from the line of a vertical ``axis`` to the far side of the longest of its numbers, or words."""
    if not _numbered(axis):
        return 0.0
    low, high = sorted(axis.get_view_interval())
    places = list(axis.get_majorticklocs())
    texts = axis.get_major_formatter().format_ticks(places)
    shown = {text for place, text in zip(places, texts, strict=True) if text and low <= place <= high}
    font = axis.get_offset_text().get_fontproperties()
    widths = (text_to_path.get_text_width_height_descent(text, font, "$" in text)[0] for text in shown)
    return TICK + max(widths, default=0.0)
