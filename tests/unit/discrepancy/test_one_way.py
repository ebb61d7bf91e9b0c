"""Records that go one way: Coulomb friction and the constant force are one number, and none of the two is given."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from emps_design.discrepancy import explanation
from emps_design.discrepancy.preparation import prepare
from emps_design.effects.effect import OFFSET
from emps_design.identification.excitation import goes_one_way
from emps_design.identification.model import lumped
from emps_design.report.diagnosis import axis_before
from tests.unit.identification.test_short_records import MOTOR, run

FORTH, BACK = run(1, seconds=1.0), run(-1, seconds=1.0)


@pytest.mark.parametrize(("records", "direction"), [((FORTH,), 1), ((BACK,), -1), ((FORTH, BACK), 0)])
def test_the_constant_force_is_free_where_both_ways_are_driven(records, direction):
    found = prepare(records, MOTOR, (), None, None, None)
    assert found.direction == direction
    assert found.start.model.held == ((OFFSET,) if direction else ())
    assert (lumped(MOTOR.units) in found.warnings) == bool(direction)


def test_a_motor_that_stutters_forward_has_two_signs_of_friction():
    """Cogging turns it back for a fifth of the time, though by no hundredth of the travel at once."""
    t = FORTH.t
    stutter = 0.02 * np.ptp(FORTH.q) / t[-1] * np.sin(60.0 * t)
    assert goes_one_way(replace(FORTH, q=FORTH.q + stutter))
    found = prepare((replace(FORTH, q=FORTH.q + stutter),), MOTOR, (), None, None, None)
    assert (found.direction, found.start.model.held) == (0, ())


@pytest.mark.parametrize("direction", [1, -1, 0])
def test_what_one_way_tells_is_given_as_a_sum(direction, monkeypatch):
    monkeypatch.setattr(explanation, "deviation", lambda now, before, index, place: 0.1 * (1 + place))
    axis = MOTOR.replace(mechanics={"offset": 0.5})
    fit = SimpleNamespace(
        model=SimpleNamespace(baseline=np.array([1.0, 2.0, 3.0, 0.5])), problem=SimpleNamespace(axis=axis)
    )
    preparation = SimpleNamespace(direction=direction)
    outcome = SimpleNamespace(path=[fit], best=fit, preparation=preparation)
    table = explanation._parameters(SimpleNamespace(outcome=outcome, baseline=fit, extended=fit))
    known = {name: entry["extended"]["value"] for name, entry in table.items()}
    if direction:
        lump = 3.0 + 0.5 * direction
        assert known == {
            "mass": 1.0, "viscous": 2.0, "coulomb": None, "constant_force": None, "coulomb_and_offset": lump
        }  # fmt: skip
        assert table["coulomb_and_offset"]["axis"] == pytest.approx(axis.mechanics.coulomb + 0.5 * direction)
        assert table["coulomb_and_offset"]["baseline"]["std"] == pytest.approx(0.3)
    else:
        assert known == {"mass": 1.0, "viscous": 2.0, "coulomb": 3.0, "constant_force": 0.5}
    before = axis_before(axis, table)
    assert (before.mechanics.mass, before.mechanics.viscous) == (1.0, 2.0)
    assert before.mechanics.coulomb == (axis.mechanics.coulomb if direction else 3.0)
