"""The section and pictures of the impedance law: what the hand feels, stability, mismatch, and Fig. 12."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.control.sampled import MARGINAL
from emps_design.figures import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, RED, Axes, Band, Curve, Grid, Level, thin
from emps_design.report.diagrams import impedance_law_diagram
from emps_design.report.page import Line, Picture, Section, Table, html, quantity
from emps_design.report.style import drawn, look, subplots

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from emps_design.comanipulation.assessment import ImpedanceAssessment
    from emps_design.comanipulation.run import TaskRun
    from emps_design.comanipulation.study import MismatchStudy
    from emps_design.comanipulation.task import Task
    from emps_design.comanipulation.wall import WallContact
    from emps_design.control.impedance.passivity import ContactMap
    from emps_design.control.impedance.robustness import StabilityMap

ABOVE = "outside upper right"
VERDICT_COLORS = {
    "stable": GREEN,
    "dead_band": BLUE,
    "no_motion": BLACK,
    "creeping": ORANGE,
    "limit_cycle": PURPLE,
    "unstable": RED,
}
_COLORS = (BLUE, RED, GREEN, PURPLE)

OMEGA = np.geomspace(0.2, 300.0, 300)  # rad/s
BAND = 20.0  # rad/s, the operator's range in section II-C of the paper


def task_figure(runs: Mapping[str, TaskRun], task: Task) -> Figure:
    """Draw Fig. 12: force of the hand, velocity and position against time, one line for each of ``runs`` of ``task``.

    The last plot is the velocity in the time interval of the verdicts, on its own scale: it shows creep or oscillation
    that is small compared with the motion before.
    """

    def signal(label: str, name: str, factor: float, begin: float = 0.0) -> Axes:
        curves: list[Any] = [Level("y", 0.0)]
        for (run_name, run), color in zip(runs.items(), _COLORS, strict=False):
            shown, words = run.t >= begin, f"{run_name}: {run.verdict.replace('_', ' ')}"
            curves.append(Curve(*thin(run.t[shown], factor * getattr(run, name)[shown]), words, color, width=1.3))
        return Axes(tuple(curves), "", label)

    whole = (signal("force $\\tau_e$ [N]", "tau_e", 1.0), signal("velocity [mm/s]", "v", 1e3))
    watched = signal("velocity [mm/s]", "v", 1e3, task.end * task.period)
    last = replace(watched, x="time [s]; above: the whole task, here: the interval of the verdicts")
    return drawn(Grid.of(*whole, signal("position [mm]", "q", 1e3), last, height=7.2, share_x=False, legend=ABOVE))


def apparent_impedance_figure(omega: np.ndarray, curves: Mapping[str, np.ndarray], target: np.ndarray) -> Figure:
    """Draw the impedance felt by the hand: ``curves`` (n,) [N/(m/s)] over ``omega`` [rad/s], and the target."""
    target_phase = np.degrees(np.angle(target))
    gains: list[Any] = [Band("x", omega[0], BAND, "#DCEEFB")]
    phases: list[Any] = [*gains, Curve(omega, target_phase, color=BLACK, line="--")]
    gains.append(Curve(omega, np.abs(target), "target $M_a s + B$", BLACK, "--"))
    for (name, response), color in zip(curves.items(), _COLORS, strict=False):
        gains.append(Curve(omega, np.abs(response), name, color))
        phases.append(Curve(omega, np.degrees(np.unwrap(np.angle(response))), color=color))
    return drawn(
        Grid.of(
            Axes(tuple(gains), "", "impedance [N/(m/s)]", log="xy", legend="upper left"),
            Axes(tuple(phases), "frequency [rad/s]", "phase [deg]", log="x"),
            height=4.6,
        )
    )


def stability_map_figure(regions: StabilityMap, mass: float, filter: float) -> Figure:
    """Draw the stable region over apparent mass and filter, one line for each mismatch, and the chosen law."""
    with look():
        figure, axes = subplots(height=3.7)
        shades = ("#FDE7D3", "#F9C9A3", "#F3A46F", "#E8834A")
        handles = []
        for e, radius, shade, color in zip(
            regions.mismatches, regions.radius, shades, (GREEN, BLUE, PURPLE, RED), strict=False
        ):
            unstable = (radius > 1.0 + MARGINAL).astype(float)
            axes.contourf(regions.masses, regions.filters, unstable, levels=[0.5, 1.5], colors=[shade], alpha=0.55)
            if 0.0 < unstable.mean() < 1.0:
                axes.contour(regions.masses, regions.filters, unstable, levels=[0.5], colors=[color], linewidths=1.8)
            handles.append(_line(color, f"limit at ±{100 * e:g} %"))
        axes.plot([mass], [filter], "o", color=BLACK, markersize=8, zorder=5)
        handles.append(_line(BLACK, "this law", marker="o", linestyle="none"))
        axes.set(
            xscale="log",
            yscale="log",
            xlim=(regions.masses[0], regions.masses[-1]),
            ylim=(regions.filters[0], regions.filters[-1]),
            xlabel="apparent mass $M_a$ [kg]",
            ylabel="filter [rad/s]",
        )
        figure.legend(handles=handles, loc="outside upper right", ncols=4)
    return figure


def _line(color: str, label: str, **options: Any) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, label=label, **options)


def mismatch_figure(study: MismatchStudy) -> Figure:
    """Draw apparent mass and damping of every plant of ``study``, coloured by its verdict; corners are squares."""
    from emps_design.control.impedance.robustness import VERDICTS

    mass, damping, _ = study.measures.fit
    with look():
        figure, (scatter_axes, bar_axes) = subplots(1, 2, height=3.6)
        corner = np.arange(len(mass)) < study.corners
        shown = np.isfinite(mass) & np.isfinite(damping)
        for place, name in enumerate(VERDICTS):
            for square in (False, True):
                rows = (study.verdict == place) & (corner == square) & shown
                if rows.any():
                    scatter_axes.scatter(
                        mass[rows],
                        damping[rows],
                        s=46 if square else 14,
                        marker="s" if square else "o",
                        color=VERDICT_COLORS[name],
                        edgecolors=BLACK if square else "none",
                        linewidths=0.7,
                        label=name.replace("_", " ") + (", corner" if square else ""),
                    )
        scatter_axes.set(xlabel="apparent mass [kg]", ylabel="apparent damping [N/(m/s)]")
        if shown.any():
            figure.legend(loc="outside upper left", ncols=3, markerscale=0.9)
        counts = [int(np.sum(study.verdict == place)) for place in range(len(VERDICTS))]
        bar_axes.bar(
            [name.replace("_", "\n") for name in VERDICTS], counts, color=[VERDICT_COLORS[name] for name in VERDICTS]
        )
        for k, count in enumerate(counts):
            bar_axes.annotate(str(count), (k, count), ha="center", va="bottom", fontsize=9)
        bar_axes.set_ylabel("plants")
        bar_axes.grid(axis="x", visible=False)
        bar_axes.margins(y=0.12)
    return figure


def wall_figure(contact: WallContact) -> Figure:
    """Draw a push into a wall: position with the wall, force of the hand and force of the wall against time."""
    wall, position = 1e3 * contact.position, 1e3 * contact.q
    reached = position[np.isfinite(position)]
    top, low = max(1.25 * wall, 1.05 * np.max(reached, initial=0.0)), np.min(reached, initial=0.0)
    carriage = Curve(*thin(contact.t, position), "carriage", BLUE, width=1.3)
    push = Curve(*thin(contact.t, contact.push), "push of the hand", BLACK, width=1.3)
    reaction = Curve(*thin(contact.t, contact.wall_force), "force of the wall", RED, width=1.3)
    inside = Band("y", wall, top, GREY, 0.25, "wall"), Level("y", wall)
    reason = "unstable: the simulation was stopped" if contact.reason else ""
    positions = Axes((carriage, *inside), "", "position [mm]", legend="upper right", remark=reason)
    forces = Axes((push, reaction), "time [s]", "force [N]", legend="lower right")
    return drawn(Grid.of(replace(positions, y_range=(low - 0.05 * (top - low), top)), forces, height=4.0))


def contact_map_figure(regions: ContactMap) -> Figure:
    """Draw the region in which law and contact are stable together, over stiffness and damping of hand or wall."""
    positive_k, positive_b = regions.stiffness > 0.0, regions.damping > 0.0
    stiffness, damping = regions.stiffness[positive_k], regions.damping[positive_b]
    unstable = (~regions.stable[np.ix_(positive_b, positive_k)]).astype(float)
    with look():
        figure, axes = subplots(height=3.2)
        axes.contourf(stiffness, damping, unstable, levels=[0.5, 1.5], colors=["#F9C9A3"], alpha=0.7)
        if 0.0 < unstable.mean() < 1.0:
            axes.contour(stiffness, damping, unstable, levels=[0.5], colors=[RED], linewidths=1.8)
        axes.set(xscale="log", yscale="log", xlabel="stiffness of the contact [N/m]", ylabel="damping [N/(m/s)]")
        places = [(300.0, 20.0, "hand")] + ([(2e6, 3.0, "unstable")] if unstable.any() else [])
        for x, y, text in places:
            axes.annotate(text, (x, y), ha="center", color=RED if text == "unstable" else BLACK)
    return figure


def impedance_section(assessment: ImpedanceAssessment) -> Section:
    """Return the section on the impedance law of ``assessment``."""
    force = assessment.axis.units.word("force")
    study = assessment.study
    return Section(
        "Impedance law",
        Picture(
            impedance_law_diagram(),
            f"(a) The law uses motion and motor current, but no {force} sensor. (b) The target impedance; in "
            "co-manipulation K and the reference velocity are zero.",
            "Impedance control, after Fig. 11 of the paper",
        ),
        *assessment.view(),
        _impedance_picture(assessment),
        *_maps(assessment),
        *([] if study is None else _mismatch_blocks(assessment, study)),
        _errata_table(),
    )


def refusal(assessment: ImpedanceAssessment) -> str:
    """Return in words why the law must not run; empty unless the verdict is unstable or a limit cycle."""
    words = {"unstable": "is unstable", "limit_cycle": "ends in a limit cycle"}.get(assessment.verdict)
    why = assessment.reason.partition(": ")[2]
    return f"the impedance law {words}: {why}" if words else ""


def _impedance_picture(assessment: ImpedanceAssessment) -> Picture:
    from emps_design.control.impedance.law import LOW_FREQUENCY, equivalent_loop
    from emps_design.control.impedance.passivity import sampled_loop
    from emps_design.errors import SpecificationError

    law = assessment.law
    below = OMEGA[np.pi / assessment.clock.period > OMEGA]

    def felt(law: Any) -> np.ndarray:
        return 1.0 / sampled_loop(law, assessment.plant, assessment.clock).admittance(below)

    curves = {"sampled law": felt(law)}
    if assessment.mismatch:
        e = assessment.mismatch
        for sign, word in ((1.0, "over"), (-1.0, "under")):
            off = law.with_errors({name: sign * e for name in ("mass", "viscous", "coulomb")})
            curves[f"estimates {100 * e:g} % {word}"] = felt(off)
    with suppress(SpecificationError):  # if no such loop exists, a warning of the section says so
        mismatch = assessment.mismatch or 0.0
        loop = equivalent_loop(assessment.axis, law.mass, law.damping, LOW_FREQUENCY, mismatch=mismatch)
        curves["equivalent force loop"] = loop.impedance(below)
    target = 1j * below * law.mass + law.damping
    units = assessment.axis.units
    return Picture(
        apparent_impedance_figure(below, curves, target),
        f"{units.word('force').capitalize()} over velocity at the hand. In the shaded band below {BAND:g} rad/s, the "
        "bandwidth of an operator, the curves should follow the dashed target; above it filters and hold make the real "
        f"{units.word('mass')} felt.",
        "Apparent impedance",
    )


def _maps(assessment: ImpedanceAssessment) -> list[Picture]:
    from emps_design.control.impedance.passivity import contact_map
    from emps_design.control.impedance.robustness import stability_map

    mismatches = tuple(dict.fromkeys((0.0, assessment.mismatch or 0.02, 0.05)))
    pictures = [
        Picture(
            stability_map_figure(
                stability_map(assessment.law, assessment.plant, assessment.clock, mismatches=mismatches),
                assessment.law.mass,
                assessment.law.filter,
            ),
            "Shaded: unstable at some corner of the mismatch, sliding or sticking. The point should not be close to "
            "the line of the expected mismatch.",
            "Where the law is stable",
        )
    ]
    if assessment.stable:
        pictures.append(
            Picture(
                contact_map_figure(contact_map(assessment.law, assessment.plant, assessment.clock)),
                "Shaded: the law and this contact together are unstable. A hand is soft and damped (left), a wall is "
                "stiff (right); damping in the contact helps.",
                "In contact with a hand or a wall",
            )
        )
    return pictures


def _mismatch_blocks(assessment: ImpedanceAssessment, study: MismatchStudy) -> list[Any]:
    from emps_design.comanipulation.run import run_task
    from emps_design.comanipulation.study import run_worst

    task, law, units = study.task, assessment.law, assessment.axis.units
    percent = f"±{100 * (assessment.mismatch or 0.0):g} %"
    force, carriage = units.word("force"), units.word("carriage")
    runs = {
        "exact estimates": run_task(assessment.axis, law, task),
        f"worst within {percent}": run_worst(assessment.axis, study),
        f"with a {force} sensor": run_task(assessment.axis, replace(law, force_sensor=True), task),
    }
    return [
        Line(
            f"{units.word('mass').capitalize()}, viscous and Coulomb friction of the law are wrong by up to {percent}: "
            f"{study.corners} corners and {study.plants} random plants, seed {study.seed}. Not varied are the filter "
            f"of the law and the {force} gain, whose error scales all three and is inside the box. “With” marks "
            "corners on a machine with that change."
        ),
        Picture(
            mismatch_figure(study),
            f"Left: apparent {units.word('mass')} and damping of each plant; squares are the corners. Right: behaviour "
            f"of the released {carriage}. Creeping means that over-estimated friction keeps it moving.",
            f"Mismatch of {percent}",
        ),
        Picture(
            task_figure(runs, task),
            f"The hand guides the {carriage} for 5 s and releases it while it moves. After the release the velocity "
            "must go to zero, and the position must not drift.",
            f"{force.capitalize()}, velocity and position, after Fig. 12 of the paper",
        ),
        _effort_table(assessment, runs),
    ]


def _effort_table(assessment: ImpedanceAssessment, runs: Mapping[str, Any]) -> Table:
    from emps_design.control.impedance.robustness import break_away

    rows, units = [], assessment.axis.units
    force = units.word("force")
    for name, run in runs.items():
        effort = {key: float(values[0]) for key, values in run.measures.effort.items()}
        start = break_away(replace(assessment.law, force_sensor="sensor" in name), assessment.plant)
        rows.append(
            [
                name,
                run.verdict.replace("_", " "),
                quantity(start, "N", 4, units),
                *(
                    quantity(effort[key], unit, 4, units)
                    for key, unit in (("rms_force", "N"), ("peak_force", "N"), ("work", "J"))
                ),
            ]
        )
    return Table(
        ["", "after release", f"{force} to break away", f"rms {force}", f"peak {force}", "work"],
        rows,
        f"The operator's effort in the task. Without a {force} sensor the hand must overcome all of the dry friction "
        f"before the {units.word('carriage')} moves.",
    )


def _errata_table() -> Table:
    from emps_design.paper.errata import find_errata

    return Table(
        ["place", "about", "what differs"],
        [
            [html('<span translate="no">{}</span>', words) for words in (erratum.place, erratum.title, erratum.text)]
            for erratum in find_errata()
        ],
        "Differences between the paper and the derivation; emps-design derive shows every step.",
    )
