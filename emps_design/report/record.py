"""Sections and pictures about a record: its signals, identified parameters, and observed force.

Pictures of a motion in closed loop with its tracking error and command, and of the effect of a feed-forward.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.figures import BLACK, BLUE, GREEN, RED, YELLOW, Axes, Band, Curve, Grid, Level, thin
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
from emps_design.report.style import drawn
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
    signals = [Axes((Curve(*thin(record.t, y), "", color, width=1.0),), "", label) for label, y, color in rows]
    return _over_time(*signals, height=1.35 * len(rows) + 0.3)


def _over_time(*axes: Axes, height: float, **options: Any) -> Figure:
    """Draw ``axes`` one above the other, over the time of the last one."""
    *above, last = axes
    return drawn(Grid.of(*above, replace(last, x="time [s]"), height=height, **options))


def force_figure(identification: Identification) -> Figure:
    """Draw measured and identified force over the record, a part of it enlarged, and the residual.

    Samples not used by the identification are gaps.
    """
    t, measured, model = (np.asarray(identification.series[key]) for key in ("t", "measured", "model"))
    used = np.asarray(identification.series["used"], dtype=bool)
    error = np.where(used, measured - model, np.nan)
    low, high = _window(t, measured)
    inside = (t >= low) & (t <= high)

    def forces(rows: Any) -> list[Curve]:
        curves = []
        for label, force, color, width in (("measured", measured, BLACK, 1.8), ("identified model", model, RED, 1.1)):
            x, y = thin(t[rows], force[rows])
            curves.append(Curve(x, np.where(np.interp(x, t, used) < 0.5, np.nan, y), label, color, width=width))
        return curves

    label = "motor force [N]"
    whole: tuple[Any, ...] = (*forces(slice(None)), Band("x", low, high, YELLOW, 0.35))
    return _over_time(
        Axes(whole, "", label, "the whole record", legend="upper right", columns=2, room=0.25),
        Axes(tuple(forces(inside)), "", label, f"{low:.3g} s to {high:.3g} s"),
        Axes((Curve(t, error, "", BLUE, width=0.9), Level("y", 0.0)), "", "measured − model [N]", "residual"),
        height=6.2,
        share_x=False,
    )


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
            f"Position on the load side, and {axis.units.word('voltage')} of the drive.",
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
    """The 95 % interval of each parameter, and the value in the axis file."""
    known, units = axis.mechanics.parameters, axis.units
    rows: list[list[Any]] = []
    for name, estimate in identification.parameters.items():
        interval = "not determined"
        if estimate.interval_95 is not None:
            interval = " to ".join(map(number, estimate.interval_95))
        of_axis = number(known[name], 6) if name in known else NOTHING
        rows.append([units.words(words(name)), interval, of_axis, units.unit(estimate.quantity.unit)])
    title = f"The {identification.model} model and the axis file; rely on the interval, not on the deviation by (15)"
    return Table(["parameter", "95 % interval", f"axis {axis.name}", "unit"], rows, title)


def _force_picture(identification: Identification, units: Units) -> Picture:
    force = units.word("force")
    known = f", both without the {force} of the effects in the axis file" if identification.axis.effects else ""
    return Picture(
        force_figure(identification),
        f"{force.capitalize()} of the motor, measured and by the {identification.model} model with the identified "
        f"parameters{known}. The middle picture enlarges the yellow part. A residual in the lowest picture that "
        "repeats from stroke to stroke is physics that the model lacks; emps-design diagnose identifies it.",
        f"Measured against identified {force}",
    )


def import_page(account: Account) -> Page:
    """Return the page of an import: the columns as read, and a picture of the record."""
    record, units = account.record, account.axis.units
    section = Section(
        f"Record {record.name}",
        *account.view(),
        Picture(record_figure(record, units), "The record as read.", "Record"),
        *(Line(note, "note") for note in account.notes),
    )
    return Page(f"Import of {record.name}", "", (), (section,), units=units)


def observation_figure(observation: Observation) -> Figure:
    """Draw the external force by every method, and the measured one if the record has it."""
    methods = []
    for name, method in observation.methods.items():
        least = method.smallest.value
        color, label = _COLORS.get(name, BLUE), f"observed, {name}"
        parts: list[Any] = [Curve(*thin(observation.t, method.force), label, color, width=1.0)]
        if observation.f_ext is not None:
            parts.append(Curve(*thin(observation.t, observation.f_ext), "measured", BLACK, width=1.2))
        parts.append(Band("y", -least, least, label="below the error bound"))
        methods.append(Axes(tuple(parts), "", "force [N]", legend="upper right", columns=3, room=0.3))
    return _over_time(*methods, height=1.7 * len(methods) + 0.4)


def observation_blocks(observation: Observation) -> tuple[Any, ...]:
    """Return picture, view and warnings of an observation."""
    units = observation.units
    force = units.word("force")
    return (
        Picture(
            observation_figure(observation),
            f"{force.capitalize()} on the {units.word('carriage')} from motor {force} and motion, (19). Inside the "
            f"grey band a {force} cannot be distinguished from errors of the model and noise.",
            f"Observed external {force}",
        ),
        *observation.view(),
        *(Line(warning, "note") for warning in observation.warnings),
    )


def motion_figure(runs: Mapping[str, Followed]) -> Figure:
    """Draw position, tracking error and command of one or two ``runs`` along the same reference, by controller."""
    first = next(iter(runs.values())).run
    top = [Curve(*thin(first.t, 1e3 * first.q_ref), "reference", BLACK, "--", 1.0)]
    middle, below = [], []
    for (name, followed), color in zip(runs.items(), (RED, BLUE), strict=False):
        run = followed.run
        top.append(Curve(*thin(run.t, 1e3 * run.position), name, color, width=1.0))
        middle.append(Curve(*thin(run.t, 1e3 * (run.q_ref - run.position)), name, color, width=1.0))
        below.append(Curve(*thin(run.t, run.u), name, color, width=1.0))
    return _over_time(
        Axes(tuple(top), "", "position [mm]"),
        Axes(tuple(middle), "", "tracking error [mm]"),
        Axes(tuple(below), "", "command [V]"),
        height=6.4,
        legend="outside lower center",
        columns=3,
    )


def tracking_figure(compensation: Compensation) -> Figure:
    """Draw the reference and the tracking error, without feed-forward and with the selected terms."""
    t, errors = compensation.errors()
    curves = [
        Curve(*thin(t, error), f"{name} feed-forward", color, width=1.0)
        for (name, error), color in zip(errors.items(), (RED, BLUE), strict=True)
    ]
    return _over_time(
        Axes((Curve(*thin(t, compensation.q_ref)),), "", "position reference [m]"),
        Axes(tuple(curves), "", f"tracking error [{compensation.unit}]", legend="upper right", columns=2),
        height=4.4,
    )
