"""A derivation is a list of steps: a title, the paper's equation number, the equation, and a sentence."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import sympy


@dataclass(frozen=True)
class DerivationStep:
    """One step of a derivation.

    ``number`` is the equation number of the paper ("" for a step between two of its equations), ``equation`` a SymPy
    ``Eq``. Where the paper prints another equation than the one derived, ``printed`` holds it as printed and
    ``difference`` is printed minus derived right-hand side; both are None where there is nothing to compare.
    """

    title: str
    number: str
    equation: sympy.Eq
    text: str
    printed: sympy.Eq | None = None
    difference: sympy.Expr | None = None

    @property
    def agrees(self) -> bool | None:
        """Whether the printed equation is the derived one; None where nothing was compared."""
        return None if self.difference is None else bool(self.difference == 0)

    def to_dict(self) -> dict[str, Any]:
        """Words, and equations as LaTeX and as text."""
        import sympy

        def both(expression: Any) -> dict[str, str] | None:
            if expression is None:
                return None
            return {"latex": sympy.latex(expression), "text": str(plain_symbols(expression))}

        return {
            "title": self.title,
            "number": self.number,
            "equation": both(self.equation),
            "text": self.text,
            "printed": both(self.printed),
            "difference": both(self.difference),
            "agrees": self.agrees,
        }


def plain_symbols(expression: Any) -> Any:
    r"""Return ``expression`` with LaTeX names of its symbols made readable as text: qd, qdd, M_hat, sign(qd).

    >>> import sympy
    >>> plain_symbols(sympy.Symbol(r"\ddot{q}") * sympy.Symbol(r"\hat{F}_v") * sympy.Symbol(r"\tau_e"))
    Fhat_v*qdd*tau_e
    """
    import sympy

    names = {symbol: _plain(symbol.name) for symbol in expression.atoms(sympy.Symbol)}
    return expression.xreplace({symbol: sympy.Symbol(name) for symbol, name in names.items() if name != symbol.name})


def _plain(name: str) -> str:
    """A LaTeX name in the code's words."""
    for command, suffix in (("ddot", "dd"), ("dot", "d"), ("hat", "hat")):
        name = re.sub(rf"\\{command}{{(.*?)}}", rf"\1{suffix}", name)
    name = re.sub(r"\\operatorname{(.*?)}", r"\1", name)
    return re.sub(r"[\\{}]", "", name).replace(" ", "_")
