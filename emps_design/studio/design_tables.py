"""The design tab's tables as HTML: gains and margins against the requirements, force loop and impedance law."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.errors import EmpsError
from emps_design.report.display import angle, delay, number, quantity, ratio
from emps_design.report.page import inline
from emps_design.studio.panes import message, numbers
from emps_design.studio.start import requirements
from emps_design.studio.state import State

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign


def _check(good: bool) -> str:
    return '<b class="yes">meets</b>' if good else '<b class="no">fails</b>'


def numbers_table(state: State, design: VelocityLoopDesign, pinned: VelocityLoopDesign | None) -> str:
    """Gains and margins as HTML, the pinned design's below, and whether the requirements are met."""

    def row(name: str, shown: VelocityLoopDesign) -> tuple[str, ...]:
        sampled, m = shown.sampled, shown.sampled.margins
        filters, other = len(shown.filters), ""
        if shown.axis.name != design.axis.name:
            name = f"{name}, {inline(shown.axis.name)}"
        if shown.axis.units != design.axis.units:  # the head's are this design's
            other = f" <code>{shown.axis.units.unit('V/(m/s)')}</code>"
        return (
            name,
            shown.structure.label + (f", {filters} filter{'s' * (filters > 1)}" if filters else ""),
            f"<b>{number(shown.k_v1)}</b>{other}",
            f"<b>{number(shown.t_v * 1e3)}</b>",
            angle(shown.phase_margin_deg),
            angle(shown.plant_input.phase_margin_deg),
            f'<b class="margin">{angle(m.phase_margin_deg)}</b>' if m.stable else '<b class="no">unstable</b>',
            delay(m.delay_margin, m.period) if m.stable else "—",
            ratio(m.gain_margin) if m.stable else "—",
            number(sampled.bandwidth) if m.stable else "—",
        )

    heads = (
        "",
        "structure",
        "k_v1 [V/(m/s)]",
        "t_v [ms]",
        "phase, asked at velocity error",
        "phase, plant input, continuous",
        "phase, plant input, sampled",
        "delay margin, sampled",
        "gain margin, sampled",
        "closed loop −3 dB, sampled [rad/s]",
    )
    rows = [row("this design", design), *([row("pinned", pinned)] if pinned is not None else [])]
    return f"{numbers(heads, rows)}{_requirements(state, design)}"


def _requirements(state: State, design: VelocityLoopDesign) -> str:
    found = requirements(design, state.required_phase_deg, state.required_overshoot_percent)
    if found is None:
        return '<p class="requirements"><b class="no">The sampled loop is unstable: no requirement is met.</b></p>'
    return (
        f'<p class="requirements">Phase margin {angle(found.phase_margin_deg)} of {angle(state.required_phase_deg)} '
        f"required: {_check(found.phase_met)} · overshoot {found.overshoot_percent:.1f} % of "
        f"{state.required_overshoot_percent:g} % allowed: {_check(found.overshoot_met)}</p>"
    )


def verdict_message(design: VelocityLoopDesign) -> str:
    """What to do with ``design``, by the worst loop that will run, as HTML."""
    from emps_design.control.loop.worst import (
        SAFE_GAIN_MARGIN,
        SAFE_PHASE_MARGIN_DEG,
        loop_in_words,
        margins_in_words,
        safety,
    )
    from emps_design.control.verdict import DesignVerdict

    worst = DesignVerdict(design).worst
    name = f"the worst loop that will run, the {loop_in_words(worst)},"
    if not worst.margins.stable:
        return message(f"Do not run: {name} is unstable.", "stop")
    has = f"{name} has {margins_in_words(worst.margins)}"
    if safety(worst.margins) >= 1.0:
        return message(f"Safe: {has}.", "good")
    safe = f"{SAFE_PHASE_MARGIN_DEG:g} deg and a gain margin of {SAFE_GAIN_MARGIN:g}"
    return message(f"Caution: {has}; a safe one has {safe}.", "warning")


def laws_table(state: State, design: VelocityLoopDesign) -> str:
    """Force loop and impedance law of the state as HTML."""
    cells = [("", ""), *_force_cells(state, design), *_impedance_cells(state)]
    heads, values = zip(*cells, strict=True)
    return numbers(heads, [values])


def _force_cells(state: State, design: VelocityLoopDesign) -> list[tuple[str, str]]:
    from emps_design.control.force.design import design_force_loop

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
        ("k_e1, largest [(m/s)/N]", f"{number(state.k_e1)}, {'unbounded' if limit is None else number(limit)}"),
        ("felt: damping, mass", f"{quantity(force.k_c, 'N/(m/s)')}, {quantity(force.apparent_mass, 'kg')}"),
    ]


def _impedance_cells(state: State) -> list[tuple[str, str]]:
    from emps_design.control.impedance.law import FrictionModel, impedance_law
    from emps_design.control.impedance.robustness import verdict
    from emps_design.control.impedance.sampled import Clock, extended_loop
    from emps_design.laws.friction_model import left_out

    try:
        law = impedance_law(state.axis, state.mass, state.damping, state.filter)
        plant, clock = FrictionModel.of(state.axis), Clock.of(state.axis)
        e = state.mismatch_percent / 100.0
        worst = law.with_errors({"mass": e, "viscous": e, "coulomb": e})
        effects = bool(left_out(state.axis))  # which the friction model of the verdict does not hold
        exact, over = (
            "unstable"
            if effects and not extended_loop(state.axis, one).stable
            else verdict(one, plant, clock, state.axis.sampling.encoder_resolution)
            for one in (law, worst)
        )
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
