"""The derivations of (6)-(11) and (24)-(30) step by step, and where the printed equations differ from them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from emps_design.cli.design_options import AsJson
from emps_design.cli.output import new_console, print_json, say

if TYPE_CHECKING:
    from emps_design.paper.derivations.step import DerivationStep


def command(
    latex: Annotated[bool, typer.Option("--latex", help="equations as LaTeX")] = False,
    as_json: AsJson = False,
) -> None:
    from emps_design.control.impedance.law import FrictionModel
    from emps_design.machines import machine
    from emps_design.paper.derivations.cascade import derive_cascade
    from emps_design.paper.derivations.impedance import cost_of_printed, impedance_derivation

    parts = {
        "cascade": ("Velocity and force loop, (6) to (11)", list(derive_cascade())),
        "impedance": ("Impedance law, (24) to (30), and section III", impedance_derivation()),
    }
    errata = [step for _, steps in parts.values() for step in steps if step.agrees is False]
    cost = cost_of_printed(FrictionModel.of(machine("emps2018")), mass=50.0, damping=100.0)
    if as_json:
        print_json(_document(parts, errata, cost))
    elif latex:
        _print_latex(parts)
    else:
        _print_text(parts, errata, cost)


def _document(
    parts: dict[str, tuple[str, list[DerivationStep]]], errata: list[DerivationStep], cost: dict[str, Any]
) -> dict[str, Any]:
    return {
        **{
            name: {"title": title, "steps": [step.to_dict() for step in steps]}
            for name, (title, steps) in parts.items()
        },
        "errata": [step.to_dict() for step in errata],
        "cost_of_printed_30": {"axis": "emps2018", "M_a": 50.0, "B": 100.0, **cost},
        "warnings": [],
    }


def _print_latex(parts: dict[str, tuple[str, list[DerivationStep]]]) -> None:
    """A fragment for a LaTeX document: one display a step, printed equations beside derived ones."""
    import sympy

    for title, steps in parts.values():
        say(f"\\section*{{{title}}}")
        for step in steps:
            say(f"\\paragraph{{{step.title}{f' ({step.number})' if step.number else ''}}} {_escaped(step.text)}")
            say(f"\\[ {sympy.latex(step.equation)} \\]")
            if step.agrees is False:
                say(f"printed: \\[ {sympy.latex(step.printed)} \\]")


def _print_text(
    parts: dict[str, tuple[str, list[DerivationStep]]], errata: list[DerivationStep], cost: dict[str, Any]
) -> None:
    import sympy
    from rich.text import Text

    from emps_design.paper.derivations.step import plain_symbols

    console = new_console()
    verdicts: dict[bool | None, str | tuple[str, str]] = {
        None: "",
        True: ("  as printed", "green"),
        False: ("  not as printed", "red"),
    }
    for title, steps in parts.values():
        console.rule(title, align="left")
        for step in steps:
            console.print(
                Text.assemble(
                    ("\n" + step.title, "bold"),
                    f"  ({step.number})" if step.number else "",
                    verdicts[step.agrees],
                )
            )
            console.print(step.text, highlight=False)
            say(sympy.pretty(plain_symbols(step.equation), use_unicode=True, wrap_line=False))
            if step.agrees is False:
                say("printed:")
                say(sympy.pretty(plain_symbols(step.printed), use_unicode=True, wrap_line=False))
    console.rule("Where the printed equations differ", align="left")
    for step in errata:
        console.print(f"({step.number}) {step.title}: {step.text}", highlight=False)
    console.print("\nWhat (30) as printed costs on emps2018 with M_a = 50 kg, B = 100 N/(m/s):")
    for name, felt in cost.items():
        console.print(
            f"  {name}: apparent mass {felt['apparent_mass']:.1f} kg, damping {felt['apparent_damping']:.1f} N/(m/s), "
            f"Coulomb friction left {felt['coulomb_left']:.1f} N",
            highlight=False,
        )


def _escaped(text: str) -> str:
    """Words of a step with LaTeX's own characters made harmless."""
    for character in ("\\", "{", "}"):
        text = text.replace(character, "")
    for character in ("_", "%", "&", "#", "$"):
        text = text.replace(character, f"\\{character}")
    return text.replace("^", "\\^{}")
