"""Pictures of the impedance law: what the hand feels, where the law is stable, Fig. 12, and the mismatch study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.control.loop.sampled_loop import MARGINAL
from emps_design.report.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, RED, look, subplots, thin

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from emps_design.comanipulation.run import TaskRun
    from emps_design.comanipulation.study import MismatchStudy
    from emps_design.comanipulation.task import Task
    from emps_design.comanipulation.wall_contact import WallContact
    from emps_design.control.impedance.passivity import ContactMap
    from emps_design.control.impedance.robustness import StabilityMap

VERDICT_COLORS = {
    "stable": GREEN,
    "dead_band": BLUE,
    "no_motion": BLACK,
    "creeping": ORANGE,
    "limit_cycle": PURPLE,
    "unstable": RED,
}
_COLORS = (BLUE, RED, GREEN, PURPLE)


def task_figure(runs: Mapping[str, TaskRun], task: Task) -> Figure:
    """Draw Fig. 12: force of the hand, velocity and position against time, one line for each of ``runs`` of ``task``.

    Below is the velocity in the time that verdicts look at, on a scale of its own: a creep or a swing that is small
    beside the motion before shows there.
    """
    velocity, watched = "velocity [mm/s]", task.end * task.period
    rows = (("force $\\tau_e$ [N]", "tau_e", 1.0, 0.0), (velocity, "v", 1e3, 0.0), ("position [mm]", "q", 1e3, 0.0),
            (velocity, "v", 1e3, watched))  # fmt: skip
    with look():
        figure, grid = subplots(4, 1, height=7.2)
        for axes in grid[:2]:
            axes.sharex(grid[2])
            axes.tick_params(labelbottom=False)
        for axes, (label, name, factor, begin) in zip(grid, rows, strict=True):
            for (run_name, run), color in zip(runs.items(), _COLORS, strict=False):
                shown = run.t >= begin
                axes.plot(
                    *thin(run.t[shown], factor * getattr(run, name)[shown]),
                    color=color,
                    linewidth=1.3,
                    label=f"{run_name}: {run.verdict}",
                )
            axes.set_ylabel(label)
            axes.axhline(0.0, color=GREY, linewidth=0.8)
            axes.margins(x=0.01)
        grid[-1].set_xlabel("time [s]; above the whole task, here what the verdicts look at")
        handles, labels = grid[0].get_legend_handles_labels()
        figure.legend(handles, [label.replace("_", " ") for label in labels], loc="outside upper right", ncols=2)
        figure.align_ylabels(grid)
    return figure


def apparent_impedance_figure(omega: np.ndarray, curves: Mapping[str, np.ndarray], target: np.ndarray) -> Figure:
    """Draw the impedance that the hand meets: ``curves`` (n,) [N/(m/s)] over ``omega`` [rad/s], and the target."""
    with look():
        figure, (top, bottom) = subplots(2, 1, height=4.6, sharex=True)
        top.loglog(omega, np.abs(target), color=BLACK, linestyle="--", label="target $M_a s + B$")
        bottom.semilogx(omega, np.degrees(np.angle(target)), color=BLACK, linestyle="--")
        for (name, response), color in zip(curves.items(), _COLORS, strict=False):
            top.loglog(omega, np.abs(response), color=color, label=name)
            bottom.semilogx(omega, np.degrees(np.unwrap(np.angle(response))), color=color)
        for axes in (top, bottom):
            axes.axvspan(omega[0], 20.0, color="#DCEEFB", linewidth=0, zorder=0)
        top.set_ylabel("impedance [N/(m/s)]")
        bottom.set(ylabel="phase [deg]", xlabel="frequency [rad/s]")
        top.legend(loc="upper left")
    return figure


def stability_map_figure(found: StabilityMap, mass: float, filter: float) -> Figure:
    """Draw where the law is stable over apparent mass and filter, one line for each mismatch, and the law chosen."""
    with look():
        figure, axes = subplots(height=3.7)
        shades = ("#FDE7D3", "#F9C9A3", "#F3A46F", "#E8834A")
        handles = []
        for e, radius, shade, color in zip(
            found.mismatches, found.radius, shades, (GREEN, BLUE, PURPLE, RED), strict=False
        ):
            unstable = (radius > 1.0 + MARGINAL).astype(float)
            axes.contourf(found.masses, found.filters, unstable, levels=[0.5, 1.5], colors=[shade], alpha=0.55)
            if 0.0 < unstable.mean() < 1.0:
                axes.contour(found.masses, found.filters, unstable, levels=[0.5], colors=[color], linewidths=1.8)
            handles.append(_line(color, f"limit at ±{100 * e:g} %"))
        axes.plot([mass], [filter], "o", color=BLACK, markersize=8, zorder=5)
        handles.append(_line(BLACK, "this law", marker="o", linestyle="none"))
        axes.set(
            xscale="log",
            yscale="log",
            xlim=(found.masses[0], found.masses[-1]),
            ylim=(found.filters[0], found.filters[-1]),
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
        figure, (left, right) = subplots(1, 2, height=3.6)
        corner = np.arange(len(mass)) < study.corners
        shown = np.isfinite(mass) & np.isfinite(damping)
        for place, name in enumerate(VERDICTS):
            for square in (False, True):
                rows = (study.verdict == place) & (corner == square) & shown
                if rows.any():
                    left.scatter(
                        mass[rows],
                        damping[rows],
                        s=46 if square else 14,
                        marker="s" if square else "o",
                        color=VERDICT_COLORS[name],
                        edgecolors=BLACK if square else "none",
                        linewidths=0.7,
                        label=name.replace("_", " ") + (", corner" if square else ""),
                    )
        left.set(xlabel="apparent mass [kg]", ylabel="apparent damping [N/(m/s)]")
        if shown.any():
            figure.legend(loc="outside upper left", ncols=3, markerscale=0.9)
        counts = [int(np.sum(study.verdict == place)) for place in range(len(VERDICTS))]
        right.bar(
            [name.replace("_", "\n") for name in VERDICTS], counts, color=[VERDICT_COLORS[name] for name in VERDICTS]
        )
        for k, count in enumerate(counts):
            right.annotate(str(count), (k, count), ha="center", va="bottom", fontsize=9)
        right.set_ylabel("plants")
        right.grid(axis="x", visible=False)
        right.margins(y=0.12)
    return figure


def wall_figure(contact: WallContact) -> Figure:
    """Draw a push into a wall: position with the wall, force of the hand and force of the wall against time."""
    with look():
        figure, (top, bottom) = subplots(2, 1, height=4.0, sharex=True)
        wall = 1e3 * contact.position
        top.plot(*thin(contact.t, 1e3 * contact.q), color=BLUE, linewidth=1.3, label="carriage")
        bottom.plot(*thin(contact.t, contact.push), color=BLACK, linewidth=1.3, label="push of the hand")
        bottom.plot(*thin(contact.t, contact.wall_force), color=RED, linewidth=1.3, label="force of the wall")
        if contact.reason:
            top.text(0.5, 0.5, "unstable: the simulation gave up", transform=top.transAxes, ha="center", color=RED)
        top.set_ylim(top=max(top.get_ylim()[1], 1.25 * wall))
        top.axhspan(wall, top.get_ylim()[1], facecolor=GREY, alpha=0.25, label="wall")
        top.axhline(wall, color=GREY, linewidth=0.8)
        top.set_ylabel("position [mm]")
        bottom.set(ylabel="force [N]", xlabel="time [s]")
        for axes, place in ((top, "upper right"), (bottom, "lower right")):
            axes.margins(x=0.01)
            axes.legend(loc=place)
        figure.align_ylabels()
    return figure


def contact_map_figure(found: ContactMap) -> Figure:
    """Draw where law and contact are stable together, over stiffness and damping of hand or wall."""
    positive_k, positive_b = found.stiffness > 0.0, found.damping > 0.0
    stiffness, damping = found.stiffness[positive_k], found.damping[positive_b]
    unstable = (~found.stable[np.ix_(positive_b, positive_k)]).astype(float)
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
