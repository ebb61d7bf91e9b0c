"""The section for the person at the drive: the code to paste, the room below the limit, what a wrong model does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from emps_design.report.display import NOTHING, angle, delay, frequency, quantity, ratio, symbol
from emps_design.report.page import Html, Listing, Section, Table, Text

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign

MISMATCH = 0.02  # the error of Section IV-B of the paper


def drive_section(velocity: VelocityLoopDesign, mismatch: float = MISMATCH) -> Section:
    """Return the section on the implementation of ``velocity``; ``mismatch`` is the relative error studied."""
    from emps_design.control.velocity.implementation import (
        difference_equation,
        encoder_voltage_noise,
        largest_velocity_step,
    )
    from emps_design.control.velocity.sensitivity import margins_under_mismatch, relative_mismatch

    axis = velocity.axis
    equation = difference_equation(axis, velocity.k_v1, velocity.t_v, velocity.structure, velocity.filters)
    blocks: list[Any] = [
        Listing("\n".join(equation.lines), "The law with its numbers, once a sample: q [m], v_ref [m/s], u [V].")
    ]
    if velocity.sampled.stable:
        step = largest_velocity_step(axis, velocity.sampled)
        noise = encoder_voltage_noise(axis, velocity.sampled)
        blocks.append(
            Table(
                ["quantity", "value", "meaning"],
                [
                    [
                        "largest velocity step",
                        quantity(step["value"], "m/s"),
                        f"from rest, below the voltage limit of {quantity(step['voltage_limit'], 'V', 3)}; "
                        f"{quantity(step['dry_friction_voltage'], 'V', 3)} of it go into dry friction",
                    ],
                    ["voltage noise of the encoder", quantity(noise["rms"], "V", 3), "rms in closed loop, in motion"],
                    ["one step of the encoder", quantity(noise["one_step"], "V", 3), "jump of the voltage"],
                ],
                "Room below the voltage limit, and the price of the encoder's resolution.",
            )
        )
    blocks.append(_mismatch_table(margins_under_mismatch(velocity, relative_mismatch(mismatch)), mismatch))
    return Section("On the drive", *blocks)


def _mismatch_table(study: dict[str, Any], mismatch: float) -> Table | Text:
    percent = f"{100 * mismatch:g} %"
    if not study["stable_share"]:
        return Text(f"With mass, viscous friction and force gain off by ±{percent} every corner is unstable.")

    def interval(key: str, shown: Any) -> list[str]:
        low, high = study[key] or (None, None)
        return [NOTHING if low is None else shown(low), NOTHING if high is None else shown(high)]

    rows: list[list[Any]] = [
        ["phase margin, plant input, sampled", *interval("phase_margin_deg", angle)],
        ["crossover", *interval("crossover", frequency)],
        ["delay margin", *interval("delay_margin", delay)],
        ["gain margin", *interval("gain_margin", ratio)],
        ["closed loop −3 dB", *interval("bandwidth", frequency)],
    ]
    if study["gains"]:
        rows += [
            [Html(symbol("k_v1") + " for the same request"), *(quantity(x, "V/(m/s)") for x in study["gains"]["k_v1"])],
            [Html(symbol("t_v") + " for the same request"), *(quantity(x, "s") for x in study["gains"]["t_v"])],
        ]
    stable = "all" if study["stable_share"] == 1.0 else f"{100 * study['stable_share']:.3g} %"
    return Table(
        ["", "lowest", "highest"],
        rows,
        f"The same gains on {study['corners']} plants with mass, viscous friction and force gain off by "
        f"±{percent}; {stable} of them stable.",
    )
