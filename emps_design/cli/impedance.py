"""The impedance law M_a, B without a force sensor: as derived and as printed, sampled, and under mismatch."""

from __future__ import annotations

import math
import sys
from typing import Annotated, Any

import typer

from emps_design.cli.options import RAD_S, refuse_ignored, within
from emps_design.cli.output import add_advice, load_axis, new_console, print_json, progress_bar, say_advice, tell
from emps_design.errors import InputError


def command(
    context: typer.Context,
    axis: Annotated[str, typer.Argument(help="TOML file or embedded machine")] = "emps2018",
    mass: Annotated[
        float | None,
        typer.Option(callback=within("kg"), help="apparent mass M_a [kg]; default the axis's controller's"),
    ] = None,
    damping: Annotated[
        float | None, typer.Option(callback=within("N/(m/s)"), help="apparent damping B [N/(m/s)]; default likewise")
    ] = None,
    mismatch: Annotated[
        float | None, typer.Option(callback=within(""), help="relative error of the estimates, such as 0.02")
    ] = None,
    filter: Annotated[
        float | None,
        typer.Option(
            **RAD_S,
            callback=within("rad/s"),
            help="low-pass of acceleration and current [rad/s, or such as 80Hz], inf: none; default that of the axis's "
            "controller, else 0.5/period",
        ),
    ] = None,
    unfiltered_current: Annotated[
        bool, typer.Option("--unfiltered-current", help="filter the acceleration alone")
    ] = False,
    stiffness: Annotated[float, typer.Option(callback=within("N/m"), help="apparent stiffness K [N/m] about 0")] = 0.0,
    coulomb_factor: Annotated[
        float, typer.Option(callback=within(""), help="factor on the Coulomb compensation")
    ] = 1.0,
    force_sensor: Annotated[bool, typer.Option("--force-sensor", help="(28) with a measured force")] = False,
    two_quadrant: Annotated[
        bool, typer.Option("--two-quadrant", help="let friction err apart in either direction")
    ] = False,
    plants: Annotated[int, typer.Option(min=0, max=1_000_000, help="Monte-Carlo plants beside the corners")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="seed of the Monte-Carlo")] = 0,
    workers: Annotated[int, typer.Option(min=1, max=256, help="threads; the numbers do not depend on it")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON document on standard output")] = False,
) -> int:
    from emps_design.comanipulation.assessment import assess_impedance

    if mismatch is None:
        refuse_ignored(context, ["two_quadrant", "plants", "seed", "workers"], "goes with --mismatch")
    if force_sensor:
        refuse_ignored(context, ["unfiltered_current"], "goes without --force-sensor; (28) takes no current")
    machine = load_axis(axis)
    mass = _required("--mass", "M_a [kg]", mass, machine.controller.mass)
    damping = _required("--damping", "B [N/(m/s)]", damping, machine.controller.damping)
    with progress_bar(not as_json or sys.stderr.isatty()) as progress:
        assessment = assess_impedance(
            machine,
            mass,
            damping,
            mismatch,
            filter,
            plants,
            seed,
            True if two_quadrant else None,
            workers,
            progress,
            current_filter=math.inf if unfiltered_current else None,
            stiffness=stiffness,
            coulomb_factor=coulomb_factor,
            force_sensor=force_sensor,
        )
        document = add_advice(assessment.to_dict(), axis)
    if as_json:
        print_json(document)
    else:
        _print(document)
    if not assessment.stable:
        tell(assessment.reason)
    if not as_json:
        say_advice(document)
    return 0 if assessment.stable else 4


def _required(option: str, what: str, requested: float | None, own: float | None) -> float:
    value = own if requested is None else requested
    if value is None:
        raise InputError(f"{option}: found none, expected {what}, here or in the axis's impedance controller")
    return value


def _print(document: dict[str, Any]) -> None:
    from rich.table import Table

    from emps_design.comanipulation.study import CALM

    console = new_console()
    law, sampled = document["law"], document["sampled"]
    name, _, why = document["headline"].partition(": ")
    console.print(f"{name if document['verdict'] in CALM else name.upper()}: {why}")
    console.print(f"{document['axis']}: impedance law {_law_in_words(law)}")
    console.print(
        f"exact estimates: poles of the sampled loop {'stable' if sampled['stable'] else 'UNSTABLE'}, released: "
        f"{sampled['verdict'].replace('_', ' ')}; simulated with encoder and limit: "
        f"{sampled['simulated'].replace('_', ' ')}"
    )
    table = Table("felt, ideal current loop", "mass, kg", "damping, N/(m/s)", "Coulomb left, N")
    rows = [("derived", document["derived"]), ("(30) as printed", document["printed"])]
    for label, values in [("(28), measured force", document["felt"])] if law["force_sensor"] else rows:
        keys = ("apparent_mass", "apparent_damping", "coulomb_left")
        table.add_row(label, *(_three_digits(values[key]) for key in keys))
    console.print(table)
    study = document.get("mismatch")
    if study is not None:
        table = Table("mismatch", f"+-{100 * study['mismatch']:g} %")
        creep = study["creep_speed"]
        free = study["creep_speed_exact_encoder"]
        ended = f" (the encoder ends one of {1e3 * free:.3g})" if free > creep else ""
        table.add_row("creep speed, mm/s", "unbounded" if math.isinf(creep) else f"{1e3 * creep:.3f}{ended}")
        table.add_row("dead band, N", f"{study['dead_band']:.3f}")
        factor = study["coulomb_factor_without_creep"]
        table.add_row("Coulomb factor without creep", "none" if factor is None else f"{factor:.4f}")
        low, high = study["stable_share_interval"]
        interval = "" if math.isnan(low) else f" (95 %: {100 * low:.2f} to {100 * high:.2f} %)"
        table.add_row("plants that come to rest", f"{100 * study['stable_share']:.2f} %{interval}")
        table.add_row("neither unstable nor cycling", f"{100 * study['bounded_share']:.2f} %")
        table.add_row("verdicts", ", ".join(f"{count} {name}" for name, count in study["verdicts"].items() if count))
        worst = study["worst"]
        errors = ", ".join(f"{name} {100 * value:+.2f} %" for name, value in worst["errors"].items())
        table.add_row("worst", f"{worst['verdict']} at {errors}")
        for case in study["beyond"]:
            table.add_row(f"corners with {case['what']}", case["verdict"])
        console.print(table, width=min(80, console.width))
    loop = document["equivalent_loop"]
    if loop["k_e1"] is not None:
        stable = "stable" if loop["sampled"]["stable"] else "UNSTABLE"
        match = loop["criterion"].replace("_", " ")
        console.print(f"equivalent cascaded loop, {stable} when sampled ({match}): k_e1 = {loop['k_e1']:g} (m/s)/N")
        for warning in (w for w in loop["warnings"] if w not in document["warnings"]):
            console.print(f"- {warning}", highlight=False)
    for warning in document["warnings"]:
        console.print(f"- {warning}", highlight=False)


def _law_in_words(law: dict[str, Any]) -> str:
    """Return the parameters of an impedance law in words; a parameter at its default is left out.

    >>> usual = {"filter": 500.0, "current_filter": 500.0, "stiffness": 0.0, "coulomb_factor": 1.0}
    >>> _law_in_words({"mass": 50.0, "damping": 100.0, "force_sensor": False, **usual})
    'M_a = 50 kg, B = 100 N/(m/s), filter 500 rad/s'
    """
    low_pass = "unfiltered" if law["filter"] is None else f"{law['filter']:g} rad/s"
    words = [f"M_a = {law['mass']:g} kg", f"B = {law['damping']:g} N/(m/s)"]
    words += [f"K = {law['stiffness']:g} N/m"] if law["stiffness"] else []
    words.append(f"filter {low_pass}")
    if law["force_sensor"]:
        words.append("with a force sensor, (28)")
    elif law["current_filter"] is None and law["filter"] is not None:
        words.append("current unfiltered")
    words += [f"Coulomb factor {law['coulomb_factor']:g}"] if law["coulomb_factor"] != 1.0 else []
    return ", ".join(words)


def _three_digits(value: float | None) -> str:
    """Return ``value`` with three significant digits, or with one decimal from 100 on.

    >>> _three_digits(0.15), _three_digits(235.82), _three_digits(73.777), _three_digits(None)
    ('0.15', '235.8', '73.8', 'undefined')
    """
    if value is None:
        return "undefined"
    return f"{value:.1f}" if abs(value) >= 100.0 else f"{value:.3g}"
