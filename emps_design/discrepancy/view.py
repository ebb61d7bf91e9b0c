"""The view of a diagnosis: the result in one sentence, its findings, and what to do next."""

from __future__ import annotations

from typing import Any

from emps_design.quantities import rounded, share_asked
from emps_design.units import Units
from emps_design.view import Line, Table, View


def diagnosis_view(document: dict[str, Any], units: Units) -> View:
    """The view of the ``document`` of a diagnosis, in ``units``."""
    after = [
        f"{words}: {entry['text']}"
        for words, entry in (
            ("Next experiment", document.get("experiment")),
            ("Closest model", document.get("closest")),
        )
        if entry
    ]
    after += [f"Remedy: {remedy}" for remedy in document.get("remedies", ())]
    return (
        Line(document["verdict"], "strong"),
        *([Line(document["sentence"])] if "sentence" in document else []),
        *([_findings(document["findings"], units)] if document["findings"] else []),
        *(Line(text) for text in after),
    )


def _findings(findings: list[dict[str, Any]], units: Units) -> Table:
    """A row per effect; the last column is the confirmed share, or the p-value if nothing was held out."""
    confirmed = any(finding.get("confirmed") for finding in findings)
    force = units.unit("N")
    headings = ("effect", "or", "where", f"gap [{force}]", f"after [{force}]", "confirmed" if confirmed else "p")
    rows = [
        (
            finding["label"],
            ", ".join(finding.get("equivalents", ())) or None,
            finding["where"]["text"],
            rounded(finding["gap_before"], 3),
            rounded(finding["gap_after"], 3),
            _share(finding.get("confirmed")) if confirmed else f"{finding['p_value']:.3f}",
        )
        for finding in findings
    ]
    return Table(headings, rows, words=("or", "where"))


def _share(confirmed: dict[str, float] | None) -> str | None:
    """The confirmed share of an effect with its standard deviation, as text; None without held-out data."""
    return share_asked(confirmed["share"], confirmed["std"]) if confirmed else None
