"""Compute velocity-loop gains k_v1 and t_v for a crossover or a bandwidth and a phase margin, with their margins."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from emps_design.commands import Reply
from emps_design.commands.options import (
    RATIO,
    LoadRangeRequest,
    PositionLoopRequest,
    VelocityLoopRequest,
    write_axis,
)
from emps_design.control.view import gains_view
from emps_design.errors import InputError
from emps_design.files import read_json
from emps_design.messages import note
from emps_design.request import option

if TYPE_CHECKING:
    from emps_design.control.position import PositionLoopDesign
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.frequency_response import FrequencyResponse

MAX_BYTES = 10_000_000  # of the JSON of an identification


def read_measured(path: str | Path, axis: Any) -> Any:
    """The measured frequency response at ``path``."""
    from emps_design.frequency_response import read_response

    return read_response(Path(path))


@dataclass(frozen=True)
class GainsRequest(LoadRangeRequest, PositionLoopRequest, VelocityLoopRequest):
    """Options of ``gains``: a specification, and the plants and loops for which the gains must hold."""

    retune: bool = option(False, "meet the specification in the sampled loop")
    at: str = option(
        "plant-input", "with --retune: plant-input or velocity-error", choices=("plant-input", "velocity-error")
    )
    mismatch: float | None = option(None, "relative error of the parameters, such as 0.02", unit="")
    sigma_from: Path | None = option(None, "output of 'identify --json': errors are its 95 % intervals")
    frf: tuple[Any, ...] = option(
        (),
        "measured response of 'frf', .csv or .mat; repeatable: margins on each; --retune takes one",
        typed=list[Path],
        read=read_measured,
    )
    sensitivity_peak_below: float | None = option(
        None, "with --frf: limit of max|S| below the first antiresonance [ratio, or e.g. 6dB]", **RATIO
    )
    sensitivity_peak_above: float | None = option(
        None, "with --frf: limit of max|S| above the first antiresonance [ratio, or e.g. 6dB]", **RATIO
    )
    coulomb: float | None = option(None, "Coulomb friction instead of the axis's [N]")
    voltage_limit: float | None = option(
        None,
        "command limit instead of the axis's [V, or the command's unit]",
        flags=("--voltage-limit", "--command-limit"),
    )
    encoder_resolution: float | None = option(None, "encoder step instead of the axis's [m]")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.retune:
            self.refuse(["at"], "requires `retune`")
        if not self.frf:
            self.refuse(["sensitivity_peak_below", "sensitivity_peak_above"], "requires `frf`")
        self.check_position_loop()

    @property
    def more_numbers(self) -> dict[str, dict[str, Any]]:
        """Coulomb friction, command limit and encoder step, by table of the axis file."""
        limit = "voltage_limit" if self.axis.drive.command == "voltage" else "command_limit"
        return {
            "mechanics": {"coulomb": self.coulomb},
            "drive": {limit: self.voltage_limit},
            "sampling": {"encoder_resolution": self.encoder_resolution},
        }

    @property
    def peaks(self) -> dict[str, float]:
        """Limits of the sensitivity peaks on measured responses, by name."""
        limits = {name: getattr(self, name) for name in ("sensitivity_peak_below", "sensitivity_peak_above")}
        return {name: limit for name, limit in limits.items() if limit is not None}

    @property
    def specification(self) -> dict[str, Any]:
        """The arguments of :func:`.design_velocity_loop` beside the axis."""
        return {
            "crossover": self.crossover,
            "bandwidth": self.bandwidth,
            "phase_margin_deg": self.phase_margin_deg,
            "velocity": self.velocity,
            "structure": self.loop_structure,
            "filters": self.loop_filters,
        }


def answer(request: GainsRequest) -> Reply:
    """The gains, their margins in every loop, and the verdict over all loops and plants of the request."""
    from emps_design.control.verdict import DesignVerdict, gains_document

    errors = _errors(request)
    design = _design(request)
    around = request.position_loop(design) if design.sampled.stable else None
    measured = _Measured(request.frf, design, around, request.peaks) if request.frf else None
    verdict = DesignVerdict(design, around, request.load_range, errors, measured.loops if measured else ())
    document = gains_document(design, verdict)
    if request.retune:
        document["suggestion"] = _suggestion(request, design)
    if measured is not None:
        document["measured"] = measured.document
        document["warnings"] += measured.warnings
        if request.sensitivity_peak_above is not None and not any(m.antiresonance for m in measured.velocity):
            text = "`sensitivity_peak_above` has no effect: the data have no antiresonance"
            document["warnings"].append(note("no-antiresonance", text))
    if verdict.stable and request.out is not None:
        table = design.controller_table() if around is None else around.controller_table()
        document["out"] = write_axis(request.out, request.machine.replace(controller=table))
    units = request.axis.units
    return Reply(document, gains_view(document, units), units, document.get("reason", ""))


def _design(request: GainsRequest) -> VelocityLoopDesign:
    """The design by the closed forms, retuned on the sampled loop, or on a measured response."""
    machine, specification = request.machine, request.specification
    if request.retune and request.frf:
        return _retuned(request)
    if request.retune:
        from emps_design.control.velocity.limits import retune_velocity_loop

        return retune_velocity_loop(machine, at=request.at, **specification)
    from emps_design.control.velocity.design import design_velocity_loop

    return design_velocity_loop(machine, **specification)


def _retuned(request: GainsRequest) -> VelocityLoopDesign:
    """The design that meets the specification on the one measured response."""
    from emps_design.frequency_response.loop import retune_on_response

    if len(request.frf) > 1:
        raise InputError(f"`frf`: found {len(request.frf)} responses to retune on, expected one")
    if request.crossover is None:
        raise InputError("`retune` with `frf`: found a bandwidth, expected `crossover`: the data do not give T_vc")
    specification = request.specification
    return retune_on_response(
        request.frf[0],
        request.machine,
        request.crossover,
        request.phase_margin_deg,
        request.at,
        request.velocity,
        specification["structure"],
        specification["filters"],
        request.peaks,
    )


def _suggestion(request: GainsRequest, design: VelocityLoopDesign) -> dict[str, Any]:
    """The filter that makes the loop fastest, and how far these gains are from the fastest ones."""
    margin = request.phase_margin_deg
    loop = (request.machine, margin, design.structure, design.filters, request.velocity)
    if request.frf:
        from emps_design.frequency_response.loop import suggest_filter_on_response

        return suggest_filter_on_response(request.frf[0], *loop)
    from emps_design.control.velocity.limits import faster_in_words, suggest_filter

    suggestion = suggest_filter(*loop)
    fastest = suggestion["without"]["crossover"]
    return {**suggestion, "these_gains": faster_in_words(design.sampled, margin, fastest) or None}


class _Measured:
    """Margins of a design on measured plants: of the velocity loop, and of the whole loop if a position loop exists."""

    def __init__(
        self,
        responses: tuple[FrequencyResponse, ...],
        design: VelocityLoopDesign,
        around: PositionLoopDesign | None,
        limits: dict[str, float],
    ):
        from emps_design.control.sampled import VELOCITY_LOOP, WHOLE
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
        self.warnings = [message for measured in self.velocity for message in measured.warnings]
        for name, document in documents.items():
            self.warnings += [message.of(f"{name} on the measured plant") for message in over_limits(document, limits)]


def _errors(request: GainsRequest) -> dict[str, float] | None:
    """The relative errors to study, by parameter: ``mismatch`` for all, or the intervals of an identification."""
    mismatch, sigma_from = request.mismatch, request.sigma_from
    if mismatch is None and sigma_from is None:
        return None
    from emps_design.control.velocity.load_range import identified_mismatch, relative_mismatch

    if mismatch is not None and sigma_from is not None:
        raise InputError("found both `mismatch` and `sigma_from`, expected only one of them")
    if mismatch is not None:
        return relative_mismatch(mismatch)
    assert sigma_from is not None
    document = read_json(sigma_from, MAX_BYTES, "expected the output of 'identify --json'")
    parameters = document.get("parameters") if isinstance(document, dict) else None
    if not isinstance(parameters, dict) or not all(isinstance(entry, dict) for entry in parameters.values()):
        raise InputError(f"{sigma_from}: no 'parameters' table, expected the output of 'identify --json'")
    return identified_mismatch(request.machine, parameters)
