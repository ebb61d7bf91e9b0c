"""The derivations as a LaTeX document that compiles by itself: article, amsmath, nothing else."""

from __future__ import annotations

from emps_design.paper.derivations import DerivationStep, derivation
from emps_design.paper.derivations.step import NOT_AS_PRINTED
from emps_design.paper.written import latex

HEAD = r"""\documentclass[10pt]{article}
\usepackage{amsmath,amssymb}
\usepackage[a4paper,margin=22mm]{geometry}
\setlength{\parindent}{0pt}
\allowdisplaybreaks
\begin{document}
"""


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
    r"""Words with LaTeX's own characters made harmless, in one pass.

    >>> print(escaped("k_v1 > 0, 2 %, W^T"))
    k\_v1 $>$ 0, 2 \%, W\textasciicircum{}T
    """
    harmless = {
        "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
        "<": "$<$", ">": "$>$", **{character: f"\\{character}" for character in "_%&#$"},
    }  # fmt: skip
    return "".join(harmless.get(character, character) for character in words)
