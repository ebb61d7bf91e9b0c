"""A quick share of the hidden-effect cases in the normal test run; `make hidden` runs all of them."""

import pytest

from tests.hidden.generate import Case, make, write
from tests.hidden.score import score

SEED = 20


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "result"),
    [
        (Case(("position_ripple",), 2, 2), "right"),
        (Case(("controller_disturbance",), 2, 2), "right"),
        (Case(("mass_change",), 2, 2), "right"),
        (Case((), 1, 0), "right"),
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_what_was_hidden_is_named(tmp_path, case, result):
    write(tmp_path / case.name, make(case, SEED))
    answer = score(tmp_path / case.name)
    assert answer.result == result, f"{answer.named or answer.verdict} {answer.note}"
    assert not case.effects or answer.closed > 0.8
