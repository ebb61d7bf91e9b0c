"""Velocity-loop gains k_v1 and t_v for a crossover or a bandwidth and a phase margin, and what they achieve."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from emps_design.axis import Axis
from emps_design.cli.destinations import AXIS, check_out
from emps_design.cli.options import (
    AsJson,
    AxisArgument,
    Bandwidth,
    ComplianceRange,
    ComputationDelay,
    Coulomb,
    Crossover,
    CurrentTimeConstant,
    DelayRange,
    EncoderResolution,
    Estimator,
    Filters,
    Force,
    ForceGain,
    InertiaRange,
    Mass,
    Out,
    Period,
    PhaseMargin,
    PositionBandwidth,
    PositionEvery,
    PositionKp,
    PositionOvershoot,
    PositionStiffness,
    ReferenceFilter,
    SensitivityPeakAbove,
    SensitivityPeakBelow,
    StructureOption,
    Velocity,
    Viscous,
    VoltageLimit,
    estimator_from_text,
    filters_from_options,
    load_range_from_options,
    position_loop_from_options,
    refuse_force,
    refuse_ignored,
    structure_from_options,
    with_numbers,
    within,
    write_axis,
)
from emps_design.cli.output import add_advice, load_axis, print_json, say_advice, tell
from emps_design.errors import InputError
from emps_design.files import read_bytes

if TYPE_CHECKING:
    from emps_design.control.position import PositionLoopDesign
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.frequency_response import FrequencyResponse

MAX_BYTES = 10_000_000  # of the JSON of an identification


def command(
    context: typer.Context,
    axis: AxisArgument = "emps2018",
    crossover: Crossover = None,
    bandwidth: Bandwidth = None,
    phase_margin: PhaseMargin = 60.0,
    retune: Annotated[bool, typer.Option("--retune", help="meet the specification in the sampled loop")] = False,
    at: Annotated[str, typer.Option(help="with --retune: plant-input or velocity-error")] = "plant-input",
    structure: StructureOption = None,
    reference_filter: ReferenceFilter = False,
    filters: Filters = None,
    position_overshoot: PositionOvershoot = None,
    position_bandwidth: PositionBandwidth = None,
    position_stiffness: PositionStiffness = None,
    position_kp: PositionKp = None,
    position_every: PositionEvery = None,
    inertia_range: InertiaRange = None,
    compliance_range: ComplianceRange = None,
    delay_range: DelayRange = None,
    mismatch: Annotated[
        float | None, typer.Option(callback=within(""), help="relative error of the parameters, such as 0.02")
    ] = None,
    sigma_from: Annotated[Path | None, typer.Option(help="JSON of 'identify --json': its 95 % intervals")] = None,
    frf: Annotated[
        list[Path] | None,
        typer.Option(help="measured response of 'frf', .csv or .mat; again for others: margins on each, retune on one"),
    ] = None,
    sensitivity_peak_below: SensitivityPeakBelow = None,
    sensitivity_peak_above: SensitivityPeakAbove = None,
    out: Out = None,
    force: Force = False,
    velocity: Velocity = 0.1,
    mass: Mass = None,
    viscous: Viscous = None,
    coulomb: Coulomb = None,
    force_gain: ForceGain = None,
    voltage_limit: VoltageLimit = None,
    current_time_constant: CurrentTimeConstant = None,
    period: Period = None,
    encoder_resolution: EncoderResolution = None,
    computation_delay: ComputationDelay = None,
    velocity_estimator: Estimator = None,
    as_json: AsJson = False,
) -> int:
    from emps_design.control.velocity.comparison import gains_document
    from emps_design.control.velocity.design import design_velocity_loop
    from emps_design.control.velocity.specification import check_specification
    from emps_design.control.verdict import DesignVerdict

    refuse_force(context, out)
    if not retune:
        refuse_ignored(context, ["at"], "goes with --retune")
    if not frf:
        refuse_ignored(context, ["sensitivity_peak_below", "sensitivity_peak_above"], "goes with --frf")
    position = (position_overshoot, position_bandwidth, position_stiffness, position_kp)
    if all(value is None for value in position):
        why = "goes with --position-overshoot, --position-bandwidth, --position-stiffness or --position-kp"
        refuse_ignored(context, ["position_every"], why)
    span = load_range_from_options(inertia_range, compliance_range, delay_range)
    check_out(out, AXIS, (axis, sigma_from, *(frf or ())), force)
    check_specification(crossover, bandwidth, phase_margin)
    loaded = load_axis(axis)
    machine = with_numbers(
        loaded,
        mechanics={"mass": mass, "viscous": viscous, "coulomb": coulomb},
        drive={
            "force_gain": force_gain,
            "voltage_limit" if loaded.drive.command == "voltage" else "command_limit": voltage_limit,
            "current_time_constant": current_time_constant,
        },
        sampling={
            "period": period,
            "encoder_resolution": encoder_resolution,
            "computation_delay": computation_delay,
        },
        controller={"velocity_estimator": estimator_from_text(velocity_estimator)},
    )
    errors = _errors(machine, mismatch, sigma_from)
    specification: dict[str, Any] = {
        "crossover": crossover,
        "bandwidth": bandwidth,
        "phase_margin_deg": phase_margin,
        "velocity": velocity,
        "structure": structure_from_options(context, machine, structure, reference_filter),
        "filters": filters_from_options(filters),
    }
    responses = _responses(frf or [])
    peaks = {"sensitivity_peak_below": sensitivity_peak_below, "sensitivity_peak_above": sensitivity_peak_above}
    limits = {name: limit for name, limit in peaks.items() if limit is not None}
    if retune and responses:
        design = _retuned(responses, machine, at, specification, limits)
    elif retune:
        from emps_design.control.velocity.limits import retune_velocity_loop

        design = retune_velocity_loop(machine, at=at, **specification)
    else:
        design = design_velocity_loop(machine, **specification)
    around = position_loop_from_options(design, *position, position_every) if design.sampled.stable else None
    measured = _Measured(responses, design, around, limits) if responses else None
    verdict = DesignVerdict(design, around, span, errors, measured.loops if measured else ())
    document = gains_document(design, verdict)
    if retune:
        suggested = (machine, phase_margin, design.structure, design.filters, velocity)
        if responses:
            from emps_design.frequency_response.loop import suggest_filter_on_response

            document["suggestion"] = suggest_filter_on_response(responses[0], *suggested)
        else:
            from emps_design.control.velocity.limits import faster_in_words, suggest_filter

            document["suggestion"] = suggestion = suggest_filter(*suggested)
            fastest = suggestion["without"]["crossover"]
            suggestion["these_gains"] = faster_in_words(design.sampled, phase_margin, fastest) or None
    if measured is not None:
        document["measured"] = measured.document
        document["warnings"] += measured.warnings
        if sensitivity_peak_above is not None and not any(margins.antiresonance for margins in measured.velocity):
            document["warnings"].append("--sensitivity-peak-above: the data have no antiresonance; all lies below")
    if verdict.stable and out is not None:
        table = design.controller_table() if around is None else around.controller_table()
        document["out"] = write_axis(out, machine.replace(controller=table))
    document = add_advice(document, axis)
    if as_json:
        print_json(document)
    else:
        from emps_design.cli.tables import print_around, print_gains

        print_gains(document)
        print_around(document)
        if measured is not None:
            from emps_design.cli.tables import print_measured

            print_measured(document["measured"])
            if "whole_loop" in document["measured"]:
                print_measured(document["measured"]["whole_loop"], "whole loop")
    if "reason" in document:
        tell(document["reason"])
    if not as_json:
        say_advice(document)
    return 0 if verdict.stable else 4


class _Measured:
    """Margins of a design on measured plants: of the velocity loop, and of the whole if there is a position loop."""

    def __init__(
        self,
        responses: list[FrequencyResponse],
        design: VelocityLoopDesign,
        around: PositionLoopDesign | None,
        limits: dict[str, float],
    ):
        from emps_design.control.nested_loops import VELOCITY_LOOP, WHOLE
        from emps_design.frequency_response.loop import measured_document, measured_margins, over_limits

        axes = {VELOCITY_LOOP: design.loop_axis}
        if around is not None or design.kept_loops:
            axes[WHOLE] = design.axis_that_runs if around is None else around.axis()
        margins = {name: [measured_margins(response, axis) for response in responses] for name, axis in axes.items()}
        documents = {name: measured_document(of_loop, limits) for name, of_loop in margins.items()}
        whole = {"whole_loop": documents[WHOLE]} if WHOLE in documents else {}
        self.velocity = margins[VELOCITY_LOOP]
        self.loops = [measured.loop(name) for name, of_loop in margins.items() for measured in of_loop]
        self.document = documents[VELOCITY_LOOP] | whole
        self.warnings = [warning for measured in self.velocity for warning in measured.warnings]
        for name, document in documents.items():
            self.warnings += [f"{name} on the measured plant: {words}" for words in over_limits(document, limits)]


def _responses(paths: list[Path]) -> list[FrequencyResponse]:
    """Read the measured responses at ``paths``."""
    if not paths:
        return []
    from emps_design.frequency_response import read_response

    return [read_response(path) for path in paths]


def _retuned(
    responses: list[FrequencyResponse], machine: Axis, at: str, specification: dict[str, Any], limits: dict[str, float]
) -> VelocityLoopDesign:
    """Return the design that meets the specification on the single response in ``responses``."""
    from emps_design.frequency_response.loop import retune_on_response

    if len(responses) > 1:
        raise InputError(f"--frf: found {len(responses)} responses to retune on, expected one")
    if specification["crossover"] is None:
        raise InputError("--retune with --frf: found a bandwidth, expected --crossover: the data have no -3 dB of T_vc")
    return retune_on_response(
        responses[0],
        machine,
        specification["crossover"],
        specification["phase_margin_deg"],
        at,
        specification["velocity"],
        specification["structure"],
        specification["filters"],
        limits,
    )


def _errors(axis: Axis, mismatch: float | None, sigma_from: Path | None) -> dict[str, float] | None:
    """Return the relative errors to study: ``mismatch`` for every parameter, or the intervals of an identification."""
    if mismatch is None and sigma_from is None:
        return None
    from emps_design.control.velocity.load_range import identified_mismatch, relative_mismatch

    if mismatch is not None and sigma_from is not None:
        raise InputError("found both --mismatch and --sigma-from, expected one of them")
    if mismatch is not None:
        return relative_mismatch(mismatch)
    assert sigma_from is not None
    try:
        document = json.loads(read_bytes(sigma_from, MAX_BYTES, "expected the JSON of 'identify --json'"))
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{sigma_from}: not JSON, expected what 'identify --json' prints") from error
    parameters = document.get("parameters") if isinstance(document, dict) else None
    if not isinstance(parameters, dict) or not all(isinstance(entry, dict) for entry in parameters.values()):
        raise InputError(f"{sigma_from}: no 'parameters' table, expected what 'identify --json' prints")
    return identified_mismatch(axis, parameters)
