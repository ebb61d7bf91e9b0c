"""Derive every equation of the paper step by step, and show where the printed ones differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from emps_design.commands import Reply
from emps_design.messages import grave
from emps_design.request import Request, option
from emps_design.units import LINEAR
from emps_design.view import Line

MACHINE, MASS, DAMPING = "emps2018", 50.0, 100.0  # the paper's experiment, to evaluate (30) as printed


@dataclass(frozen=True)
class DeriveRequest(Request):
    """Options of ``derive``."""

    latex: bool = option(False, "a LaTeX document of the derivations", printed=True)


def answer(request: DeriveRequest) -> Reply:
    """The derivations with the errata, and the effect of (30) as printed on the paper's axis."""
    from emps_design.paper import errata

    if request.latex:
        return Reply({}, (Line(errata.document(), "code"),), LINEAR)
    from emps_design.laws.law import FrictionModel
    from emps_design.machines import machine
    from emps_design.paper.loops import cost_of_printed

    parts = errata.derivation()
    cost = cost_of_printed(FrictionModel.of(machine(MACHINE)), mass=MASS, damping=DAMPING)
    document: dict[str, Any] = {
        **{
            name: {"title": title, "steps": [step.to_dict() for step in steps]}
            for name, (title, steps) in parts.items()
        },
        "errata": [erratum.to_dict() for erratum in errata.find_errata()],
        "cost_of_printed_30": {"axis": MACHINE, "M_a": MASS, "B": DAMPING, **cost},
        "warnings": [
            grave("claim-is-false", f"{step.place} {step.title}: {claim}: this is false")
            for _, steps in parts.values()
            for step in steps
            for claim, true in step.checks
            if not true
        ],
    }
    costs = [
        Line(
            f"  {name}: apparent mass {felt['apparent_mass']:.1f} kg, damping {felt['apparent_damping']:.1f} N/(m/s), "
            f"remaining Coulomb friction {felt['coulomb_left']:.1f} N",
            "prose",
        )
        for name, felt in cost.items()
    ]
    title = f"Effect of (30) as printed on {MACHINE} with M_a = {MASS:g} kg, B = {DAMPING:g} N/(m/s):"
    view = (*errata.view(), Line(""), Line(title), *costs)
    return Reply(document, view, LINEAR)
