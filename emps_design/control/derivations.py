"""A derivation is a list of steps: a title, the paper's equation number, the equation, and a sentence."""

from __future__ import annotations

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
            return None if expression is None else {"latex": sympy.latex(expression), "text": str(expression)}

        return {
            "title": self.title,
            "number": self.number,
            "equation": both(self.equation),
            "text": self.text,
            "printed": both(self.printed),
            "difference": both(self.difference),
            "agrees": self.agrees,
        }
