"""A folder to start from: a commented axis file, synthetic records, and what to do with them."""

from __future__ import annotations

from pathlib import Path

import typer

from emps_design.cli.destinations import ANYTHING, ARCHIVE, AXIS, TABLE, check_folder

# What `puzzle.npz` has and `axis.toml` lacks.
PUZZLE = ({"kind": "position_ripple", "amplitude": 2.0, "period": 0.0025, "phase": 0.5},)

STARTER = """# Start here

`axis.toml` describes the machine and its controller; every key says what it is, in SI units. `record.npz` and
`record.csv` are one simulated run of it (columns t [s], q_ref [m], q [m], u [V]). Put your numbers into the axis file,
your measurement in the place of the record, and ask:

    emps-design identify record.npz --axis axis.toml          the parameters, with standard deviations
    emps-design gains axis.toml --crossover 100 --phase-margin 60   velocity-loop gains and margins
    emps-design report axis.toml --record record.npz --crossover 100 --out report.html
    emps-design diagnose puzzle.npz --axis axis.toml --out found    where simulation and data disagree, and why

`puzzle.npz` is a run of the same machine with something in it that `axis.toml` does not know of.

A .csv may use ; , or tab, a decimal comma, and titles with a unit such as `q [mm]`. Every command explains itself with
`--help` and prints JSON with `--json`.
"""

FILES = {"axis.toml": AXIS, "record.npz": ARCHIVE, "record.csv": TABLE, "puzzle.npz": ARCHIVE, "README.md": ANYTHING}


def command(
    directory: Path = typer.Argument(..., metavar="DIR", help="Folder to make or to fill."),
    machine: str = typer.Option("emps2019", "--machine", help="Embedded machine or axis file to copy."),
    seed: int = typer.Option(0, "--seed", min=0, help="Seed of the noise in the record."),
    force: bool = typer.Option(False, "--force", help="Overwrite files of the same names."),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """A folder to start from: a commented axis file, synthetic records, and what to do with them."""
    from emps_design.cli.output import print_json, say
    from emps_design.cli.wording import load_axis
    from emps_design.errors import InputError
    from emps_design.files import write_text, write_together
    from emps_design.simulation.synthetic import synthetic_record

    check_folder(directory, FILES, (machine,), force=True)
    taken = [name for name in FILES if (directory / name).exists()]
    if taken and not force:
        raise InputError(f"{directory}: {', '.join(taken)} exist already; choose another folder, or give --force")
    axis = load_axis(machine)
    record = synthetic_record(axis, seed=seed)
    puzzle = synthetic_record(axis.replace(effects=[*axis.effects, *PUZZLE]), seed=seed + 1)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{directory}: cannot be made, {error.strerror}; expected a folder to write to") from error
    with write_together(directory) as aside:
        write_text(aside / "axis.toml", axis.to_toml(comments=True))
        record.save(aside / "record.npz")
        record.save(aside / "record.csv")
        puzzle.save(aside / "puzzle.npz")
        write_text(aside / "README.md", STARTER)
    if as_json:
        print_json({"directory": str(directory), "files": list(FILES), "record": record.to_dict(), "seed": seed})
    else:
        say(f"{directory}: {', '.join(FILES)}\nNext: read {directory / 'README.md'}")
