"""Check the force loop around the velocity loop: stability in contact with an operator, margins, largest k_e1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from emps_design.commands import Reply
from emps_design.commands.options import VelocityLoopRequest, write_axis
from emps_design.control.velocity.gains import IP, own_filters, own_gains, own_structure
from emps_design.control.view import force_view
from emps_design.errors import InputError
from emps_design.laws.library import ip_velocity
from emps_design.messages import Message, note
from emps_design.request import Request, option

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign

PAPER = 100.0  # rad/s, crossover of the paper's velocity loop


@dataclass(frozen=True)
class ContactRequest(Request):
    """The force gain and the operator in contact."""

    k_e1: float | None = option(None, "force-loop gain [(m/s)/N]", unit="(m/s)/N")
    hand: float | None = option(None, "viscous hand k_h, tau_e = -k_h qd [N/(m/s)]", unit="N/(m/s)")
    environment: float | None = option(None, "wall K_env, tau_e = -K_env q [N/m]", unit="N/m")
    sensor_only: bool = option(False, "the operator's force does not act on the carriage, as in the paper")
    sensor_delay: int = option(0, "samples between force and its reading", limits=(0, 1000))


@dataclass(frozen=True)
class ForceRequest(VelocityLoopRequest, ContactRequest):
    """Options of ``force``: the contact and the inner velocity loop."""

    @property
    def gain(self) -> float:
        """The force gain [(m/s)/N] of the request, or that of the axis."""
        gain, unit = self.machine.controller.k_e1 if self.k_e1 is None else self.k_e1, self.machine.units.unit
        if gain is None:
            raise InputError(
                f"k_e1: found none, expected `k_e1` in {unit('(m/s)/N')}, or k_e1 in the axis file's [controller]"
            )
        return gain


def answer(request: ForceRequest) -> Reply:
    """Stability of the force loop in contact, its margins, and the largest force gain."""
    from emps_design.control.force import design_force_loop

    k_e1, hand, units = request.gain, request.hand, request.axis.units
    notes = []
    if hand is None and request.environment is None:
        hand = 1.0 / k_e1 if k_e1 > 0.0 else 0.0
        damping = units.quantity(hand, "N/(m/s)", "g")
        text = f"no operator given: assumed a viscous hand with k_c = 1/k_e1 = {damping}"
        notes.append(note("usual-hand", text, hand=hand))
    loop, origin = _velocity_loop(request)
    notes += origin
    design = design_force_loop(
        loop, k_e1, hand or 0.0, request.environment or 0.0, request.sensor_delay, not request.sensor_only
    )
    if request.out is not None and (loop.structure != IP or loop.filters):
        raise InputError(
            f"`out`: found a {loop.structure.label} velocity loop{' with filters' * bool(loop.filters)}, expected IP "
            "without filters: no [controller] has k_e1 around another loop; in the drive, set the velocity reference "
            f"to k_e1 times the {units.word('force')}"
        )
    document: dict[str, Any] = design.to_dict()
    document["warnings"] += notes
    if not design.reason and request.out is not None:
        table = {"kind": ip_velocity.LAW.name, "k_v1": loop.k_v1, "t_v": loop.t_v, "k_e1": k_e1}
        document["out"] = write_axis(request.out, request.machine.replace(controller=table))
    if design.reason:
        document["nearest"], document["reason"] = design.nearest_stable, design.reason
    return Reply(document, force_view(document, units), units, design.reason)


def _velocity_loop(request: ForceRequest) -> tuple[VelocityLoopDesign, list[Message]]:
    """The inner velocity loop: as specified, else of the axis file, else the paper's; a message unless specified."""
    from emps_design.control.velocity.design import VelocityLoopDesign, design_velocity_loop

    machine, structure, crossover = request.machine, request.loop_structure, request.crossover
    origin, own = list[Message](), own_gains(machine)
    if crossover is None and request.bandwidth is None:
        if own is not None:
            why = "requires `crossover` or `bandwidth`; otherwise the velocity loop is that of the axis file"
            request.refuse(["phase_margin_deg", "structure", "reference_filter", "filters"], why)
            structure, filters = own_structure(machine), own_filters(machine)
            loop = VelocityLoopDesign(
                machine, *own, {}, velocity=request.velocity, structure=structure, filters=filters
            )
            text = "velocity loop: gains, structure and filters of the axis file"
            return loop, [note("loop-of-the-axis-file", text)]
        crossover = PAPER
        text = f"velocity loop: designed for the paper's 100 rad/s crossover and {request.phase_margin_deg:g} deg"
        origin.append(note("loop-of-the-paper", text, crossover=PAPER, phase_margin_deg=request.phase_margin_deg))
    loop = design_velocity_loop(
        machine,
        crossover,
        request.bandwidth,
        request.phase_margin_deg,
        request.velocity,
        structure,
        request.loop_filters,
    )
    return loop, origin
