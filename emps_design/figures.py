"""Figures as data: curves, areas, bands and levels on axes with labels and units.

A figure is described once, next to the result that it shows. :func:`draw_on` renders axes with matplotlib, for a page
and for ``plot()``; the studio renders the same axes with Bokeh. Line styles and marks have matplotlib's names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

# Okabe and Ito's palette: distinct under the common forms of colour blindness and in grey print.
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, YELLOW, BLACK = "#CC79A7", "#F0E442", "#1A1A1A"
GREY = "#6B7280"
PALE_GREY, PALE_BLUE = "#E5E7EB", "#EEF7FD"  # for areas behind curves

TURN = np.linspace(0.0, 2.0 * np.pi, 300)  # rad, the angles of a full circle
SMALL = 8.5  # points, font size of a remark
Values = Sequence[float] | np.ndarray | float
Range = tuple[float | None, float | None]
NOT_GIVEN: Range = (None, None)


@dataclass(frozen=True)
class Curve:
    """Points ``x``, ``y`` (n,) with a ``line`` through them, "" for none, and a ``mark`` of ``size`` [points] at each.

    The legend shows ``label``; matplotlib adds ``detail``.
    """

    x: Values
    y: Values
    label: str = ""
    color: str = BLUE
    line: str = "-"
    width: float = 1.6
    mark: str = ""
    size: float = 5.0
    alpha: float = 1.0
    detail: str = ""

    @property
    def points(self) -> list[Curve]:
        """One curve per point."""
        return [replace(self, x=x, y=y) for x, y in zip(*np.array([self.x, self.y]).tolist(), strict=True)]


@dataclass(frozen=True)
class Area:
    """A filled polygon with the corners ``x``, ``y`` (n,)."""

    x: Values
    y: Values
    color: str = GREY
    alpha: float = 1.0
    label: str = ""

    @classmethod
    def between(cls, x: np.ndarray, low: np.ndarray, high: np.ndarray, label: str = "") -> Area:
        """The band of a curve over ``x`` (n,), from ``low`` to ``high`` (n,).

        >>> Area.between(np.array([0.0, 1.0]), np.array([1.0, 2.0]), np.array([3.0, 4.0])).y.tolist()
        [1.0, 2.0, 4.0, 3.0]
        """
        return cls(np.concatenate([x, x[::-1]]), np.concatenate([low, high[::-1]]), BLUE, 0.25, label)


@dataclass(frozen=True)
class Band:
    """The band from ``low`` to ``high`` on ``axis``, "x" or "y", across the whole figure."""

    axis: str
    low: float
    high: float
    color: str = PALE_GREY
    alpha: float = 1.0
    label: str = ""


@dataclass(frozen=True)
class Level:
    """A line at the value ``at`` of ``axis``, "x" or "y", across the figure; matplotlib labels it ``text``."""

    axis: str
    at: float
    color: str = GREY
    line: str = "-"
    width: float = 0.8
    text: str = ""


@dataclass(frozen=True)
class Remark:
    """``text`` beside the point ``x``, ``y``, offset by ``right`` and ``up`` [points]; it ends there if left of it."""

    x: float
    y: float
    text: str
    color: str = BLACK
    right: float = 0.0
    up: float = 0.0
    size: float = SMALL

    @property
    def down(self) -> float:
        """The offset downwards [points]."""
        return -self.up

    @property
    def align(self) -> str:
        """Alignment of the text: "left" if it starts at the point, "right" if it ends there."""
        return "right" if self.right < 0.0 else "left"


@dataclass(frozen=True)
class Axes:
    """``parts`` on axes with the labels ``x`` and ``y``, units included, in drawing order.

    ``log`` names the logarithmic scales, "x" or "xy". ``x_range`` and ``y_range`` are the ends of the scales, None for
    automatic; ``room`` is the share of the height that stays free at the top. ``ticks`` is the tick spacing of y.
    ``legend`` is matplotlib's location of the legend, in ``columns``. ``square`` axes have equal scales, ``hertz`` adds
    a scale in Hz to one in rad/s, and ``remark`` is a text box.
    """

    parts: tuple[Curve | Area | Band | Level | Remark, ...]
    x: str = ""
    y: str = ""
    title: str = ""
    log: str = ""
    x_range: Range = NOT_GIVEN
    y_range: Range = NOT_GIVEN
    ticks: float | None = None
    legend: str = ""
    columns: int = 1
    square: bool = False
    hertz: bool = False
    room: float = 0.0
    remark: str = ""

    @property
    def curves(self) -> tuple[Curve, ...]:
        """The curves among its parts."""
        return tuple(part for part in self.parts if isinstance(part, Curve))


@dataclass(frozen=True)
class Grid:
    """``rows`` of axes in one figure of ``height`` [in]; with ``share_x`` the axes of a column share their scale of x.

    ``heights`` are the relative heights of the rows. ``legend`` is the location of a common legend outside the axes,
    with the curves of the first axes.
    """

    rows: tuple[tuple[Axes, ...], ...]
    height: float = 3.2
    heights: tuple[float, ...] = ()
    share_x: bool = True
    legend: str = ""
    columns: int = 2

    @property
    def axes(self) -> tuple[Axes, ...]:
        """All axes, row by row."""
        return tuple(axes for row in self.rows for axes in row)

    @classmethod
    def of(cls, *axes: Axes, **options: Any) -> Grid:
        """``axes`` one above the other."""
        return cls(tuple((each,) for each in axes), **options)


def thin(x: np.ndarray, y: np.ndarray, bins: int = 900) -> tuple[np.ndarray, np.ndarray]:
    """Return at most ``2 bins`` points of (x, y) that draw the same line: the extremes of each bin, in order.

    >>> x = np.linspace(0, 1, 10_000)
    >>> thin_x, thin_y = thin(x, np.sin(50 * x), bins=100)
    >>> bool(thin_x.size <= 200 and thin_y.max() > 0.999)
    True
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if x.size <= 2 * bins:
        return x, y
    width = -(-x.size // bins)
    full = x.size // width * width
    blocks = y[:full].reshape(-1, width)
    start = np.arange(blocks.shape[0]) * width
    low, high = start + blocks.argmin(axis=1), start + blocks.argmax(axis=1)
    places = np.unique(np.concatenate([[0], low, high, np.arange(full, x.size)[:: max(1, width // 2)], [x.size - 1]]))
    return x[places], y[places]


def draw_on(axes: Any, drawn: Axes) -> None:
    """Draw ``drawn`` on the matplotlib ``axes``."""
    for part in drawn.parts:
        if isinstance(part, Curve):
            axes.plot(
                part.x, part.y, color=part.color, linestyle=part.line, linewidth=part.width, marker=part.mark,
                markersize=part.size, markeredgewidth=2.0 if part.mark == "x" else None, alpha=part.alpha,
                label=": ".join(filter(None, (part.label, part.detail))) or None,
            )  # fmt: skip
        elif isinstance(part, Area):
            axes.fill(part.x, part.y, color=part.color, alpha=part.alpha, linewidth=0, label=part.label or None)
        elif isinstance(part, Band):
            across = axes.axvspan if part.axis == "x" else axes.axhspan
            look = {"color": part.color, "alpha": part.alpha, "linewidth": 0, "label": part.label or None}
            across(part.low, part.high, **look)
        elif isinstance(part, Level):
            across = axes.axvline if part.axis == "x" else axes.axhline
            across(part.at, color=part.color, linestyle=part.line, linewidth=part.width)
        else:
            axes.annotate(
                part.text, (part.x, part.y), xytext=(part.right, part.up), textcoords="offset points", ha=part.align,
                va="center", fontsize=part.size, color=part.color,
            )  # fmt: skip
    _frame(axes, drawn)
    _name_levels(axes, drawn)


def _frame(axes: Any, drawn: Axes) -> None:
    """Set scales, ranges, labels and legend."""
    for axis in drawn.log:
        axes.set(**{f"{axis}scale": "log"})
    axes.set(xlabel=drawn.x, ylabel=drawn.y)
    axes.set_title(drawn.title, parse_math=False)  # a name may hold a dollar
    if drawn.square:
        axes.set_aspect("equal", adjustable="box")
    if drawn.x_range == NOT_GIVEN:
        axes.margins(x=0.01)
    else:
        axes.set_xlim(*drawn.x_range)
    if drawn.y_range != NOT_GIVEN:
        axes.set_ylim(*drawn.y_range)
    if drawn.room:
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + drawn.room * (high - low))
    if drawn.ticks:
        from matplotlib.ticker import MultipleLocator

        axes.yaxis.set_major_locator(MultipleLocator(drawn.ticks))
    if drawn.hertz:
        top = axes.secondary_xaxis("top", functions=(lambda w: w / (2 * np.pi), lambda f: f * (2 * np.pi)))
        top.set_xlabel("frequency [Hz]")
    if drawn.legend:
        axes.legend(loc=drawn.legend, ncols=drawn.columns)
    if drawn.remark:
        box = {"boxstyle": "round,pad=0.35", "facecolor": "white", "edgecolor": "#D1D5DB", "alpha": 0.92}
        axes.text(0.35, 0.55, drawn.remark, transform=axes.transAxes, fontsize=SMALL, bbox=box)


def _name_levels(axes: Any, drawn: Axes) -> None:
    """Label the levels that have a text: those of y at the left end, those of x along the line."""
    for level in drawn.parts:
        if not isinstance(level, Level) or not level.text:
            continue
        upright = level.axis == "x"
        axes.annotate(
            level.text,
            (level.at, 0.5) if upright else (0.0, level.at),
            xycoords=("data", "axes fraction") if upright else ("axes fraction", "data"),
            xytext=(3, 0) if upright else (4, 3),
            textcoords="offset points",
            va="center" if upright else "bottom",
            rotation=90 if upright else 0,
            fontsize=SMALL,
            color=level.color,
        )
