"""Simulate the nonlinear axis: replay a record, follow a reference, co-manipulation, or a break-away test."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import typer

from emps_design.cli.options import refuse_force, refuse_ignored, within
from emps_design.commands.destinations import ARCHIVE, OVERWRITE, PICTURES, TABLE, check_out

# The options that each scenario uses, beside those common to all.
SCENARIOS = {
    "replay": ("record", "out", "plot"),
    "reference": ("reference", "out", "plot"),
    "breakaway": ("rate", "peak", "out", "plot"),
    "comanipulation": ("mismatch", "mass", "damping", "reference_velocity", "as_printed", "plants", "seed"),
    "bench": ("tau_ref", "seed"),
}

# Keys that the table leaves out: they are printed elsewhere, or by --json alone.
OUTSIDE_TABLE = (
    "run",
    "study",
    "law",
    "task",
    "units",
    "warnings",
    "scenario",
    "axis",
    "effort",
    "headline",
    "reason",
    "advice",
    "worst_loop",
)


def command(
    context: typer.Context,
    axis: str = typer.Argument(
        "", metavar="[AXIS]", help="TOML file or embedded machine; emps2019, for co-manipulation emps2018."
    ),
    scenario: str = typer.Option("", "--scenario", help="replay, reference, breakaway, comanipulation or bench."),
    record: Path | None = typer.Option(None, "--record", help="Record to replay: .mat, .csv or .npz."),
    reference: Path | None = typer.Option(
        None, "--reference", help="Reference to follow: columns t, q_ref (.csv, .npz)."
    ),
    rate: float = typer.Option(
        1.0, "--rate", callback=within("N/s"), help="Break-away: how fast the force rises [N/s]."
    ),
    peak: float | None = typer.Option(None, "--peak", callback=within("N"), help="Break-away: largest force [N]."),
    mismatch: float = typer.Option(
        0.02, "--mismatch", callback=within(""), help="Co-manipulation: relative error of the model."
    ),
    mass: float | None = typer.Option(
        None, "--mass", callback=within("kg"), help="Co-manipulation: apparent mass M_a [kg]."
    ),
    damping: float | None = typer.Option(
        None, "--damping", callback=within("N/(m/s)"), help="Co-manipulation: apparent damping B [N/(m/s)]."
    ),
    reference_velocity: float = typer.Option(
        0.0, "--reference-velocity", callback=within("m/s"), help="Co-manipulation: qd_0 of (25) [m/s]."
    ),
    as_printed: bool = typer.Option(False, "--as-printed", help="Co-manipulation: (27), (30) as printed."),
    plants: int = typer.Option(
        200, "--plants", min=0, max=1_000_000, help="Co-manipulation: plants drawn within the mismatch."
    ),
    tau_ref: float | None = typer.Option(
        None, "--tau-ref", callback=within("N"), help="Bench: force reference of the cascaded loop [N]."
    ),
    seed: int = typer.Option(0, "--seed", min=0, help="Seed of what is drawn."),
    out: Path | None = typer.Option(None, "--out", help="Write the signals to this file: .npz (lossless) or .csv."),
    plot: Path | None = typer.Option(None, "--plot", help="Draw the run into this file: .png, .svg or .pdf."),
    force: bool = typer.Option(False, "--force", help=OVERWRITE),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> int:
    from emps_design.cli.output import add_advice, print_json, say_advice, tell
    from emps_design.errors import InputError

    scenario = scenario or ("replay" if record else "reference" if reference else "")
    if scenario not in SCENARIOS:
        from emps_design.errors import nearest_name

        problem = f"found {scenario!r}" if scenario else "nothing to do"
        raise InputError(
            f"--scenario: {problem}, expected one of {', '.join(SCENARIOS)}{nearest_name(scenario, tuple(SCENARIOS))}"
        )
    _refuse_ignored(context, scenario)
    refuse_force(context, out, plot)
    if scenario == "bench" and axis:
        raise InputError(f"AXIS: found {axis!r}, but the bench is a machine of its own; leave it out")
    _check(out, plot, (axis, record, reference), force)
    if scenario == "comanipulation":
        from emps_design.control.impedance.law import PRINTED

        law = {"reference_velocity": reference_velocity, **({"current_factor": PRINTED} if as_printed else {})}
        result = _comanipulation(axis, mismatch, seed, plants, mass, damping, law)
    elif scenario == "bench":
        result = _bench(seed, tau_ref)
    else:
        result = _single(scenario, axis, record, reference, rate, peak)
        if out is not None:
            _write(out, result)
        if plot is not None:
            _draw(plot, result)
    document = add_advice(result.to_dict(), axis or None, [record] if record else [])
    for warning in document.get("warnings", []):
        tell(warning)
    if as_json:
        print_json(document)
    elif scenario == "bench":
        _show_bench(document)
    else:
        _show(document)
    if "reason" in document:
        tell(document["reason"])
    if not as_json:
        say_advice(document)
    return 4 if "reason" in document else 0


def _refuse_ignored(context: typer.Context, scenario: str) -> None:
    """Refuse options on the command line that ``scenario`` would ignore."""
    for name in dict.fromkeys(option for options in SCENARIOS.values() for option in options):
        readers = [user for user, options in SCENARIOS.items() if name in options]
        if scenario not in readers:
            refuse_ignored(context, [name], f"goes with --scenario {' or '.join(readers)}, found {scenario}")


def _single(
    scenario: str, name: str, record: Path | None, reference: Path | None, rate: float, peak: float | None
) -> Any:
    from emps_design.cli.output import load_axis
    from emps_design.errors import InputError
    from emps_design.simulation import scenarios

    axis = load_axis(name or "emps2019")
    if scenario == "breakaway":
        return scenarios.breakaway(axis, rate, peak)
    if scenario == "replay":
        if record is None:
            raise InputError("--scenario replay: found no record, expected --record FILE")
        from emps_design.importing import import_record

        return scenarios.replay(axis, import_record(record, axis))
    if reference is None:
        raise InputError("--scenario reference: found no reference, expected --reference FILE")
    from emps_design.simulation.scenarios import read_reference

    return scenarios.follow(axis, *read_reference(reference, axis.sampling.period, axis.units))


def _comanipulation(
    name: str,
    mismatch: float,
    seed: int,
    plants: int,
    mass: float | None,
    damping: float | None,
    law: dict[str, Any],
) -> Any:
    from emps_design.cli.output import load_axis, progress_bar
    from emps_design.comanipulation.scenario import run_comanipulation

    with progress_bar() as progress:
        return run_comanipulation(
            load_axis(name or "emps2018"),
            mismatch=mismatch,
            seed=seed,
            plants=plants,
            mass=mass,
            damping=damping,
            progress=progress,
            **law,
        )


def _bench(seed: int, tau_ref: float | None) -> Any:
    from emps_design.cli.output import progress_bar, set_units
    from emps_design.paper import reproduce_section_3
    from emps_design.paper.virtual_bench import numbers
    from emps_design.units import Units

    set_units(Units())
    with progress_bar() as progress:
        bench = numbers() if tau_ref is None else numbers(tau_ref=tau_ref)
        return reproduce_section_3(seed, bench, progress)


def _check(out: Path | None, plot: Path | None, inputs: tuple[str | Path | None, ...], force: bool) -> None:
    """Refuse output names with an unknown suffix, and files that must not be overwritten."""
    from emps_design.errors import InputError

    for option, path, kinds in (("--out", out, {".npz": ARCHIVE, ".csv": TABLE}), ("--plot", plot, PICTURES)):
        if path is not None and path.suffix not in kinds:
            *others, last = kinds
            expected = f"{', '.join(others)} or {last}"
            raise InputError(f"{option}: found {path.name!r}, expected a name that ends in {expected}")
        if path is not None:
            check_out(path, kinds[path.suffix], inputs, force, option)


def _write(out: Path, result: Any) -> None:
    if out.suffix == ".npz":
        result.run.save(out)
    else:
        result.run.to_csv(out, result.axis.units, mapped=bool(result.axis.record.named))


def _draw(path: Path, result: Any) -> None:
    from emps_design.files import write_aside
    from emps_design.report.style import draw, labelled

    figure = labelled(result.run.plot()[0].figure, result.axis.units)
    with write_aside(path) as aside:
        draw(figure, aside, path.suffix[1:])


def _show(document: dict[str, Any]) -> None:
    from emps_design.cli.output import new_console, new_table, say

    if "headline" in document:
        say(document["headline"])
    title = f"{document['scenario']}, axis {document.get('axis', '')}"
    table = new_table(title, "quantity", "value", "unit", words=("unit",))
    for row in _rows(document, document.get("units", {})):
        table.add_row(*row)
    new_console().print(table)


def _show_bench(document: dict[str, Any]) -> None:
    from emps_design.cli.output import new_console, new_table

    console, printed = new_console(), document["printed"]
    for key, title in (("table_1", "Table I"), ("table_2", "Table II")):
        table = new_table(title, "parameter", "value", "2 sigma", "% sigma", "printed", "2 sigma", "% sigma")
        for name, row in document[key].items():
            table.add_row(name.replace("_", " "), *(f"{number:.4g}" for number in (*row, *printed[key][name])))
        console.print(table)
    table = new_table("Errors [N], least and largest of ten", "", "found", "printed", words=("found", "printed"))
    for key, title in (("rms_1", "identification"), ("rms_2", "observation"), ("rms_direct", "direct validation")):
        errors = document[key]
        table.add_row(title, f"{min(errors):.2f} to {max(errors):.2f}", "{:g} to {:g}".format(*printed[key]))
    force = document["break_away"][0]
    table.add_row("break-away forth", f"{force:.2f}", f"{printed['break_away']:g}")
    console.print(table)


def _rows(document: dict[str, Any], units: dict[str, str], before: tuple[str, ...] = ()) -> list[tuple[str, str, str]]:
    """Name, value and unit of each number; ``units`` has a unit by the name of a quantity, or of a group of them."""
    from emps_design.cli.output import display_unit

    rows: list[tuple[str, str, str]] = []
    for key, value in document.items():
        path = (*before, key)
        if key in OUTSIDE_TABLE:
            continue
        if isinstance(value, dict):
            rows += _rows(value, units, path)
        elif not isinstance(value, list) or value:
            base = next((units[name] for name in path if name in units), "")
            if isinstance(value, float) and math.isfinite(value):
                unit, factor = display_unit(value, base)
                text = f"{factor * value:.6g}"
            elif value is None or isinstance(value, float):
                unit, text = "", "-"
            else:
                unit, text = "", ", ".join(map(str, value)) if isinstance(value, list) else str(value)
            rows.append((" ".join(path).replace("_", " "), text, unit))
    return rows
