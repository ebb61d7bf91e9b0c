"""The sections on the velocity loop: axis and gains, and its Bode, Nyquist, poles and step response."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from emps_design.report.diagrams import velocity_and_force_loop_diagram
from emps_design.report.display import angle, frequency, number, quantity, symbol
from emps_design.report.loop_figures import bode_figure, nyquist_figure, parts_figure, poles_figure, step_figure
from emps_design.report.loops import broken_loops
from emps_design.report.page import Html, Picture, Section, Table, Text

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.velocity.step_response import StepResponse

ACTS_ON = {
    "ip": "integral of the error, proportional on the velocity",
    "pi": "proportional to the error and its integral",
}
AT_THE_PLANT_INPUT = {
    "ip": "It crosses 0 dB at a higher frequency, where the same delay costs more phase",
    "pi": "With PI it is the loop broken at the velocity error",
}


def gains_section(velocity: VelocityLoopDesign) -> Section:
    """Return the section on the axis and the gains of ``velocity``."""
    axis, low_high = velocity.axis, velocity.feasible_phase_margin_deg
    mechanics, drive, sampling = axis.mechanics, axis.drive, axis.sampling
    rows = [
        [Html(symbol("M")), quantity(mechanics.mass, "kg", 6), "load-side equivalent mass"],
        [Html(symbol("F_v")), quantity(mechanics.viscous, "N/(m/s)", 6), "viscous friction"],
        *([["back-EMF", quantity(drive.braking, "N/(m/s)", 6), "what it brakes beside that"]] if drive.braking else []),
        [Html(symbol("F_c")), quantity(mechanics.coulomb, "N", 6), "Coulomb friction"],
        ["offset", quantity(mechanics.offset, "N", 6), "constant force"],
        [Html(symbol("G_tau")), quantity(drive.force_gain, "N/V", 6), "force per volt"],
        ["voltage limit", quantity(drive.command_limit, "V"), ""],
        ["current loop", quantity(drive.current_time_constant, "s"), "time constant, 0: ideal"],
        [
            "sampling period",
            quantity(sampling.period, "s"),
            f"Nyquist {frequency(math.pi / sampling.period)}",
        ],
        ["computation delay", f"{sampling.computation_delay} samples", ""],
        ["encoder step", quantity(sampling.encoder_resolution, "m"), "on the load side"],
        *([effect.kind.replace("_", " "), "effect", _parameters(effect)] for effect in axis.effects),
    ]
    equations = ("(7)", "(8)", "(9)") if velocity.structure.form == "ip" else ("PI", "as (8)", "as (9)")
    solved = "retuned, for the loop as sampled" if velocity.retuned_at else equations[0]
    gains = [
        [Html(symbol("k_v1")), quantity(velocity.k_v1, "V/(m/s)", 6), f"{solved}; kp of a drive"],
        [Html(symbol("t_v")), quantity(velocity.t_v, "s", 6), f"{solved}; Tn of a drive"],
        [Html(symbol("K_v")), quantity(velocity.K_v, "N/m", 6), equations[1]],
        [Html(symbol("omega_0v")), frequency(velocity.omega_0v, 6), equations[2]],
        [Html(symbol("z_v")), number(velocity.z_v, 6), equations[2]],
        ["structure", velocity.structure.label, "of the velocity loop"],
        *([one.kind, quantity(one.frequency, "Hz"), "filter of the command"] for one in velocity.filters),
    ]
    return Section(
        "Axis and gains",
        Picture(
            velocity_and_force_loop_diagram(velocity.structure, bool(velocity.filters)),
            f"The {velocity.structure.label} velocity loop ({ACTS_ON[velocity.structure.form]}) inside the force loop. "
            "The two dotted lines are the places where the loop is broken to read margins.",
            "Structure, after Fig. 4 of the paper",
        ),
        Table(["quantity", "value", "meaning"], rows, f"The axis {axis.name} as designed on."),
        Table(["gain", "value", "equation"], gains, "Gains and canonical form of the velocity loop."),
        None
        if velocity.retuned_at  # these are the margins that (7) can give
        else Text(
            f"At this crossover there are gains for phase margins between {angle(low_high[0])} and "
            f"{angle(low_high[1])}."
        ),
    )


def _parameters(effect: Any) -> str:
    units = {p.name: p.unit for p in effect.effect.parameters}
    return ", ".join(f"{name} {quantity(value, units[name])}" for name, value in effect.parameters.items())


def velocity_section(velocity: VelocityLoopDesign) -> Section:
    """Return the section on the loop: Bode, Nyquist, poles and its step response, sampled too where that is stable."""
    from emps_design.control.velocity.step_response import step_responses

    error, plant = broken_loops(velocity)
    step, sampled = step_responses(velocity)
    period = velocity.axis.sampling.period

    def column(response: StepResponse | None, value: Any) -> Any:
        return "unstable" if response is None else value(response)

    return Section(
        "Velocity loop",
        Picture(
            bode_figure(error, period),
            "The loop of the specification. The vertical bars are the phase margin (lower picture, above −180°) "
            "and the gain margin (upper picture, below 0 dB). The sampled curve, up to Nyquist, is the loop as "
            "implemented.",
            "Bode diagram, broken at the velocity error",
        ),
        Picture(
            bode_figure(plant, period),
            f"The loop that delay acts on. {AT_THE_PLANT_INPUT[velocity.structure.form]}; the distance between the two "
            "curves is what the implementation takes.",
            "Bode diagram, broken at the plant input",
        ),
        Picture(
            parts_figure(velocity),
            "The sampled loop at the plant input and what it is made of: the plant as the controller sees it, with "
            "hold, delay and velocity estimator, and the controller with its filters. The loop is their product; plant "
            "and controller count in SI and in units of the command.",
            "Bode diagram: plant, controller and loop",
        ),
        Picture(
            nyquist_figure((error, plant)),
            "The curve must pass the point −1 on its right; the angle between the negative real axis and the ray to "
            "the unit circle is the phase margin.",
            "Nyquist diagrams",
        ),
        Picture(
            poles_figure(velocity),
            "Left: the two poles of (9), with lines of constant damping ratio. Right: the poles of the sampled loop, "
            "all of which must lie inside the unit circle.",
            "Closed-loop poles",
        ),
        Picture(
            step_figure(step, sampled),
            "Response to a step of the velocity reference. Triangles mark the peak, dotted lines the time after which "
            "the response stays within 2 %.",
            "Step response",
        ),
        Table(
            ["", "continuous", "sampled"],
            [
                [
                    "overshoot",
                    f"{step.overshoot_percent:.2f} %",
                    column(sampled, lambda r: f"{r.overshoot_percent:.2f} %"),
                ],
                [
                    "rise time, 10 to 90 %",
                    quantity(step.rise_time, "s"),
                    column(sampled, lambda r: quantity(r.rise_time, "s")),
                ],
                [
                    "settling time, ±2 %",
                    quantity(step.settling_time, "s"),
                    column(sampled, lambda r: quantity(r.settling_time, "s")),
                ],
            ],
            "Step response of the closed velocity loop.",
        ),
    )
