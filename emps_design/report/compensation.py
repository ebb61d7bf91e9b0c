"""Picture of what a feed-forward does to the tracking error."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.report.style import BLUE, RED, look, subplots, thin

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.compensation import Compensation


def tracking_figure(found: Compensation) -> Figure:
    """Draw the reference and the tracking error, without feed-forward and with what is kept."""
    t, errors = found.errors()
    with look():
        figure, (top, below) = subplots(2, 1, height=4.4, sharex=True)
        top.plot(*thin(t, found.q_ref), color=BLUE)
        top.set_ylabel("position reference [m]")
        for (name, error), color in zip(errors.items(), (RED, BLUE), strict=True):
            below.plot(*thin(t, error), color=color, linewidth=1.0, label=f"{name} feed-forward")
        below.set(xlabel="time [s]", ylabel=f"tracking error [{found.unit}]")
        below.legend(loc="upper right", ncols=2)
        figure.align_ylabels((top, below))
    return figure
