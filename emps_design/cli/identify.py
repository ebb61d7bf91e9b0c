"""Identify the parameters of an axis from one record, or from several with their spread."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from emps_design.cli.options import HERTZ, refuse_force, refuse_ignored
from emps_design.commands.destinations import AXIS, OVERWRITE, check_out

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
    from emps_design.identification.result import IdentificationRequest
    from emps_design.importing import import_record

    _refuse_ignored(context, estimator, len(records))
    refuse_force(context, out)
    if not bootstrap:
        refuse_ignored(context, ["seed"], "goes with --bootstrap; nothing else is drawn")
    check_out(out, AXIS, (axis, *records, holdout), force)
    loaded = load_axis(axis)
    # Checks the options before the records are read.
    options = vars(
        IdentificationRequest(model, estimator, filter, cutoff, external_force, None, bootstrap, seed, with_)
    )
    read = [import_record(path, loaded) for path in records]
    together = len(read) > 1 and any(map(goes_one_way, read))
    if together:
        from emps_design.identification.several import identify_together

        identification: Any = identify_together(read, loaded, **options)
    elif len(read) == 1:
        judge = None if holdout is None else import_record(holdout, loaded)
        identification = identify(read[0], loaded, **{**options, "holdout": judge})
    else:
        from emps_design.identification.several import identify_several

        with progress_bar(not as_json or sys.stderr.isatty()) as progress:
            identification = identify_several(read, loaded, progress=progress, **options)
    document = add_advice(identification.to_dict(), axis, records)
    if as_json:
        print_json(document)
    elif together or len(read) == 1:
        _show_one(identification)
    else:
        _show_several(identification)
    for warning in identification.warnings:
        tell(warning)
    if out is not None:  # last: the parameters are shown even if they make no valid axis
        write_text(out, identification.to_axis(name=one_line(out.stem)).to_toml())
    if not as_json:
        say_advice(document)


def _refuse_ignored(context: typer.Context, estimator: str, records: int) -> None:
    """Refuse options that ``estimator``, or several records, would ignore."""
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


def _show_one(identification: Identification) -> None:
    from emps_design.cli.output import new_console, new_table
    from emps_design.quantities import decimals, rounded

    console = new_console()
    title = f"{identification.record}, {identification.model} model, {identification.estimator.replace('_', ' ')}"
    headings = ("parameter", "value", "std (15)", "% (16)", "std *", "95 % ± *", "unit")
    table = new_table(title, *headings, words=("unit",), whole=True, pad_edge=False, padding=(0, 1, 0, 0))
    own = _rows_of(identification.proposed)
    for key, estimate in identification.parameters.items():
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
    if identification.proposed:
        console.print(_why_proposed(identification.proposed))
    for label, key in ((f"HAC std, lag {identification.hac_lag:.2f} s", "std_hac"), ("bootstrap std", "std_bootstrap")):
        known = {name: getattr(e, key) for name, e in identification.parameters.items() if getattr(e, key) is not None}
        if known:
            console.print(f"{label}: {', '.join(f'{name} {rounded(std, 4)}' for name, std in known.items())}")
    console.print(
        f"force error {rounded(identification.rms_error, 4)} N rms, "
        f"{identification.relative_error_percent:.4f} % of the force; condition number "
        f"{identification.condition_number:.1f}"
    )
    residual = identification.residual
    console.print(
        f"* {identification.samples} rows count as {residual.effective_samples:.0f} independent ones (residual "
        f"correlated over {1e3 * residual.correlation_time:.0f} ms)"
    )
    if identification.extra["cutoff_sensitivity"] is not None:
        console.print(_moved_by_cutoff(identification))
    if any(estimate.systematic for estimate in identification.parameters.values()):
        console.print("95 % ± holds what this filter is off by as well, judged by --filter hold")
    stepped = {name: estimate.encoder for name, estimate in identification.parameters.items() if estimate.encoder}
    if stepped:
        each = ", ".join(f"{name} {rounded(rms, 4)}" for name, rms in stepped.items())
        console.print(f"95 % ± holds what the steps of the encoder do as well, by simulation: {each} rms")
    console.print(f"filter {identification.chain}: {identification.filter_text}")
    if identification.extra.get("held_out"):
        judged = identification.extra["held_out"]
        share = judged["relative_error_percent"]
        compared = f"{share:.4f} %" if math.isfinite(share) else "where there is no force to compare it with"
        console.print(f"held out, {judged['on']}: {rounded(judged['rms_error'], 4)} N rms, {compared}")
    if "cutoff_from_data" in identification.extra:
        chosen = identification.extra["cutoff_from_data"]["cutoff_hz"]
        if identification.chain != "hold":
            console.print(f"--filter hold would cut off at {chosen:g} Hz")
        elif identification.cutoff_hz != chosen:
            console.print(f"motion and encoder of this record would have a cut-off of {chosen:g} Hz")
    if "hausman_test" in identification.extra:
        test = identification.extra["hausman_test"]
        verdict = "biased" if test["least_squares_biased"] else "not shown to be biased"
        little = ", too little to matter" if test["least_squares_biased"] and not test["bias_matters"] else ""
        console.print(
            f"Durbin-Wu-Hausman: least squares is {verdict} (p = {test['p_value']:.2g}), by at most "
            f"{test['shift_in_std']:.2f} standard deviations{little}"
        )
    if "closed_loop" in identification.extra:
        loop = identification.extra["closed_loop"]
        console.print(
            f"closed loop from q_ref: position {1e6 * loop['position_rms_error']:.3f} um rms, force "
            f"{rounded(loop['force_rms_error'], 3)} N rms ({loop['force_relative_error_percent']:.2f} %)"
        )


def _rows_of(terms: Sequence[str]) -> set[str]:
    """Return the names of the parameters of ``terms``."""
    from emps_design.effects.terms import TERMS

    return {quantity.name for term in terms for quantity in TERMS[term].quantities}


def _why_proposed(terms: Sequence[str]) -> str:
    """Say which terms the record asked for, why, and how to leave them out."""
    return (
        f"+ proposed: {', '.join(terms)}; without it strokes that took no part in the fit are predicted with at least "
        "twice the error; --with none leaves it out"
    )


def _moved_by_cutoff(identification: Identification) -> str:
    """Say by how much half and twice the cut-off change the parameters, and whether the intervals cover it."""
    moved = ", ".join(
        f"{name} {100.0 * share:.2g} %"
        for name, share in identification.extra["cutoff_sensitivity"].items()
        if share is not None and identification.parameters[name].determined
    )
    tried = " and ".join(f"{frequency:.3g}" for frequency in identification.extra["cutoffs_tried"]["cutoff_hz"])
    beyond = any(estimate.cutoff for estimate in identification.parameters.values())
    held = "; 95 % ± holds what is beyond chance" if beyond else ", no more than chance"
    return f"cut-offs of {tried} Hz change {moved}{held}" if tried else "no other cut-off leaves enough of the record"


def _written(number: float | None, places: int) -> str:
    """Return ``number`` with ``places`` decimals, or with an exponent if it is too long or would show as 0.

    >>> _written(95.1089, 4), _written(3.001e-05, 9), _written(2e-08, 6)
    ('95.1089', '3.001e-05', '2.000e-08')
    """
    if number is None:
        return ""
    lost = 0.0 < abs(number) < 0.5 * 10.0**-places
    return f"{number:.3e}" if lost or places > MOST_PLACES else f"{number:.{places}f}"


def _show_several(identifications: SeveralIdentifications) -> None:
    from emps_design.cli.output import new_console, new_table
    from emps_design.quantities import decimals

    console = new_console()
    headings = ("parameter", "mean", "spread", "std *", "drift/record", "unit")
    estimator = identifications.estimator.replace("_", " ")
    title = f"{len(identifications.records)} records, {identifications.model} model, {estimator}"
    table = new_table(title, *headings, words=("unit",), whole=True)
    own = _rows_of(identifications.proposed)
    for row in identifications.table():
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
    if identifications.proposed:
        console.print(_why_proposed(identifications.proposed))
    console.print(
        "spread: std between records; std *: mean within one, for a correlated residual; drift **: p < 1 % over all "
        "parameters together"
    )
    title = "force error [N rms]: identified on the row's record, judged on the column's"
    matrix = new_table(title, pad_edge=False, padding=(0, 1, 0, 0))
    matrix.add_column("", overflow="fold")
    for number in range(1, len(identifications.records) + 1):
        matrix.add_column(str(number), justify="right", no_wrap=True)
    for number, (name, row) in enumerate(
        zip(identifications.records, identifications.cross_validation, strict=True), 1
    ):
        matrix.add_row(f"{number} {name}", *(f"{value:.3f}" for value in row))
    console.print(matrix)
