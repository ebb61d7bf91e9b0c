"""A text in the place of an axis, a record or a number is refused in one line by every public function."""

import inspect

import pytest

import emps_design
from emps_design import EmpsError, diagnose, machine
from emps_design.request import KINDS

OTHERS = {"advise", "load_axis", "machine", "read_record", "run_task"}  # they take texts, or objects of their own only
FUNCTIONS = {name: getattr(emps_design, name) for name in emps_design.__all__}
FUNCTIONS = {name: each for name, each in FUNCTIONS.items() if inspect.isfunction(each) and name not in OTHERS}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_text_is_no_number(name):
    parameters = inspect.signature(FUNCTIONS[name]).parameters.values()
    plain = [each.name for each in parameters if set(str(each.annotation).split(" | ")) <= KINDS.keys()]
    needed = [each.name for each in parameters if each.default is each.empty and each.kind is not each.VAR_KEYWORD]
    axis = {"axis": machine("emps2019")} if "axis" in needed else {}
    assert plain
    for parameter in plain:
        with pytest.raises(EmpsError, match="30 mm") as refused:
            FUNCTIONS[name](**dict.fromkeys(needed, ()) | axis | {parameter: "30 mm"})
        assert "\n" not in str(refused.value)


def test_no_record_is_refused():
    with pytest.raises(EmpsError, match="records: found none, expected at least one"):
        diagnose([], machine("emps2019"))
