"""The external force that was observed, method by method, as pictures and a table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from emps_design.report.display import NOTHING, quantity
from emps_design.report.page import Callout, Picture, Table
from emps_design.report.style import BLACK, BLUE, GREEN, RED, look, subplots, thin

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.identification.observation import Observation

_COLORS = {"offline": BLUE, "online": RED, "kalman": GREEN}


def observation_figure(found: Observation) -> Figure:
    """Draw the external force by every method, and the measured one where the record has it."""
    with look():
        figure, grid = subplots(
            len(found.methods), 1, height=1.7 * len(found.methods) + 0.4, sharex=True, squeeze=False
        )
        for axes, (name, method) in zip(grid.flat, found.methods.items(), strict=True):
            axes.plot(
                *thin(found.t, method.force), color=_COLORS.get(name, BLUE), linewidth=1.0, label=f"observed, {name}"
            )
            if found.f_ext is not None:
                axes.plot(*thin(found.t, found.f_ext), color=BLACK, linewidth=1.2, label="measured")
            least = method.smallest.value
            axes.axhspan(-least, least, color="#E5E7EB", linewidth=0, label="cannot be told from errors")
            axes.set_ylabel("force [N]")
            axes.legend(loc="upper right", ncols=3)
            axes.set_ylim(axes.get_ylim()[0], axes.get_ylim()[1] + 0.3 * (axes.get_ylim()[1] - axes.get_ylim()[0]))
            axes.margins(x=0.01)
        grid.flat[-1].set_xlabel("time [s]")
    return figure


def observation_blocks(found: Observation) -> tuple[Any, ...]:
    """Return picture, table and warnings of an observation."""
    rows = [
        [
            name,
            NOTHING if method.rms_error is None else quantity(method.rms_error, "N"),
            quantity(method.delay, "s"),
            quantity(method.smallest.value, "N"),
            method.smallest.bound.replace("_", " "),
        ]
        for name, method in found.methods.items()
    ]
    return (
        Picture(
            observation_figure(found),
            "Force on the carriage from motor force and motion, (19). Inside the grey band a force cannot be told from "
            "the errors of model and noise.",
            "Observed external force",
        ),
        Table(
            ["method", "rms error", "delay", "smallest observable force", "what bounds it"],
            rows,
            f"Observers on {found.record} with the axis {found.axis}.",
        ),
        Callout("warning", "To read with the numbers", items=found.warnings) if found.warnings else None,
    )
