"""Frequency response from force to velocity in records, estimated in closed loop, with coherence and deviations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from emps_design.cli.options import HERTZ, refuse_force
from emps_design.commands.destinations import MATLAB, OVERWRITE, PICTURES, TABLE, check_named_out

if TYPE_CHECKING:
    from emps_design.frequency_response import ResponseEstimate

LONG = 1_000_000  # samples from which on a progress bar is worth it
OUT = {".csv": TABLE, ".mat": MATLAB}


def command(
    context: typer.Context,
    records: list[Path] = typer.Argument(..., metavar="RECORD...", help="Record files: .mat, .csv or .npz."),
    axis: str = typer.Option(
        "emps2019", "--axis", help="TOML file or embedded machine: its force gain and computation delay are read."
    ),
    method: str = typer.Option("auto", "--method", help="auto, periodic, stepped, local-polynomial or welch."),
    instrument: str = typer.Option(
        "",
        "--instrument",
        help="What moves the axis: excitation (default where recorded), reference, or, in open loop, command.",
    ),
    low: float = typer.Option(0.0, "--from", **HERTZ, help="Lowest frequency [Hz]."),
    high: float | None = typer.Option(None, "--to", **HERTZ, help="Highest frequency [Hz]; 0.8 of Nyquist at most."),
    out: Path | None = typer.Option(None, "--out", help="Write the response to this file: .csv, or .mat for MATLAB."),
    plot: Path | None = typer.Option(None, "--plot", help="Draw it into this file: .png, .svg or .pdf."),
    force: bool = typer.Option(False, "--force", help=OVERWRITE),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    from emps_design.cli.output import add_advice, load_axis, print_json, print_warnings, progress_bar, say_advice
    from emps_design.errors import InputError, nearest_name
    from emps_design.frequency_response import estimate_response, write_response
    from emps_design.frequency_response.estimate import METHODS
    from emps_design.frequency_response.signals import INSTRUMENTS
    from emps_design.importing import import_record

    refuse_force(context, out, plot)
    for option, value, known in (
        ("--method", method, ("auto", *METHODS)),
        ("--instrument", instrument, ("", *INSTRUMENTS)),
    ):
        if value not in known:
            expected = ", ".join(name for name in known if name)
            raise InputError(f"{option}: found {value!r}, expected one of {expected}{nearest_name(value, known)}")
    for option, path, kinds in (("--out", out, OUT), ("--plot", plot, PICTURES)):
        check_named_out(path, kinds, (axis, *records), force, option)
    loaded = load_axis(axis)
    read = [import_record(path, loaded) for path in records]
    with progress_bar(sum(map(len, read)) >= LONG) as progress:
        estimate = estimate_response(read, loaded, method, instrument, low, high, progress=progress)
    if out is not None:
        write_response(out, estimate.response)
    if plot is not None:
        _draw(plot, estimate)
    document = add_advice(estimate.to_dict(), axis, records)
    if as_json:
        print_json(document)
    else:
        _show(estimate, loaded.units.unit)
    print_warnings(estimate.all_warnings)
    if not as_json:
        say_advice(document)


def _draw(path: Path, estimate: ResponseEstimate) -> None:
    from emps_design.files import write_aside
    from emps_design.report.loop_figures import response_figure
    from emps_design.report.style import draw, labelled

    figure = labelled(response_figure(estimate.comparison, estimate.spectral_ratio), estimate.axis.units)
    with write_aside(path) as aside:
        draw(figure, aside, path.suffix[1:])


def _show(estimate: ResponseEstimate, unit: Callable[[str], str]) -> None:
    import numpy as np
    from rich import box
    from rich.table import Table

    from emps_design.cli.output import new_console

    console, response = new_console(), estimate.response
    console.print(
        f"{response.name}: {len(response)} lines from {response.frequency[0]:.4g} to {response.frequency[-1]:.4g} Hz; "
        f"{estimate.method}, by the {estimate.instrument}, {estimate.seconds:.4g} s on {estimate.passes} "
        f"pass{'' if estimate.passes == 1 else 'es'}"
    )
    table = Table(box=box.SIMPLE, pad_edge=False)
    for heading in (
        "frequency [Hz]",
        f"magnitude [({unit('m/s')})/({unit('N')})]",
        "phase [deg]",
        "std [%]",
        "coherence",
        "ratio of spectra",
    ):
        table.add_column(heading, justify="right")
    wanted = np.geomspace(response.frequency[0], response.frequency[-1], 16)
    apart = estimate.spectral_ratio / response.response - 1.0
    for i in sorted({int(np.argmin(np.abs(response.frequency - f))) for f in wanted}):
        table.add_row(
            f"{response.frequency[i]:.4g}",
            f"{response.magnitude[i]:.4g}",
            f"{response.phase_deg[i]:.1f}",
            f"{100 * response.std[i]:.2f}",
            f"{response.coherence[i]:.4f}",
            f"{100 * abs(apart[i]):.2g} % off",
        )
    console.print(table)
    for resonance in estimate.resonances:
        console.print(
            f"{resonance.kind} at {resonance.frequency:.2f} +- {resonance.std:.2f} Hz, damping {resonance.damping:.3f}"
        )
    chain = estimate.comparison.chain
    values = [
        f"{name.replace('_', ' ')} {f'{value:.5g} +- {std:.2g} {unit(of)}'.rstrip() if known else 'not determined'}"
        for name, (value, std, of) in chain.parameters.items()
        for known in [chain.determines(name)]
    ]
    console.print(f"fitted, {chain.label}: {', '.join(values)} (residuals {chain.misfit:.2g} deviations)")
    console.print(f"{estimate.axis.name}: {estimate.comparison.agreement.sentence}")
    if estimate.distortion is not None:
        levels = estimate.distortion.to_dict()
        words = [f"{name} {100 * level:.2g} %" for name, level in levels.items() if level is not None]
        console.print(f"of the linear answer, one period: {', '.join(words)} (odd, even: nonlinear distortion)")
    console.print("ratio of spectra: velocity over command, which ignores feedback; for comparison only")
