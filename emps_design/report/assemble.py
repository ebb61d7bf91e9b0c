"""From names of files to the page of ``report``: reads the files, makes the design, and assembles the page."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from emps_design.advice import Advice, advise
from emps_design.axis import Axis
from emps_design.errors import InputError, nearest_name
from emps_design.laws import NONE, get_law
from emps_design.machines import load_axis, machine_names
from emps_design.progress import Progress, no_progress
from emps_design.report.design import DesignResults, design_page, design_results
from emps_design.report.page import Page, Section, quantity

if TYPE_CHECKING:
    from emps_design.comanipulation.assessment import ImpedanceAssessment
    from emps_design.control.nested_loops import NestedLoop
    from emps_design.control.velocity.gains import Structure
    from emps_design.identification.identify import Identification
    from emps_design.laws.library.cascade import Filter
    from emps_design.records import Record

DESIGN_ON = ("record", "axis")
K_E1, WALL, OF_MASS = 0.01, 1e4, 100.0  # (m/s)/N, N/m, kg: defaults of a force loop for an axis of that mass


@dataclass(frozen=True)
class Report:
    """A design with the results that its page shows."""

    results: DesignResults
    impedance: ImpedanceAssessment | None = None
    identifications: tuple[Identification, ...] = ()
    warnings: tuple[str, ...] = ()
    loops: tuple[NestedLoop, ...] = ()

    @cached_property
    def page(self) -> Page:
        """The page, with the advice on the design first."""
        return design_page(replace(self.results, advice=self.advice))

    @property
    def advice(self) -> Advice:
        """The advice on the design."""
        return advise("report", self._document)

    @property
    def reason(self) -> str:
        """Which loops are unstable, and what is stable nearby, in one line; empty if all loops are stable."""
        others = (loop.reason for loop in (self.results.force, self.impedance) if loop is not None)
        return "; ".join(reason for reason in (self.results.verdict.reason, *others) if reason)

    @property
    def nearest(self) -> dict[str, Any]:
        """The nearest stable numbers of each unstable loop, by the name of its section in :meth:`to_dict`."""
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
        from emps_design.control.velocity.comparison import kept_position_loop

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


def assemble_report(
    axis: str | Axis | None = None,
    record: str | Path | Record | None = None,
    crossover: float | None = None,
    bandwidth: float | None = None,
    phase_margin_deg: float = 60.0,
    design_on: str | None = None,
    model: str = "symmetric",
    chain: str | None = None,
    k_e1: float | None = None,
    hand: float | None = None,
    environment: float | None = None,
    mass: float | None = None,
    damping: float | None = None,
    filter: float | None = None,
    mismatch: float = 0.02,
    retune: bool = False,
    frf: str | Path | None = None,
    structure: Structure | None = None,
    filters: tuple[Filter, ...] | None = None,
    record_axis: Axis | None = None,
    progress: Progress | None = None,
) -> Report:
    """Design the loops of ``axis``, or of the axis identified from ``record``, and return the page with the results.

    ``axis``: an :class:`Axis`, a TOML file or an embedded machine; ``record``: a :class:`Record` or its file.
    ``design_on``: "record" takes the mechanics identified from the record (the default if no axis is named), "axis"
    those of the axis. ``record_axis`` is the axis of the record if that is another: the record is identified with its
    drive, and left out if its units differ. ``model`` of friction and filter ``chain`` are those of ``identify``.
    ``crossover`` or ``bandwidth`` [rad/s], ``phase_margin_deg`` [deg]; ``retune`` meets the specification in the
    sampled loop; ``structure`` and ``filters`` default to those of the axis's controller. ``frf`` is the file of a
    measured response, shown beside the model as the first picture.

    The force loop has a section if ``k_e1`` [(m/s)/N], ``hand`` [N/(m/s)] or ``environment`` [N/m] is given, or the
    axis's controller has a k_e1; missing ones are 0.01 (m/s)/N and a wall of 1e4 N/m for a mass of 100 kg, else in
    proportion, and the page says so. The impedance law has one if ``mass`` [kg] and ``damping`` [N/(m/s)] are given,
    or the axis has an impedance controller; ``filter`` [rad/s] is its low-pass, ``mismatch`` the relative error of its
    estimates.

    >>> report = assemble_report("emps2018", crossover=100.0, phase_margin_deg=60.0)
    >>> report.results.velocity.axis.name, round(report.results.velocity.k_v1, 2)
    ('emps2018', 556.77)
    """
    tell = progress or no_progress
    if design_on not in (None, *DESIGN_ON):
        raise InputError(
            f"`design_on`: found {design_on!r}, expected {' or '.join(DESIGN_ON)}{nearest_name(design_on, DESIGN_ON)}"
        )
    if record is None and design_on == "record":
        raise InputError("`design_on`: found 'record' without a record; give one with `record`")
    if (mass is None) != (damping is None):
        raise InputError("impedance law: found one of mass and damping, expected both [kg, N/(m/s)] or neither")
    design_on = design_on or ("record" if axis is None and record is not None else "axis")
    named = axis if axis is not None else ("emps2018" if record is None else "emps2019")
    loaded = named if isinstance(named, Axis) else load_axis(named)
    inputs: dict[str, str | None] = {_input_name(named): _digest(named)}

    from emps_design.control.velocity.design import check_specification, design_velocity_loop

    check_specification(crossover, bandwidth, phase_margin_deg)  # before the record is read
    parts: list[Section] = []
    response = None
    if frf is not None:
        from emps_design.frequency_response import read_response

        response = read_response(frf)
        inputs[Path(frf).name] = hashlib.sha256(Path(frf).read_bytes()).hexdigest()
    notes: list[str] = []
    identifications: tuple[Identification, ...] = ()
    if record is not None and record_axis is not None and record_axis.units != loaded.units:
        notes.append(f"The record was made on {record_axis.name}, an axis with other units: this page leaves it out.")
    elif record is not None:
        tell("reading the record", 0.05)
        other = record_axis if design_on == "axis" else None
        made_on, identifications, section = _from_record(record, other or loaded, model, chain, design_on, inputs, tell)
        loaded = loaded if design_on == "axis" else made_on
        parts.append(section)
        notes.append(_basis(loaded, identifications[0], design_on, made_on.name))
    tell("designing the loops", 0.4)
    around, taken = _force_loop(loaded, k_e1, hand, environment)
    notes += [f"Force loop: {taken}, not asked for."] if taken else []
    law: dict[str, Any] = {"structure": structure, "filters": filters}
    if retune:
        from emps_design.control.velocity.limits import retune_velocity_loop

        velocity = retune_velocity_loop(loaded, crossover, bandwidth, phase_margin_deg, **law)
    else:
        velocity = design_velocity_loop(loaded, crossover, bandwidth, phase_margin_deg, **law)
    measured = None
    if response is not None:
        from emps_design.frequency_response.coupling import ResponseComparison
        from emps_design.report.loop_figures import response_section

        measured = response_section(ResponseComparison(response, loaded))
    assessed = None
    stops: tuple[str, ...] = ()
    cautions: tuple[str, ...] = ()
    controller = loaded.controller
    if mass is None and has_impedance_law(loaded):
        mass, damping = controller.mass, controller.damping
    if mass is not None and damping is not None:
        from emps_design.comanipulation.assessment import assess_impedance
        from emps_design.comanipulation.study import CALM
        from emps_design.report.impedance import impedance_section, refusal

        tell("trying the impedance law", 0.45)
        assessed = assess_impedance(loaded, mass, damping, mismatch, filter)
        parts.append(impedance_section(assessed))
        stops = () if assessed.stable else (refusal(assessed),)
        if assessed.verdict in CALM:
            notes.append(f"Impedance law, {assessed.headline}.")
        elif assessed.stable:
            cautions = (f"impedance law, {assessed.headline}",)
    loops: tuple[NestedLoop, ...] = ()
    if controller.kind != NONE and get_law(controller.kind).loops:
        from emps_design.control.nested_loops import nested_loops
        from emps_design.report.velocity import controller_section

        loops = nested_loops(loaded)
        parts.append(controller_section(loops, velocity.kept_loops))
    results = design_results(
        velocity,
        *around,
        inputs=inputs,
        parts=tuple(parts),
        measured=measured,
        notes=tuple(notes),
        stops=stops,
        cautions=cautions,
    )
    tell("drawing", 0.6)
    warnings = [warning for fit in identifications for warning in fit.warnings]
    warnings += [*results.verdict.warnings, *velocity.warnings]
    warnings += results.force.warnings if results.force else ()
    warnings += assessed.to_dict()["warnings"] if assessed else []
    report = Report(results, assessed, identifications, tuple(dict.fromkeys(warnings)), loops)
    _ = report.page
    tell("writing", 0.95)
    return report


def has_impedance_law(axis: Axis) -> bool:
    """Whether the controller of ``axis`` is an impedance law."""
    return axis.controller.kind != NONE and bool(get_law(axis.controller.kind).apparent)


def usual_force_loop(axis: Axis) -> tuple[float, float]:
    """Return a first force gain [(m/s)/N] and wall [N/m], scaled with the mass of ``axis`` in powers of ten.

    >>> from emps_design.machines import machine
    >>> usual_force_loop(machine("emps2018"))
    (0.01, 10000.0)
    """
    scale = 10.0 ** round(math.log10(axis.mechanics.mass / OF_MASS))
    return K_E1 / scale, WALL * scale


def _force_loop(
    axis: Axis, k_e1: float | None, hand: float | None, environment: float | None
) -> tuple[tuple[float | None, float, float], str]:
    """Return gain, hand and wall of the force loop, and in words which of them was a default; None for no force loop.

    A missing gain is that of the axis, or else the usual one.
    """
    own = axis.controller.k_e1
    if k_e1 is None and hand is None and environment is None and own is None:
        return (None, 0.0, 0.0), ""
    usual, wall = usual_force_loop(axis)
    gain, taken = own if k_e1 is None else k_e1, ""
    if gain is None:
        gain, taken = usual, f"a gain of {quantity(usual, '(m/s)/N')} was taken"
    elif hand is None and environment is None:
        environment, taken = wall, f"a wall of {quantity(wall, 'N/m')} was taken"
    return (gain, hand or 0.0, environment or 0.0), taken


def _from_record(
    record: str | Path | Record, axis: Axis, model: str, chain: str | None, design_on: str,
    inputs: dict[str, str | None], tell: Progress,
) -> tuple[Axis, tuple[Identification, ...], Section]:  # fmt: skip
    """Identify ``axis`` from ``record``; return the axis to design on, the identifications, and their section."""
    from emps_design.identification.chains import DEFAULT_CHAIN
    from emps_design.identification.identify import identify
    from emps_design.importing import import_record
    from emps_design.records import Record
    from emps_design.report.record import record_section

    read = record if isinstance(record, Record) else import_record(record, axis)
    inputs[read.name if isinstance(record, Record) else Path(record).name] = read.sha256
    tell("identifying", 0.15)
    others = [name for name in ("symmetric", "asymmetric") if name != model]
    chain = chain or DEFAULT_CHAIN
    identifications = tuple(identify(read, axis, model=name, filter=chain) for name in (model, *others))
    section = record_section(read, identifications, axis)
    return (identifications[0].to_axis() if design_on == "record" else axis), identifications, section


def _basis(axis: Axis, identification: Identification, design_on: str, made_on: str) -> str:
    if design_on == "record":
        return (
            f"The gains are for the mechanics identified from {identification.record} ({identification.model} model), "
            f"with the drive and the sampling of the axis {axis.name}."
        )
    shown = "compared with it below" if made_on == axis.name else f"identified below, with the drive of {made_on}"
    return f"The gains are for the axis {axis.name} as it is written; {identification.record} is {shown}."


def _input_name(axis: str | Axis) -> str:
    if isinstance(axis, Axis):
        return f"axis {axis.name}"
    return axis if axis in machine_names() else Path(axis).name


def _digest(axis: str | Axis) -> str | None:
    """Return the SHA-256 of an axis file, or of the TOML of an :class:`Axis`; None for an embedded machine."""
    if isinstance(axis, Axis):
        return hashlib.sha256(axis.to_toml().encode()).hexdigest()
    return None if axis in machine_names() else hashlib.sha256(Path(axis).read_bytes()).hexdigest()
