"""The pictures of the design tab, and the specifications that can be reached.

The pictures are made once; afterwards only their data change, so that they follow the controls at once. The reachable
specifications limit the controls and colour the plane of specifications.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from bokeh.models import ColumnDataSource, DataRange1d, FixedTicker, HoverTool, LinearColorMapper, Range1d
from bokeh.models.annotations import BoxAnnotation, Label, Legend, LegendItem, Span, Title
from bokeh.models.glyphs import Line, Patch, Rect, Scatter
from bokeh.models.renderers import GlyphRenderer
from bokeh.plotting import figure

from emps_design.report.loop_figures import broken_loops
from emps_design.report.style import BLACK, BLUE, GREEN, GREY, RED
from emps_design.stretches import stretches
from emps_design.studio.ranges import CHOICES, choices_of
from emps_design.studio.state import State

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.velocity.specification import Pairs

STEP = 0.5  # deg
UNSTABLE, NO_GAIN = "the sampled loop is unstable", "no gains are positive"


KINDS = ("no positive gains", "sampled loop unstable", "below the required margin", "meets it")

TOOLS = "pan,box_zoom,wheel_zoom,reset,save"
ASPECT = 1.28  # width over height: two rows fit both screens
_TURN = np.linspace(0.0, 2.0 * np.pi, 120)


@dataclass(frozen=True)
class Plane:
    """Kinds of loops over a plane of specifications: ``kind`` (m, n) as indices into ``KINDS``, at the cells' centres.

    ``x`` (n,) [rad/s] is evenly spaced in its logarithm, from end to end of ``range``; ``y`` (m,) are phase margins
    [deg].
    """

    range: tuple[float, float]
    x: np.ndarray
    y: np.ndarray
    kind: np.ndarray


@dataclass(frozen=True)
class Feasible:
    """Reachable frequencies [rad/s], reachable phase margins [deg] at one of them, and what limits them in words.

    ``low`` and ``high`` are None if no phase margin can be reached at that frequency, ``frequencies`` if none can at
    any; ``upper`` [rad/s] is the end of the control.
    """

    frequencies: tuple[float, float] | None
    upper: float
    low: float | None
    high: float | None
    text: str

    @property
    def empty(self) -> bool:
        """Whether no phase margin can be reached at that frequency."""
        return self.low is None

    @property
    def beyond(self) -> str:
        """What limits the frequencies, in words."""
        if self.frequencies is None:
            return "Sample faster or remove delay."
        highest = self.frequencies[1]
        return f"Above {highest:g} rad/s every phase margin is unstable." * (highest < self.upper)

    def nearest(self, phase_margin_deg: float) -> float | None:
        """Return the reachable phase margin [deg] nearest to ``phase_margin_deg``, or None."""
        return None if self.low is None else float(np.clip(phase_margin_deg, self.low, self.high))

    def nearest_frequency(self, frequency: float) -> float:
        """Return the reachable frequency [rad/s] nearest to ``frequency``, or ``frequency`` if there is none."""
        return frequency if self.frequencies is None else float(np.clip(frequency, *self.frequencies))


def _pairs(state: State) -> Pairs:
    """Return the specifications by frequency and phase margin for axis, structure and filters of ``state``."""
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
    """Return what positive gains with a stable sampled loop can reach around the specification of ``state``.

    Of several intervals of the phase margin it takes the one nearest to that of ``state``.

    >>> from emps_design.machines import machine
    >>> found = feasible(State.of(machine("emps2018")).changed(computation_delay=1))
    >>> found.low, found.high
    (15.0, 77.5)
    """
    choice = CHOICES["phase_margin_deg"]
    phases = np.arange(choice.lower, choice.upper + STEP / 2, STEP)
    gains, good = _designs(state, np.full(phases.size, state.frequency), phases)
    frequencies, upper = reachable_frequencies(state), choices_of(state.axis)["frequency"].upper
    where = f"at {state.specification} {state.frequency:g} rad/s"
    if not good.any():
        reason = f"{UNSTABLE} with every phase margin" if gains.any() else NO_GAIN
        return Feasible(frequencies, upper, None, None, f"Nothing can be reached {where}: {reason}.")
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
    """Return the lowest and highest frequency [rad/s] of the control with any reachable phase margin, or None."""
    return _reachable(_velocity_loop_alone(state).to_toml())


def _velocity_loop_alone(state: State, **kept: Any) -> State:
    """Return ``state`` with first values for all that the velocity loop does not depend on, as a key of the caches."""
    law: dict[str, Any] = {"specification": state.specification, "structure": state.structure, "filters": state.filters}
    return replace(State.plain(state.axis), **law, **kept)


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
    """Return the kinds of loops over frequencies, as the specification of ``state`` means them, and phase margins."""
    return _plane(_velocity_loop_alone(state, required_phase_deg=state.required_phase_deg).to_toml(), columns, rows)


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


def _frame(plot: figure, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Let ``plot`` show at least these ranges with equal scales, whatever its data are."""
    corners = _points(plot, _source(x=list(x), y=list(y)), "x", "y", fill_alpha=0.0, line_alpha=0.0)
    plot.x_range = DataRange1d(renderers=[corners], range_padding=0.0)
    plot.y_range = DataRange1d(renderers=[corners], range_padding=0.0)


def _source(*names: str, **columns: Any) -> ColumnDataSource:
    return ColumnDataSource({name: [] for name in names} | columns)


# Glyphs are added directly: the methods of a figure make four more of each, for selections that are not used here.
def _line(plot: figure, source: ColumnDataSource, x: str, y: str, **look: Any) -> GlyphRenderer:
    return plot.add_glyph(source, Line(x=x, y=y, **look))


def _points(plot: figure, source: ColumnDataSource, x: str, y: str, **look: Any) -> GlyphRenderer:
    return plot.add_glyph(source, Scatter(x=x, y=y, **look))


def _legend(items: list[LegendItem], **look: Any) -> Legend:
    """Return a legend in small type; ``look`` is untyped because bokeh's annotations refuse a number as padding."""
    return Legend(items=items, label_text_font_size="10px", **look)


class LoopPlots:
    """Bode, Nyquist, poles and step of a design, with a pinned design to compare with, and the requirements shaded."""

    def __init__(self) -> None:
        self.lines = {
            key: _source("w", "magnitude", "phase", "re", "im") for key in ("continuous", "sampled", "pinned")
        }
        self.steps = {key: _source("t", "y") for key in ("continuous", "sampled", "pinned")}
        self.poles = {key: _source("re", "im") for key in ("inside", "outside", "pinned")}
        self.marks = _source("w", "phase", "re", "im", "color")
        self.nyquist_frequency = [Span(dimension="height", line_color=GREEN, line_dash="dashed") for _ in range(2)]
        self.phase_band = BoxAnnotation(bottom=-180, top=-150, fill_color=RED, fill_alpha=0.10)
        self.overshoot_band = BoxAnnotation(bottom=1.2, fill_color=RED, fill_alpha=0.10)
        self.circle = _source("re", "im")
        self.magnitude, self.phase = self._bode()
        self.nyquist = self._nyquist()
        self.step = self._step()
        self.z_plane = self._z_plane()

    def _bode(self) -> tuple[figure, figure]:
        magnitude = blank("Bode: magnitude", "frequency [rad/s]", "magnitude [dB]", x_axis_type="log")
        phase = blank(
            "Bode: phase",
            "frequency [rad/s]",
            "phase [deg]",
            x_axis_type="log",
            x_range=magnitude.x_range,
        )
        for plot, column, level in ((magnitude, "magnitude", 0.0), (phase, "phase", -180.0)):
            for key, color, dash in _LINES:
                _line(plot, self.lines[key], "w", column, line_color=color, line_dash=dash, line_width=2)
            plot.add_layout(Span(location=level, dimension="width", line_color=BLACK, line_dash="dashed", line_width=1))
        magnitude.add_layout(self.nyquist_frequency[0])
        phase.add_layout(self.nyquist_frequency[1])
        phase.add_layout(self.phase_band)
        _points(phase, self.marks, "w", "phase", fill_color="color", line_color="color", size=8)
        magnitude.yaxis.ticker = FixedTicker(ticks=[-60, -30, 0, 30, 60])
        phase.yaxis.ticker = FixedTicker(ticks=[-360, -270, -180, -90])
        magnitude.y_range = Range1d(start=-70, end=60)
        phase.y_range = Range1d(start=-370, end=-60)
        phase.add_tools(HoverTool(tooltips=[("frequency", "@w{0.0} rad/s"), ("phase", "@phase{0.0}°")]))
        return magnitude, phase

    def _nyquist(self) -> figure:
        plot = blank("Nyquist", "real part", "imaginary part", match_aspect=True)
        plot.add_glyph(self.circle, Patch(x="re", y="im", fill_color=RED, fill_alpha=0.10, line_color=None))
        _line(plot, _source(x=np.cos(_TURN), y=np.sin(_TURN)), "x", "y", line_color=GREY, line_dash="dashed")
        for key, color, dash in _LINES:
            _line(plot, self.lines[key], "re", "im", line_color=color, line_dash=dash, line_width=2)
        _points(plot, self.marks, "re", "im", fill_color="color", line_color="color", size=8)
        _points(plot, _source(x=[-1.0], y=[0.0]), "x", "y", marker="cross", size=14, line_color=BLACK, line_width=3)
        _frame(plot, (-2.3, 1.2), (-2.2, 1.2))
        return plot

    def _step(self) -> figure:
        plot = blank("Step of the velocity reference", "time [ms]", "velocity / reference")
        plot.add_layout(self.overshoot_band)
        plot.add_layout(BoxAnnotation(bottom=0.98, top=1.02, fill_color=GREY, fill_alpha=0.15))
        items = []
        for key, color, dash in _LINES:
            line = _line(plot, self.steps[key], "t", "y", line_color=color, line_dash=dash, line_width=2)
            items.append(LegendItem(label=key, renderers=[line]))
        self.pinned_item = items[-1]
        self.pinned_item.visible = False
        plot.add_layout(_legend(items, location="bottom_right", padding=4, spacing=0))
        plot.y_range = Range1d(start=0.0, end=1.6)
        self.unstable_note = Label(
            x=8, y=60, x_units="screen", y_units="screen", text="", text_color=RED, text_font_size="13px"
        )
        plot.add_layout(self.unstable_note)
        return plot

    def _z_plane(self) -> figure:
        plot = blank("Poles of the sampled loop, z plane", "real part", "imaginary part", match_aspect=True)
        disk = _source(x=np.cos(_TURN), y=np.sin(_TURN))
        plot.add_glyph(disk, Patch(x="x", y="y", fill_color="#EEF7FD", line_color=BLACK))
        for key, look in (
            ("pinned", {"marker": "diamond", "size": 9, "line_color": GREY, "fill_color": GREY, "fill_alpha": 0.3}),
            ("inside", {"marker": "x", "size": 11, "line_color": BLUE, "line_width": 3}),
            ("outside", {"marker": "x", "size": 13, "line_color": RED, "line_width": 4}),
        ):
            _points(plot, self.poles[key], "re", "im", **look)
        _frame(plot, (-1.2, 1.2), (-1.2, 1.2))
        return plot

    def update(self, design: VelocityLoopDesign, place: str) -> None:
        """Show ``design``, its loop broken at ``place``."""
        from emps_design.control.verdict import step_responses

        loop = broken_loops(design, 250)[0 if place == "velocity error" else 1]
        for key, curve in (("continuous", loop.continuous), ("sampled", loop.sampled)):
            self.lines[key].data = _curve_data(curve)
        marks: dict[str, list] = {"w": [], "phase": [], "re": [], "im": [], "color": []}
        for curve in loop.curves:
            w, margin = curve.margins.crossover, curve.margins.phase_margin_deg
            if w is not None and margin is not None:  # an unstable loop has neither
                at = complex(curve.response(np.array([w]))[0])
                marks["w"].append(w)
                marks["phase"].append(margin - 180.0)
                marks["re"].append(at.real)
                marks["im"].append(at.imag)
                marks["color"].append(curve.color)
        self.marks.data = marks
        for span in self.nyquist_frequency:
            span.location = math.pi / design.axis.sampling.period
        continuous, sampled = step_responses(design, 301)
        self.steps["continuous"].data = {"t": continuous.t * 1e3, "y": continuous.y}
        self.steps["sampled"].data = {"t": [], "y": []} if sampled is None else {"t": sampled.t * 1e3, "y": sampled.y}
        self.unstable_note.text = "" if sampled else "sampled loop unstable: no step response"
        poles = np.asarray(design.sampled.poles)
        inside = np.abs(poles) < 1.0
        self.poles["inside"].data = {"re": poles.real[inside], "im": poles.imag[inside]}
        self.poles["outside"].data = {"re": poles.real[~inside], "im": poles.imag[~inside]}

    def require(self, phase_margin_deg: float, overshoot_percent: float) -> None:
        """Shade what the requirements forbid."""
        self.phase_band.top = -180.0 + phase_margin_deg
        self.overshoot_band.bottom = 1.0 + overshoot_percent / 100.0
        radius = 2.0 * math.sin(math.radians(phase_margin_deg) / 2.0)  # |1 + L| at a crossover with that margin
        self.circle.data = {"re": -1.0 + radius * np.cos(_TURN), "im": radius * np.sin(_TURN)}

    def pin(self) -> None:
        """Keep the design that is shown as thin grey lines to compare with."""
        stable = len(self.steps["sampled"].data["t"]) > 0
        self.lines["pinned"].data = dict(self.lines["sampled"].data)
        self.steps["pinned"].data = dict(self.steps["sampled" if stable else "continuous"].data)
        both = [self.poles[key].data for key in ("inside", "outside")]
        self.poles["pinned"].data = {name: np.concatenate([d[name] for d in both]) for name in ("re", "im")}
        self.pinned_item.visible = True

    def unpin(self) -> None:
        """Remove the pinned design."""
        for source in (self.lines["pinned"], self.steps["pinned"], self.poles["pinned"]):
            source.data = {name: [] for name in source.data}
        self.pinned_item.visible = False


_LINES = (("continuous", BLUE, "solid"), ("sampled", RED, "solid"), ("pinned", GREY, "dotted"))


def _curve_data(curve: Any) -> dict[str, np.ndarray]:
    return {
        "w": curve.w,
        "magnitude": curve.magnitude_db,
        "phase": curve.phase_deg,
        "re": curve.L.real,
        "im": curve.L.imag,
    }


class PlanePlot:
    """The plane of specifications: where (7) has gains, where the sampled loop is stable, where it meets the margin."""

    COLORS = ("#9CA3AF", "#DE7B3C", "#F6DA92", "#BFE3D5")  # of KINDS
    PHASES = (0.0, 90.0)

    def __init__(self) -> None:
        self.cells = _source("kind", "x", "width")
        self.marks = {key: _source("x", "y") for key in ("here", "pinned")}
        self.plot = blank("What can be specified", "", "phase margin [deg]", x_axis_type="log")
        # As a dict: bokeh's annotations of image leave the mapper out.
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
        # Boxes outside the ranges: the legend names every class, whatever the plane shows.
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
        """Mark ``design`` and the pinned one at their crossover or bandwidth, as ``specification`` says."""
        names = {"crossover": "crossover", "bandwidth": "closed-loop −3 dB bandwidth"}
        self.plot.xaxis.axis_label = f"{names[specification]} [rad/s]"
        for key, marked in (("here", design), ("pinned", pinned)):
            designs = [] if marked is None else [marked]
            self.marks[key].data = {
                "x": [getattr(d, specification) for d in designs],
                "y": [d.phase_margin_deg for d in designs],
            }
