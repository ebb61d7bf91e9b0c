"""The advice on what was found in a record: nothing speaks against it, or what does and what to do about that."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from emps_design.advice.advice import CAUTION, SAFE, Advice, Asked, against, command, sentence

PAGE = "design.html"
FOLDER, RESPONSE, CONTROLLER, IDENTIFIED = "diagnosis", "response.csv", "controller.toml", "identified.toml"


def identify(document: Mapping[str, Any], asked: Asked) -> Advice:
    """The advice on identified parameters."""
    diagnose = command("diagnose", *asked.records, axis=asked.axis)
    unknown = [name for name, one in document["parameters"].items() if one.get("value", one.get("mean")) is None]
    if against(document) or unknown:
        text = against(document) or f"{', '.join(unknown)} cannot be told from this record"
        return Advice(CAUTION, text, diagnose)
    out = asked.out
    onward = command("report", out) if out else asked.again(out=IDENTIFIED)
    if out:
        onward = command("report", out, out=PAGE)
    return Advice(SAFE, "nothing in the record speaks against the model and its intervals", onward)


def _law(document: Mapping[str, Any], asked: Asked) -> Advice:
    if document.get("controller") is None:
        return Advice(CAUTION, sentence(document.get("reason") or "the law cannot be told from this record"), None)
    equivalents, reason = document.get("equivalents"), document.get("reason")
    if equivalents or reason or document.get("verdict") not in (None, "told") or against(document):
        text = against(document) or reason or "another law explains the record as well"
        return Advice(CAUTION, sentence(text), None)
    onward = command("identify", *asked.records, axis=asked.axis)
    return Advice(
        SAFE,
        "what is left of the command is the record's own noise and resolution",
        onward if asked.out else asked.again(out=CONTROLLER),
    )


def _frf(document: Mapping[str, Any], asked: Asked) -> Advice:
    if against(document):
        return Advice(CAUTION, against(document), None)
    out = asked.out
    onward = command("report", asked.axis, frf=out, out=PAGE) if out else asked.again(out=RESPONSE)
    return Advice(SAFE, "coherence and deviations are those of a plant that answers as a linear one", onward)


def _observe(document: Mapping[str, Any], asked: Asked) -> Advice:
    if against(document):
        return Advice(CAUTION, against(document), command("identify", *asked.records, axis=asked.axis))
    least = document.get("online", document.get("offline"))["smallest_observable_force"]["value"]
    return Advice(SAFE, f"forces of more than {least:.3g} N are seen with this model", None)


def _diagnose(document: Mapping[str, Any], asked: Asked) -> Advice:
    verdict, findings = document["verdict"], document["findings"]
    folder = asked.out
    experiment = document.get("experiment") or {}
    onward = asked.again(out=FOLDER)
    if folder:
        onward = command("report", f"{folder}/model.toml", out=PAGE)
    tried = onward
    if folder and experiment.get("file"):
        tried = command("simulate", f"{folder}/model.toml", reference=f"{folder}/{experiment['file']}")
    said = {
        "unnamed": "something is missing from the model that no effect of the library explains",
        "partly-named": "beside what has a name something is missing that no effect explains",
        "ambiguous": "the record cannot tell which of several effects is missing",
    }
    if verdict in said or document.get("unexplained") or document.get("interrupted"):
        return Advice(CAUTION, said.get(verdict, "structure is left that no effect explains"), tried)
    if against(document):
        return Advice(CAUTION, against(document), tried)
    if findings and not all(finding.get("confirmed") for finding in findings):
        return Advice(CAUTION, "not every effect was confirmed on data that did not find it; hold a record out", tried)
    names = ", ".join(finding["label"] for finding in findings)
    text = (
        f"what was missing has a name and was confirmed: {names}" if findings else "nothing is missing from the model"
    )
    return Advice(SAFE, text, onward)


RECORDS: dict[str, Callable[[Mapping[str, Any], Asked], Advice]] = {
    "identify": identify,
    "observe": _observe,
    "law": _law,
    "frf": _frf,
    "diagnose": _diagnose,
}
