"""Run the whole workflow on the embedded machine: simulated record, identification, gains, force loop, report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import ARCHIVE, PAGE, check_out
from emps_design.errors import InputError
from emps_design.files import write_text
from emps_design.request import Request, option
from emps_design.view import Line, Table, View

if TYPE_CHECKING:
    from emps_design.report.assemble import Report

MACHINE = "emps2019"
CROSSOVER, PHASE_MARGIN = 100.0, 60.0  # rad/s, deg


@dataclass(frozen=True)
class DemoRequest(Request):
    """Options of ``demo``: the file of the page, and the seed of the record."""

    out: Path = option(Path("emps-design-demo.html"), "HTML report; the record is written next to it")
    seed: int = option(0, "seed of the noise in the record", limits=(0, None))
    overwrites: ClassVar[bool] = True

    @property
    def record(self) -> Path:
        """The file of the record."""
        return self.out.with_suffix(".npz")

    def check_files(self) -> None:
        """Raise :class:`InputError` if page and record have the same name, or if other content would be lost."""
        check_out(self.out, PAGE, (), self.overwrite, "`out`")
        if self.out == self.record:
            raise InputError(f"`out`: found {self.out.name!r}, expected the name of a page; the record has that name")
        check_out(self.record, ARCHIVE, (), self.overwrite, "`out`")


def answer(request: DemoRequest) -> Reply:
    """The record, the report on it, and the results of each step."""
    from emps_design.machines import machine
    from emps_design.report.assemble import assemble_report, usual_force_loop
    from emps_design.simulation.synthetic import synthetic_record

    request.check_files()
    axis, out, record = machine(MACHINE), request.out, request.record
    k_e1, wall = usual_force_loop(axis)
    request.progress("simulating a record of the machine", 0.0)
    synthetic_record(axis, seed=request.seed).save(record)
    report = assemble_report(
        record=record,
        crossover=CROSSOVER,
        phase_margin_deg=PHASE_MARGIN,
        k_e1=k_e1,
        environment=wall,
        progress=request.progress,
    )
    write_text(out, report.page.html())
    truth = axis.mechanics.parameters
    files = {"record": str(record), "out": str(out)}
    document = {"machine": MACHINE, "seed": request.seed, "truth": truth, **files, **report.to_dict()}
    view = (
        Line(f"1. Simulated record of {MACHINE}: {record}"),
        _identified(report, truth),
        *_loops(report, axis),
        Line(""),
        Line(f"Report with all figures: {out.resolve()}"),
    )
    return Reply(document, view, axis.units, warnings=report.warnings)


def _identified(report: Report, truth: dict[str, float]) -> Table:
    """The identified parameters beside the true ones."""
    rows = []
    for name, estimate in report.identifications[0].parameters.items():
        assert estimate.interval_95 is not None
        low, high = estimate.interval_95
        half, unit = (high - low) / 2, estimate.quantity.unit
        rows.append((name, f"{truth[name]:.4f}", f"{estimate.value:.4f}", f"{half:.4f}", unit))
    return Table(("parameter", "true value", "estimate", "95 % ±", "unit"), rows, "2. Identified from the record")


def _loops(report: Report, axis: Axis) -> View:
    """The gains of the velocity loop and its margins, and the largest gain of the force loop."""
    velocity, force, unit = report.results.velocity.to_dict(), report.results.force, axis.units.unit
    assert force is not None
    plant_input, sampled = velocity["plant_input"], velocity["sampled"]
    margin = f"stable, phase margin {sampled['phase_margin_deg']:.1f} deg" if sampled["stable"] else "unstable"
    largest = force.to_dict()["k_e1_max"]["sampled"]
    most = "unbounded" if largest is None else f"{largest:.4g} {unit('(m/s)/N')}"
    return (
        Line(f"3. Velocity loop for a crossover of {CROSSOVER:g} rad/s and a phase margin of {PHASE_MARGIN:g} deg:"),
        Line(
            f"   k_v1 = {velocity['k_v1']:.2f} {unit('V/(m/s)')}, t_v = {1e3 * velocity['t_v']:.3f} ms; closed-loop "
            f"bandwidth {velocity['bandwidth']:.1f} rad/s"
        ),
        Line(
            f"   at the plant input: phase margin {plant_input['phase_margin_deg']:.1f} deg, delay margin "
            f"{1e3 * plant_input['delay_margin']:.2f} ms"
        ),
        Line(f"   sampled every {1e3 * axis.sampling.period:g} ms: {margin}"),
        Line(
            f"4. Force loop with k_e1 = {force.k_e1:g} {unit('(m/s)/N')}: "
            f"{'stable' if force.worst.margins.stable else 'unstable'}; largest k_e1 for the sampled loop {most}",
            "prose",
        ),
    )
