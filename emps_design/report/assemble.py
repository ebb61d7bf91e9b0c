"""The command ``report``: reads the files, makes the design, and assembles the page."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from emps_design.advice import Advice, advise
from emps_design.axis import Axis
from emps_design.laws import NONE, get_law
from emps_design.machines import machine_names
from emps_design.messages import Message
from emps_design.report.design import DesignResults, design_page, design_results
from emps_design.report.page import Page, Section, quantity
from emps_design.report.request import MODELS, ReportRequest
from emps_design.request import takes

if TYPE_CHECKING:
    from emps_design.comanipulation.assessment import ImpedanceAssessment
    from emps_design.control.sampled import NestedLoop
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.frequency_response import FrequencyResponse
    from emps_design.identification.identify import Identification

K_E1, WALL, OF_MASS = 0.01, 1e4, 100.0  # (m/s)/N, N/m, kg: defaults of a force loop for an axis of that mass


@dataclass(frozen=True)
class Report:
    """The results of a design, and its page."""

    results: DesignResults
    impedance: ImpedanceAssessment | None = None
    identifications: tuple[Identification, ...] = ()
    warnings: tuple[Message, ...] = ()
    loops: tuple[NestedLoop, ...] = ()

    @cached_property
    def page(self) -> Page:
        """The page, with the advice on the design first."""
        return design_page(replace(self.results, advice=self.advice))

    @property
    def advice(self) -> Advice:
        """The advice on the design."""
        return advise("report", self._document, units=self.results.velocity.axis.units)

    @property
    def reason(self) -> str:
        """The unstable loops and the nearest stable parameters, in one line; empty if all loops are stable."""
        others = (loop.reason for loop in (self.results.force, self.impedance) if loop is not None)
        return "; ".join(reason for reason in (self.results.verdict.reason, *others) if reason)

    @property
    def nearest(self) -> dict[str, Any]:
        """The nearest stable parameters of each unstable loop, by the name of its section in :meth:`to_dict`."""
        verdict, force, impedance = self.results.verdict, self.results.force, self.impedance
        nearest: dict[str, Any] = {}
        if verdict.reason:
            nearest["velocity_loop"] = verdict.nearest
        if force is not None and force.reason:
            nearest["force_loop"] = force.nearest_stable
        if impedance is not None and impedance.reason:
            nearest["impedance"] = impedance.nearest
        return nearest

    def to_dict(self) -> dict[str, Any]:
        """Return the results as plain data, with ``reason`` and ``nearest`` if a loop is unstable."""
        return {**self._document, "advice": self.advice.to_dict()}

    @cached_property
    def _document(self) -> dict[str, Any]:
        from emps_design.control.verdict import kept_position_loop

        velocity = self.results.velocity.to_dict()
        document: dict[str, Any] = {"velocity_loop": velocity, "worst_loop": self.results.verdict.worst.to_dict()}
        if self.results.force is not None:
            document["force_loop"] = self.results.force.to_dict()
        if self.identifications:
            document["identification"] = {fit.model: fit.to_dict() for fit in self.identifications}
        if self.impedance is not None:
            document["impedance"] = self.impedance.to_dict()
        if self.loops:
            document["controller_loops"] = [loop.to_dict() for loop in self.loops]
        document |= kept_position_loop(self.results.velocity)
        if self.reason:
            document["reason"], document["nearest"] = self.reason, self.nearest
        document["inputs"] = dict(self.results.inputs)
        document["warnings"] = list(self.warnings)
        return document


@dataclass(frozen=True)
class _Basis:
    """The axis of the design, and the results of the record."""

    axis: Axis
    identifications: tuple[Identification, ...] = ()
    sections: tuple[Section, ...] = ()
    notes: tuple[str, ...] = ()


@takes(ReportRequest)
def assemble_report(request: ReportRequest) -> Report:
    """Design the loops of an axis, or of the axis identified from a record, and return the page with the results.

    ``axis``: an :class:`Axis`, a TOML file or an embedded machine; ``record``: a :class:`Record` or its file.
    ``design_on``: "record" uses the mechanics identified from the record (the default if no axis is named), "axis"
    those of the axis. ``record_axis`` is the axis of the record if that is another one: the record is identified with
    its drive, and not shown if its units differ. ``model`` of friction and ``record_filter`` are those of ``identify``.
    ``crossover`` or ``bandwidth`` [rad/s], ``phase_margin_deg`` [deg]; ``retune`` meets the specification in the
    sampled loop; ``structure`` and ``filters`` default to those of the controller. ``frf`` is the file of a measured
    response, shown beside the model as the first picture.

    The force loop has a section if ``k_e1`` [(m/s)/N], ``hand`` [N/(m/s)] or ``environment`` [N/m] is given, or the
    axis's controller has a k_e1; missing ones are 0.01 (m/s)/N and a wall of 1e4 N/m for a mass of 100 kg, else in
    proportion, and the page says so. The impedance law has one if ``mass`` [kg] and ``damping`` [N/(m/s)] are given,
    or the axis has an impedance controller; ``filter`` [rad/s] is its low-pass, ``mismatch`` the relative error of its
    estimates.

    >>> report = assemble_report("emps2018", crossover=100.0, phase_margin_deg=60.0)
    >>> report.results.velocity.axis.name, round(report.results.velocity.k_v1, 2)
    ('emps2018', 556.77)
    """
    from emps_design.control.velocity.design import check_specification

    check_specification(request.crossover, request.bandwidth, request.phase_margin_deg)  # before the record is read
    progress, inputs = request.progress, _inputs(request)
    response = _response(request, inputs)
    basis = _basis(request, inputs)
    axis, notes = basis.axis, basis.notes
    progress("designing the loops", 0.4)
    around, default = _force_loop(axis, request)
    notes += (f"{axis.units.word('force').capitalize()} loop: {default}, because none was given.",) if default else ()
    velocity = _velocity_loop(axis, request)
    measured = None
    if response is not None:
        from emps_design.frequency_response.coupling import ResponseComparison
        from emps_design.report.loop_figures import response_section

        measured = response_section(ResponseComparison(response, axis))
    parts, assessed = basis.sections, None
    remarks: dict[str, Any] = {"notes": notes}
    if request.apparent is not None:
        from emps_design.report.impedance import impedance_section

        progress("simulating the impedance law", 0.45)
        assessed = _impedance_law(axis, request)
        parts += (impedance_section(assessed),)
        remarks = _remarks_on(assessed)
        remarks["notes"] = notes + remarks["notes"]
    loops: tuple[NestedLoop, ...] = ()
    if axis.controller.kind != NONE and get_law(axis.controller.kind).loops:
        from emps_design.control.controller import controller_margins
        from emps_design.control.sampled import nested_loops
        from emps_design.report.velocity import controller_section

        loops = nested_loops(axis)
        parts += (controller_section(controller_margins(axis)),)
    results = design_results(velocity, *around, inputs=inputs, parts=parts, measured=measured, **remarks)
    progress("drawing", 0.6)
    warnings = [warning for fit in basis.identifications for warning in fit.warnings]
    warnings += [*results.verdict.warnings, *velocity.warnings]
    warnings += results.force.warnings if results.force else ()
    warnings += assessed.to_dict()["warnings"] if assessed else []
    report = Report(results, assessed, basis.identifications, tuple(dict.fromkeys(warnings)), loops)
    _ = report.page
    progress("writing", 0.95)
    return report


def _inputs(request: ReportRequest) -> dict[str, str | None]:
    """Name and SHA-256 of the axis: of its file, or of the TOML of an :class:`Axis`; None for an embedded machine."""
    named = request.sources.get("axis", request.axis) or request.default_name
    if isinstance(named, Axis):
        return {f"axis {named.name}": hashlib.sha256(named.to_toml().encode()).hexdigest()}
    if named in machine_names():
        return {named: None}
    return {Path(named).name: _digest(named)}


def _digest(path: str | Path) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _response(request: ReportRequest, inputs: dict[str, str | None]) -> FrequencyResponse | None:
    """The measured response, or None; its file is added to ``inputs``."""
    if request.frf is None:
        return None
    from emps_design.frequency_response import read_response

    response = read_response(request.frf)
    inputs[Path(request.frf).name] = _digest(request.frf)
    return response


def _basis(request: ReportRequest, inputs: dict[str, str | None]) -> _Basis:
    """The axis that the design is on, after the record, if any, was identified; the record is added to ``inputs``."""
    axis, made_on = request.machine, request.record_axis
    if request.record is None:
        return _Basis(axis)
    if made_on is not None and made_on.units != axis.units:
        not_shown = f"The record was made on {made_on.name}, an axis with other units, and is not on this page."
        return _Basis(axis, notes=(not_shown,))
    from emps_design.identification.chains import DEFAULT_CHAIN
    from emps_design.identification.identify import identify
    from emps_design.importing import import_record
    from emps_design.records import Record
    from emps_design.report.record import record_section

    request.progress("reading the record", 0.05)
    record_axis = axis if made_on is None or request.base == "record" else made_on
    record, is_read = request.record, isinstance(request.record, Record)
    record = record if is_read else import_record(record, record_axis)
    inputs[record.name if is_read else Path(request.record).name] = record.sha256
    request.progress("identifying", 0.15)
    models = (request.model, *(name for name in MODELS if name != request.model))
    identifications = tuple(
        identify(record, record_axis, model=name, filter=request.record_filter or DEFAULT_CHAIN) for name in models
    )
    section, first = record_section(record, identifications, record_axis), identifications[0]
    if request.base == "record":
        axis = first.to_axis()
        note = (
            f"The gains are for the mechanics identified from {first.record} ({first.model} model), with the drive and "
            f"the sampling of the axis {axis.name}."
        )
        return _Basis(axis, identifications, (section,), (note,))
    shown = f"identified below, with the drive of {record_axis.name}"
    if record_axis.name == axis.name:
        shown = "compared with it below"
    note = f"The gains are for the axis {axis.name} as in its file; {first.record} is {shown}."
    return _Basis(axis, identifications, (section,), (note,))


def _velocity_loop(axis: Axis, request: ReportRequest) -> VelocityLoopDesign:
    """The velocity loop of the specification, met by the closed forms or, with ``retune``, by the sampled loop."""
    from emps_design.control.velocity.design import design_velocity_loop
    from emps_design.control.velocity.limits import retune_velocity_loop

    design = retune_velocity_loop if request.retune else design_velocity_loop
    return design(
        axis,
        request.crossover,
        request.bandwidth,
        request.phase_margin_deg,
        structure=request.structure,
        filters=request.filters,
    )


def _impedance_law(axis: Axis, request: ReportRequest) -> ImpedanceAssessment:
    from emps_design.comanipulation.assessment import assess_impedance

    assert request.apparent is not None
    return assess_impedance(axis, *request.apparent, request.mismatch, request.filter)


def _remarks_on(assessed: ImpedanceAssessment) -> dict[str, Any]:
    """Remarks of the summary on an impedance law: ``notes``, ``cautions``, and ``stops`` for one that must not run."""
    from emps_design.comanipulation.study import CALM
    from emps_design.report.impedance import refusal

    headline = assessed.headline
    remarks = {"notes": (), "cautions": (), "stops": () if assessed.stable else (refusal(assessed),)}
    if assessed.verdict in CALM:
        return {**remarks, "notes": (f"Impedance law, {headline}.",)}
    return {**remarks, "cautions": (f"impedance law, {headline}",) if assessed.stable else ()}


def usual_force_loop(axis: Axis) -> tuple[float, float]:
    """Return a default force gain [(m/s)/N] and wall [N/m], scaled with the mass of ``axis`` in powers of ten.

    >>> from emps_design.machines import machine
    >>> usual_force_loop(machine("emps2018"))
    (0.01, 10000.0)
    """
    scale = 10.0 ** round(math.log10(axis.mechanics.mass / OF_MASS))
    return K_E1 / scale, WALL * scale


def _force_loop(axis: Axis, request: ReportRequest) -> tuple[tuple[float | None, float, float], str]:
    """Return gain, hand and wall of the force loop, and the default among them in words; gain None: no force loop.

    A missing gain is that of the axis, or else the default.
    """
    hand, environment, of_axis = request.hand, request.environment, axis.controller.k_e1
    if request.k_e1 is None and hand is None and environment is None and of_axis is None:
        return (None, 0.0, 0.0), ""
    usual, wall = usual_force_loop(axis)
    gain, default = of_axis if request.k_e1 is None else request.k_e1, ""
    if gain is None:
        gain, default = usual, f"a gain of {quantity(usual, '(m/s)/N', 4, axis.units)} was assumed"
    elif hand is None and environment is None:
        environment, default = wall, f"a wall of {quantity(wall, 'N/m', 4, axis.units)} was assumed"
    return (gain, hand or 0.0, environment or 0.0), default
