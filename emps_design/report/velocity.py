"""The sections on the velocity loop, its implementation, the force loop, and the controller of the axis file.

They have gains, margins and pictures of the loops, the difference equation of the drive, the range of margins under a
mismatch, and the largest gain of the force loop.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.report.diagrams import velocity_and_force_loop_diagram
from emps_design.report.loop_figures import (
    bode_figure,
    broken_loops,
    nyquist_figure,
    nyquist_plane,
    parts_figure,
    poles_figure,
    step_figure,
    z_plane,
)
from emps_design.report.page import (
    NOTHING,
    Callout,
    Html,
    Listing,
    Picture,
    Section,
    Table,
    Text,
    angle,
    delay,
    frequency,
    html,
    number,
    quantity,
    ratio,
    symbol,
)
from emps_design.report.style import BLACK, BLUE, GREEN, RED, look, subplots

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from emps_design.control.force import ForceLoopDesign
    from emps_design.control.sampled import NestedLoop
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.verdict import StepResponse
    from emps_design.units import Units

ACTS_ON = {
    "ip": "integral of the error, proportional on the velocity",
    "pi": "proportional to the error and its integral",
}
AT_THE_PLANT_INPUT = {
    "ip": "It crosses 0 dB at a higher frequency, where the same delay costs more phase",
    "pi": "With PI it is the loop broken at the velocity error",
}

MISMATCH = 0.02  # the error of Section IV-B of the paper

WALLS = np.geomspace(1.0 / 30.0, 30.0, 22)  # stiffnesses, relative to that of the design


def gains_section(velocity: VelocityLoopDesign) -> Section:
    """Return the section on the axis and the gains of ``velocity``."""
    axis, low_high = velocity.axis, velocity.feasible_phase_margin_deg
    mechanics, drive, sampling, units = axis.mechanics, axis.drive, axis.sampling, axis.units
    force, braking = units.word("force"), quantity(drive.braking, "N/(m/s)", 6, units)
    rows = [
        [Html(symbol("M")), quantity(mechanics.mass, "kg", 6, units), f"load-side equivalent {units.word('mass')}"],
        [Html(symbol("F_v")), quantity(mechanics.viscous, "N/(m/s)", 6, units), "viscous friction"],
        *([["back-EMF", braking, "what it brakes beside that"]] if drive.braking else []),
        [Html(symbol("F_c")), quantity(mechanics.coulomb, "N", 6, units), "Coulomb friction"],
        ["offset", quantity(mechanics.offset, "N", 6, units), f"constant {force}"],
        [Html(symbol("G_tau")), quantity(drive.force_gain, "N/V", 6, units), f"{force} per {units.word('volt')}"],
        [f"{units.word('voltage')} limit", quantity(drive.command_limit, "V", 4, units), ""],
        ["current loop", quantity(drive.current_time_constant, "s"), "time constant, 0: ideal"],
        [
            "sampling period",
            quantity(sampling.period, "s"),
            f"Nyquist {frequency(math.pi / sampling.period)}",
        ],
        ["computation delay", f"{sampling.computation_delay} samples", ""],
        ["encoder step", quantity(sampling.encoder_resolution, "m", 4, units), "on the load side"],
        *([effect.kind.replace("_", " "), "effect", _parameters(effect, units)] for effect in axis.effects),
    ]
    equations = ("(7)", "(8)", "(9)") if velocity.structure.form == "ip" else ("PI", "as (8)", "as (9)")
    solved = "retuned, for the loop as sampled" if velocity.retuned_at else equations[0]
    gains = [
        [Html(symbol("k_v1")), quantity(velocity.k_v1, "V/(m/s)", 6, units), f"{solved}; kp of a drive"],
        [Html(symbol("t_v")), quantity(velocity.t_v, "s", 6), f"{solved}; Tn of a drive"],
        [Html(symbol("K_v")), quantity(velocity.K_v, "N/m", 6, units), equations[1]],
        [Html(symbol("omega_0v")), frequency(velocity.omega_0v, 6), equations[2]],
        [Html(symbol("z_v")), number(velocity.z_v, 6), equations[2]],
        ["structure", velocity.structure.label, "of the velocity loop"],
        *([stage.kind, quantity(stage.frequency, "Hz"), "filter of the command"] for stage in velocity.filters),
    ]
    return Section(
        "Axis and gains",
        Picture(
            velocity_and_force_loop_diagram(velocity.structure, bool(velocity.filters)),
            f"The {velocity.structure.label} velocity loop ({ACTS_ON[velocity.structure.form]}) inside the {force} "
            "loop. The two dotted lines are the places where the loop is broken to read margins.",
            "Structure, after Fig. 4 of the paper",
        ),
        Table(["quantity", "value", "meaning"], rows, f"The axis {axis.name} as designed on."),
        Table(["gain", "value", "equation"], gains, "Gains and canonical form of the velocity loop."),
        None
        if velocity.retuned_at  # the range is that of the gains of (7)
        else Text(
            f"At this crossover there are gains for phase margins between {angle(low_high[0])} and "
            f"{angle(low_high[1])}."
        ),
    )


def _parameters(effect: Any, units: Units) -> str:
    unit = {p.name: p.unit for p in effect.effect.parameters}
    return ", ".join(f"{name} {quantity(value, unit[name], 4, units)}" for name, value in effect.parameters.items())


def velocity_section(velocity: VelocityLoopDesign) -> Section:
    """Return the section on the loop: Bode, Nyquist, poles and step response, continuous and sampled."""
    from emps_design.control.verdict import step_responses

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


def drive_section(velocity: VelocityLoopDesign, mismatch: float = MISMATCH) -> Section:
    """Return the section on the implementation of ``velocity``; ``mismatch`` is the relative error studied."""
    from emps_design.control.velocity.design import difference_equation, encoder_voltage_noise, largest_velocity_step
    from emps_design.control.velocity.load_range import margins_under_mismatch, relative_mismatch

    axis, units = velocity.axis, velocity.axis.units
    voltage = units.word("voltage")
    equation = difference_equation(axis, velocity.k_v1, velocity.t_v, velocity.structure, velocity.filters)
    signals = units.label("q [m], v_ref [m/s], u [V]")
    blocks: list[Any] = [Listing("\n".join(equation.lines), f"The law with its numbers, once a sample: {signals}.")]
    if velocity.sampled.stable:
        step = largest_velocity_step(axis, velocity.sampled)
        noise = encoder_voltage_noise(axis, velocity.sampled)
        blocks.append(
            Table(
                ["quantity", "value", "meaning"],
                [
                    [
                        "largest velocity step",
                        quantity(step["value"], "m/s", 4, units),
                        f"from rest, below the {voltage} limit of {quantity(step['voltage_limit'], 'V', 3, units)}; "
                        f"{quantity(step['dry_friction_voltage'], 'V', 3, units)} of it go into dry friction",
                    ],
                    [
                        f"{voltage} noise of the encoder",
                        quantity(noise["rms"], "V", 3, units),
                        "rms in closed loop, in motion",
                    ],
                    ["one step of the encoder", quantity(noise["one_step"], "V", 3, units), f"jump of the {voltage}"],
                ],
                f"Room below the {voltage} limit, and the price of the encoder's resolution.",
            )
        )
    blocks.append(_mismatch_table(margins_under_mismatch(velocity, relative_mismatch(mismatch)), mismatch, units))
    return Section("On the drive", *blocks)


def _mismatch_table(study: dict[str, Any], mismatch: float, units: Units) -> Table | Text:
    off = f"{units.word('mass')}, viscous friction and {units.word('force')} gain off by ±{100 * mismatch:g} %"
    if not study["stable_share"]:
        return Text(f"With {off} every corner is unstable.")

    def interval(key: str, shown: Any) -> list[str]:
        low, high = study[key] or (None, None)
        return [NOTHING if low is None else shown(low), NOTHING if high is None else shown(high)]

    rows: list[list[Any]] = [
        ["phase margin, plant input, sampled", *interval("phase_margin_deg", angle)],
        ["crossover", *interval("crossover", frequency)],
        ["delay margin", *interval("delay_margin", delay)],
        ["gain margin", *interval("gain_margin", ratio)],
        ["closed loop −3 dB", *interval("bandwidth", frequency)],
    ]
    if study["gains"]:
        rows += [
            [
                html("{} for the same request", Html(symbol(name))),
                *(quantity(x, unit, 4, units) for x in study["gains"][name]),
            ]
            for name, unit in (("k_v1", "V/(m/s)"), ("t_v", "s"))
        ]
    stable = "all" if study["stable_share"] == 1.0 else f"{100 * study['stable_share']:.3g} %"
    return Table(
        ["", "lowest", "highest"],
        rows,
        f"The same gains on {study['corners']} plants with {off}; {stable} of them stable.",
    )


def force_limit_figure(design: ForceLoopDesign) -> Figure:
    """Draw the largest k_e1 over the stiffness of the wall, continuous and sampled, and the k_e1 of the design.

    The range is around the wall of the design; without one, around the stiffness with which the mass would have its
    resonance at the crossover.
    """
    loop = design.velocity_loop
    centre = design.environment or loop.axis.mechanics.mass * loop.crossover**2
    stiffness = centre * WALLS
    walls = [replace(design, environment=float(stiffness)) for stiffness in stiffness]
    limits_of = {
        name: [getattr(wall, f"k_e1_max_{name}") for wall in walls] for name in ("continuous", "sampled")
    }  # None: no limit, 0: always unstable
    with look():
        figure, axes = subplots(height=3.4)
        for (name, limits), color, style in zip(limits_of.items(), (BLUE, RED), ("-", "--"), strict=True):
            shown = np.array([limit or np.nan for limit in limits], dtype=float)
            axes.loglog(stiffness / 1e3, shown, color=color, linestyle=style, label=f"largest $k_{{e1}}$, {name}")
        axes.autoscale_view()
        bottom, top = axes.get_ylim() if np.any(np.isfinite(_drawn(axes))) else (design.k_e1, design.k_e1)
        bottom, top = min(bottom, design.k_e1 / 2.0), max(top, design.k_e1 * 2.0)
        edge = np.array([np.nan if limit is None else max(limit, bottom) for limit in limits_of["sampled"]])
        if np.any(np.isfinite(edge)):
            axes.fill_between(stiffness / 1e3, edge, np.full(edge.size, top), color=RED, alpha=0.08, linewidth=0)
        axes.set_ylim(bottom, top)
        axes.axhline(design.k_e1, color=BLACK, linewidth=1.1, linestyle=":", label="$k_{e1}$ of this design")
        if design.environment > 0:
            axes.plot(
                [design.environment / 1e3],
                [design.k_e1],
                "o" if design.stable else "X",
                color=GREEN if design.stable else RED,
                markersize=9,
                zorder=5,
                label="this design: " + ("stable" if design.stable else "unstable"),
            )
        axes.set(xlabel="stiffness of the wall $K_{env}$ [N/mm]", ylabel=r"$k_{e1}$ [(m/s)/N]")
        axes.grid(which="both", linewidth=0.5)
        axes.legend(loc="lower left")
    return figure


def _drawn(axes: Axes) -> np.ndarray:
    return np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()])


def force_loop_figure(design: ForceLoopDesign) -> Figure:
    """Draw the Nyquist curve of the sampled force loop and its poles in the z plane."""
    period = design.velocity_loop.axis.sampling.period
    w = np.geomspace(0.5, np.pi / period * (1 - 1e-9), 500)
    loop = design.response(w)
    with look():
        figure, (nyquist_axes, z_axes) = subplots(1, 2, height=4.0)
        nyquist_axes.plot(loop.real, loop.imag, color=RED)
        nyquist_plane(nyquist_axes, (-2.2, 1.4), (-2.6, 1.0), "force loop, sampled")
        z_plane(z_axes, np.asarray(design.poles), "closed-loop poles, z plane")
    return figure


def force_section(force: ForceLoopDesign) -> Section:
    """Return the section on the force loop ``force``: stability first, then margins and limits."""
    units, operator = force.velocity_loop.axis.units, []
    word, carriage = units.word("force"), units.word("carriage")
    if force.hand:
        operator.append(f"a viscous hand of {quantity(force.hand, 'N/(m/s)', 4, units)}")
    if force.environment:
        operator.append(f"a wall of {number(force.environment / 1e3)} {units.unit('N/mm')}")
    margins, stable = force.margins, force.worst.margins.stable

    def limit(value: float | None) -> str:
        return "unbounded" if value is None else quantity(value, "(m/s)/N", 4, units)

    def margin(shown: str) -> str:
        return shown if force.stable else "unstable"

    reading = str(force.paper_reading["text"])
    unstable = ("force-loop-unstable", "inner-loop-unstable", "other-machine-unstable", "sampled-limit-unbounded")
    warnings = [message for message in force.warnings if message.code not in unstable]
    rows = [
        [Html(symbol("k_e1")), quantity(force.k_e1, "(m/s)/N", 4, units), f"velocity per {units.word('newton')}"],
        [Html(symbol("k_c")), quantity(force.k_c, "N/(m/s)", 4, units), "what the hand feels at low frequency, 1/k_e1"],
        [
            f"apparent {units.word('mass')}",
            quantity(force.apparent_mass, "kg", 4, units),
            "low-frequency match of k_e1 T_vc with 1/(M_a s + B)",
        ],
        ["largest gain, continuous", limit(force.k_e1_max_continuous), "closed form (Routh)"],
        ["largest gain, sampled", limit(force.k_e1_max_sampled), "by the poles of the loop as implemented"],
        [
            "phase margin, sampled",
            margin(angle(margins.phase_margin_deg) if margins.phase_margin_deg else "unbounded"),
            "",
        ],
        ["gain margin, sampled", margin(ratio(margins.gain_margin)), ""],
        ["delay margin, sampled", margin(delay(margins.delay_margin, margins.period)), ""],
    ]
    return Section(
        f"{word.capitalize()} loop",
        Text(
            f"Operator: {' and '.join(operator) or 'none'}, tau_e = −(k_h q̇ + K_env q), positive towards +q. The "
            f"{word} acts on the sensor{f' and on the {carriage}' if force.on_carriage else ' only'}."
        ),
        Callout("good", "stable.") if stable else Callout("stop", f"the {units.words(force.worst.name)} is unstable."),
        Table(
            ["quantity", "value", "meaning"],
            rows,
            f"{word.capitalize()} loop of Fig. 4, (10) and (11), with an explicit operator.",
        ),
        Callout("note", "The paper's own reading of (10), (11)", f"{reading}."),
        Picture(
            force_limit_figure(force),
            "Shaded, above the dashed line, the loop as implemented is unstable: the “too high gain” of the paper. "
            "Where all is shaded no gain is stable, where nothing is any. The stiffer the wall, the smaller the gain.",
            f"How large the {word} gain may be",
        ),
        Picture(
            force_loop_figure(force),
            "Left: the loop must leave −1 on its left. Right: the closed-loop poles, velocity loop and operator "
            "included.",
            f"{word.capitalize()} loop in contact",
        ),
        Callout("warning", "To read with the numbers", items=tuple(warnings)) if warnings else None,
    )


def controller_section(loops: Sequence[NestedLoop], kept: Sequence[NestedLoop] = ()) -> Section:
    """Return the section on the nested ``loops`` of a controller, the whole last: stability first, then margins.

    ``kept`` are the same loops with the velocity loop of the design in place of the controller's own.
    """
    whole = loops[-1].margins
    verdict = Callout("good", "stable.") if whole.stable else Callout("stop", "the controller's loop is unstable.")
    return Section(
        "Controller of the axis",
        Text(
            "The loops as the axis file says them, not those designed above: the velocity loop with the position loop "
            "open, the position loop with the velocity loop closed, and the whole where a delay or a current loop sits."
        ),
        verdict,
        _table(loops, "Sampled, each at the rate at which it runs, with filters, delay and current loop."),
        *([_table(kept, "The same with the velocity loop designed above in the place of its own.")] if kept else []),
    )


def _table(loops: Sequence[NestedLoop], caption: str) -> Table:
    heads = ["loop", "broken at the", "stable", "crossover", "phase margin", "gain margin", "delay margin"]
    return Table(heads, [_row(loop) for loop in loops], caption)


def _row(loop: NestedLoop) -> list[str]:
    margins = loop.margins
    if not margins.stable:
        return [loop.name, loop.broken, "unstable", "", "", "", ""]
    late = delay(margins.delay_margin, margins.period)
    shown = (frequency(margins.crossover), angle(margins.phase_margin_deg), ratio(margins.gain_margin), late)
    return [loop.name, loop.broken, "stable", *shown]
