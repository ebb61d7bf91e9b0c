"""The experiment that measures a frequency response on a running carriage, within its limits: multi-sine or stepped."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from emps_design.cli.destinations import OVERWRITE, TABLE, check_out
from emps_design.cli.options import HERTZ, refuse_force, refuse_ignored

if TYPE_CHECKING:
    from emps_design.frequency_response import Experiment


def command(
    context: typer.Context,
    axis: str = typer.Argument("emps2019", help="TOML file or embedded machine, with its controller."),
    stroke: float = typer.Option(..., "--stroke", help="Travel that may be used [m]."),
    speed: float = typer.Option(..., "--speed", help="Speed of the passes, at most [m/s]; the excitation takes 80 %."),
    low: float = typer.Option(2.0, "--from", **HERTZ, help="Lowest frequency [Hz]."),
    high: float | None = typer.Option(None, "--to", **HERTZ, help="Highest frequency [Hz]; 0.8 of Nyquist."),
    resolution: float = typer.Option(
        0.5, "--resolution", **HERTZ, help="Base line of a multi-sine [Hz]; a step takes as long as its period."
    ),
    steps: int | None = typer.Option(None, "--steps", max=2000, help="A stepped sine of so many lines, no multi-sine."),
    passes: int = typer.Option(4, "--passes", min=1, max=1000, help="Passes, to and fro; how often each step comes."),
    slope: float = typer.Option(0.5, "--slope", min=0.0, max=3.0, help="The command falls with this power of f."),
    at: str = typer.Option("command", "--at", help="command: added to the controller's output; or reference."),
    speed_limit: float | None = typer.Option(None, "--speed-limit", help="Largest speed [m/s]."),
    force_limit: float | None = typer.Option(None, "--force-limit", help="Largest force [N]; the command's own limit."),
    jerk_limit: float | None = typer.Option(None, "--jerk-limit", help="Largest jerk of the excitation [m/s^3]."),
    noise: float | None = typer.Option(
        None, "--noise", min=0.0, help="Force noise to expect [N rms, white]; 2 % of the Coulomb friction."
    ),
    seed: int = typer.Option(0, "--seed", min=0, help="Seed of lines and phases of a multi-sine."),
    out: Path | None = typer.Option(None, "--out", help="Write reference and excitation to this .csv file."),
    force: bool = typer.Option(False, "--force", help=OVERWRITE),
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    from emps_design.cli.output import load_axis, print_json, print_warnings
    from emps_design.frequency_response import Limits, design_experiment

    refuse_force(context, out)
    if steps is not None:
        refuse_ignored(context, ["seed"], "goes without --steps: a stepped sine leaves nothing to chance")
    check_out(out, TABLE, (axis,), force)
    limits = Limits(stroke, speed_limit, force_limit, jerk_limit)
    found = design_experiment(
        load_axis(axis), limits, speed, low, high, resolution, passes, slope, at, noise, seed, steps
    )
    if out is not None:
        _write(out, found)
    if as_json:
        print_json(found)
    else:
        _show(found, out)
    print_warnings(found.warnings)


def _write(out: Path, found: Experiment) -> None:
    import numpy as np

    from emps_design.files import write_aside

    with write_aside(out) as aside:
        table = np.column_stack(list(found.columns.values()))
        np.savetxt(aside, table, fmt=["%.12g", *["%.10g"] * (table.shape[1] - 1)], delimiter=",",
                   header=",".join(found.columns), comments="")  # fmt: skip


def _show(found: Experiment, out: Path | None) -> None:
    import numpy as np
    from rich import box
    from rich.table import Table

    from emps_design.cli.output import new_console
    from emps_design.frequency_response.waves import SteppedSine

    console, peaks, unit = new_console(), found.peaks, found.axis.units.unit
    stepped = found.signal == SteppedSine.label
    what = f"steps of at most {found.periods} blocks" if stepped else f"{found.periods} periods"
    console.print(
        f"{found.axis.name}: {found.signal} of {found.frequency.size} lines from {found.frequency[0]:.4g} to "
        f"{found.frequency[-1]:.4g} Hz, added to the {found.at}; {found.passes} passes of {what} of "
        f"{found.samples * found.period:g} s, {found.q_ref.size * found.period:.4g} s in all"
    )
    console.print(
        f"passes at {found.speed:.5g} {unit('m/s')} (asked: {found.requested_speed:.5g}), "
        f"speed {peaks['slowest']:.4g} to {peaks['velocity']:.4g} {unit('m/s')}, command at most "
        f"{peaks['command']:.4g} {unit('V')}, travel {peaks['stroke']:.4g} {unit('m')}; the amplitude is bound by the "
        f"{found.bound_by}"
    )
    table = Table(title=f"expected of {found.noise:g} {unit('N')} rms of white force noise", box=box.SIMPLE)
    for heading in ("frequency [Hz]", "relative std [%]"):
        table.add_column(heading, justify="right")
    wanted = np.geomspace(found.frequency[0], found.frequency[-1], 10)
    for i in sorted({int(np.argmin(np.abs(found.frequency - f))) for f in wanted}):
        table.add_row(f"{found.frequency[i]:.4g}", f"{100 * found.std[i]:.3g}")
    console.print(table)
    if out is not None:
        console.print(f"reference and excitation: {out}", soft_wrap=True)
