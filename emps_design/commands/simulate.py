"""Simulate the nonlinear axis: replay of a record, motion along a reference, co-manipulation, or break-away test."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

from emps_design.axis import Axis
from emps_design.commands import Reply
from emps_design.commands.destinations import ARCHIVE, PICTURES, TABLE
from emps_design.errors import InputError
from emps_design.files import write_aside
from emps_design.inputs import read_axis, read_record
from emps_design.request import Request, option
from emps_design.units import LINEAR

# The options that each scenario uses, beside those common to all.
SCENARIOS = {
    "replay": ("record", "out", "plot"),
    "reference": ("reference", "out", "plot"),
    "breakaway": ("rate", "peak", "out", "plot"),
    "comanipulation": ("mismatch", "mass", "damping", "reference_velocity", "as_printed", "plants", "seed"),
    "bench": ("tau_ref", "seed"),
}


@dataclass(frozen=True)
class SimulateRequest(Request):
    """Options of ``simulate``: the axis, a scenario, and the options of that scenario."""

    axis: Axis | None = option(
        None,
        "TOML file or embedded machine; default emps2019, for co-manipulation emps2018",
        argument=True,
        metavar="[AXIS]",
        typed=str | None,
        read=read_axis,
    )
    scenario: str = option("", "default: replay of --record, or along --reference", choices=("", *SCENARIOS))
    record: Path | None = option(None, "record to replay: .mat, .csv or .npz")
    reference: Path | None = option(None, "reference to follow: columns t, q_ref (.csv, .npz)")
    rate: float = option(1.0, "break-away: rate of the force [N/s]", unit="N/s")
    peak: float | None = option(None, "break-away: largest force [N]", unit="N")
    mismatch: float = option(0.02, "co-manipulation: relative error of the model", unit="")
    mass: float | None = option(None, "co-manipulation: apparent mass M_a [kg]", unit="kg")
    damping: float | None = option(None, "co-manipulation: apparent damping B [N/(m/s)]", unit="N/(m/s)")
    reference_velocity: float = option(0.0, "co-manipulation: qd_0 of (25) [m/s]", unit="m/s")
    as_printed: bool = option(False, "co-manipulation: (27), (30) as printed")
    plants: int = option(200, "co-manipulation: random plants within the mismatch", limits=(0, 1_000_000))
    tau_ref: float | None = option(None, "bench: force reference of the cascaded loop [N]", unit="N")
    seed: int = option(0, "seed of the random numbers", limits=(0, None))
    out: Path | None = option(
        None, "write the signals to this file: .npz (lossless) or .csv", writes={".npz": ARCHIVE, ".csv": TABLE}
    )
    plot: Path | None = option(None, "plot the run to this file: .png, .svg or .pdf", writes=PICTURES)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.chosen_scenario:
            raise InputError(f"`scenario`: nothing to do, expected one of {', '.join(SCENARIOS)}")
        for name in dict.fromkeys(chain(*SCENARIOS.values())):
            users = [scenario for scenario, options in SCENARIOS.items() if name in options]
            if self.chosen_scenario not in users:
                self.refuse([name], f"requires `scenario` {' or '.join(users)}, found {self.chosen_scenario}")
        if self.chosen_scenario in ("replay", "reference"):
            name = SCENARIOS[self.chosen_scenario][0]
            if getattr(self, name) is None:
                raise InputError(f"`scenario` {self.chosen_scenario}: found no {name}, expected `{name}` FILE")
        if self.chosen_scenario == "bench":
            self.refuse(["axis"], "the bench has its own machine; leave the axis out")

    @property
    def chosen_scenario(self) -> str:
        """The scenario: by default ``replay`` with a record, ``reference`` with a reference, else ""."""
        if self.scenario:
            return self.scenario
        return "replay" if self.record is not None else "" if self.reference is None else "reference"

    @cached_property
    def machine(self) -> Axis:
        """The axis to simulate: by default emps2018 for co-manipulation, else emps2019."""
        return self.axis or read_axis("emps2018" if self.chosen_scenario == "comanipulation" else "emps2019")


def answer(request: SimulateRequest) -> Reply:
    """Run the scenario; the answer has a reason if the loop is unstable or in a limit cycle."""
    result = _simulated(request)
    if request.out is not None:
        _write(request.out, result)
    if request.plot is not None:
        _draw(request.plot, result)
    document = result.to_dict()
    units = LINEAR if request.chosen_scenario == "bench" else request.machine.units
    return Reply(document, result.view(), units, document.get("reason", ""), tuple(document["warnings"]))


def _simulated(request: SimulateRequest) -> Any:
    """The result of the scenario."""
    if request.chosen_scenario == "bench":
        from emps_design.paper.virtual_bench import numbers, reproduce_section_3

        bench = numbers() if request.tau_ref is None else numbers(tau_ref=request.tau_ref)
        return reproduce_section_3(request.seed, bench, request.progress)
    if request.chosen_scenario == "comanipulation":
        return _comanipulation(request)
    from emps_design.simulation import scenarios
    from emps_design.simulation.synthetic import read_reference

    if request.chosen_scenario == "breakaway":
        return scenarios.breakaway(request.machine, request.rate, request.peak)
    machine = request.machine
    if request.record is not None:
        return scenarios.replay(machine, read_record(request.record, machine))
    assert request.reference is not None
    reference = read_reference(request.reference, machine.sampling.period, machine.units)
    return scenarios.follow(machine, *reference)


def _comanipulation(request: SimulateRequest) -> Any:
    from emps_design.comanipulation.scenario import run_comanipulation
    from emps_design.control.impedance.law import PRINTED

    law: dict[str, Any] = {"current_factor": PRINTED} if request.as_printed else {}
    return run_comanipulation(
        request.machine,
        mismatch=request.mismatch,
        seed=request.seed,
        plants=request.plants,
        mass=request.mass,
        damping=request.damping,
        progress=request.progress,
        reference_velocity=request.reference_velocity,
        **law,
    )


def _write(out: Path, result: Any) -> None:
    if out.suffix == ".npz":
        result.run.save(out)
    else:
        result.run.to_csv(out, mapped=bool(result.axis.record.named))


def _draw(path: Path, result: Any) -> None:
    from emps_design.report.style import draw, labelled

    figure = labelled(result.run.plot()[0].figure, result.axis.units)
    with write_aside(path) as aside:
        draw(figure, aside, path.suffix[1:])
