"""What is said about a record, from documents of every kind."""

import pytest

from emps_design.advice import advise
from emps_design.identification.assemble import implausible
from emps_design.identification.model import lumped
from emps_design.identification.proposals import Unexplained
from emps_design.importing.read import MEANS
from emps_design.machines import machine
from emps_design.messages import grave, note, warning, wrong
from emps_design.units import LINEAR

WORDS = ("diagnose", "r.npz", "--axis", "a.toml")


@pytest.mark.parametrize(
    ("verdict", "confirmed", "level"),
    [
        ("nothing-missing", None, "safe"),
        ("parameters-only", None, "safe"),
        ("named", {"share": 1.0, "std": 0.1}, "safe"),
        ("named", None, "caution"),
        ("partly-named", {"share": 1.0, "std": 0.1}, "caution"),
        ("ambiguous", {"share": 1.0, "std": 0.1}, "caution"),
        ("unnamed", None, "caution"),
    ],
)
def test_only_what_was_confirmed_or_complete_is_safe(verdict, confirmed, level):
    named = verdict not in ("nothing-missing", "parameters-only", "unnamed")
    findings = [{"label": "friction that falls with speed", "confirmed": confirmed}] if named else []
    document = {"verdict": verdict, "findings": findings, "warnings": [], "experiment": None}
    found = advise("diagnose", document, WORDS, "a.toml", ["r.npz"])
    assert found.level == level
    assert found.next == "emps-design diagnose r.npz --axis a.toml --out diagnosis"


def test_an_experiment_that_was_written_is_tried_next():
    document = {"verdict": "ambiguous", "findings": [], "warnings": [], "experiment": {"file": "experiment.csv"}}
    found = advise("diagnose", document, (*WORDS, "--out", "d"), "a.toml", ["r.npz"])
    assert found.next == "emps-design simulate d/model.toml --reference d/experiment.csv"


LAW = {"controller": {"kind": "p", "kp": 2.0}, "verdict": "told", "reason": "", "equivalents": [], "warnings": []}


@pytest.mark.parametrize(
    ("more", "level"),
    [
        ({}, "safe"),
        ({"controller": None, "verdict": "not told", "reason": "the reference stands still"}, "caution"),
        ({"verdict": "ambiguous", "equivalents": [{}]}, "caution"),
        ({"warnings": [warning("disagree", "the records disagree on kp")]}, "caution"),
        ({"warnings": [note("rest", "the reference rests at first")]}, "safe"),
        ({"warnings": ["text of a document that was read from a file"]}, "caution"),
    ],
)
def test_a_law_is_safe_where_it_alone_explains_the_record(more, level):
    assert advise("law", {**LAW, **more}).level == level


@pytest.mark.parametrize("value", [2.0, None])
def test_an_identification_with_a_warning_names_diagnose(value):
    document = {"record": "r.npz", "axis": "a", "parameters": {"mass": {"value": value}}, "warnings": []}
    assert advise("identify", document).level == ("safe" if value else "caution")
    answer = advise("identify", {**document, "warnings": [warning("left", "38 % of the force is left")]})
    assert (answer.level, answer.text) == ("caution", "38 % of the force is left")
    assert answer.next == "emps-design diagnose r.npz --axis a"


def test_the_most_severe_message_is_the_advice_whatever_comes_before_it():
    """In the words of the code that warns: structure, what is not told, and what was converted."""
    structure = Unexplained(0.4, 0.3, 2.0, 1.5).warnings()[0]
    graver = [structure, lumped(LINEAR), warning("resampled", "f.csv: resampled"), note("rest", "it rests at first")]
    for i, worst in enumerate(graver[:-1]):
        document = {"parameters": {"mass": {"value": 2.0}}, "warnings": graver[i:][::-1], "record": "r", "axis": "a"}
        assert advise("identify", document).text == worst


def test_the_first_of_equally_severe_messages_is_the_advice():
    """A record that lies, then values that cannot be, then structure: the order in which they are found."""
    damaged = wrong("contradiction", f"u: every second sample is from another signal; {MEANS}")
    impossible = implausible({"mass": -9.0, "viscous": -2.0, "coulomb": -2.0}, machine("emps2019"))[0]
    far = implausible({"mass": 950.0, "viscous": 200.0, "coulomb": 20.0}, machine("emps2019"))[0]
    found = [damaged, impossible, far, Unexplained(0.4, 0.3, 2.0, 1.5).warnings()[0]]
    for i, first in enumerate(found):
        document = {"parameters": {"mass": {"value": 2.0}}, "warnings": found[i:], "record": "r", "axis": "a"}
        assert advise("identify", document).text == first


def test_an_unstable_loop_makes_no_design_safe():
    """Severity decides, not words: a note that speaks of instability harms nothing."""
    document = {"axis": "a", "warnings": [note("harmless", "no gain is unstable")], "worst_loop": None}
    assert advise("margins", document).level == "safe"
    document["warnings"].append(grave("unstable", "the sampled loop is unstable"))
    assert (advise("margins", document).level, advise("margins", document).text) == (
        "caution",
        "the sampled loop is unstable",
    )
