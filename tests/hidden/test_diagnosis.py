"""A quick share of the hidden-effect cases; `make hidden` runs all of them."""

import pytest

from tests.hidden.generate import Case, make, write
from tests.hidden.score import score

SEED = 20


@pytest.mark.study("five diagnoses with the whole library")
@pytest.mark.parametrize(
    ("case", "repeats"),
    [
        (Case(("position_ripple",), 2, 2), True),
        (Case(("mass_change",), 2, 2), True),
        (Case(("elastic_force",), 2, 2), False),
        (Case(("unknown_magnet",), 1, 1), False),
        (Case((), 1, 0), False),
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_what_was_hidden_is_named(tmp_path, case, repeats):
    write(tmp_path / case.name, make(case, SEED, repeats))
    answer = score(tmp_path / case.name)
    assert answer.result == "right", f"{answer.named or answer.verdict} {answer.note}"
    assert not answer.named or answer.closed > 0.8
