"""Observe the external force of a record, off-line and on-line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from emps_design.cli.options import HERTZ, refuse_force
from emps_design.commands.destinations import OVERWRITE, TABLE, check_out

if TYPE_CHECKING:
    import numpy as np

    from emps_design.identification.observation import Observation
    from emps_design.records import Record
    from emps_design.units import Units

LONG = 200_000  # samples from which on a progress bar is worth it


def command(
    context: typer.Context,
    record: Path = typer.Argument(..., metavar="RECORD", help="Record file: .mat, .csv or .npz."),
    axis: str = typer.Option("emps2019", "--axis", help="TOML file or embedded machine with identified parameters."),
    cutoff: float | None = typer.Option(
        None,
        "--cutoff",
        **HERTZ,
        help="Low-pass of the on-line observer [Hz, or such as 120rad/s], Kalman: twice that; default 20 Hz, or what "
        "the sampling allows.",
    ),
    offline_cutoff: float | None = typer.Option(
        None,
        "--offline-cutoff",
        **HERTZ,
        help="Zero-phase low-pass off-line [Hz, or such as 370rad/s]; default 60 Hz, or what the sampling allows.",
    ),
    injected: str | None = typer.Option(
        None,
        "--injected",
        metavar="COLUMN:VOLTS",
        help="Voltage added behind the controller, a column of the record times VOLTS: it is taken out of u, and its "
        "force is the truth to judge by.",
    ),
    out: Path | None = typer.Option(
        None, "--out", help="Write the observed forces to this .csv file; cells are empty where none can be known."
    ),
    force: bool = typer.Option(False, "--force", help=OVERWRITE),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """Observe the external force of a record, off-line and on-line."""
    from emps_design.cli.output import add_advice, load_axis, print_json, progress_bar, say_advice, tell
    from emps_design.identification.observation import observe, with_known_push
    from emps_design.importing import import_record

    refuse_force(context, out)
    check_out(out, TABLE, (axis, record), force)
    loaded = load_axis(axis)
    read = import_record(record, loaded)
    if injected is not None:
        read = with_known_push(read, _voltage(injected, read), loaded.supplied_by(read).drive.gain)
    with progress_bar(len(read) >= LONG) as progress:
        observation = observe(read, loaded, cutoff_hz=cutoff, offline_cutoff_hz=offline_cutoff, progress=progress)
    if out is not None:
        _write(out, observation, loaded.units)
    document = add_advice(observation.to_dict(), axis, [record])
    if as_json:
        print_json(document)
    else:
        _show(observation)
    for warning in observation.warnings:
        tell(warning)
    if not as_json:
        say_advice(document)


def _voltage(injected: str, record: Record) -> np.ndarray:
    """The voltage [V] that ``COLUMN:VOLTS`` stands for, one value per sample."""
    import numpy as np

    from emps_design.errors import InputError

    name, _, factor = injected.rpartition(":")
    column = np.ravel(np.asarray(record.extra.get(name, ())))
    if column.dtype.kind not in "buif" or column.size != len(record):
        columns = [key for key, values in record.extra.items() if np.size(values) == len(record)]
        raise InputError(
            f"--injected: found {injected!r}, expected COLUMN:VOLTS with a further column of {record.name}: "
            f"{', '.join(columns) or 'it has none'}"
        )
    try:
        volts = float(factor)
    except ValueError:
        raise InputError(f"--injected: found {factor!r} for VOLTS, expected a number") from None
    return volts * column


def _write(out: Path, observation: Observation, units: Units) -> None:
    from emps_design.files import write_aside

    names = ["t [s]", *(f"{name} [{units.unit('N')}]" for name in observation.methods)]
    columns = [observation.t, *(result.force for result in observation.methods.values())]
    with write_aside(out) as aside, aside.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for start in range(0, len(observation.t), LONG):
            rows = zip(*(column[start : start + LONG].tolist() for column in columns), strict=True)
            file.writelines(",".join("" if x != x else f"{x:.9g}" for x in row) + "\n" for row in rows)


def _show(observation: Observation) -> None:
    from emps_design.cli.output import new_console, new_table
    from emps_design.quantities import rounded

    console, known = new_console(), observation.f_ext is not None
    title = f"External force of {observation.record}, axis {observation.axis}"
    judged = ("rms error [N]", "away from edges [N]", "rise [ms]", "plateau") if known else ()
    table = new_table(title, "method", "delay [ms]", *judged, pad_edge=False)
    for name, result in observation.methods.items():
        cells = [f"{1e3 * result.delay:.2f}"]
        if known:
            steps = result.steps
            cells += [
                "" if result.rms_error is None else rounded(result.rms_error),
                "" if steps is None else rounded(steps.rms_error_away_from_edges),
                "" if steps is None or steps.rise_time is None else f"{1e3 * steps.rise_time:.1f}",
                "" if steps is None else f"{steps.plateau_error_percent:+.2f} %",
            ]
        table.add_row(name, *cells)
    console.print(table)
    spans = (
        f"{name} {estimate.reliable[0]:.3f} to {estimate.reliable[1]:.3f} s"
        for name, estimate in observation.methods.items()
    )
    console.print(f"known from and to, filters settle before and after: {', '.join(spans)}")
    first = next(iter(observation.methods.values()))
    if known:
        console.print(f"errors: from {first.judged[0]:.2f} to {first.judged[1]:.2f} s, against the force of the moment")
    for name, result in observation.methods.items():
        least = result.smallest
        bounds = ", ".join(f"{_word(bound)} {rounded(value)} N" for bound, value in least.bounds.items())
        console.print(
            f"{name}: smallest observable force {rounded(least.value)} N, set by {_word(least.bound)} ({bounds})"
        )
    for bound, reason in first.smallest.to_dict()["reasons"].items():
        console.print(f"{_word(bound)}: {reason}")


def _word(bound: str) -> str:
    return bound.replace("_", "-")
