"""The sections on the velocity loop, the force loop, and the controller of the axis file.

Each is the view of its result, and pictures of the loops.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from emps_design.figures import BLACK, BLUE, GREEN, RED, Curve, Grid
from emps_design.report.diagrams import velocity_and_force_loop_diagram
from emps_design.report.loop_figures import open_loop_plane, velocity_loop_figures, z_plane
from emps_design.report.page import Line, Picture, Section, Table, angle, quantity
from emps_design.report.style import drawn, look, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from emps_design.control.controller import ControllerMargins
    from emps_design.control.force import ForceLoopDesign
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.verdict import DesignVerdict

ACTS_ON = {
    "ip": "integral of the error, proportional on the velocity",
    "pi": "proportional to the error and its integral",
}
AT_THE_PLANT_INPUT = {
    "ip": "It crosses 0 dB at a higher frequency, where the same delay costs more phase",
    "pi": "With PI it is the loop broken at the velocity error",
}
MISMATCH = 0.02  # the error of Section IV-B of the paper, as a share of each parameter

WALLS = np.geomspace(1.0 / 30.0, 30.0, 22)  # stiffnesses, relative to that of the design


def gains_section(velocity: VelocityLoopDesign, verdict: DesignVerdict) -> Section:
    """Return the section on the gains of ``velocity``: margins at each place, law, and margins under ``MISMATCH``.

    The warnings are in the summary of the page.
    """
    from emps_design.control.velocity.load_range import relative_mismatch
    from emps_design.control.verdict import gains_document, mismatch_document
    from emps_design.control.view import gains_view, mismatch_view

    units = velocity.axis.units
    document = gains_document(velocity, verdict) | {"warnings": []}
    off = mismatch_document(replace(verdict, errors=relative_mismatch(MISMATCH)))
    loop, place = ("sampled", velocity.retuned_at) if velocity.retuned_at else ("ideal", "velocity-error")
    return Section(
        "Gains and margins",
        Picture(
            velocity_and_force_loop_diagram(velocity.structure, bool(velocity.filters)),
            f"The {velocity.structure.label} velocity loop ({ACTS_ON[velocity.structure.form]}) inside the "
            f"{units.word('force')} loop. Margins are those of the loop broken at either of the two dotted lines. "
            f"The specification applies to the {loop} loop broken at the {place.replace('-', ' ')}; "
            "delays and lags of a drive act at the plant input.",
            "Structure, after Fig. 4 of the paper",
        ),
        *gains_view(document, units),
        _with_lags(velocity),
        _lost_phase(velocity),
        *mismatch_view(off, units),
    )


def _with_lags(velocity: VelocityLoopDesign) -> Table | None:
    """The margins at the plant input with lags but without sampling; None if the ideal loop lacks only the sampling."""
    if not velocity.left_out:
        return None
    ((table, *_), title) = velocity.with_lags.plant_input.view(), "Broken at the plant input, with lags: continuous"
    return replace(table, title=title) if isinstance(table, Table) else None


def _lost_phase(velocity: VelocityLoopDesign) -> Line | None:
    """The loss of phase margin by the implementation, at the plant input; None for an unstable loop."""
    ideal, on_drive = velocity.plant_input.phase_margin_deg, velocity.sampled.margins.phase_margin_deg
    if ideal is None or on_drive is None:
        return None
    parts = ["sampling", "hold", "current loop", "delay", "velocity estimator"]
    parts += ["filters of the command"] * bool(velocity.filters)
    parts += ["effects of the axis"] * bool(velocity.axis.effects)
    return Line(
        f"At the plant input, {', '.join(parts[:-1])} and {parts[-1]} cost {ideal - on_drive:.1f}° of the "
        f"{angle(ideal)} phase margin of the continuous loop."
    )


def velocity_section(velocity: VelocityLoopDesign) -> Section:
    """Return the section on the loop in pictures: Bode, Nyquist, poles and step response, continuous and sampled."""
    pictures = {
        "bode_velocity_error": (
            "Bode diagram, broken at the velocity error",
            "The loop of the specification. The vertical bars are the phase margin (lower picture, above −180°) "
            "and the gain margin (upper picture, below 0 dB). The sampled curve, up to Nyquist, is the loop as "
            "implemented.",
        ),
        "bode_plant_input": (
            "Bode diagram, broken at the plant input",
            f"The loop on which delay acts. {AT_THE_PLANT_INPUT[velocity.structure.form]}; the difference between the "
            "two curves is the effect of the implementation.",
        ),
        "bode_parts": (
            "Bode diagram: plant, controller and loop",
            "The sampled loop at the plant input and its parts: the plant as seen by the controller, with hold, delay "
            "and velocity estimator, and the controller with its filters. The loop is their product; plant and "
            "controller are in SI units and units of the command.",
        ),
        "nyquist": (
            "Nyquist diagrams",
            "The curve must pass the point −1 on its right; the angle between the negative real axis and the ray to "
            "the unit circle is the phase margin.",
        ),
        "poles": (
            "Closed-loop poles",
            "Left: the two poles of (9), with lines of constant damping ratio. Right: the poles of the sampled loop, "
            "all of which must lie inside the unit circle.",
        ),
        "step": (
            "Step response",
            "Response to a step of the velocity reference. Triangles mark the peak, dotted lines the time after which "
            "the response stays within 2 %.",
        ),
    }
    figures = velocity_loop_figures(velocity)
    return Section(
        "Velocity loop",
        *(Picture(figures[name], caption, title) for name, (title, caption) in pictures.items()),
        _step_table(velocity),
    )


def _step_table(velocity: VelocityLoopDesign) -> Table:
    from emps_design.control.verdict import step_responses

    rows = []
    for name, step in zip(("continuous", "sampled"), step_responses(velocity), strict=True):
        cells = ["unstable"] * 3
        if step is not None:
            cells = [
                f"{step.overshoot_percent:.2f} %",
                quantity(step.rise_time, "s"),
                quantity(step.settling_time, "s"),
            ]
        rows.append((name, *cells))
    headings = ("", "overshoot", "rise time, 10 to 90 %", "settling time, ±2 %")
    return Table(headings, rows, "Step response of the closed velocity loop")


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
    loop = design.response(np.geomspace(0.5, np.pi / period * (1 - 1e-9), 500))
    curve = Curve(loop.real, loop.imag, color=RED)
    nyquist = open_loop_plane((curve,), (-2.2, 1.4), (-2.6, 1.0), "force loop, sampled")
    return drawn(Grid(((nyquist, z_plane(np.asarray(design.poles), "closed-loop poles, z plane")),), 4.0))


def force_section(force: ForceLoopDesign) -> Section:
    """Return the section on the force loop ``force``: stability, margins and limits, then pictures."""
    from emps_design.control.view import force_view

    units = force.velocity_loop.axis.units
    word = units.word("force")
    unstable = ("force-loop-unstable", "inner-loop-unstable", "other-machine-unstable", "sampled-limit-unbounded")
    warnings = [message for message in force.warnings if message.code not in unstable]  # the verdict says these
    return Section(
        f"{word.capitalize()} loop",
        *force_view(force.to_dict() | {"warnings": warnings}, units),
        Picture(
            force_limit_figure(force),
            "Shaded, above the dashed line, the loop as implemented is unstable: the “too high gain” of the paper. "
            "Where everything is shaded, no gain is stable; where nothing is, every gain is. A stiffer wall needs a "
            "smaller gain.",
            f"Largest {word} gain",
        ),
        Picture(
            force_loop_figure(force),
            "Left: the loop must leave −1 on its left. Right: the closed-loop poles, velocity loop and operator "
            "included.",
            f"{word.capitalize()} loop in contact",
        ),
    )


def controller_section(margins: ControllerMargins) -> Section:
    """Return the section on the loops of the controller in the axis file."""
    return Section(
        "Controller of the axis",
        Line(
            "The loops of the controller in the axis file, not those designed above: the velocity loop with the "
            "position loop open, the position loop with the velocity loop closed, and the whole loop broken where "
            "delay and current loop act."
        ),
        *margins.view(),
    )
