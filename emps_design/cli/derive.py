"""Every equation of the paper step by step, and where the printed ones differ."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from emps_design.cli.options import AsJson, refuse_ignored
from emps_design.cli.output import new_console, print_json, say

if TYPE_CHECKING:
    from emps_design.paper.derivations import DerivationStep

MASS, DAMPING = 50.0, 100.0  # of the paper's experiments, for what (30) as printed costs


def command(
    context: typer.Context,
    latex: Annotated[bool, typer.Option("--latex", help="a LaTeX document of the derivations")] = False,
    as_json: AsJson = False,
) -> None:
    from emps_design.laws.friction_model import FrictionModel
    from emps_design.machines import machine
    from emps_design.paper.derivations import derivation
    from emps_design.paper.derivations.impedance import cost_of_printed

    if as_json:
        refuse_ignored(context, ["latex"], "goes without --json; a document is one or the other")
    if latex:
        from emps_design.paper.errata import document

        say(document())
        return
    cost = cost_of_printed(FrictionModel.of(machine("emps2018")), mass=MASS, damping=DAMPING)
    if as_json:
        print_json(_document(derivation(), cost))
    else:
        _print_text(derivation(), cost)


def _document(parts: dict[str, tuple[str, tuple[DerivationStep, ...]]], cost: dict[str, Any]) -> dict[str, Any]:
    from emps_design.paper.errata import find_errata

    return {
        **{
            name: {"title": title, "steps": [step.to_dict() for step in steps]}
            for name, (title, steps) in parts.items()
        },
        "errata": [erratum.to_dict() for erratum in find_errata()],
        "cost_of_printed_30": {"axis": "emps2018", "M_a": MASS, "B": DAMPING, **cost},
        "warnings": [
            f"{step.place} {step.title}: {claim}: found false"
            for _, steps in parts.values()
            for step in steps
            for claim, true in step.checks
            if not true
        ],
    }


def _print_text(parts: dict[str, tuple[str, tuple[DerivationStep, ...]]], cost: dict[str, Any]) -> None:
    from rich.text import Text

    from emps_design.paper.errata import find_errata
    from emps_design.paper.written import text

    console = new_console()
    for title, steps in parts.values():
        console.rule(title, align="left")
        for step in steps:
            colour = "green" if step.agrees else "red"
            number = f"  ({step.number})" if step.number else ""
            console.print(Text.assemble(("\n" + step.title, "bold"), number, (f"  {step.verdict}", colour)))
            console.print(step.text, highlight=False)
            if step.assumes:
                console.print(f"assumes: {'; '.join(step.assumes)}", highlight=False)
            for claim, true in step.checks:
                console.print(f"checked: {claim}{'' if true else ': FOUND FALSE'}", highlight=False)
            say(f"    {text(step.equation)}")
            if step.agrees is False:
                say(f"printed:\n    {text(step.printed)}")
    console.rule("Where the paper differs", align="left")
    for erratum in find_errata():
        console.print(f"{erratum.place} {erratum.title}: {erratum.text}", highlight=False)
    console.print(f"\nWhat (30) as printed costs on emps2018 with M_a = {MASS:g} kg, B = {DAMPING:g} N/(m/s):")
    for name, felt in cost.items():
        console.print(
            f"  {name}: apparent mass {felt['apparent_mass']:.1f} kg, damping {felt['apparent_damping']:.1f} N/(m/s), "
            f"Coulomb friction left {felt['coulomb_left']:.1f} N",
            highlight=False,
        )
