"""What the data tab does with a record, each a job: identify, find the law, observe, respond, diagnose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from emps_design.advice import Advice, advise
from emps_design.axis import Axis
from emps_design.progress import of_part
from emps_design.records import Record
from emps_design.report.display import quantity
from emps_design.units import Units

Options = dict[str, Any]  # what the tab chose: friction and filter of Identify, model of Diagnose, record held out
NAMED_MODEL, CLOSEST_MODEL = "named", "closest"


def _blocks(units: Units, *blocks: Any) -> str:
    """Blocks of a report page as HTML in the ``units`` of an axis, without the page around them."""
    from emps_design.report import Page, Section

    text = Page("", "", (), (Section("Result", *blocks),), units=units).html()
    start = text.index("</h2>", text.index('<section id="result">')) + len("</h2>")
    return text[start : text.index("</section>", start)]


def _advice(name: str, document: dict[str, Any], record: Record, axis: Axis) -> Advice:
    """What to do with what the command ``name`` finds in ``record``, by its ``document``."""
    return advise(name, document, axis=axis.name, records=[record.name])


def identify_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Identify ``record`` and return the section of the report about it, and the axis it gives."""
    from emps_design.identification import identify
    from emps_design.report.record import identification_blocks

    progress("identifying", 0.2)
    found = identify(record, axis, model=options["friction"], filter=options["chain"], holdout=options.get("held_out"))
    progress("drawing", 0.7)
    values = ", ".join(
        f"{name.replace('_', ' ')} {quantity(e.value, e.quantity.unit)}" for name, e in found.parameters.items()
    )
    judged = found.extra["held_out"]
    judged_on = f", {quantity(judged['rms_error'], 'N')} on {judged['on']}" if options.get("held_out") else ""
    complete = all(estimate.determined for estimate in found.parameters.values())
    return {
        "text": f"Identified: {values}; force error {quantity(found.rms_error, 'N')} rms{judged_on}.",
        "html": _blocks(axis.units, *identification_blocks(found, axis)),
        "model": found.to_axis(name=f"{axis.name.split(' from ')[0]} from {record.name}") if complete else None,
        "advice": _advice("identify", found.to_dict(), record, axis),
    }


def observe_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Observe the external force of ``record`` with the parameters of ``axis``."""
    from emps_design.identification.observation import observe
    from emps_design.report.observation import observation_blocks

    progress("observing", 0.2)
    found = observe(record, axis)
    progress("drawing", 0.7)
    least = min(found.methods.values(), key=lambda method: method.smallest.value).smallest.value
    return {
        "text": f"Observed with {axis.name}: forces below {quantity(least, 'N', 3)} cannot be told from errors.",
        "html": _blocks(axis.units, *observation_blocks(found)),
        "advice": _advice("observe", found.to_dict(), record, axis),
    }


def law_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Tell which controller made ``record``; return its table, and ``axis`` with it where it is told."""
    from emps_design.identification.controller import identify_law
    from emps_design.report.law import law_blocks

    progress("trying structures", 0.2)
    found = identify_law(record, axis.drive.command_unit)
    progress("drawing", 0.9)
    table, name = found.controller, f"{axis.name.split(' with the law')[0]} with the law of {record.name}"
    return {
        "text": f"Law {found.verdict}: {found.in_words or found.reason}.",
        "html": _blocks(axis.units, *law_blocks(found)),
        "model": None if table is None else Axis.from_dict({**axis.to_dict(), "controller": table, "name": name}, name),
        "advice": _advice("law", found.to_dict(), record, axis),
    }


def response_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Estimate the frequency response of ``record``; return it beside the model, and the axis that fits it."""
    from emps_design.frequency_response import estimate_response
    from emps_design.report.frequency_response import response_blocks

    found = estimate_response(record, axis, progress=of_part(progress, 0.0, 0.5))
    progress("fitting", 0.6)
    compared = found.comparison
    chain = compared.chain
    progress("drawing", 0.8)
    return {
        "text": f"Response at {len(found.response)} lines by the {found.instrument}: {compared.agreement.sentence}.",
        "html": _blocks(axis.units, *response_blocks(compared, found.spectral_ratio)),
        "model": chain.on(axis).replace(name=f"{axis.name} with the response of {record.name}"),
        "advice": _advice("frf", found.to_dict(), record, axis),
    }


def diagnose_work(record: Record, axis: Axis, options: Options, progress: Callable) -> dict[str, Any]:
    """Find where ``record`` and ``axis`` disagree; return the page's summary and the model that was sought."""
    from emps_design.discrepancy import diagnose
    from emps_design.report.diagnosis import diagnosis_page, typeset

    found = diagnose(
        record,
        axis,
        holdout=options.get("held_out"),
        progress=progress,
        closest=options["sought"] == CLOSEST_MODEL,
    )
    model = found.axis if found.closest is None or found.closest.axis is None else found.closest.axis
    progress("drawing", 0.98)
    page = diagnosis_page(found)
    shown = [*page.summary, *(block for section in page.sections for block in section.blocks)]
    document = found.to_dict()
    return {
        "text": typeset(document.get("sentence", document["verdict"])),
        "html": _blocks(axis.units, *shown),
        "model": model.replace(name=f"{axis.name} diagnosed on {record.name}"),
        "advice": _advice("diagnose", document, record, axis),
    }


WORK = {
    "Identify": identify_work,
    "Law": law_work,
    "Observe": observe_work,
    "Response": response_work,
    "Diagnose": diagnose_work,
}
