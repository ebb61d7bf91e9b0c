"""The force loop around the velocity loop: stability in contact with an operator, margins, largest k_e1."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from emps_design.cli.options import (
    AsJson,
    AxisArgument,
    Bandwidth,
    ComputationDelay,
    Crossover,
    CurrentTimeConstant,
    Estimator,
    Filters,
    Force,
    ForceGain,
    Mass,
    Out,
    Period,
    PhaseMargin,
    ReferenceFilter,
    StructureOption,
    Velocity,
    Viscous,
    estimator_from_text,
    filters_from_options,
    refuse_force,
    refuse_ignored,
    structure_from_options,
    with_numbers,
    within,
    write_axis,
)
from emps_design.cli.output import add_advice, load_axis, print_json, say_advice, tell
from emps_design.commands.destinations import AXIS, check_out
from emps_design.errors import InputError


def command(
    context: typer.Context,
    axis: AxisArgument = "emps2018",
    k_e1: Annotated[
        float | None, typer.Option("--k-e1", callback=within("(m/s)/N"), help="force-loop gain [(m/s)/N]")
    ] = None,
    hand: Annotated[
        float | None, typer.Option(callback=within("N/(m/s)"), help="viscous hand k_h, tau_e = -k_h qd [N/(m/s)]")
    ] = None,
    environment: Annotated[
        float | None, typer.Option(callback=within("N/m"), help="wall K_env, tau_e = -K_env q [N/m]")
    ] = None,
    sensor_only: Annotated[
        bool, typer.Option("--sensor-only", help="the operator's force does not act on the carriage, as in the paper")
    ] = False,
    sensor_delay: Annotated[int, typer.Option(min=0, max=1000, help="samples between force and its reading")] = 0,
    crossover: Crossover = None,
    bandwidth: Bandwidth = None,
    phase_margin: PhaseMargin = 60.0,
    structure: StructureOption = None,
    reference_filter: ReferenceFilter = False,
    filters: Filters = None,
    out: Out = None,
    force: Force = False,
    velocity: Velocity = 0.1,
    mass: Mass = None,
    viscous: Viscous = None,
    force_gain: ForceGain = None,
    current_time_constant: CurrentTimeConstant = None,
    period: Period = None,
    computation_delay: ComputationDelay = None,
    velocity_estimator: Estimator = None,
    as_json: AsJson = False,
) -> int:
    from emps_design.control.force import design_force_loop
    from emps_design.control.velocity.design import VelocityLoopDesign, design_velocity_loop
    from emps_design.control.velocity.gains import IP, own_filters, own_gains, own_structure
    from emps_design.laws.library import ip_velocity

    refuse_force(context, out)
    check_out(out, AXIS, (axis,), force)
    machine = with_numbers(
        load_axis(axis),
        mechanics={"mass": mass, "viscous": viscous},
        drive={"force_gain": force_gain, "current_time_constant": current_time_constant},
        sampling={"period": period, "computation_delay": computation_delay},
        controller={"velocity_estimator": estimator_from_text(velocity_estimator)},
    )
    notes: list[str] = []
    controller = machine.controller
    if k_e1 is None:
        k_e1 = controller.k_e1
    if k_e1 is None:
        raise InputError("k_e1: found none, expected --k-e1 in (m/s)/N, or k_e1 in the axis file's [controller]")
    if hand is None and environment is None:
        hand = 1.0 / k_e1 if k_e1 > 0.0 else 0.0
        notes.append(f"no operator given: taken as a viscous hand of k_c = 1/k_e1 = {hand:g} N/(m/s)")

    wanted_structure = structure_from_options(context, machine, structure, reference_filter)
    own = own_gains(machine)
    if crossover is None and bandwidth is None and own is not None:
        why = "goes with --crossover or --bandwidth; without them the velocity loop is that of the axis file"
        refuse_ignored(context, ["phase_margin", "structure", "reference_filter", "filters"], why)
        loop = VelocityLoopDesign(
            machine, *own, {}, velocity=velocity, structure=own_structure(machine), filters=own_filters(machine)
        )
        notes.append("velocity loop: gains, structure and filters of the axis file")
    else:
        if crossover is None and bandwidth is None:
            crossover = 100.0
            notes.append(f"velocity loop: designed for the paper's 100 rad/s crossover and {phase_margin:g} deg")
        loop = design_velocity_loop(
            machine, crossover, bandwidth, phase_margin, velocity, wanted_structure, filters_from_options(filters)
        )
    design = design_force_loop(loop, k_e1, hand or 0.0, environment or 0.0, sensor_delay, not sensor_only)

    if out is not None and (loop.structure != IP or loop.filters):
        raise InputError(
            f"--out: found a {loop.structure.label} velocity loop{' with filters' * bool(loop.filters)}, expected IP "
            "alone: no [controller] has k_e1 around another; make the drive's velocity reference k_e1 times the force"
        )
    document: dict[str, Any] = design.to_dict()
    document["warnings"] += notes
    stable = design.worst.margins.stable
    if stable and out is not None:
        gains = {"k_v1": loop.k_v1, "t_v": loop.t_v, "k_e1": k_e1}
        document["out"] = write_axis(out, machine.replace(controller={"kind": ip_velocity.LAW.name, **gains}))
    if not stable:
        document["nearest"], document["reason"] = design.nearest_stable, design.reason
    document = add_advice(document, axis)
    if as_json:
        print_json(document)
    else:
        from emps_design.cli.tables import print_force

        print_force(document)
    if not stable:
        tell(document["reason"])
    if not as_json:
        say_advice(document)
    return 0 if stable else 4
