"""The plots of the design tab, and the feasible specifications.

Bokeh draws the axes that a page draws with matplotlib. The plots are made once; afterwards only their data change, so
that they follow the controls without delay. The feasible specifications limit the controls and colour the plane of
specifications.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from bokeh.core.property.vectorization import Field, value
from bokeh.models import ColumnDataSource, DataRange1d, FixedTicker, HoverTool, LinearColorMapper, Range1d
from bokeh.models.annotations import Label, Legend, LegendItem, Title
from bokeh.models.glyphs import HSpan, HStrip, MultiLine, Patches, Rect, Scatter, Text, VSpan, VStrip
from bokeh.models.renderers import GlyphRenderer
from bokeh.plotting import figure

from emps_design.figures import BLACK, GREY, RED, TURN, Area, Axes, Band, Curve, Level, Remark
from emps_design.report.loop_figures import FREQUENCY, bode_axes, broken_loops, nyquist_axes, step_axes, z_plane
from emps_design.stretches import stretches
from emps_design.studio.ranges import CHOICES, choices_of
from emps_design.studio.state import State

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.velocity.specification import Pairs

STEP = 0.5  # deg
UNSTABLE, NO_GAIN = "the sampled loop is unstable", "there are no positive gains"


KINDS = ("no positive gains", "sampled loop unstable", "below the required margin", "meets the requirement")

TOOLS = "pan,box_zoom,wheel_zoom,reset,save"
ASPECT = 1.28  # width over height: two rows fit on a screen
DASHES = {"-": "solid", "--": "dashed", ":": "dotted"}
CORNERS = {"lower right": "bottom_right", "lower left": "bottom_left"}  # of a legend
MARKS = {"o": "circle", "s": "square", "x": "x", "X": "x", "P": "cross", "^": "triangle", "D": "diamond"}


@dataclass(frozen=True)
class Plane:
    """Kinds of loops over a plane of specifications: ``kind`` (m, n) as indices into ``KINDS``, at the cells' centres.

    ``x`` (n,) [rad/s] is evenly spaced on a logarithmic scale over ``range``; ``y`` (m,) are phase margins [deg].
    """

    range: tuple[float, float]
    x: np.ndarray
    y: np.ndarray
    kind: np.ndarray


@dataclass(frozen=True)
class Feasible:
    """Feasible frequencies [rad/s], feasible phase margins [deg] at one of them, and their limits in words.

    ``low`` and ``high`` are None if no phase margin is feasible at that frequency; ``frequencies`` is None if none is
    at any frequency. ``upper`` [rad/s] is the upper end of the control.
    """

    frequencies: tuple[float, float] | None
    upper: float
    low: float | None
    high: float | None
    text: str

    @property
    def empty(self) -> bool:
        """Whether no phase margin is feasible at that frequency."""
        return self.low is None

    @property
    def beyond(self) -> str:
        """What limits the frequencies, in words."""
        if self.frequencies is None:
            return "Sample faster or remove delay."
        highest = self.frequencies[1]
        return f"Above {highest:g} rad/s the loop is unstable with every phase margin." * (highest < self.upper)

    def nearest(self, phase_margin_deg: float) -> float | None:
        """Return the feasible phase margin [deg] nearest to ``phase_margin_deg``, or None."""
        return None if self.low is None else float(np.clip(phase_margin_deg, self.low, self.high))

    def nearest_frequency(self, frequency: float) -> float:
        """Return the feasible frequency [rad/s] nearest to ``frequency``, or ``frequency`` if there is none."""
        return frequency if self.frequencies is None else float(np.clip(frequency, *self.frequencies))


def _pairs(state: State) -> Pairs:
    """Return the pairs of frequency and phase margin for axis, structure and filters of ``state``."""
    from emps_design.control.velocity.specification import pairs_by_closed_form

    requested = state.requested
    return pairs_by_closed_form(state.axis, requested, structure=requested["structure"], filters=requested["filters"])


def _designs(state: State, frequency: np.ndarray, phases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether each specification has gains, and whether they give a stable sampled loop; arrays of one shape."""
    from emps_design.control.velocity.sampled import sweep_stability

    pairs = _pairs(state)
    k_v1, t_v = pairs.gains(frequency.ravel(), phases.ravel())
    stable = sweep_stability(pairs.plant, k_v1, t_v)
    return np.isfinite(k_v1).reshape(phases.shape), stable.reshape(phases.shape)


def feasible(state: State) -> Feasible:
    """Return the specifications near that of ``state`` with positive gains and a stable sampled loop.

    Of several intervals of the phase margin it is the one nearest to that of ``state``.

    >>> from emps_design.machines import machine
    >>> limits = feasible(State.of(machine("emps2018")).changed(computation_delay=1))
    >>> limits.low, limits.high
    (15.0, 77.5)
    """
    choice = CHOICES["phase_margin_deg"]
    phases = np.arange(choice.lower, choice.upper + STEP / 2, STEP)
    gains, good = _designs(state, np.full(phases.size, state.frequency), phases)
    frequencies, upper = reachable_frequencies(state), choices_of(state.axis)["frequency"].upper
    where = f"at {state.specification} {state.frequency:g} rad/s"
    if not good.any():
        reason = f"{UNSTABLE} with every phase margin" if gains.any() else NO_GAIN
        return Feasible(frequencies, upper, None, None, f"No design is feasible {where}: {reason}.")
    middle = state.phase_margin_deg
    first, last = min(
        ((start, stop - 1) for start, stop in stretches(good)),
        key=lambda run: max(phases[run[0]] - middle, middle - phases[run[1]], 0.0),
    )
    low, high = float(phases[first]), float(phases[last])
    below = None if first == 0 else UNSTABLE if gains[first - 1] else NO_GAIN
    above = None if last == phases.size - 1 else UNSTABLE if gains[last + 1] else NO_GAIN
    if below and below == above:
        text = f"outside {low:g}° to {high:g}° {UNSTABLE}"
    else:
        text = " and ".join(
            [*([f"below {low:g}° {below}"] if below else []), *([f"above {high:g}° {above}"] if above else [])]
        )
    return Feasible(frequencies, upper, low, high, f"A{where[1:]}, {text}." if text else "")


@lru_cache(maxsize=16)
def _reachable(table: str) -> tuple[float, float] | None:
    state = State.from_toml(table)
    choice, phase = choices_of(state.axis)["frequency"], CHOICES["phase_margin_deg"]
    frequencies = np.arange(choice.lower, choice.upper + choice.step / 2, choice.step)
    X, Y = np.meshgrid(frequencies, np.arange(phase.lower, phase.upper + STEP, 2 * STEP))
    good = _designs(state, X, Y)[1].any(axis=0)
    return (float(frequencies[good][0]), float(frequencies[good][-1])) if good.any() else None


def reachable_frequencies(state: State) -> tuple[float, float] | None:
    """Return the lowest and highest frequency [rad/s] of the control with a feasible phase margin, or None."""
    return _reachable(_velocity_loop_only(state).to_toml())


def _velocity_loop_only(state: State, **more: Any) -> State:
    """Return ``state`` with defaults for all that the velocity loop does not depend on, as a key of the caches."""
    law: dict[str, Any] = {"specification": state.specification, "structure": state.structure, "filters": state.filters}
    return replace(State.defaults(state.axis), **law, **more)


@lru_cache(maxsize=16)
def _plane(table: str, columns: int, rows: int) -> Plane:
    from emps_design.control.velocity.sampled import sweep_sampled_margins

    state = State.from_toml(table)
    frequency = choices_of(state.axis)["frequency"]
    edges = np.geomspace(frequency.lower, frequency.upper, columns + 1)
    x = np.sqrt(edges[1:] * edges[:-1])
    y = (np.arange(rows) + 0.5) * 90.0 / rows
    X, Y = np.meshgrid(x, y)
    pairs = _pairs(state)
    k_v1, t_v = (gain.reshape(X.shape) for gain in pairs.gains(X.ravel(), Y.ravel()))
    margins = sweep_sampled_margins(pairs.plant, k_v1, t_v, 60, exact_delay=False)
    phase = np.nan_to_num(margins["phase_margin_deg"], nan=180.0)
    kind = np.select([np.isnan(k_v1), ~margins["stable"], phase < state.required_phase_deg], [0, 1, 2], 3)
    return Plane((frequency.lower, frequency.upper), x, y, kind.astype(np.uint8))


def plane(state: State, columns: int = 90, rows: int = 60) -> Plane:
    """Return the kinds of loops over frequency (crossover or bandwidth, by ``state``) and phase margin."""
    return _plane(_velocity_loop_only(state, required_phase_deg=state.required_phase_deg).to_toml(), columns, rows)


def blank(title: str, x: str, y: str, aspect: float = ASPECT, **options: Any) -> figure:
    """Return an empty figure in the studio's style; ``x`` and ``y`` are the labels of its axes with units."""
    plot = figure(
        title=Title(text=title, text_font_size="12px"),
        x_axis_label=x,
        y_axis_label=y,
        aspect_ratio=aspect,
        sizing_mode="scale_width",
        tools=TOOLS,
        active_scroll=None,
        toolbar_location="above",
        **options,
    )
    plot.html_attributes = {"aria-label": title}
    plot.toolbar.autohide = True
    plot.toolbar.logo = None
    plot.axis.axis_label_text_font_style = "normal"
    plot.axis.axis_label_text_font_size = "11px"
    plot.axis.major_label_text_font_size = "10px"
    plot.grid.grid_line_color = "#E5E7EB"
    plot.min_border_right = 12
    return plot


def _source(*names: str, **columns: Any) -> ColumnDataSource:
    return ColumnDataSource({name: [] for name in names} | columns)


# Glyphs are added directly: the methods of a figure make four copies of each, for selections that are not used here.
def _points(plot: figure, source: ColumnDataSource, x: str, y: str, **look: Any) -> GlyphRenderer:
    return plot.add_glyph(source, Scatter(x=x, y=y, **look))


def _legend(items: list[LegendItem], **look: Any) -> Legend:
    """Return a legend in small type; ``look`` is untyped because bokeh's annotations refuse a number as padding."""
    return Legend(items=items, label_text_font_size="10px", **look)


class LivePlot:
    """A figure that shows :class:`~emps_design.figures.Axes`; other axes only change its data.

    ``y_range`` and ``ticks`` are fixed, so that the scale does not move with a control. Labels of levels and marks
    along a line are not drawn, for space and speed.
    """

    def __init__(
        self, title: str, y_range: tuple[float, float] | None = None, ticks: Sequence[float] = (), **look: Any
    ):
        """Make the figure with the options ``look``; without ``y_range`` its scales are equal and fit the axes."""
        self.plot = plot = blank(title, "", "", match_aspect=y_range is None, **look)
        self.corners = _source("x", "y")
        if y_range is None:
            frame = _points(plot, self.corners, "x", "y", fill_alpha=0.0, line_alpha=0.0)
            plot.x_range = DataRange1d(renderers=[frame], range_padding=0.0)
            plot.y_range = DataRange1d(renderers=[frame], range_padding=0.0)
        else:
            plot.x_range, plot.y_range = (
                look.get("x_range") or Range1d(start=1.0, end=2.0),
                Range1d(start=y_range[0], end=y_range[1]),
            )
        if ticks:
            plot.yaxis.ticker = FixedTicker(ticks=list(ticks))
        line: dict[str, Any] = {"line_color": "color", "line_width": "width"}
        fill: dict[str, Any] = {"fill_color": "color", "fill_alpha": "alpha", "line_color": None}
        dashed: dict[str, Any] = {**line, "line_dash": "line"}
        mark: dict[str, Any] = {"marker": "mark", "size": "size", "fill_color": "color", "line_color": "color"}
        text: dict[str, Any] = {"x_offset": "right", "y_offset": "down", "text_align": "align", "text_color": "color"}
        glyphs = {  # their columns are the fields of the parts
            "areas": Patches(xs="x", ys="y", **fill),
            "bands x": VStrip(x0="low", x1="high", **fill),
            "bands y": HStrip(y0="low", y1="high", **fill),
            "levels x": VSpan(x="at", **dashed),
            "levels y": HSpan(y="at", **dashed),
            "lines": MultiLine(xs="x", ys="y", line_alpha="alpha", **dashed),
            "marks": Scatter(x="x", y="y", line_width=2, **mark),
            "remarks": Text(x="x", y="y", text="text", text_font_size="11px", text_baseline="middle", **text),
        }
        self.sources = {name: _source(*_columns(glyph)) for name, glyph in glyphs.items()}
        self.drawn = {name: plot.add_glyph(self.sources[name], glyph) for name, glyph in glyphs.items()}
        self.named: list[tuple[str, str, int]] = []
        self.legend = _legend([], padding=4, spacing=0, visible=False)
        plot.add_layout(self.legend)
        self.remark = Label(x=8, y=60, x_units="screen", y_units="screen", text="", text_color=RED)
        self.remark.text_font_size = "13px"
        plot.add_layout(self.remark)

    def show(self, axes: Axes) -> None:
        """Show ``axes``."""
        parts: dict[str, list[Any]] = {name: [] for name in self.sources}
        named = []
        for part in axes.parts:
            if isinstance(part, Curve):
                kind = "lines" if part.line else "marks"
                if part.label:
                    named.append((part.label, kind, len(parts[kind])))
                parts["lines"] += [part] if part.line else []
                parts["marks"] += part.points if part.mark and not part.line else []
            else:
                kind = {Area: "areas", Band: "bands", Level: "levels", Remark: "remarks"}[type(part)]
                parts[f"{kind} {part.axis}" if isinstance(part, Band | Level) else kind].append(part)
        for name, source in self.sources.items():
            data = {column: [_value(part, column) for part in parts[name]] for column in source.data}
            if name in ("areas", "lines") or data != source.data:  # the others have no arrays and seldom change
                source.data = data
        self._name(named if axes.legend else [], axes.legend)
        self.plot.xaxis.axis_label, self.plot.yaxis.axis_label = axes.x, axes.y
        self.remark.text = axes.remark
        if axes.square:
            self.corners.data = {"x": list(axes.x_range), "y": list(axes.y_range)}
        else:
            self.plot.x_range.update(start=axes.x_range[0], end=axes.x_range[1])

    def _name(self, named: list[tuple[str, str, int]], place: str) -> None:
        """Show a legend at ``place`` that names curves: label, kind of glyph, and row of its source, each."""
        self.legend.visible = bool(named)
        if named and named != self.named:
            self.named = named
            self.legend.location = cast(Any, CORNERS[place])
            self.legend.items = [
                LegendItem(label=value(label), renderers=[self.drawn[kind]], index=row) for label, kind, row in named
            ]


def _columns(glyph: Any) -> set[str]:
    """The columns that ``glyph`` reads from its source."""
    values = glyph.properties_with_values(include_defaults=False).values()
    return {read.field for read in values if isinstance(read, Field)}


def _value(part: Any, column: str) -> Any:
    """The field ``column`` of a part, with Bokeh's names of line styles and marks."""
    names: dict[str, dict[str, str]] = {"line": DASHES, "mark": MARKS}
    value = getattr(part, column)
    return names[column][value] if column in names else value


class LoopPlots:
    """Bode and Nyquist plots, poles and step response of a design and of a pinned one, with the requirements shaded."""

    def __init__(self) -> None:
        self.magnitude = LivePlot("Bode: magnitude", (-70.0, 60.0), (-60, -30, 0, 30, 60), x_axis_type="log")
        log = {"x_axis_type": "log", "x_range": self.magnitude.plot.x_range}
        self.phase = LivePlot("Bode: phase", (-370.0, -60.0), (-360, -270, -180, -90), **log)
        self.nyquist = LivePlot("Nyquist")
        self.step = LivePlot("Step of the velocity reference", (0.0, 1.6))
        self.z_plane = LivePlot("Poles of the sampled loop, z plane")
        tips = [("frequency", "$snap_x{0.0} rad/s"), ("phase", "$snap_y{0.0}°")]
        self.phase.plot.add_tools(HoverTool(tooltips=tips, renderers=[self.phase.drawn["lines"]]))
        self.shown: dict[str, Axes] = {}
        self.pinned: dict[str, tuple[Curve, ...]] = {}

    def update(self, design: VelocityLoopDesign, state: State) -> None:
        """Show ``design``, with the loop broken at the place of ``state`` and its requirements as forbidden areas."""
        from emps_design.control.verdict import step_responses

        loop = broken_loops(design, 250)[0 if state.place == "velocity error" else 1]
        magnitude, phase = bode_axes(loop, design.axis.sampling.period)
        self.shown = {
            "magnitude": replace(magnitude, x=FREQUENCY),
            "phase": phase,
            "nyquist": nyquist_axes(loop),
            "step": step_axes(*step_responses(design, 301)),
            "z_plane": z_plane(np.asarray(design.sampled.poles), ""),
        }
        margin, overshoot = state.required_phase_deg, state.required_overshoot_percent
        radius = 2.0 * math.sin(math.radians(margin) / 2.0)  # |1 + L| at a crossover with that margin
        forbidden: dict[str, Any] = {
            "phase": Band("y", -180.0, -180.0 + margin, RED, 0.1),
            "step": Band("y", 1.0 + overshoot / 100.0, 10.0, RED, 0.1),
            "nyquist": Area(-1.0 + radius * np.cos(TURN), radius * np.sin(TURN), RED, 0.1),
        }
        for name, axes in self.shown.items():
            behind = [forbidden[name]] if name in forbidden else []
            getattr(self, name).show(replace(axes, parts=(*behind, *axes.parts, *self.pinned.get(name, ()))))

    def pin(self) -> None:
        """Pin the present design: further designs show it in grey."""
        self.pinned = {name: _greyed(axes) for name, axes in self.shown.items()}

    def unpin(self) -> None:
        """Remove the pinned design, from the next update on."""
        self.pinned = {}


def _greyed(axes: Axes) -> tuple[Curve, ...]:
    """The sampled curve of ``axes``, the continuous one if there is no other, or its poles."""
    look: dict[str, Any] = {"color": GREY, "label": "pinned"}
    lines = [replace(curve, line=":", mark="", **look) for curve in axes.curves if curve.label and curve.line]
    poles = [replace(curve, mark="D", color=GREY, label="") for curve in axes.curves if not curve.line]
    return tuple(lines[-1:] or poles)


class PlanePlot:
    """The plane of specifications: positive gains by (7), stability of the sampled loop, required phase margin."""

    COLORS = ("#9CA3AF", "#DE7B3C", "#F6DA92", "#BFE3D5")  # of KINDS
    PHASES = (0.0, 90.0)

    def __init__(self) -> None:
        self.cells = _source("kind", "x", "width")
        self.marks = {key: _source("x", "y") for key in ("here", "pinned")}
        self.plot = blank("Feasible specifications", "", "phase margin [deg]", x_axis_type="log")
        # As a dict, since bokeh's type annotations of image lack the mapper.
        colors: dict[str, Any] = {"color_mapper": LinearColorMapper(palette=list(self.COLORS), low=-0.5, high=3.5)}
        self.plot.image(
            "kind",
            source=self.cells,
            x="x",
            y=self.PHASES[0],
            dw="width",
            dh=self.PHASES[1] - self.PHASES[0],
            **colors,
        )
        pinned, here = self.marks["pinned"], self.marks["here"]
        _points(self.plot, pinned, "x", "y", marker="diamond", size=14, fill_color=GREY, line_color=BLACK)
        _points(self.plot, here, "x", "y", size=13, fill_color="white", line_color=BLACK, line_width=3)
        self.plot.grid.visible = False
        # Boxes outside the visible range, so that the legend always has every kind.
        outside = _source(x=[1.0], y=[-9.0])
        boxes: list[GlyphRenderer] = [
            self.plot.add_glyph(outside, Rect(x="x", y="y", width=0.1, height=0.1, fill_color=color, line_color=None))
            for color in self.COLORS
        ]
        items = [LegendItem(label=name, renderers=[box]) for name, box in zip(KINDS, boxes, strict=True)]
        legend = _legend(items, location="bottom_left", glyph_height=10, glyph_width=10, padding=3, spacing=-4)
        legend.margin, legend.background_fill_alpha = 4, 0.85
        self.plot.add_layout(legend)
        self.plot.x_range = Range1d(start=1.0, end=10.0)
        self.plot.y_range = Range1d(start=self.PHASES[0], end=self.PHASES[1])

    def color(self, regions: Plane) -> None:
        """Colour the plane by the kinds of ``regions``."""
        low, high = regions.range
        self.cells.data = {"kind": [regions.kind], "x": [low], "width": [high - low]}
        self.plot.x_range.update(start=low, end=high)

    def show(self, specification: str, design: VelocityLoopDesign, pinned: VelocityLoopDesign | None) -> None:
        """Mark ``design`` and the pinned one at their crossover or bandwidth, according to ``specification``."""
        names = {"crossover": "crossover", "bandwidth": "closed-loop −3 dB bandwidth"}
        self.plot.xaxis.axis_label = f"{names[specification]} [rad/s]"
        for key, marked in (("here", design), ("pinned", pinned)):
            designs = [] if marked is None else [marked]
            self.marks[key].data = {
                "x": [getattr(d, specification) for d in designs],
                "y": [d.phase_margin_deg for d in designs],
            }
