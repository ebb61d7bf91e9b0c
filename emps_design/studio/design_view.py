"""The design tab: controls of the specification, and the gains, margins and plots of the design.

Its tables compare gains and margins with the requirements, and show the verdicts on force loop and impedance law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import panel as pn

from emps_design import view
from emps_design.advice import advise
from emps_design.errors import EmpsError
from emps_design.report.page import LEVELS, angle, delay, html as markup, number, quantity, ratio, sentence_of
from emps_design.studio.controls import FilterRows, Knob
from emps_design.studio.panes import AxisFile, bold, html, judgement, message
from emps_design.studio.plots import LoopPlots, PlanePlot, feasible, plane
from emps_design.studio.ranges import requirements
from emps_design.studio.state import LABELS, PLACES, SPECIFICATIONS, State, conversion_in_words, differences_in_words
from emps_design.view import Line, Table, View

if TYPE_CHECKING:
    from emps_design.axis import Axis
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.laws.library.cascade import Filter

GROUPS = (
    ("Velocity loop", ("frequency", "phase_margin_deg")),
    ("Requirements", ("required_phase_deg", "required_overshoot_percent")),
    ("Drive", ("period_ms", "computation_delay", "current_ms")),
    ("Force loop", ("k_e1", "hand", "wall")),
    ("Impedance law", ("mass", "damping", "filter", "mismatch_percent")),
)

# The specification of the velocity loop: an infeasible number is moved to the nearest feasible one.
SPECIFYING = ("frequency", "phase_margin_deg", "specification", "structure", "filters")


def _check(good: bool) -> str:
    return bold("meets", "yes") if good else bold("fails", "no")


def numbers_view(state: State, design: VelocityLoopDesign, pinned: VelocityLoopDesign | None) -> View:
    """Gains and margins of ``design`` and of the pinned one, and whether the requirements are met."""
    units = design.axis.units

    def row(name: str, shown: VelocityLoopDesign) -> tuple[str, ...]:
        sampled, m = shown.sampled, shown.sampled.margins
        filters, gain = len(shown.filters), bold(number(shown.k_v1))
        if shown.axis.name != design.axis.name:
            name = f"{name}, {shown.axis.name}"
        if shown.axis.units != units:  # the headings have the units of this design
            gain = markup("{} <code>{}</code>", gain, shown.axis.units.unit("V/(m/s)"))
        return (
            name,
            shown.structure.label + (f", {filters} filter{'s' * (filters > 1)}" if filters else ""),
            gain,
            bold(number(shown.t_v * 1e3)),
            angle(shown.phase_margin_deg),
            angle(shown.plant_input.phase_margin_deg),
            bold(angle(m.phase_margin_deg), "margin") if m.stable else bold("unstable", "no"),
            delay(m.delay_margin, m.period) if m.stable else "—",
            ratio(m.gain_margin) if m.stable else "—",
            number(sampled.bandwidth) if m.stable else "—",
        )

    headings = (
        "",
        "structure",
        f"k_v1 [{units.unit('V/(m/s)')}]",
        "t_v [ms]",
        "phase, specified at velocity error",
        "phase, plant input, continuous",
        "phase, plant input, sampled",
        "delay margin, sampled",
        "gain margin, sampled",
        "closed loop −3 dB, sampled [rad/s]",
    )
    rows = [row("this design", design), *([row("pinned", pinned)] if pinned is not None else [])]
    return Table(headings, rows), _requirements(state, design)


def _requirements(state: State, design: VelocityLoopDesign) -> Line:
    achieved = requirements(design, state.required_phase_deg, state.required_overshoot_percent)
    if achieved is None:
        return Line(bold("The sampled loop is unstable: no requirement is met.", "no"))
    return Line(
        markup(
            "Phase margin {}, required {}: {} · overshoot {} %, allowed {} %: {}",
            angle(achieved.phase_margin_deg),
            angle(state.required_phase_deg),
            _check(achieved.phase_met),
            f"{achieved.overshoot_percent:.1f}",
            f"{state.required_overshoot_percent:g}",
            _check(achieved.overshoot_met),
        )
    )


def verdict_message(design: VelocityLoopDesign) -> str:
    """Return the advice on ``design`` as HTML, judged by its worst loop."""
    from emps_design.control.verdict import DesignVerdict

    verdict = DesignVerdict(design)
    document = {"reason": verdict.reason, "worst_loop": verdict.worst.to_dict(), "warnings": design.warnings}
    advice = advise("gains", document, units=design.axis.units)
    return judgement(sentence_of(advice.text), LEVELS[advice.level][0])


def laws_view(state: State, design: VelocityLoopDesign) -> View:
    """Force loop and impedance law of ``state``."""
    cells = [("", ""), *_force_cells(state, design), *_impedance_cells(state)]
    headings, values = zip(*cells, strict=True)
    return (Table(headings, [values]),)


def _force_cells(state: State, design: VelocityLoopDesign) -> list[tuple[str, str]]:
    from emps_design.control.force import design_force_loop

    units = state.axis.units
    loop = units.words("force loop")
    try:
        force = design_force_loop(design, state.k_e1, hand=state.hand, environment=state.wall * 1e3)
    except EmpsError as error:
        return [(loop, str(error))]
    if not design.sampled.stable:
        return [(loop, bold("the inner velocity loop is unstable", "no"))]
    limit = force.k_e1_max_sampled
    felt = f"{quantity(force.k_c, 'N/(m/s)', units=units)}, {quantity(force.apparent_mass, 'kg', units=units)}"
    return [
        (f"{loop}, sampled", bold("stable", "yes") if force.stable else bold("unstable", "no")),
        (
            f"k_e1, largest [{units.unit('(m/s)/N')}]",
            f"{number(state.k_e1)}, {'unbounded' if limit is None else number(limit)}",
        ),
        (f"apparent damping, {units.word('mass')}", felt),
    ]


def _impedance_cells(state: State) -> list[tuple[str, str]]:
    from emps_design.control.impedance.law import FrictionModel, impedance_law
    from emps_design.control.impedance.passivity import Clock, extended_loop
    from emps_design.control.impedance.robustness import verdict
    from emps_design.laws.law import left_out

    units = state.axis.units
    try:
        law = impedance_law(state.axis, state.mass, state.damping, state.filter)
        plant, clock = FrictionModel.of(state.axis), Clock.of(state.axis)
        e = state.mismatch_percent / 100.0
        worst = law.with_errors({"mass": e, "viscous": e, "coulomb": e})
        effects = bool(left_out(state.axis))  # the friction model of the verdict lacks them
        exact, over = (
            "unstable"
            if effects and not extended_loop(state.axis, candidate).stable
            else verdict(candidate, plant, clock, state.axis.sampling.encoder_resolution)
            for candidate in (law, worst)
        )
        felt = worst.apparent(plant)
    except EmpsError as error:
        return [("impedance law", bold(str(error), "no"))]

    def shown(word: str) -> str:
        return bold(word.replace("_", " "), "no" if word in ("unstable", "limit_cycle", "creeping") else "yes")

    return [
        ("impedance law, exact", shown(exact)),
        (f"estimates {state.mismatch_percent:g} % too large", shown(over)),
        (
            f"apparent {units.word('mass')}, damping then",
            f"{quantity(felt.mass, 'kg', units=units)}, {quantity(felt.damping, 'N/(m/s)', units=units)}",
        ),
        ("remaining Coulomb friction", quantity(felt.coulomb_left, "N", units=units)),
    ]


class DesignView:
    """Controls on the left, numbers and plots on the right; ``changed(state)`` is called after each change.

    ``opened(axis)`` is called with an axis from a file; by default :meth:`add_axis`.
    """

    def __init__(
        self,
        state: State,
        machines: dict[str, Any],
        changed: Callable[[State], None],
        opened: Callable[[Axis], None] | None = None,
    ):
        self.state, self.machines, self._changed = state, machines, changed
        self.design: VelocityLoopDesign | None = None
        self.pinned: VelocityLoopDesign | None = None
        self.plots, self.plane = LoopPlots(), PlanePlot()
        self._plane: Any = None
        self.machine = pn.widgets.Select(
            label="Axis", options=list(machines), value=state.axis.name, width=306, margin=(4, 6)
        )
        self.machine.param.watch(lambda event: self._design_on(self.machines[event.new]), "value")
        self.file = AxisFile(opened or self.add_axis, self._refuse, width=306)
        self.reset = pn.widgets.Button(label="Default values for this axis", width=306, margin=(2, 6))
        self.reset.on_click(lambda event: self._default_values())
        self.words = {
            "specification": pn.widgets.RadioButtonGroup(
                label="Frequency means",
                options=list(SPECIFICATIONS),
                value=state.specification,
                width=306,
                margin=(2, 6),
            ),
            "structure": pn.widgets.Select(
                label="Structure", options=list(LABELS), value=state.structure, width=306, margin=(2, 6)
            ),
            "place": pn.widgets.RadioButtonGroup(
                label="Loop broken at", options=list(PLACES), value=state.place, margin=(2, 8)
            ),
        }
        for name, group in self.words.items():
            group.param.watch(lambda event, name=name: self._on_word(name, event.new), "value")
        self.pin = pn.widgets.Toggle(label="Pin this design to compare", width=210, margin=(2, 8))
        self.pin.param.watch(self._pinned, "value")
        self.knobs = {name: Knob(name, getattr(state, name), self.turn) for _, names in GROUPS for name in names}
        self.filters = FilterRows(lambda tables: self.turn("filters", tables), self._default_filter)
        self.verdict, self.message, self.numbers, self.laws = html(), html(), html(), html()
        self.titles: dict[str, pn.pane.HTML] = {}
        self._quiet = False
        self.view = self._layout()
        self.set_state(state)

    def _layout(self) -> pn.Row:
        groups: list[Any] = []
        for title, names in GROUPS:
            self.titles[title] = html(margin=(6, 6, 0, 6))
            groups.append(self.titles[title])
            groups += [self.words["specification"]] if title == "Velocity loop" else []
            groups += [self.knobs[name].view for name in names]
            groups += [self.words["structure"], self.filters.view] if title == "Velocity loop" else []
        axis = (self.machine, self.file.field, self.reset)
        controls = pn.Column(*axis, *groups, width=330, margin=(0, 8, 0, 0))
        p = self.plots
        columns = ((p.magnitude, p.phase), (p.nyquist, self.plane), (p.step, p.z_plane))
        pictures = pn.Row(
            *(
                pn.Column(
                    *(pn.pane.Bokeh(shown.plot, sizing_mode="scale_width") for shown in column),
                    margin=0,
                    sizing_mode="stretch_width",
                )
                for column in columns
            ),
            margin=0,
            sizing_mode="stretch_width",
        )
        bar = pn.Row(pn.pane.HTML("Loop broken at", margin=(6, 0, 0, 5)), self.words["place"], self.pin, margin=(4, 0))
        words = (self.verdict, self.message, self.numbers)
        results = pn.Column(*words, bar, pictures, self.laws, sizing_mode="stretch_width", margin=0)
        results.styles = {"position": "sticky", "top": "0", "align-self": "flex-start"}  # visible beside every knob
        return pn.Row(controls, results, sizing_mode="stretch_width")

    def _default_filter(self, kind: str) -> Filter:
        from emps_design.control.velocity.limits import first_try

        return first_try(self.state.axis, self.state.frequency, kind)

    def _design_on(self, axis: Axis) -> None:
        """Design the specification on ``axis``, and list the numbers that changed with the axis."""
        before = self.state
        after = before.with_axis(axis)
        self.set_state(after, differences_in_words(before, after))
        self._changed(self.state)

    def _default_values(self) -> None:
        self.set_state(replace(State.of(self.state.axis), pinned=self.state.pinned))
        self._changed(self.state)

    def _on_word(self, name: str, value: Any) -> None:
        if not self._quiet:
            self.turn(name, value)

    def turn(self, name: str, value: Any) -> None:
        """Change one number or word of the state, from any tab, and show the new design.

        If the value is refused, the control returns to the value of the present design.
        """
        before = self.state
        try:
            self.state = self.state.changed(**{name: value})
            self._suit()
            if name in self.knobs:
                self.knobs[name].set(getattr(self.state, name))
            if name == "place":
                self._show_pinned()
            elif name in self.knobs or name in self.words or name == "filters":
                self._design(conversion_in_words(name, value), move=name in SPECIFYING)
        except EmpsError as error:
            self.state = before
            self._suit()
            self._refuse(f"{error}; the design is unchanged")
        self._show_controls()
        self._changed(self.state)

    def _pinned(self, event: Any) -> None:
        if self._quiet:
            return
        self.state = replace(self.state, pinned=replace(self.state, pinned=None) if event.new else None)
        self._show_pinned()
        self._changed(self.state)

    def _refuse(self, text: str) -> None:
        self._say(text, "bad")

    def _show_pinned(self, note: str = "") -> None:
        """Draw the pinned design as grey lines, or remove them."""
        from emps_design.studio.files_view import velocity_design

        pinned = self.state.pinned
        self.pinned = None if pinned is None else velocity_design(pinned)
        if self.pinned is None:
            self.plots.unpin()
        else:
            self.plots.update(self.pinned, self.state)
            self.plots.pin()
        self.refresh(note)

    def add_axis(self, axis: Axis) -> None:
        """Add ``axis`` to the list, select it, and design on it."""
        self.machines[axis.name] = axis
        self.machine.options = list(self.machines)
        if self.machine.value == axis.name:
            self._design_on(axis)
        else:
            self.machine.value = axis.name

    def set_state(self, state: State, note: str = "") -> None:
        """Show ``state`` in every control and design it; the message begins with ``note``."""
        self.state = state
        self._suit()
        self._show_controls()
        self._show_pinned(note)

    def _suit(self) -> None:
        """Set label and range of every knob for the axis."""
        for knob in self.knobs.values():
            knob.suit(self.state)

    def _show_controls(self) -> None:
        state = self.state
        self._quiet = True
        try:
            for title, pane in self.titles.items():
                pane.object = f"<h3>{state.axis.units.words(title)}</h3>"
            for name, knob in self.knobs.items():
                knob.set(getattr(state, name))
            for name, group in self.words.items():
                group.value = getattr(state, name)
            self.filters.set(state.filters)
            self.pin.value = state.pinned is not None
        finally:
            self._quiet = False

    def _feasible_note(self, move: bool) -> tuple[str, bool]:
        """Return the feasible range in words, and whether it has a design; ``move`` moves the state into it."""
        notes: list[str] = []
        reachable, requested = feasible(self.state), self.state.frequency
        frequency = reachable.nearest_frequency(requested)
        if frequency == requested:
            notes += [reachable.text, reachable.beyond]
        elif move:
            notes += [reachable.text, f"The frequency was moved from {requested:g} to {frequency:g} rad/s."]
            self.state = self.state.changed(frequency=frequency)
            reachable = feasible(self.state)
            notes.append(reachable.text)
        else:
            notes += [reachable.text, f"The nearest feasible frequency is {frequency:g} rad/s."]
        if reachable.frequencies is not None:
            self.knobs["frequency"].limit(*reachable.frequencies, self.state.frequency)
        low, high, margin = reachable.low, reachable.high, self.state.phase_margin_deg
        phase = reachable.nearest(margin)
        if phase not in (None, margin) and move:
            notes.append(f"The phase margin was moved from {margin:g}° to {phase:g}°.")
            self.state = self.state.changed(phase_margin_deg=phase)
        elif phase not in (None, margin):
            notes.append(f"The nearest feasible phase margin is {phase:g}°.")
        if low is not None and high is not None:
            self.knobs["phase_margin_deg"].limit(low, high, self.state.phase_margin_deg)
        return " ".join(filter(None, notes)), not reachable.empty

    def refresh(self, note: str = "") -> None:
        """Design the specification of the state and show it; if there is no design, say why."""
        try:
            self._design(note)
        except EmpsError as error:
            self.design = None
            self.verdict.object = self.numbers.object = self.laws.object = ""
            self._refuse(f"{note} {error}; there is no design, the plots show the previous one".strip())

    def _design(self, note: str = "", move: bool = False) -> None:
        from emps_design.studio.files_view import velocity_design

        notes, reached = self._feasible_note(move)
        self.design = velocity_design(self.state)
        self.verdict.object = verdict_message(self.design)
        refused = f"{sentence_of(self.design.refused)} " if self.design.refused else ""
        self._say(f"{refused}{note} {notes}".strip(), "note" if reached and not refused else "bad")
        state = self.state
        self.plots.update(self.design, state)
        regions = plane(state)
        if regions is not self._plane:
            self.plane.color(regions)
            self._plane = regions
        self.plane.show(state.specification, self.design, self.pinned)
        self.numbers.object = view.html(numbers_view(state, self.design, self.pinned))
        self.laws.object = view.html(laws_view(state, self.design))

    def _say(self, text: str, level: str) -> None:
        self.message.object = message(text, level) if text else ""
