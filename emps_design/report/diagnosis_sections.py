"""The sections of the page of ``diagnose``, one function each; None where there is nothing to show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from emps_design.discrepancy.search.acceptance import explained
from emps_design.quantities import inside, share_asked
from emps_design.report import diagnosis_figures as figures
from emps_design.report.display import NOTHING, interval, probability, quantity, sentence_of, with_std, words
from emps_design.report.footer import inputs_table, versions
from emps_design.report.page import Callout, Picture, Points, Section, Table, Text, html

if TYPE_CHECKING:
    from emps_design.discrepancy.result import Diagnosis

IN_LOOP = "after a refit in closed loop"


def _label(finding: Mapping[str, Any]) -> str:
    return finding.get("label") or words(finding["effect"])


def in_plain_words(document: Mapping[str, Any]) -> str:
    """The answer for a reader who does not know control loops: what was found, and how much it explains."""
    findings, left = document["findings"], document.get("unexplained")
    gap = document["gap"].get("holdout") or document["gap"]["train"]
    before, after, floor = gap.get("baseline"), gap.get("extended"), document["gap"].get("floor")
    if document["verdict"] in ("nothing-missing", "parameters-only"):
        return "The machine does what its model says, but for noise; nothing has to be added to the model."
    if not findings:
        return (
            "The machine does not do what its model says, and none of the causes that were tried explains it. "
            "More measuring is needed before anything is changed."
        )
    names = [inside(_label(finding)) for finding in findings]
    listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    whom = "it" if len(names) == 1 else "them"
    closed = ""
    if None not in (before, after, floor) and before > max(floor, after):
        share = closed_share(before, after, floor)  # by its numbers fitted anew too, not by a cause alone
        closed = f" With {whom} the corrected model explains {share} of the difference."
    cause = "one cause has" if len(names) == 1 else f"{len(names)} causes have"
    rest = " Something is left that nothing known explains; it needs another measurement." if left else ""
    other = "A second record" if document.get("held_out", {}).get("time") is None else "A part of the record"
    sure = f" {other} that played no part in finding {whom} agrees." if _agrees(findings) else ""
    return f"The machine does not quite do what its model says, and {cause} been found: {listed}.{closed}{sure}{rest}"


def _agrees(findings: Sequence[Mapping[str, Any]]) -> bool:
    return all(finding.get("confirmed") for finding in findings)


def how_sure(finding: Mapping[str, Any]) -> str:
    """What the held-out data say of a finding."""
    confirmed = finding.get("confirmed")
    if not confirmed:
        return "not seen on held-out data"
    return f"the held-out data ask for {_share(confirmed)} of it"


def closed_share(before: float, after: float, floor: float) -> str:
    """How much of a gap is closed, in words; a model that leaves less than the noise closes all of it.

    >>> closed_share(2.0, 0.9, 1.0), closed_share(2.0, 1.5, 1.0)
    ('100 %', '58 %')
    """
    return f"{100 * min(explained(before, after, floor), 1.0):.0f} %"


def _share(confirmed: Mapping[str, float] | None) -> str:
    return share_asked(confirmed["share"], confirmed["std"]).replace("+-", "±") if confirmed else NOTHING


def answer_points(document: Mapping[str, Any]) -> Points:
    """What was found and how sure, what is left, and what to record next, one line each."""
    lines = [
        f"Found: {inside(_label(f))}, up to {quantity(f['where']['force']['value'], 'N', 3)}; {how_sure(f)}."
        for f in document["findings"]
        if f.get("where", {}).get("force")
    ]
    if document.get("unexplained"):
        lines.append(f"Left: {document['unexplained']['text']}.")
    if document.get("experiment"):
        lines.append(f"Record next: {document['experiment']['text']}.")
    return Points(lines or ["Nothing has to be recorded."])


def findings_section(findings: Sequence[Mapping[str, Any]]) -> Section | None:
    """The effects found, with what each is good for, and their numbers."""
    if not findings:
        return None
    alike = any(finding.get("equivalents") for finding in findings)
    notes = [finding.get("note", "") for finding in findings]
    shared = len(set(notes)) == 1
    headers = [
        "effect",
        "p-value",
        "confirmed: share asked for",
        "gap without it [N]",
        "gap with it [N]",
        "acts in the",
        "where",
        "force up to [N]",
        *([] if shared else ["remark"]),
        *(["cannot be told from"] if alike else []),
    ]
    remark = f" {sentence_of(notes[0])}" if shared and notes[0] else ""
    blocks: list[Any] = [
        Table(
            headers,
            [
                [
                    html("<b>{}</b>", _label(f)),
                    probability(f.get("p_value")),
                    _share(f.get("confirmed")),
                    f.get("gap_before"),
                    f.get("gap_after"),
                    f.get("where", {}).get("channel", "plant"),
                    f.get("where", {}).get("text", ""),
                    f.get("where", {}).get("force", {}).get("value"),
                    *([] if shared else [note]),
                    *([", ".join(words(e) for e in f.get("equivalents") or ()) or "—"] if alike else []),
                ]
                for f, note in zip(findings, notes, strict=True)
            ],
            "Findings in the order they were accepted; the gap is the rms error of the simulated force, and the force "
            f"is what the effect itself contributes.{remark}",
        )
    ]
    rows = [
        [
            _label(finding),
            words(name),
            with_std(entry.get("value"), entry.get("std"), entry.get("unit", "")),
            interval(entry.get("value"), entry.get("std"), entry.get("unit", "")),
            finding.get("where", {}).get("record", "this record") if entry.get("per_record") else "the machine",
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


def unexplained_section(document: Mapping[str, Any]) -> Section | None:
    """The force that no effect explains, over position and velocity."""
    missing = document.get("unexplained")
    if not missing:
        return None
    return Section(
        "What no effect explains",
        Picture(
            figures.map_figure(missing["map"]),
            f"Mean force the model misses over position and velocity, away from reversals; white where the record does "
            f"not go. {sentence_of(missing['text'])} Rows alike: it depends on position; columns alike: on velocity.",
            "The missing force",
        ),
    )


def closest_section(document: Mapping[str, Any]) -> Section | None:
    """What the model that follows most closely leaves, beside the one that is named."""
    closest = document.get("closest")
    if not closest:
        return None
    blocks: list[Any] = [Text(sentence_of(closest["text"]))]
    if "gap" in closest:
        rows = [
            [word, record, document[key][part]["extended"], closest[key][part]["extended"], document[key].get("floor")]
            for key, word in (("gap", document["simulation"]), ("gap_inverse_60hz", "inverse model, 60 Hz"))
            for part, record in (("train", "training"), ("holdout", "held out"))
            if part in closest[key]
        ]
        caption = "The model for a simulation or a feed-forward that is to come close; for a cause, the one above."
        headers = ["force error", "record", "named model [N rms]", "closest model [N rms]", "floor [N rms]"]
        blocks.append(Table(headers, rows, caption))
    if closest.get("model_file"):
        blocks.append(Text(html("Its axis file: <code>{}</code>.", closest["model_file"])))
    return Section("The closest model", *blocks)


def candidates_section(diagnosis: Diagnosis, candidates: Sequence[Mapping[str, Any]]) -> Section | None:
    """What was tried, and what each would have left."""
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
    document = diagnosis.to_dict()
    refitted = "refitted in closed loop on the fitting part; the statistic must exceed what is to beat: the largest "
    refitted += "that healthy records give, or the share of the cost that a finding must be worth"
    if "band_hz" in document:
        refitted = (
            "on strokes that took no part in the fit; the statistic is how many times larger the error is without"
        )
    return Section(
        "Candidates",
        Picture(
            figures.candidates_figure(candidates, document["gap"]),
            _candidates_caption(candidates, "predicting what was held out" if "band_hz" in document else IN_LOOP),
            "What was tried",
        ),
        Table(
            ["candidate", "decision", "gap left [N]", "statistic", "to beat", "why"],
            rows,
            f"The best candidates, {refitted}.",
        ),
    )


def _candidates_caption(candidates: Sequence[Mapping[str, Any]], how: str) -> str:
    if all(candidate.get("gap") is None for candidate in candidates):
        return (
            "No candidate explained enough to be fitted. The bars are the statistics of their first guesses; the "
            "dashed line is what they had to beat."
        )
    return (
        f"Force error left by each candidate {how}; shorter is better. The dashed line is the "
        "model as it was, the dotted line the noise floor. A candidate near the dashed line explains nothing."
    )


def parameters_section(document: Mapping[str, Any]) -> Section | None:
    """The baseline's numbers before and after."""
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


def gap_section(document: Mapping[str, Any]) -> Section:
    """The force error of both models on every record, with intervals."""
    rows = []
    simulated = document.get("simulation", "closed loop")

    def shown(values: Mapping[str, Any], name: str) -> str:
        low, high = values.get(f"{name}_interval") or (None, None)
        value = NOTHING if values.get(name) is None else f"{values[name]:.3g}"
        return value if low is None else f"{value} ({low:.3g} to {high:.3g})"

    compared = [("gap", f"{simulated}, unfiltered"), ("gap_inverse_60hz", "inverse model, 60 Hz")]
    if "band_hz" in document:  # one and the same
        compared = [("gap", f"{simulated}, below {document['band_hz']:.2g} Hz")]
    for key, word in compared:
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


def views_section(diagnosis: Diagnosis) -> Section | None:
    """The residual over each quantity, and its spectrum over time."""
    if len(diagnosis.views) < 2:
        return None
    spectrum = diagnosis.to_dict().get("spectrum_over_time")
    band = any(view.band is not None for view in diagnosis.views)
    caption = (
        "What the model as it was misses, by frequency and time. A level line is a hum, a line that follows the speed "
        "a ripple over position, one column per event."
    )
    blocks = [Picture(figures.spectrum_figure(spectrum), caption, "Spectrum over time")] if spectrum else []
    return Section(
        "The residual from every side",
        Picture(
            figures.views_figure(diagnosis.views),
            "Mean residual force of the model as it was and, where it was extended, of the better one"
            + ("; the grey band is what a healthy record shows. What still leaves it is unexplained." if band else "."),
            "Residual over every quantity",
        ),
        *blocks,
    )


def limits_section(document: Mapping[str, Any]) -> Section | None:
    """What could be there unseen, and how large."""
    limits = document.get("not_excluded") or ()
    if not limits:
        return None
    rows = [[entry.get("label") or words(entry["effect"]), entry["text"]] for entry in limits]
    return Section(
        "What could not be excluded",
        Table(
            ["effect", "would have been noticed from"],
            rows,
            "Each effect alone, at the middle one of the shapes tried; what is fainter may be there.",
        ),
    )


def remedy_section(document: Mapping[str, Any]) -> Section | None:
    """What a control engineer does about it."""
    remedies = [r for r in document.get("remedies", ()) if r]
    blocks: list[Any] = [Points(map(sentence_of, remedies))] if remedies else []
    if document.get("model_file"):
        what = "with what was missing" if document["findings"] else "refitted to the records, with nothing added"
        blocks.append(
            Text(html("The model {}: <code>{}</code>. Every command runs on it.", what, document["model_file"]))
        )
    return Section("What to do", *blocks) if blocks else None


def method_section(document: Mapping[str, Any]) -> Section:
    """How it was found, what was assumed, and what it was read from."""
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
