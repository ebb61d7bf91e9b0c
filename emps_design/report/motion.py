"""Pictures of a motion in closed loop with its tracking error and command, and of the effect of a feed-forward."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.report.style import BLACK, BLUE, RED, look, subplots, thin

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.figure import Figure

    from emps_design.compensation import Compensation
    from emps_design.simulation.scenarios import Followed


def motion_figure(runs: Mapping[str, Followed]) -> Figure:
    """Draw position, tracking error and command of one or two ``runs`` along the same reference, by controller."""
    with look():
        figure, (top, middle, below) = subplots(3, 1, height=6.4, sharex=True)
        first = next(iter(runs.values())).run
        top.plot(*thin(first.t, 1e3 * first.q_ref), color=BLACK, linestyle="--", linewidth=1.0, label="reference")
        for (name, followed), color in zip(runs.items(), (RED, BLUE), strict=False):
            run = followed.run
            top.plot(*thin(run.t, 1e3 * run.position), color=color, linewidth=1.0, label=name)
            middle.plot(*thin(run.t, 1e3 * (run.q_ref - run.position)), color=color, linewidth=1.0)
            below.plot(*thin(run.t, run.u), color=color, linewidth=1.0)
        top.set_ylabel("position [mm]")
        middle.set_ylabel("tracking error [mm]")
        below.set(xlabel="time [s]", ylabel="command [V]")
        figure.legend(*top.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        figure.align_ylabels((top, middle, below))
    return figure


def tracking_figure(compensation: Compensation) -> Figure:
    """Draw the reference and the tracking error, without feed-forward and with what is kept."""
    t, errors = compensation.errors()
    with look():
        figure, (top, below) = subplots(2, 1, height=4.4, sharex=True)
        top.plot(*thin(t, compensation.q_ref), color=BLUE)
        top.set_ylabel("position reference [m]")
        for (name, error), color in zip(errors.items(), (RED, BLUE), strict=True):
            below.plot(*thin(t, error), color=color, linewidth=1.0, label=f"{name} feed-forward")
        below.set(xlabel="time [s]", ylabel=f"tracking error [{compensation.unit}]")
        below.legend(loc="upper right", ncols=2)
        figure.align_ylabels((top, below))
    return figure
