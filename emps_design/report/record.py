"""Sections and pictures about a record: its signals, identified parameters, and observed force.

Pictures of a motion in closed loop with its tracking error and command, and of the effect of a feed-forward.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.records import Record
from emps_design.report.page import (
    NOTHING,
    Line,
    Page,
    Picture,
    Section,
    Table,
    number,
    quantity,
    words,
)
from emps_design.report.style import BLACK, BLUE, GREEN, GREY, RED, YELLOW, look, subplots, thin
from emps_design.units import Units

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.axis import Axis
    from emps_design.compensation import Compensation
    from emps_design.identification.identify import Identification
    from emps_design.identification.observation import Observation
    from emps_design.importing.account import Account
    from emps_design.simulation.scenarios import Followed

_COLORS = {"offline": BLUE, "online": RED, "kalman": GREEN}


def record_figure(record: Record, units: Units | None = None) -> Figure:
    """Draw position and command of ``record``, and the external force if measured, in the units of the axis."""
    units = units or Units()
    unit, factor = units.display(0.5, "m")
    rows = [(f"{units.words('position')} [{unit}]", factor * record.q, BLUE)]
    rows.append((units.label("voltage [V]"), record.u, BLACK))
    if record.f_ext is not None:
        rows.append((units.label("external force [N]"), record.f_ext, RED))
    with look():
        figure, grid = subplots(len(rows), 1, height=1.35 * len(rows) + 0.3, sharex=True)
        for axes, (label, y, color) in zip(grid, rows, strict=True):
            axes.plot(*thin(record.t, y), color=color, linewidth=1.0)
            axes.set_ylabel(label)
            axes.margins(x=0.01)
        grid[-1].set_xlabel("time [s]")
        figure.align_ylabels(grid)
    return figure


def force_figure(identification: Identification) -> Figure:
    """Draw measured and identified force over the record, one part of it enlarged, and the residual.

    Samples that the identification did not use are gaps.
    """
    t, measured, model = (np.asarray(identification.series[key]) for key in ("t", "measured", "model"))
    used = np.asarray(identification.series["used"], dtype=bool)
    error = np.where(used, measured - model, np.nan)
    low, high = _window(t, measured)
    inside = (t >= low) & (t <= high)
    with look():
        figure, (top, middle, bottom) = subplots(3, 1, height=6.2)
        for axes, rows in ((top, slice(None)), (middle, inside)):
            for label, force, color, width in (
                ("measured", measured, BLACK, 1.8),
                ("identified model", model, RED, 1.1),
            ):
                x, y = thin(t[rows], force[rows])
                left_out = np.interp(x, t, used) < 0.5
                axes.plot(x, np.where(left_out, np.nan, y), color=color, linewidth=width, label=label)
            axes.set_ylabel("motor force [N]")
            axes.margins(x=0.01)
        top.axvspan(low, high, color=YELLOW, alpha=0.35, linewidth=0)
        top.set(title="the whole record", ylim=(top.get_ylim()[0], top.get_ylim()[1] + 0.25 * np.ptp(top.get_ylim())))
        top.legend(loc="upper right", ncols=2)
        middle.set_title(f"{low:.3g} s to {high:.3g} s")
        bottom.plot(t, error, color=BLUE, linewidth=0.9)
        bottom.axhline(0.0, color=GREY, linewidth=0.8)
        bottom.set(title="residual", ylabel="measured − model [N]", xlabel="time [s]")
        bottom.margins(x=0.01)
        figure.align_ylabels((top, middle, bottom))
    return figure


def _window(t: np.ndarray, force: np.ndarray) -> tuple[float, float]:
    """Return start and end [s] of an eighth of the record around its largest force."""
    length = (t[-1] - t[0]) / 8.0
    centre = float(t[int(np.argmax(np.abs(force)))])
    low = min(max(float(t[0]), centre - 0.5 * length), float(t[-1]) - length)
    return low, low + length


def record_section(record: Record, identifications: Sequence[Identification], axis: Axis) -> Section:
    """Return the section on ``record`` with all ``identifications`` on it, compared with ``axis``."""
    warnings = dict.fromkeys(warning for each in identifications for warning in each.warnings)
    return Section(
        f"Record {record.name}",
        Line(in_words(record)),
        Picture(
            record_figure(record, axis.units),
            f"Position on the load side and the {axis.units.word('voltage')} that the drive was given.",
            "Record",
        ),
        *(part for each in identifications for part in (*each.view(), _comparison(each, axis))),
        _force_picture(identifications[0], axis.units),
        *(Line(warning, "note") for warning in warnings),
    )


def identification_blocks(identification: Identification, axis: Axis) -> tuple[Any, ...]:
    """Return view, picture and warnings of one identification, compared with ``axis``."""
    return (
        *identification.view(),
        _comparison(identification, axis),
        _force_picture(identification, axis.units),
        *(Line(warning, "note") for warning in identification.warnings),
    )


def in_words(record: Record) -> str:
    """Return the length of ``record`` in words.

    >>> import numpy as np
    >>> in_words(Record.from_arrays(1e-3, *np.tile(np.linspace(0.0, 1.0, 2001), (3, 1))))
    '2001 samples of 1.000 ms, 2.00 s in all'
    """
    return f"{len(record)} samples of {quantity(record.period, 's')}, {quantity(record.duration, 's', 3)} in all"


def _comparison(identification: Identification, axis: Axis) -> Table:
    """The 95 % interval of each parameter, and the number of the axis file."""
    known, units = axis.mechanics.parameters, axis.units
    rows: list[list[Any]] = []
    for name, estimate in identification.parameters.items():
        interval = "not determined"
        if estimate.interval_95 is not None:
            interval = " to ".join(map(number, estimate.interval_95))
        own = number(known[name], 6) if name in known else NOTHING
        rows.append([units.words(words(name)), interval, own, units.unit(estimate.quantity.unit)])
    title = f"The {identification.model} model beside the axis file; believe the interval, not the deviation by (15)"
    return Table(["parameter", "95 % interval", f"axis {axis.name}", "unit"], rows, title)


def _force_picture(identification: Identification, units: Units) -> Picture:
    force = units.word("force")
    known = ", both less what the effects of the axis file take" if identification.axis.effects else ""
    return Picture(
        force_figure(identification),
        f"{force.capitalize()} of the motor, measured and by the {identification.model} model with the identified "
        f"parameters{known}. The middle picture enlarges the yellow part. What is left in the lowest picture and "
        "repeats from stroke to stroke is physics that the model lacks; emps-design diagnose names it.",
        f"Measured against identified {force}",
    )


def import_page(account: Account) -> Page:
    """Return the page on an import: the columns as they were read, and a picture of the record."""
    record, units = account.record, account.axis.units
    section = Section(
        f"Record {record.name}",
        *account.view(),
        Picture(record_figure(record, units), "The record as it was read.", "Record"),
        *(Line(note, "note") for note in account.notes),
    )
    return Page(f"Import of {record.name}", "", (), (section,), units=units)


def observation_figure(observation: Observation) -> Figure:
    """Draw the external force by every method, and the measured one if the record has it."""
    with look():
        figure, grid = subplots(
            len(observation.methods), 1, height=1.7 * len(observation.methods) + 0.4, sharex=True, squeeze=False
        )
        for axes, (name, method) in zip(grid.flat, observation.methods.items(), strict=True):
            color, label = _COLORS.get(name, BLUE), f"observed, {name}"
            axes.plot(*thin(observation.t, method.force), color=color, linewidth=1.0, label=label)
            if observation.f_ext is not None:
                axes.plot(*thin(observation.t, observation.f_ext), color=BLACK, linewidth=1.2, label="measured")
            least = method.smallest.value
            axes.axhspan(-least, least, color="#E5E7EB", linewidth=0, label="cannot be told from errors")
            axes.set_ylabel("force [N]")
            axes.legend(loc="upper right", ncols=3)
            axes.set_ylim(axes.get_ylim()[0], axes.get_ylim()[1] + 0.3 * (axes.get_ylim()[1] - axes.get_ylim()[0]))
            axes.margins(x=0.01)
        grid.flat[-1].set_xlabel("time [s]")
    return figure


def observation_blocks(observation: Observation) -> tuple[Any, ...]:
    """Return picture, view and warnings of an observation."""
    units = observation.units
    force = units.word("force")
    return (
        Picture(
            observation_figure(observation),
            f"{force.capitalize()} on the {units.word('carriage')} from motor {force} and motion, (19). Inside the "
            f"grey band a {force} cannot be told from the errors of model and noise.",
            f"Observed external {force}",
        ),
        *observation.view(),
        *(Line(warning, "note") for warning in observation.warnings),
    )


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
