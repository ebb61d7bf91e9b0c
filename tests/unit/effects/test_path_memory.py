"""An effect that declares ``by_travel``: the simulation relies on it for the form of ``rate``."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.effects import EFFECTS, Solver, get_effect
from emps_design.effects.effect import CHECK_BASELINE
from emps_design.errors import AxisError

MEMORIES = [effect.name for effect in EFFECTS if effect.solver.by_travel]


def rate(effect, x, v, level, **motion):
    given = {"q": 0.0, "t": 0.0, "tau": 0.0, **motion}
    parameters = np.array([p.starts[0] for p in effect.parameters])
    dx = np.zeros(1)
    effect.rate(given["q"], v, given["t"], given["tau"], [x], parameters, CHECK_BASELINE, level, dx)
    return dx[0], effect.force(given["q"], v, given["t"], given["tau"], [x], parameters, CHECK_BASELINE)


def test_there_are_two():
    assert MEMORIES == ["presliding_friction", "maxwell_slip_friction"]


@pytest.mark.parametrize("name", MEMORIES)
@pytest.mark.parametrize("level", [0.0, 1e-3, 20.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_changes_with_travel_alone_and_evenly(name, level, side):
    effect = get_effect(name)
    at_rest, _ = rate(effect, 0.1, 0.0, level)
    assert at_rest == 0.0
    for x in (-0.3, 0.2, 0.7):
        slow, force = rate(effect, x, 0.01 * side, level)
        assert rate(effect, x, 0.5 * side, level)[0] == pytest.approx(50.0 * slow, rel=1e-12)
        assert rate(effect, x, 0.01 * side, level, q=3.0, t=7.0, tau=-40.0) == (slow, force)
        ends = [rate(effect, one, 0.01 * side, level)[0] for one in (x - 0.1, x + 0.1)]
        assert sum(ends) / 2.0 == pytest.approx(slow, rel=1e-9)
        assert ends[1] < ends[0]
        assert rate(effect, 2.0 * x, 0.01 * side, level)[1] == pytest.approx(2.0 * force)


def test_a_memory_has_one_state_and_a_force():
    with pytest.raises(AxisError, match="by_travel needs exactly one state and a force"):
        replace(get_effect("stribeck_friction"), solver=Solver(by_travel=True))
