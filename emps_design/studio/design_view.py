"""The design tab: turn the specification, see gains, margins and pictures follow."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import panel as pn

from emps_design.errors import EmpsError
from emps_design.report.display import angle, delay, number, quantity, ratio
from emps_design.report.page import inline
from emps_design.studio.controls import Knob
from emps_design.studio.panes import html
from emps_design.studio.plots import PLACES, LoopPlots, PlanePlot
from emps_design.studio.reach import plane, reach
from emps_design.studio.state import SPECIFICATIONS, State

if TYPE_CHECKING:
    from emps_design.control.velocity_loop import VelocityLoopDesign

GROUPS = (
    ("Velocity loop", ("frequency", "phase_margin_deg")),
    ("Requirements", ("required_phase_deg", "required_overshoot_percent")),
    ("Drive", ("period_ms", "computation_delay", "current_ms")),
    ("Force loop", ("k_e1", "hand", "wall")),
    ("Impedance law", ("mass", "damping", "filter", "mismatch_percent")),
)


class DesignView:
    """Controls on the left, numbers and pictures on the right; ``changed(state)`` tells the other tabs."""

    def __init__(self, state: State, machines: dict[str, Any], changed: Callable[[State], None]):
        self.state, self.machines, self._changed = state, machines, changed
        self.design: VelocityLoopDesign | None = None
        self.pinned: VelocityLoopDesign | None = None
        self.plots, self.plane = LoopPlots(), PlanePlot()
        self._plane_of: Any = None
        self.machine = pn.widgets.Select(label="Axis", options=list(machines), value=state.axis.name, width=300)
        self.machine.param.watch(self._machine_chosen, "value")
        self.specification = pn.widgets.RadioButtonGroup(
            label="Frequency means", options=list(SPECIFICATIONS), value=state.specification, width=300
        )
        self.specification.param.watch(lambda event: self._turned("specification", event.new), "value")
        self.place = pn.widgets.RadioButtonGroup(label="Loop broken at", options=list(PLACES), value=PLACES[0])
        self.place.param.watch(lambda event: self.refresh(), "value")
        self.pin = pn.widgets.Toggle(label="Pin this design to compare", width=210)
        self.pin.param.watch(self._pinned, "value")
        self.knobs = {name: Knob(name, getattr(state, name), self._turned) for _, names in GROUPS for name in names}
        self.message, self.numbers, self.side = html(), html(), html()
        self.view = self._layout()
        self.refresh()

    def _layout(self) -> pn.Row:
        groups: list[Any] = []
        for title, names in GROUPS:
            groups.append(html(f"<h3>{title}</h3>", margin=(6, 5, 0, 5)))
            groups += [self.specification] if title == "Velocity loop" else []
            groups += [self.knobs[name].view for name in names]
        left = pn.Column(self.machine, *groups, width=330, margin=(0, 8, 0, 0))
        p = self.plots
        grid = pn.GridBox(
            pn.Column(
                pn.pane.Bokeh(p.magnitude, sizing_mode="scale_width"),
                pn.pane.Bokeh(p.phase, sizing_mode="scale_width"),
                margin=0,
                sizing_mode="stretch_width",
            ),
            pn.pane.Bokeh(p.nyquist, sizing_mode="scale_width"),
            pn.pane.Bokeh(p.step, sizing_mode="scale_width"),
            pn.pane.Bokeh(self.plane.plot, sizing_mode="scale_width"),
            pn.pane.Bokeh(p.z_plane, sizing_mode="scale_width"),
            pn.Column(self.side, sizing_mode="stretch_width", margin=0),
            ncols=3,
            sizing_mode="stretch_width",
        )
        bar = pn.Row(pn.pane.HTML("Loop broken at", margin=(8, 5)), self.place, self.pin, margin=0)
        return pn.Row(
            left,
            pn.Column(self.message, self.numbers, bar, grid, sizing_mode="stretch_width", margin=0),
            sizing_mode="stretch_width",
        )

    def _machine_chosen(self, event) -> None:
        self.set_state(self.state.with_axis(self.machines[event.new]))
        self._changed(self.state)

    def _turned(self, name: str, value: Any) -> None:
        try:
            self.state = self.state.changed(**{name: value})
        except EmpsError as error:
            self._say(str(error), "stop")
            return
        self.refresh()
        self._changed(self.state)

    def _pinned(self, event) -> None:
        if event.new and self.design is not None:
            self.pinned = self.design
            self.plots.pin()
            self.plane.pin()
        else:
            self.pinned = None
            self.plots.unpin()
            self.plane.unpin()
        self._show_numbers()

    def add_axis(self, axis: Any) -> None:
        """Offer ``axis`` in the list, choose it, and design on it."""
        self.machines[axis.name] = axis
        self.machine.options = list(self.machines)
        if self.machine.value == axis.name:
            self.set_state(self.state.with_axis(axis))
            self._changed(self.state)
        else:
            self.machine.value = axis.name

    def set_state(self, state: State) -> None:
        """Show ``state`` in every control, and design on it."""
        self.state = state
        for name, knob in self.knobs.items():
            knob.set(getattr(state, name))
        self.specification.value = state.specification
        self.refresh()

    def refresh(self) -> None:
        """Design what the state asks for and show it; a specification that cannot be had stays unreachable."""
        from emps_design.studio.exports import velocity_design

        reachable = reach(self.state)
        said = reachable.text
        if not reachable.empty:
            phase = reachable.nearest(self.state.phase_margin_deg)
            self.knobs["phase_margin_deg"].limit(reachable.low, reachable.high)
            if phase != self.state.phase_margin_deg:
                said = f"{said} The phase margin asked for moved from {self.state.phase_margin_deg:g}° to {phase:g}°."
                self.state = self.state.changed(phase_margin_deg=phase)
        try:
            self.design = velocity_design(self.state)
        except EmpsError as error:
            self._say(str(error), "stop")
            return
        self._say(said, "stop" if reachable.empty else "note")
        self.plots.update(self.design, self.place.value)
        self.plots.require(self.state.required_phase_deg, self.state.required_overshoot_percent)
        key = (self.state.axis, self.state.required_phase_deg)
        if key != self._plane_of:
            names = tuple(name for name, _ in self.plane.CLASSES)
            self.plane.cells.data = plane(self.state.axis, self.state.required_phase_deg, names)
            self._plane_of = key
        self.plane.show(self.design.crossover, self.design.phase_margin_deg)
        self._show_numbers()
        self.side.object = side_table(self.state, self.design)

    def _show_numbers(self) -> None:
        if self.design is not None:
            self.numbers.object = numbers_table(self.state, self.design, self.pinned)

    def _say(self, text: str, level: str) -> None:
        self.message.object = f'<div class="said {level}" role="status">{inline(text)}</div>' if text else ""


def _check(good: bool) -> str:
    return '<b class="yes">meets</b>' if good else '<b class="no">fails</b>'


def numbers_table(state: State, design: VelocityLoopDesign, pinned: VelocityLoopDesign | None) -> str:
    """Gains and margins as HTML, the pinned design's below, and whether the requirements are met."""

    def row(name: str, shown: VelocityLoopDesign) -> str:
        sampled, m = shown.sampled, shown.sampled.margins
        cells = [
            f"<b>{number(shown.k_v1)}</b>",
            f"<b>{number(shown.t_v * 1e3)}</b>",
            angle(shown.phase_margin_deg),
            angle(shown.plant_input.phase_margin_deg),
            f'<b class="margin">{angle(m.phase_margin_deg)}</b>' if m.stable else '<b class="no">unstable</b>',
            delay(m.delay_margin, m.period) if m.stable else "—",
            ratio(m.gain_margin) if m.stable else "—",
            number(sampled.bandwidth) if m.stable else "—",
        ]
        return f"<tr><th>{name}</th>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"

    heads = (
        "k_v1 [V/(m/s)]",
        "t_v [ms]",
        "phase, asked at velocity error",
        "phase, plant input, continuous",
        "phase, plant input, sampled",
        "delay margin, sampled",
        "gain margin, sampled",
        "closed loop −3 dB, sampled [rad/s]",
    )
    head = "".join(f"<th>{text}</th>" for text in heads)
    rows = row("this design", design) + (row("pinned", pinned) if pinned is not None else "")
    return f'<table class="numbers"><tr><th></th>{head}</tr>{rows}</table>{_requirements(state, design)}'


def _requirements(state: State, design: VelocityLoopDesign) -> str:
    from emps_design.studio.plots import steps_of

    m = design.sampled.margins
    if not m.stable:
        return '<p class="requirements"><b class="no">The sampled loop is unstable: no requirement is met.</b></p>'
    overshoot = steps_of(design)[1].overshoot_percent
    phase_good = m.phase_margin_deg is None or m.phase_margin_deg >= state.required_phase_deg
    return (
        f'<p class="requirements">Phase margin {angle(m.phase_margin_deg)} of {angle(state.required_phase_deg)} '
        f"required: {_check(phase_good)} · overshoot {overshoot:.1f} % of {state.required_overshoot_percent:g} % "
        f"allowed: {_check(overshoot <= state.required_overshoot_percent)}</p>"
    )


def side_table(state: State, design: VelocityLoopDesign) -> str:
    """Force loop and impedance law of the state as HTML."""
    rows = [*_force_rows(state, design), *_impedance_rows(state)]
    body = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in rows)
    return f'<table class="side"><tr><th colspan="2">Force loop and impedance law</th></tr>{body}</table>'


def _force_rows(state: State, design: VelocityLoopDesign) -> list[tuple[str, str]]:
    from emps_design.control.force_loop import design_force_loop

    try:
        force = design_force_loop(design, state.k_e1, hand=state.hand, environment=state.wall * 1e3)
    except EmpsError as error:
        return [("force loop", inline(str(error)))]
    if not design.sampled.stable:
        return [("force loop", '<b class="no">the velocity loop inside it is unstable</b>')]
    limit = force.k_e1_max_sampled
    stable = '<b class="yes">stable</b>' if force.stable else '<b class="no">unstable</b>'
    return [
        ("force loop, sampled", stable),
        ("k_e1, largest", f"{number(state.k_e1)}, {'unbounded' if limit is None else number(limit)} (m/s)/N"),
        ("felt: damping, mass", f"{quantity(force.k_c, 'N/(m/s)')}, {quantity(force.apparent_mass, 'kg')}"),
    ]


def _impedance_rows(state: State) -> list[tuple[str, str]]:
    from emps_design.control.impedance import FrictionModel, impedance_law
    from emps_design.control.impedance_robustness import verdict
    from emps_design.control.impedance_sampled import Clock

    try:
        law = impedance_law(state.axis, state.mass, state.damping, state.filter)
        plant, clock = FrictionModel.of(state.axis), Clock.of(state.axis)
        e = state.mismatch_percent / 100.0
        worst = law.with_errors({"mass": e, "viscous": e, "coulomb": e})
        exact = verdict(law, plant, clock, state.axis.sampling.encoder_resolution)
        over = verdict(worst, plant, clock, state.axis.sampling.encoder_resolution)
        felt = worst.apparent(plant)
    except EmpsError as error:
        return [("impedance law", f'<b class="no">{inline(str(error))}</b>')]

    def shown(word: str) -> str:
        mark = "no" if word in ("unstable", "limit_cycle", "creeping") else "yes"
        return f'<b class="{mark}">{word.replace("_", " ")}</b>'

    return [
        ("impedance law, exact", shown(exact)),
        (f"over-estimate of {state.mismatch_percent:g} %", shown(over)),
        ("felt then: mass, damping", f"{quantity(felt.mass, 'kg')}, {quantity(felt.damping, 'N/(m/s)')}"),
        ("Coulomb left", quantity(felt.coulomb_left, "N")),
    ]
