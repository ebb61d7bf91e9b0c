"""The page of ``diagnose``: the answer in plain words, then where, before and after, what was tried, what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from emps_design.advice import advise
from emps_design.discrepancy.explain.extent import EVERYWHERE
from emps_design.report import diagnosis_figures as figures
from emps_design.report.advice import advice_callout
from emps_design.report.diagnosis_design import design_section
from emps_design.report.diagnosis_experiment import experiment_section
from emps_design.report.diagnosis_sections import (
    answer_points,
    candidates_section,
    closed_share,
    closest_section,
    findings_section,
    gap_section,
    in_plain_words,
    limits_section,
    method_section,
    parameters_section,
    remedy_section,
    unexplained_section,
    views_section,
)
from emps_design.report.display import quantity
from emps_design.report.frequency_response import response_section
from emps_design.report.page import Callout, Facts, Page, Picture, Text
from emps_design.units import Units

if TYPE_CHECKING:
    from emps_design.discrepancy.result import Diagnosis

VERDICTS = {
    "named": ("warning", "What is missing from the model has a name"),
    "parameters-only": ("note", "Nothing is missing: only the numbers of the axis file are off"),
    "partly-named": ("warning", "Part of what is missing has a name, and something is left that has none"),
    "nothing-missing": ("good", "Nothing is missing from the model"),
    "ambiguous": ("warning", "Something is missing, and these data cannot tell which of several effects it is"),
    "unnamed": ("warning", "Something is missing that no effect of the library explains"),
}


SIMULATED = {
    "closed loop": "in closed loop from the reference alone",
    "inverse model": "as inverse models of the recorded motion",
}


def diagnosis_page(diagnosis: Diagnosis) -> Page:
    """Return the page of a diagnosis."""
    document = diagnosis.to_dict()
    findings = document["findings"]
    level, verdict = VERDICTS[document["verdict"]]
    answer = (Text(typeset(document["sentence"])),) if "sentence" in document else ()
    what_to_do = advice_callout(advise("diagnose", document))
    summary: list[Any] = [
        what_to_do,
        Callout(level, in_plain_words(document), verdict),
        answer_points(document),
        *answer,
    ]
    simulated = document.get("simulation", "closed loop")
    whole = document.get("held_out", {}).get("time") is None
    summary.append(_gap_facts(document["gap"], simulated, document.get("unexplained") or {}, whole))
    if diagnosis.views:
        summary.append(Picture(figures.where_figure(diagnosis), _where_caption(diagnosis, findings), "Where"))
    if diagnosis.trace is not None:
        summary.append(
            Picture(
                figures.before_after_figure(diagnosis),
                _trace_caption(diagnosis.trace.name, simulated, bool(findings)),
                "Before and after",
            )
        )
    response = getattr(diagnosis, "response", None)
    sections = [
        findings_section(findings),
        unexplained_section(document),
        closest_section(document),
        experiment_section(document.get("experiment"), getattr(diagnosis, "experiment", None)),
        remedy_section(document),
        parameters_section(document),
        gap_section(document),
        views_section(diagnosis),
        None if response is None else response_section(response),
        candidates_section(diagnosis, document.get("candidates", ())),
        limits_section(document),
        design_section(diagnosis, document),
        method_section(document),
    ]
    axis = getattr(diagnosis, "axis", None)
    names = ", ".join(record["name"] for record in document.get("records", ()))
    return Page(
        "Where simulation and machine disagree",
        names,
        tuple(summary),
        tuple(section for section in sections if section is not None),
        units=Units() if axis is None else axis.units,
    )


def typeset(text: str) -> str:
    """ASCII of the command line as a page sets it.

    >>> typeset("7.4 +- 0.6 N; 1.6 N -> 0.4 N")
    '7.4 ± 0.6 N; 1.6 N → 0.4 N'
    """
    return text.replace("+-", "±").replace("->", "→")


def _where_caption(diagnosis: Diagnosis, findings: Sequence[Mapping[str, Any]]) -> str:
    view = diagnosis.views[0]
    texts = (f.get("where", {}).get("text") for f in findings)
    places = "; ".join(dict.fromkeys(text for text in texts if text and text != EVERYWHERE))
    where = f" What was found acts {places}." if places else ""
    models = ", before (model as it was, refitted) and after" if findings else " that the refitted model leaves"
    return f"Residual force over {view.quantity}{models}.{where}"


def _trace_caption(name: str, simulated: str, extended: bool) -> str:
    models = "two models make" if extended else "the refitted model makes"
    left = "the extended model leaves" if extended else "it leaves"
    return (
        f"Record {name}: measured force, and what {models} of it {SIMULATED[simulated]}. Look at the lower picture: "
        f"what {left} should look like noise."
    )


def _gap_facts(gap: Mapping[str, Any], simulated: str, unexplained: Mapping[str, Any], whole: bool) -> Facts:
    """The force error before and after, and where the unknown is of one kind with a force of that kind as well.

    ``whole``: a record of its own was held out, if any was, and no part.
    """
    held_out = gap.get("holdout")
    nothing_added = held_out and held_out["baseline"] == held_out["extended"]
    part = "holdout" if held_out and not (nothing_added and unexplained.get("record") == "train") else "train"
    values = gap[part]
    unit = gap.get("unit", "N")
    word = f"{'held-out' if part == 'holdout' else 'training'} {'record' if whole else 'part'}"
    before, after, floor = values.get("baseline"), values.get("extended"), gap.get("floor")
    errors = [("force error before", before), ("force error after", after)]
    if before == after:  # one model: nothing was added
        errors = [("force error", before)]
    items = [(name, quantity(value, unit, 3), f"{word}, {simulated}") for name, value in errors]
    if unexplained.get("kind"):
        left = quantity(unexplained["kind_leaves"], unit, 3)
        items.append(("with the unknown force too", left, f"like {unexplained['kind']}; on any record at most"))
    items.append(("noise floor", quantity(floor, unit, 3), gap.get("floor_from", "")))
    if before is not None and after is not None and floor is not None and before > max(floor, after):
        items.append(
            (
                "of the gap closed",
                closed_share(before, after, floor),
                f"of the {word}, in mean square over the floor; 100 % reaches it",
            )
        )
    return Facts(tuple(items))
