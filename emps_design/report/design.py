"""The page of ``report``: the whole design of one axis, its specification and what it achieves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from emps_design.advice import Advice, where_in_words
from emps_design.control.sampled import VELOCITY_LOOP
from emps_design.control.view import warning_lines
from emps_design.report.page import (
    Facts,
    Html,
    Line,
    Page,
    Section,
    advice_line,
    angle,
    frequency,
    inputs_table,
    number,
    quantity,
    sentence_of,
    symbol,
    versions,
)
from emps_design.report.velocity import force_section, gains_section, velocity_section

if TYPE_CHECKING:
    from emps_design.control.force import ForceLoopDesign
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.verdict import DesignVerdict

ASSUMPTIONS = (
    "The axis is rigid unless its file lists an elastic effect; Coulomb friction drops out of the linear "
    "loop because it is constant in motion.",
    "The {force} gain G_tau is known: an error of it scales every mechanical parameter and cannot be seen in a record "
    "without a known payload.",
    "Continuous margins are those of an ideal drive; sampled margins contain the hold, the computation delay, the "
    "current loop, the velocity estimator, the filters of the command and the effects of the axis file.",
    "Margins are read at two places because delay acts at the plant input, while the specification (7) is stated for "
    "the loop broken at the velocity error.",
)


@dataclass(frozen=True)
class DesignResults:
    """The results that the page shows.

    ``force``: the force loop around ``velocity``, or None; ``inputs``: SHA-256 of every input by name, None for
    built-in ones; ``parts``: further sections, such as a record or an impedance law; ``measured``: the section on a
    measured response, which comes first; ``notes``: statements for the summary; ``stops``: further instabilities;
    ``cautions``: further warnings; ``advice``: the advice on the design.
    """

    velocity: VelocityLoopDesign
    force: ForceLoopDesign | None = None
    inputs: Mapping[str, str | None] = field(default_factory=dict)
    parts: tuple[Section, ...] = ()
    measured: Section | None = None
    notes: tuple[str, ...] = ()
    stops: tuple[str, ...] = ()
    cautions: tuple[str, ...] = ()
    advice: Advice | None = None

    @cached_property
    def verdict(self) -> DesignVerdict:
        """The verdict on the velocity loop and on the loops that the axis file keeps around it."""
        from emps_design.control.verdict import DesignVerdict

        return DesignVerdict(self.velocity)


def design_results(
    velocity: VelocityLoopDesign,
    k_e1: float | None = None,
    hand: float = 0.0,
    environment: float = 0.0,
    **more: Any,
) -> DesignResults:
    """Collect the results for the page of ``velocity``, with a force loop if there is a ``k_e1`` [(m/s)/N].

    ``hand`` [N/(m/s)] and ``environment`` [N/m] are those of the force loop; ``more`` are other fields of
    :class:`DesignResults`.
    """
    from emps_design.control.force import design_force_loop

    return DesignResults(
        velocity=velocity,
        force=None if k_e1 is None else design_force_loop(velocity, k_e1, hand=hand, environment=environment),
        **more,
    )


def design_page(results: DesignResults) -> Page:
    """Return the page of a design, its advice first."""
    velocity = results.velocity
    nyquist = math.pi / velocity.axis.sampling.period
    return Page(
        f"Control design of the axis {velocity.axis.name}",
        _specification(velocity),
        _summary(results),
        (
            *([] if results.measured is None else [results.measured]),
            gains_section(velocity, results.verdict),
            velocity_section(velocity),
            *([] if results.force is None else [force_section(results.force)]),
            *results.parts,
            Section("Axis", *velocity.axis.view(), Line(f"Nyquist frequency: {frequency(nyquist)}")),
            _end_section(results),
        ),
        units=velocity.axis.units,
    )


def _specification(velocity: VelocityLoopDesign) -> str:
    requested = dict(velocity.requested)
    phase = requested.pop("phase_margin_deg", None)
    parts = [f"{name} {frequency(value)}" for name, value in requested.items()]
    if phase is not None:
        parts.append(f"phase margin {angle(phase)}")
    retuned = (
        f"; gains retuned so that the sampled loop meets it at the {velocity.retuned_at.replace('-', ' ')}"
        if velocity.retuned_at
        else ""
    )
    return "Specification: " + ", ".join(parts) + retuned


def _stops(results: DesignResults) -> list[Line]:
    """Return the lines on unstable loops, which come before any margin."""
    velocity, force, units = results.velocity, results.force, results.velocity.axis.units
    stops = []
    if not velocity.sampled.stable:
        stops.append(
            f"With these gains the sampled velocity loop is unstable. {sentence_of(velocity.reason)} The margins of "
            "the continuous loop below do not apply to this drive: sample faster, remove delay, or specify less."
        )
    elif not results.verdict.stable:
        stops.append(sentence_of(results.verdict.reason))
    if force is not None and not force.worst.margins.stable:
        gain = quantity(force.k_e1, "(m/s)/N", 4, units)
        loop = units.words(force.worst.name)
        stops.append(f"The {loop} is unstable at k_e1 = {gain}. {sentence_of(force.reason)}")
    return [Line(stop, "bad") for stop in (*stops, *map(sentence_of, results.stops))]


def _summary(results: DesignResults) -> tuple[Any, ...]:
    velocity = results.velocity
    sampled, period, units = velocity.sampled, velocity.axis.sampling.period, velocity.axis.units
    blocks: list[Any] = [] if results.advice is None else [advice_line(results.advice)]
    blocks += _stops(results)
    facts: list[tuple[Any, str, str]] = [
        (Html(symbol("k_v1")), quantity(velocity.k_v1, "V/(m/s)", 4, units), "gain of the velocity loop"),
        (Html(symbol("t_v")), quantity(velocity.t_v, "s"), "its integral time"),
    ]
    worst = results.verdict.worst
    if worst.margins.stable and (worst.name != VELOCITY_LOOP or worst.where):
        where = where_in_words(worst.where, units)
        place = f"phase margin, sampled, at the {worst.broken}{where and ', '}{where}"
        facts.append((f"worst: {units.words(worst.name)}", angle(worst.margins.phase_margin_deg), place))
    if sampled.stable:
        facts += [
            (
                "phase margin on the drive",
                angle(sampled.margins.phase_margin_deg),
                f"plant input, sampled, at {number(sampled.margins.crossover)} rad/s",
            ),
            (
                "delay margin",
                quantity(sampled.margins.delay_margin, "s", 3),
                f"{number(sampled.margins.delay_margin_samples, 3)} samples of {quantity(period, 's', 3)}",
            ),
        ]
    else:
        facts.append(("margins on the drive", "none", "the sampled loop is unstable"))
    blocks.append(Facts(tuple(facts)))
    blocks += [Line(note) for note in results.notes]
    of_loop = [message for message in velocity.warnings if message.code != "unstable"]
    warnings = [*results.cautions, *results.verdict.warnings, *of_loop]
    return (*blocks, *warning_lines(list(dict.fromkeys(warnings))))


def _end_section(results: DesignResults) -> Section:
    force = results.velocity.axis.units.word("force")
    return Section(
        "Assumptions, inputs and versions",
        *(Line(text.format(force=force), "point") for text in ASSUMPTIONS),
        inputs_table(results.inputs) if results.inputs else None,
        Line(versions()),
    )
