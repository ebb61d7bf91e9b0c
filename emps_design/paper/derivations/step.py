"""Steps of a derivation: an equation, its assumptions, the claims that the program checked, the printed equation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import sympy as sp

from emps_design.paper.written import EQUATIONS, READ_AS, Equation, latex, text

AS_PRINTED, NOT_AS_PRINTED, FAILS = "as printed", "not as printed", "does not hold"


@dataclass(frozen=True)
class DerivationStep:
    """One step of a derivation.

    ``number`` is the equation number of the paper ("" for a step between two of its equations), ``assumes`` what the
    step rests on, and ``checks`` the claims that the program tried, each with whether it holds. Where the paper prints
    the equation, ``printed`` holds it as printed, ``read_as`` its undefined symbols with those that they must
    stand for, and ``difference`` is printed minus derived right-hand side, so read.
    """

    title: str
    number: str
    equation: Equation
    text: str
    assumes: tuple[str, ...] = ()
    checks: tuple[tuple[str, bool], ...] = ()
    printed: Equation | None = None
    read_as: Mapping[sp.Symbol, sp.Symbol] = field(default_factory=dict)
    difference: Any = None

    @property
    def place(self) -> str:
        """Place in the paper: the equation number in brackets, else the title."""
        return f"({self.number})" if self.number else self.title

    @property
    def holds(self) -> bool:
        """Whether every claim of the step was found true."""
        return all(true for _, true in self.checks)

    @property
    def agrees(self) -> bool | None:
        """Whether the printed equation is the derived one, symbol by symbol; None where nothing was compared."""
        return None if self.printed is None else self.difference == 0 and not self.read_as

    @property
    def verdict(self) -> str:
        """The step in a few words, "" where there is nothing to compare."""
        if not self.holds:
            return FAILS
        if self.printed is None:
            return ""
        if self.difference != 0:
            return NOT_AS_PRINTED
        read = " and ".join(f"{text(symbol)} is read as {text(meant)}" for symbol, meant in self.read_as.items())
        return f"{AS_PRINTED} once {read}" if read else AS_PRINTED

    def to_dict(self) -> dict[str, Any]:
        """Words, and equations as LaTeX and as text."""

        def both(written: Any) -> dict[str, str] | None:
            return None if written is None else {"latex": latex(written), "text": text(written)}

        return {
            "place": self.place,
            "title": self.title,
            "number": self.number,
            "equation": both(self.equation),
            "text": self.text,
            "assumes": list(self.assumes),
            "checks": [{"claim": claim, "holds": true} for claim, true in self.checks],
            "holds": self.holds,
            "printed": both(self.printed),
            "read_as": {text(symbol): text(meant) for symbol, meant in self.read_as.items()},
            "difference": both(self.difference),
            "agrees": self.agrees,
            "verdict": self.verdict,
        }


def compared(
    title: str,
    number: str,
    derived: Equation,
    words: str,
    assumes: tuple[str, ...] = (),
    checks: tuple[tuple[str, bool], ...] = (),
    put: Mapping[Any, Any] | None = None,
) -> DerivationStep:
    """Return the step with the printed equation of that number and left-hand side beside it.

    ``put`` are expressions that earlier steps derived for symbols of the printed equation.
    """
    printed = next(equation for equation in EQUATIONS[number] if equation.lhs == derived.lhs)
    there = printed.rhs.free_symbols
    read_as = {symbol: meant for symbol, meant in READ_AS.get(number, {}).items() if symbol in there}
    difference = sp.simplify(sp.expand(printed.rhs.subs(read_as).subs(put or {}) - derived.rhs))
    return DerivationStep(title, number, derived, words, assumes, checks, printed, read_as, sp.factor(difference))
