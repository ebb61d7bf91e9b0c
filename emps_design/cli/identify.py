"""Identify the parameters of an axis from one record, or from several with their spread."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from emps_design.cli.destinations import AXIS, OVERWRITE, check_out
from emps_design.cli.options import HERTZ, refuse_force, refuse_ignored

if TYPE_CHECKING:
    from emps_design.identification.result import Identification
    from emps_design.identification.several import SeveralIdentifications

MOST_PLACES = 6  # behind the point, in a column of the table


def command(
    context: typer.Context,
    records: list[Path] = typer.Argument(
        ...,
        metavar="RECORD...",
        help="Record file: .mat, .csv or .npz. Several: mean, spread, drift, cross-validation.",
    ),
    axis: str = typer.Option(
        "emps2019",
        "--axis",
        help="TOML file or embedded machine: G_tau, limits, controller, and effects that are known already.",
    ),
    model: str = typer.Option("symmetric", "--model", help="symmetric or asymmetric friction."),
    filter: str = typer.Option(
        "hold",
        "--filter",
        help="hold: models the hold of the drive, leaves rests out, cut-off from the data; report: 100 Hz "
        "low-pass, of the 2019 report; paper: median and decimation, of the 2018 paper.",
    ),
    cutoff: float | None = typer.Option(
        None,
        "--cutoff",
        **HERTZ,
        help="Low-pass [Hz, or such as 370rad/s] instead of the filter's own; what the data say is printed too.",
    ),
    estimator: str = typer.Option(
        "auto",
        "--estimator",
        help="auto: ls, or iv where ls is biased or noise hides a parameter from it, or oe where from both; "
        "ls: least squares; iv: instruments; oe: closed-loop output error.",
    ),
    with_: str = typer.Option(
        "auto",
        "--with",
        help="Terms beside mass and friction, with commas: gravity, asymmetric-viscous, bent-viscous; auto: what the "
        "record asks for; none.",
    ),
    external_force: str = typer.Option(
        "refuse", "--external-force", help="refuse a record with one, or known: let the measured force take part."
    ),
    holdout: Path | None = typer.Option(
        None, "--holdout", help="Judge the fit on this record; without it on the last third, fitted to the rest."
    ),
    bootstrap: int = typer.Option(
        0, "--bootstrap", min=0, max=100_000, help="Draws of a bootstrap of the residual, 0: none."
    ),
    seed: int = typer.Option(0, "--seed", min=0, help="Seed of the bootstrap."),
    out: Path | None = typer.Option(None, "--out", help="Write the identified axis to this TOML file."),
    force: bool = typer.Option(False, "--force", help=OVERWRITE),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """Identify the parameters of an axis from one record, or from several with their spread."""
    import sys

    from emps_design.cli.output import add_advice, load_axis, print_json, progress_bar, say_advice, tell
    from emps_design.errors import one_line
    from emps_design.files import write_text
    from emps_design.identification import identify
    from emps_design.identification.excitation import goes_one_way
    from emps_design.identification.result import Request
    from emps_design.importing import import_record

    _refuse_ignored(context, estimator, len(records))
    refuse_force(context, out)
    if not bootstrap:
        refuse_ignored(context, ["seed"], "goes with --bootstrap; nothing else is drawn")
    check_out(out, AXIS, (axis, *records, holdout), force)
    loaded = load_axis(axis)
    # Refused before the records are read.
    options = vars(Request(model, estimator, filter, cutoff, external_force, None, bootstrap, seed, with_))
    read = [import_record(path, loaded) for path in records]
    together = len(read) > 1 and any(map(goes_one_way, read))
    if together:
        from emps_design.identification.several import identify_together

        found: Any = identify_together(read, loaded, **options)
    elif len(read) == 1:
        judge = None if holdout is None else import_record(holdout, loaded)
        found = identify(read[0], loaded, **{**options, "holdout": judge})
    else:
        from emps_design.identification.several import identify_several

        with progress_bar(not as_json or sys.stderr.isatty()) as progress:
            found = identify_several(read, loaded, progress=progress, **options)
    document = add_advice(found.to_dict(), axis, records)
    if as_json:
        print_json(document)
    elif together or len(read) == 1:
        _show_one(found)
    else:
        _show_several(found)
    for warning in found.warnings:
        tell(warning)
    if out is not None:  # last: what was found is shown, even where it is no machine
        write_text(out, found.to_axis(name=one_line(out.stem)).to_toml())
    if not as_json:
        say_advice(document)


def _refuse_ignored(context: typer.Context, estimator: str, records: int) -> None:
    """Raise for an option that what was asked for would not read."""
    from emps_design.errors import InputError

    if estimator in ("auto", "ls"):
        if records > 1:
            why = f"goes with one record, found {records}; several judge one another"
            refuse_ignored(context, ["bootstrap", "holdout"], why)
        return
    if records > 1:
        raise InputError(f"--estimator: {estimator} takes one record, found {records}; use ls for several")
    why = f"goes with --estimator ls, found {estimator}, which filters as hold does and has intervals of its own"
    refuse_ignored(context, ["filter", "bootstrap", "holdout"], why)


def _show_one(found: Identification) -> None:
    from emps_design.cli.output import new_console, new_table
    from emps_design.quantities import decimals, rounded

    console = new_console()
    title = f"{found.record}, {found.model} model, {found.estimator.replace('_', ' ')}"
    headings = ("parameter", "value", "std (15)", "% (16)", "std *", "95 % ± *", "unit")
    table = new_table(title, *headings, words=("unit",), whole=True, pad_edge=False, padding=(0, 1, 0, 0))
    own = _rows_of(found.proposed)
    for key, estimate in found.parameters.items():
        name = key.replace("_and_", " + ") + (" +" if key in own else "")
        if estimate.interval_95 is None:
            table.add_row(name, "-", "", "", "", "", estimate.quantity.unit)  # a warning says why
            continue
        low, high = estimate.interval_95
        percent, n = estimate.relative_std_percent, decimals(max(abs(estimate.value or 0.0), estimate.std or 0.0))
        table.add_row(
            name,
            _written(estimate.value, n),
            _written(estimate.std, n),
            "" if percent is None else f"{percent:.2f}",
            _written(estimate.std_long_run, n),
            _written(0.5 * (high - low), n),
            estimate.quantity.unit,
        )
    console.print(table)
    if found.proposed:
        console.print(_why_proposed(found.proposed))
    for label, key in ((f"HAC std, lag {found.hac_lag:.2f} s", "std_hac"), ("bootstrap std", "std_bootstrap")):
        known = {name: getattr(e, key) for name, e in found.parameters.items() if getattr(e, key) is not None}
        if known:
            console.print(f"{label}: {', '.join(f'{name} {rounded(std, 4)}' for name, std in known.items())}")
    console.print(
        f"force error {rounded(found.rms_error, 4)} N rms, "
        f"{found.relative_error_percent:.4f} % of the force; condition number {found.condition_number:.1f}"
    )
    console.print(
        f"* {found.samples} rows count as {found.residual.effective_samples:.0f} independent ones (residual correlated "
        f"over {1e3 * found.residual.correlation_time:.0f} ms)"
    )
    if found.extra["cutoff_sensitivity"] is not None:
        console.print(_moved_by_cutoff(found))
    if any(estimate.systematic for estimate in found.parameters.values()):
        console.print("95 % ± holds what this filter is off by as well, judged by --filter hold")
    stepped = {name: one.encoder for name, one in found.parameters.items() if one.encoder}
    if stepped:
        each = ", ".join(f"{name} {rounded(rms, 4)}" for name, rms in stepped.items())
        console.print(f"95 % ± holds what the steps of the encoder do as well, by simulation: {each} rms")
    console.print(f"filter {found.chain}: {found.filter_text}")
    if found.extra.get("held_out"):
        judged = found.extra["held_out"]
        share = judged["relative_error_percent"]
        compared = f"{share:.4f} %" if math.isfinite(share) else "where there is no force to compare it with"
        console.print(f"held out, {judged['on']}: {rounded(judged['rms_error'], 4)} N rms, {compared}")
    if "cutoff_from_data" in found.extra:
        chosen = found.extra["cutoff_from_data"]["cutoff_hz"]
        if found.chain != "hold":
            console.print(f"--filter hold would cut off at {chosen:g} Hz")
        elif found.cutoff_hz != chosen:
            console.print(f"motion and encoder of this record would have a cut-off of {chosen:g} Hz")
    if "hausman_test" in found.extra:
        test = found.extra["hausman_test"]
        verdict = "biased" if test["least_squares_biased"] else "not shown to be biased"
        little = ", too little to matter" if test["least_squares_biased"] and not test["bias_matters"] else ""
        console.print(
            f"Durbin-Wu-Hausman: least squares is {verdict} (p = {test['p_value']:.2g}), by at most "
            f"{test['shift_in_std']:.2f} standard deviations{little}"
        )
    if "closed_loop" in found.extra:
        loop = found.extra["closed_loop"]
        console.print(
            f"closed loop from q_ref: position {1e6 * loop['position_rms_error']:.3f} um rms, force "
            f"{rounded(loop['force_rms_error'], 3)} N rms ({loop['force_relative_error_percent']:.2f} %)"
        )


def _rows_of(terms: Sequence[str]) -> set[str]:
    """The parameters that ``terms`` have, by name."""
    from emps_design.effects.terms import TERMS

    return {quantity.name for term in terms for quantity in TERMS[term].quantities}


def _why_proposed(terms: Sequence[str]) -> str:
    """Which rows of the table the record asked for by itself, and how to do without."""
    return (
        f"+ proposed: {', '.join(terms)}; without it strokes that took no part in the fit are predicted with at least "
        "twice the error; --with none leaves it out"
    )


def _moved_by_cutoff(found: Identification) -> str:
    """What half and twice the cut-off change, and whether the intervals hold it."""
    moved = ", ".join(
        f"{name} {100.0 * share:.2g} %"
        for name, share in found.extra["cutoff_sensitivity"].items()
        if share is not None and found.parameters[name].determined
    )
    tried = " and ".join(f"{one:.3g}" for one in found.extra["cutoffs_tried"]["cutoff_hz"])
    beyond = any(one.cutoff for one in found.parameters.values())
    held = "; 95 % ± holds what is beyond chance" if beyond else ", no more than chance"
    return f"cut-offs of {tried} Hz change {moved}{held}" if tried else "no other cut-off leaves enough of the record"


def _written(number: float | None, places: int) -> str:
    """``number`` with so many ``places``, or with an exponent where a column has no room for it or it would show as 0.

    >>> _written(95.1089, 4), _written(3.001e-05, 9), _written(2e-08, 6)
    ('95.1089', '3.001e-05', '2.000e-08')
    """
    if number is None:
        return ""
    lost = 0.0 < abs(number) < 0.5 * 10.0**-places
    return f"{number:.3e}" if lost or places > MOST_PLACES else f"{number:.{places}f}"


def _show_several(found: SeveralIdentifications) -> None:
    from emps_design.cli.output import new_console, new_table
    from emps_design.quantities import decimals

    console = new_console()
    headings = ("parameter", "mean", "spread", "std *", "drift/record", "unit")
    title = f"{len(found.records)} records, {found.model} model, {found.estimator.replace('_', ' ')}"
    table = new_table(title, *headings, words=("unit",), whole=True)
    own = _rows_of(found.proposed)
    for row in found.table():
        n = decimals(max(abs(row["mean"]), row["std"]))
        table.add_row(
            row["name"] + (" +" if row["name"] in own else ""),
            f"{row['mean']:.{n}f}",
            f"{row['spread']:.{n}f}",
            f"{row['std']:.{n}f}",
            "-" if row["drift"] is None else f"{row['drift']:+.{n}f}" + (" **" if row["drift_significant"] else ""),
            row["unit"],
        )
    console.print(table)
    if found.proposed:
        console.print(_why_proposed(found.proposed))
    console.print(
        "spread: std between records; std *: mean within one, for a correlated residual; drift **: p < 1 % over all "
        "parameters together"
    )
    title = "force error [N rms]: identified on the row's record, judged on the column's"
    matrix = new_table(title, pad_edge=False, padding=(0, 1, 0, 0))
    matrix.add_column("", overflow="fold")
    for number in range(1, len(found.records) + 1):
        matrix.add_column(str(number), justify="right", no_wrap=True)
    for number, (name, row) in enumerate(zip(found.records, found.cross_validation, strict=True), 1):
        matrix.add_row(f"{number} {name}", *(f"{value:.3f}" for value in row))
    console.print(matrix)
