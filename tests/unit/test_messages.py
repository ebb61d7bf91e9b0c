"""A message is a string wherever one is wanted, and keeps its code when it is copied or sent to another process."""

import copy
import json
import pickle

import pytest

from emps_design.messages import Severity, grave, note, severity_of, warning, wrong

CREEPS = grave("creep", "the released carriage creeps at 3 mm/s", speed=0.003)


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda message: pickle.loads(pickle.dumps(message))])
def test_a_copy_is_the_same_message(again):
    copied = again(CREEPS)
    assert copied == CREEPS
    assert (copied.code, copied.severity, copied.values) == ("creep", Severity.GRAVE, {"speed": 0.003})


def test_it_is_text_for_everyone_else():
    assert {"the released carriage creeps at 3 mm/s": 1}[CREEPS] == 1
    assert json.dumps([CREEPS]) == '["the released carriage creeps at 3 mm/s"]'
    assert f"- {CREEPS}" == "- the released carriage creeps at 3 mm/s"


def test_severities_are_ordered():
    severities = [severity_of(make("code", "text")) for make in (note, warning, grave, wrong)]
    assert severities == sorted(Severity)


def test_the_name_of_what_it_is_about_leaves_the_rest():
    about = CREEPS.of("first.csv")
    assert about == "first.csv: the released carriage creeps at 3 mm/s"
    assert (about.code, about.severity, about.values) == (CREEPS.code, CREEPS.severity, CREEPS.values)
