"""The page of ``diagnose``: one sentence, where, before and after, what lost, what could not be excluded, what to do.

What a diagnosis must offer is written in :class:`emps_design.report.diagnosis_protocol.Diagnosis`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from emps_design.discrepancy.locate import EVERYWHERE
from emps_design.report import diagnosis_figures as figures
from emps_design.report.diagnosis_design import axis_before, design_change
from emps_design.report.diagnosis_experiment import experiment_section
from emps_design.report.diagnosis_protocol import Diagnosis, Trace, View
from emps_design.report.display import NOTHING, angle, interval, probability, quantity, with_std, words
from emps_design.report.footer import inputs_table, versions
from emps_design.report.page import Callout, Facts, Html, Page, Picture, Points, Section, Table, Text, inline

VERDICTS = {
    "named": ("warning", "What is missing from the model has a name"),
    "parameters-only": ("note", "Nothing is missing: only the numbers of the axis file are off"),
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
    summary: list[Any] = [
        Callout(level, typeset(document.get("sentence") or verdict), verdict if "sentence" in document else "")
    ]
    simulated = document.get("simulation", "closed loop")
    summary.append(_gap_facts(document["gap"], simulated))
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
    sections = [
        _findings_section(findings),
        _unexplained_section(document),
        _candidates_section(diagnosis, document.get("candidates", ())),
        _parameters_section(document),
        _gap_section(document),
        _views_section(diagnosis),
        _limits_section(document),
        _remedy_section(document),
        experiment_section(document.get("experiment"), getattr(diagnosis, "experiment", None)),
        _design_section(document.get("design") or _design_rows(diagnosis, document)),
        _method_section(document),
    ]
    names = ", ".join(record["name"] for record in document.get("records", ()))
    return Page(
        "Where simulation and machine disagree",
        names,
        tuple(summary),
        tuple(section for section in sections if section is not None),
    )


def typeset(text: str) -> str:
    """ASCII of the command line as a page sets it.

    >>> typeset("7.4 +- 0.6 N; 1.6 N -> 0.4 N")
    '7.4 ± 0.6 N; 1.6 N → 0.4 N'
    """
    return text.replace("+-", "±").replace("->", "→")


def _sentence(text: str) -> str:
    """``text`` with a capital and a full stop, empty text as it is."""
    return f"{text[0].upper()}{text[1:]}".rstrip(".") + "." if text else ""


def _label(finding: Mapping[str, Any]) -> str:
    return finding.get("label") or words(finding["effect"])


def _where_caption(diagnosis: Diagnosis, findings: Sequence[Mapping[str, Any]]) -> str:
    view = diagnosis.views[0]
    told = (f.get("where", {}).get("text") for f in findings)
    places = "; ".join(dict.fromkeys(text for text in told if text and text != EVERYWHERE))
    said = f" {_sentence(places)}" if places else ""
    models = ", before (model as it was, refitted) and after" if findings else " that the refitted model leaves"
    return f"Residual force over {view.quantity}{models}.{said}"


def _trace_caption(name: str, simulated: str, extended: bool) -> str:
    models = "two models make" if extended else "the refitted model makes"
    left = "the extended model leaves" if extended else "it leaves"
    return (
        f"Record {name}: measured force, and what {models} of it {SIMULATED[simulated]}. Look at the lower picture: "
        f"what {left} should look like noise."
    )


def _gap_facts(gap: Mapping[str, Any], simulated: str) -> Facts:
    part = "holdout" if gap.get("holdout") else "train"
    values = gap[part]
    unit = gap.get("unit", "N")
    word = "held-out record" if part == "holdout" else "training record"
    before, after, floor = values.get("baseline"), values.get("extended"), gap.get("floor")
    errors = [("force error before", before), ("force error after", after)]
    if before == after:  # one model: nothing was added
        errors = [("force error", before)]
    items = [(name, quantity(value, unit, 3), f"{word}, {simulated}") for name, value in errors]
    items.append(("noise floor", quantity(floor, unit, 3), "what repeats of the record differ by"))
    if None not in (before, after, floor) and before > max(floor, after):
        share = f"{100 * (before - after) / (before - floor):.0f} %"
        items.append(("of the gap closed", share, "100 % reaches the floor"))
    return Facts(tuple(items))


def _findings_section(findings: Sequence[Mapping[str, Any]]) -> Section | None:
    if not findings:
        return None
    alike = any(finding.get("equivalents") for finding in findings)
    headers = ["effect", "p-value", "gap without it [N]", "gap with it [N]", "acts in the", "where", "force up to [N]"]
    headers.append("remark")
    blocks: list[Any] = [
        Table(
            [*headers, *(["cannot be told from"] if alike else [])],
            [
                [
                    Html(f"<b>{inline(_label(f))}</b>"),
                    probability(f.get("p_value")),
                    f.get("gap_before"),
                    f.get("gap_after"),
                    f.get("where", {}).get("channel", "plant"),
                    f.get("where", {}).get("text", ""),
                    f.get("where", {}).get("force", {}).get("value"),
                    f.get("note", ""),
                    *([", ".join(words(e) for e in f.get("equivalents") or ()) or "—"] if alike else []),
                ]
                for f in findings
            ],
            "Findings in the order they were accepted; the gap is the rms error of the simulated force, and the force "
            "is what the effect itself contributes.",
        )
    ]
    rows = [
        [
            _label(finding),
            words(name),
            with_std(entry.get("value"), entry.get("std"), entry.get("unit", "")),
            interval(entry.get("value"), entry.get("std"), entry.get("unit", "")),
            "this record" if entry.get("per_record") else "the machine",
        ]
        for finding in findings
        for name, entry in finding.get("parameters", {}).items()
    ]
    if rows:
        blocks.append(
            Table(
                ["effect", "parameter", "value ± std", "95 % interval", "belongs to"],
                rows,
                "Parameters of what was found. A number that belongs to one record (the phase of a ripple, the time of "
                "an event) is fitted anew on every other record.",
            )
        )
    return Section("What is missing", *blocks)


def _unexplained_section(document: Mapping[str, Any]) -> Section | None:
    missing = document.get("unexplained")
    if not missing:
        return None
    return Section(
        "What no effect explains",
        Picture(
            figures.map_figure(missing["map"]),
            f"Mean force the model misses over position and velocity, away from reversals; white where the record does "
            f"not go. {_sentence(missing['text'])} Rows alike: it depends on position; columns alike: on velocity.",
            "The missing force",
        ),
    )


def _candidates_section(diagnosis: Diagnosis, candidates: Sequence[Mapping[str, Any]]) -> Section | None:
    if not candidates:
        return None
    rows = [
        [
            c.get("label") or words(c["effect"]),
            "accepted" if c.get("accepted") else "lost",
            c.get("gap"),
            c.get("statistic"),
            c.get("threshold"),
            c.get("note", ""),
        ]
        for c in candidates
    ]
    return Section(
        "Candidates",
        Picture(
            figures.candidates_figure(candidates, diagnosis.to_dict()["gap"]),
            _candidates_caption(candidates),
            "What was tried",
        ),
        Table(
            ["candidate", "decision", "gap left [N]", "statistic", "to beat", "why"],
            rows,
            "The best candidates, refitted in closed loop on the fitting part; the statistic must exceed the largest "
            "that healthy records give.",
        ),
    )


def _candidates_caption(candidates: Sequence[Mapping[str, Any]]) -> str:
    if all(candidate.get("gap") is None for candidate in candidates):
        return (
            "No candidate explained enough to be fitted. The bars are the statistics of their first guesses; the "
            "dashed line is the largest that healthy records give."
        )
    return (
        "Force error left by each candidate after a refit in closed loop; shorter is better. The dashed line is the "
        "model as it was, the dotted line the noise floor. A candidate near the dashed line explains nothing."
    )


def _parameters_section(document: Mapping[str, Any]) -> Section | None:
    parameters = document.get("parameters") or {}
    if not parameters:
        return None

    def shown(entry: Mapping[str, Any] | None, unit: str) -> str:
        return with_std(entry.get("value"), entry.get("std"), unit) if entry else NOTHING

    return Section(
        "Baseline parameters",
        Table(
            ["parameter", "axis file", "refitted, nothing added", "with what was missing"],
            [
                [
                    words(name),
                    quantity(entry.get("axis"), entry["unit"]),
                    shown(entry.get("baseline"), entry["unit"]),
                    shown(entry.get("extended"), entry["unit"]),
                ]
                for name, entry in parameters.items()
            ],
            "The same four numbers before and after: a missing effect biases what stands in for it.",
        ),
    )


def _gap_section(document: Mapping[str, Any]) -> Section:
    rows = []
    simulated = document.get("simulation", "closed loop")

    def shown(values: Mapping[str, Any], name: str) -> str:
        low, high = values.get(f"{name}_interval") or (None, None)
        value = NOTHING if values.get(name) is None else f"{values[name]:.3g}"
        return value if low is None else f"{value} ({low:.3g} to {high:.3g})"

    for key, word in (("gap", f"{simulated}, unfiltered"), ("gap_inverse_60hz", "inverse model, 60 Hz")):
        gap = document.get(key)
        for part, name in (("train", "training"), ("holdout", "held out")):
            if gap and gap.get(part):
                values = gap[part]
                rows.append([word, name, shown(values, "baseline"), shown(values, "extended"), shown(gap, "floor")])
    return Section(
        "The gap in numbers",
        Table(
            ["force error", "record", "baseline [N rms]", "extended [N rms]", "floor [N rms]"],
            rows,
            "Both models have their baseline parameters refitted to the training record; the held-out part could only "
            "veto. In brackets 95 % intervals, from pieces of each error redrawn.",
        ),
    )


def _views_section(diagnosis: Diagnosis) -> Section | None:
    if len(diagnosis.views) < 2:
        return None
    return Section(
        "The residual from every side",
        Picture(
            figures.views_figure(diagnosis.views),
            "Mean residual force before (orange) and after (blue); the grey band is what a healthy record shows. "
            "What leaves the band after the extension is still unexplained.",
            "Residual over every quantity",
        ),
    )


def _limits_section(document: Mapping[str, Any]) -> Section | None:
    limits = document.get("not_excluded") or ()
    if not limits:
        return None
    rows = [
        [
            entry.get("label") or words(entry["effect"]),
            quantity(entry.get("size"), entry.get("unit", ""), 2),
            entry.get("text", ""),
        ]
        for entry in limits
    ]
    return Section(
        "What could not be excluded",
        Table(
            ["effect", "could be there up to", "remark"],
            rows,
            "The smallest size that this procedure would have noticed on these records; anything below may be there.",
        ),
    )


def _remedy_section(document: Mapping[str, Any]) -> Section | None:
    remedies = [r for r in document.get("remedies", ()) if r]
    blocks: list[Any] = [Points(map(_sentence, remedies))] if remedies else []
    if document.get("model_file"):
        blocks.append(
            Text(
                Html(
                    f"The model with what was missing: <code>{document['model_file']}</code>. Every command runs on it."
                )
            )
        )
    return Section("What to do", *blocks) if blocks else None


def _design_rows(diagnosis: Diagnosis, document: Mapping[str, Any]) -> list[dict[str, Any]]:
    axis, parameters = getattr(diagnosis, "axis", None), document.get("parameters")
    if axis is None or not parameters or not document["findings"]:
        return []
    return design_change(axis_before(axis, parameters), axis)


def _design_section(rows: Sequence[Mapping[str, Any]]) -> Section | None:
    if not rows:
        return None

    def shown(value: Any, unit: str) -> str:
        if isinstance(value, str) or value is None:
            return value or NOTHING
        return angle(value) if unit == "deg" else quantity(value, unit)

    return Section(
        "What the better model changes in the design",
        Table(
            ["quantity", "with the model as it was", "with the better model", "remark"],
            [
                [
                    row["quantity"],
                    shown(row["before"], row.get("unit", "")),
                    shown(row["after"], row.get("unit", "")),
                    row.get("note", ""),
                ]
                for row in rows
            ],
            "The same specification, designed on both models.",
        ),
    )


def _method_section(document: Mapping[str, Any]) -> Section:
    blocks: list[Any] = []
    if document.get("calibration"):
        blocks.append(Text(document["calibration"]))
    if document.get("assumptions"):
        blocks.append(Points(document["assumptions"]))
    if document.get("warnings"):
        blocks.append(Callout("warning", "Warnings", items=tuple(document["warnings"])))
    inputs = dict(document.get("inputs") or {r["name"]: r.get("sha256") for r in document.get("records", ())})
    if inputs:
        blocks.append(inputs_table(inputs))
    blocks.append(Text(versions()))
    return Section("Method, warnings and inputs", *blocks)


__all__ = ["Diagnosis", "Trace", "View", "diagnosis_page", "typeset"]
