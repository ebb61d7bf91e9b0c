"""Where the paper differs from what follows: every step that is not as printed, and what no equation says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from emps_design.paper.derivations import derivation
from emps_design.paper.derivations.step import DerivationStep
from emps_design.paper.written import latex


@dataclass(frozen=True)
class Erratum:
    """One place of the paper: what is ``printed`` and what is ``derived`` (LaTeX, or words), and why in ``text``."""

    place: str
    title: str
    printed: str
    derived: str
    text: str
    step: DerivationStep | None = None

    def to_dict(self) -> dict[str, Any]:
        """The step as plain data with the place and the words; without its equations where there is no step."""
        words = {"place": self.place, "title": self.title, "text": self.text}
        if self.step is not None:
            return {**self.step.to_dict(), **words}
        return {"number": "", **words, "printed": self.printed, "derived": self.derived}


_IN_WORDS = (
    Erratum(
        "Table II", "Experiment of Table II", "shown in Fig. 6", "shown in Fig. 9",
        "Table II belongs to direct validation, whose force is in Fig. 9; Fig. 6 is of identification.",
    ),
)  # fmt: skip


def find_errata() -> tuple[Erratum, ...]:
    """Return what differs, in the order of the paper.

    >>> [one.place for one in find_errata()]  # doctest: +NORMALIZE_WHITESPACE
    ['(1)', 'Break-away force of section III-A', '(8)', '(9)', '(10)', '(13)', '(15)', '(16)', '(18)', '(26)', '(27)',
     '(30)', 'Table II']
    """
    found = [_of(step) for _, steps in derivation().values() for step in steps if step.agrees is False]
    return (*found, *_IN_WORDS)


def _of(step: DerivationStep) -> Erratum:
    # Where nothing differs but a symbol, that is what there is to say.
    words = step.text if step.difference != 0 else f"{step.verdict[0].upper()}{step.verdict[1:]}."
    return Erratum(step.place, step.title, latex(step.printed), latex(step.equation), words, step)
