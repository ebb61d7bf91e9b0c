"""Errata of the paper: every step of the derivations that is not as printed, and the errors outside equations.

:func:`derivation` derives the paper's equations from its premises and compares them with the printed ones.
``PLACES`` gives the place of each numbered equation in the package; :func:`document` writes the derivations as a
complete LaTeX document, which needs only article and amsmath.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from emps_design.paper.loops import derive_force_loop, derive_impedance, derive_pi_loop, derive_velocity_loop
from emps_design.paper.model import NOT_AS_PRINTED, DerivationStep, derive_least_squares, derive_model
from emps_design.paper.written import latex
from emps_design.view import Line, View

HEAD = r"""\documentclass[10pt]{article}
\usepackage{amsmath,amssymb}
\usepackage[a4paper,margin=22mm]{geometry}
\setlength{\parindent}{0pt}
\allowdisplaybreaks
\begin{document}
"""


@cache
def derivation() -> dict[str, tuple[str, tuple[DerivationStep, ...]]]:
    """Title and steps of each part, by name.

    >>> list(derivation())
    ['model', 'cascade', 'pi', 'identification', 'impedance']
    """
    return {
        "model": ("Drive and carriage, (1) to (5)", derive_model()),
        "cascade": ("Velocity and force loop, (6) to (11)", (*derive_velocity_loop(), *derive_force_loop())),
        "pi": ("The velocity loop of a servo drive, PI", derive_pi_loop()),
        "identification": ("Identification and observation, (12) to (23)", derive_least_squares()),
        "impedance": ("Impedance law, (24) to (30)", derive_impedance()),
    }


@dataclass(frozen=True)
class Erratum:
    """One error of the paper: the ``printed`` and the ``derived`` form (LaTeX, or words), and the reason, ``text``."""

    place: str
    title: str
    printed: str
    derived: str
    text: str
    step: DerivationStep | None = None

    def to_dict(self) -> dict[str, Any]:
        """The derivation step, if any, as plain data, with place, title and text."""
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
    """Return the errata, in the order of the paper.

    >>> [erratum.place for erratum in find_errata()]  # doctest: +NORMALIZE_WHITESPACE
    ['(1)', 'Break-away force of section III-A', '(8)', '(9)', '(10)', '(13)', '(15)', '(16)', '(18)', '(26)', '(27)',
     '(30)', 'Table II']
    """
    errata = [_erratum(step) for _, steps in derivation().values() for step in steps if step.agrees is False]
    return (*errata, *_IN_WORDS)


def _erratum(step: DerivationStep) -> Erratum:
    # Where only a symbol differs, the verdict says so.
    words = step.text if step.difference != 0 else f"{step.verdict[0].upper()}{step.verdict[1:]}."
    return Erratum(step.place, step.title, latex(step.printed), latex(step.equation), words, step)


_GAINS, _FORCE = "emps_design.control.velocity.gains", "emps_design.control.force.design_force_loop"
_LEAST_SQUARES = "emps_design.identification.inverse_model.least_squares"
_DIRECT = "emps_design.identification.observation.direct_validation"
_LAW, _LIBRARY = "emps_design.control.impedance.law.ImpedanceLaw", "emps_design.laws.library.impedance"

PLACES: dict[str, tuple[str, ...]] = {
    "1": ("emps_design.axis.Drive",),
    "2": ("emps_design.simulation.plant.Plant", "emps_design.observer.model_force"),
    "3": ("emps_design.identification.model.column",),
    "4": ("emps_design.effects.library.stribeck_friction",),
    "5": ("emps_design.identification.inverse_model.regression",),
    "6": ("emps_design.control.velocity.design.VelocityLoopDesign.velocity_error_loop",),
    "7": (f"{_GAINS}.velocity_gains",),
    "8": ("emps_design.control.velocity.design.VelocityLoopDesign.closed_loop",),
    "9": (f"{_GAINS}.canonical_form",),
    "10": (_FORCE,),
    "11": (_FORCE,),
    "12": ("emps_design.identification.inverse_model.regression",),
    "13": (_LEAST_SQUARES, "emps_design.identification.statistics"),
    "14": (_LEAST_SQUARES,),
    "15": ("emps_design.identification.inverse_model.LeastSquares",),
    "16": ("emps_design.identification.result.Identification",),
    "17": (_LEAST_SQUARES,),
    "18": ("emps_design.observer.observe_offline",),
    "19": ("emps_design.observer.observe_offline", "emps_design.observer.observe_online"),
    "20": ("emps_design.identification.observation.observe",),
    "21": (_DIRECT,),
    "22": (_DIRECT,),
    "23": (_DIRECT,),
    "24": (_LAW,),
    "25": (_LAW, "emps_design.control.impedance.law.equivalent_impedance"),
    "26": ("emps_design.paper.loops.derived_law",),
    "27": (f"{_LIBRARY}.demanded_force",),
    "28": (f"{_LIBRARY}.demanded_force",),
    "29": (f"{_LIBRARY}.observed_force", "emps_design.observer.ForceObserver"),
    "30": (f"{_LIBRARY}.impedance",),
}


def view() -> View:
    """Lines with every part of the derivation, then the errata."""
    parts = derivation().values()
    steps = [line for title, steps in parts for line in (_heading(title), *(line for s in steps for line in s.view()))]
    errata = [Line(f"{erratum.place} {erratum.title}: {erratum.text}", "prose") for erratum in find_errata()]
    return (*steps, _heading("Where the paper differs"), *errata)


def _heading(title: str) -> Line:
    return Line(f"{title} ".ljust(80, "─"), "strong")


def document() -> str:
    """Every part of the derivation as one document; an equation of the paper keeps its number.

    >>> text = document()
    >>> text.count(r"\\begin{equation*}") == text.count(r"\\end{equation*}") > 40
    True
    """
    lines = [HEAD]
    for title, steps in derivation().values():
        lines.append(rf"\section*{{{title}}}")
        for step in steps:
            lines += _step(step)
    return "\n".join([*lines, r"\end{document}"])


def _step(step: DerivationStep) -> list[str]:
    heading = f"{step.title} ({step.number})" if step.number else step.title
    verdict = f" \\emph{{{escaped(step.verdict)}.}}" if step.verdict else ""
    assumes = f" Assumes: {escaped('; '.join(step.assumes))}." if step.assumes else ""
    lines = [f"\\paragraph{{{escaped(heading)}}} {escaped(step.text)}{assumes}{verdict}"]
    lines += _display(latex(step.equation), step.number)
    if step.verdict.startswith(NOT_AS_PRINTED) or step.read_as:
        lines += ["Printed:", *_display(latex(step.printed), step.number)]
    if step.checks:
        claims = (escaped(claim) + ("" if true else " FAILS") for claim, true in step.checks)
        lines.append(f"Checked: {'; '.join(claims)}.")
    return lines


def _display(equation: str, number: str) -> list[str]:
    tag = rf" \tag{{{number}}}" if number else ""
    return [r"\begin{equation*}", equation + tag, r"\end{equation*}"]


def escaped(words: str) -> str:
    r"""Text with the special characters of LaTeX escaped, in one pass.

    >>> print(escaped("k_v1 > 0, 2 %, W^T"))
    k\_v1 $>$ 0, 2 \%, W\textasciicircum{}T
    """
    harmless = {
        "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
        "<": "$<$", ">": "$>$", **{character: f"\\{character}" for character in "_%&#$"},
    }  # fmt: skip
    return "".join(harmless.get(character, character) for character in words)
