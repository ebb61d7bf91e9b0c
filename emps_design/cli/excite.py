"""The experiment that measures a frequency response on a running carriage, within its limits: multi-sine or stepped."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from emps_design.cli.options import HERTZ, refuse_force, refuse_ignored
from emps_design.commands.destinations import OVERWRITE, TABLE, check_out

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
    experiment = design_experiment(
        load_axis(axis), limits, speed, low, high, resolution, passes, slope, at, noise, seed, steps
    )
    if out is not None:
        _write(out, experiment)
    if as_json:
        print_json(experiment)
    else:
        _show(experiment, out)
    print_warnings(experiment.warnings)


def _write(out: Path, experiment: Experiment) -> None:
    import numpy as np

    from emps_design.files import write_aside

    with write_aside(out) as aside:
        table = np.column_stack(list(experiment.columns.values()))
        np.savetxt(aside, table, fmt=["%.12g", *["%.10g"] * (table.shape[1] - 1)], delimiter=",",
                   header=",".join(experiment.columns), comments="")  # fmt: skip


def _show(experiment: Experiment, out: Path | None) -> None:
    import numpy as np
    from rich import box
    from rich.table import Table

    from emps_design.cli.output import new_console
    from emps_design.frequency_response.waves import SteppedSine

    console, peaks, unit = new_console(), experiment.peaks, experiment.axis.units.unit
    stepped = experiment.signal == SteppedSine.label
    what = f"steps of at most {experiment.periods} blocks" if stepped else f"{experiment.periods} periods"
    lines = experiment.frequency
    console.print(
        f"{experiment.axis.name}: {experiment.signal} of {lines.size} lines from {lines[0]:.4g} to "
        f"{lines[-1]:.4g} Hz, added to the {experiment.at}; {experiment.passes} passes of {what} of "
        f"{experiment.samples * experiment.period:g} s, {experiment.q_ref.size * experiment.period:.4g} s in all"
    )
    console.print(
        f"passes at {experiment.speed:.5g} {unit('m/s')} (asked: {experiment.requested_speed:.5g}), "
        f"speed {peaks['slowest']:.4g} to {peaks['velocity']:.4g} {unit('m/s')}, command at most "
        f"{peaks['command']:.4g} {unit('V')}, travel {peaks['stroke']:.4g} {unit('m')}; the amplitude is bound by the "
        f"{experiment.bound_by}"
    )
    table = Table(title=f"expected of {experiment.noise:g} {unit('N')} rms of white force noise", box=box.SIMPLE)
    for heading in ("frequency [Hz]", "relative std [%]"):
        table.add_column(heading, justify="right")
    wanted = np.geomspace(lines[0], lines[-1], 10)
    for i in sorted({int(np.argmin(np.abs(lines - f))) for f in wanted}):
        table.add_row(f"{lines[i]:.4g}", f"{100 * experiment.std[i]:.3g}")
    console.print(table)
    if out is not None:
        console.print(f"reference and excitation: {out}", soft_wrap=True)
