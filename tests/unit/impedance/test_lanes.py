"""Laws side by side are the laws alone, to the bit."""

import numpy as np
import pytest

from emps_design.comanipulation.run import BLOCK, Setup, run_many
from emps_design.comanipulation.task import NAMES, guided_task, pushed_task
from emps_design.control.impedance.law import impedance_law
from emps_design.laws.law import PARAMETERS
from emps_design.machines import machine

LAWS = 41  # some lanes stay empty
TASK = guided_task(1e-3, 3.0)
DELAYED = {"sampling": {"computation_delay": 1}}
RIPPLE = {"effects": [{"kind": "position_ripple", "amplitude": 1.0, "phase": 0.5, "period": 2.5e-3}]}


def setup(changes=None, task=TASK, spread=0.03, mass=50.0, damping=100.0, name="emps2018", laws=LAWS, **options):
    axis = machine(name).replace(**(changes or {}))
    errors = np.random.default_rng(5).uniform(-spread, spread, (5, laws))
    law = impedance_law(axis, mass, damping, **options).with_errors(dict(zip(PARAMETERS, errors, strict=True)))
    return Setup.of(axis, [law], task)


@pytest.mark.parametrize(
    "case",
    [
        {},
        {"task": TASK.reversed},
        {"task": pushed_task(1e-3, 3.0)},
        {"task": pushed_task(1e-3, 3.0, force=5.0)},
        {"name": "emps2018-two-quadrant"},
        {"name": "emps2019", "task": guided_task(1e-3, 3.0, scale=0.3)},
        {"changes": {"drive": {"current_time_constant": 0.0}}},
        {"changes": {"sampling": {"encoder_resolution": 0.0}}},
        {"changes": {"drive": {"command_limit": 3.0}}},
        {"force_sensor": True},
        {"stiffness": 300.0, "rest_position": 0.01},
        {"mass": 30.0, "damping": 20.0, "filter": 200.0, "velocity_estimator": "backward"},
        {"mass": 1.0, "damping": 0.5, "spread": 0.2},
    ],
    ids=str,
)
def test_side_by_side_is_alone_to_the_bit(case):
    one = setup(**case)
    assert one.in_lanes
    together, alone = one.measured(one.law.gains), one.alone(one.law.gains)[0]
    assert together.tobytes() == alone.tobytes()


def test_what_lanes_give_up_is_what_reaches_the_limit():
    free = setup()
    middle = float(np.median(free.measured(free.law.gains)[:, NAMES.index("peak_u")]))
    one = setup(changes={"drive": {"command_limit": middle}})
    given_up = np.isnan(one.side_by_side(one.law.gains)).all(axis=1)
    clipped = one.alone(one.law.gains)[0][:, NAMES.index("clipped")] > 0.0
    assert np.array_equal(given_up, clipped)
    assert 0 < clipped.sum() < LAWS


def test_a_law_does_not_depend_on_its_neighbours():
    one = setup()
    order = np.random.default_rng(1).permutation(LAWS)
    assert np.array_equal(one.side_by_side(one.law.gains)[order], one.side_by_side(one.law.gains[order]))


def test_one_law_of_many_estimates_is_many_laws():
    axis = machine("emps2018")
    law, errors = impedance_law(axis, 50.0, 100.0), np.random.default_rng(2).uniform(-0.02, 0.02, BLOCK + 4)
    together = run_many(axis, [law.with_errors({"mass": errors, "coulomb": errors})], TASK, workers=2)
    alone = run_many(axis, [law.with_errors({"mass": error, "coulomb": error}) for error in errors.tolist()], TASK)
    for name in ("raw", "threshold", "expected", "integrates"):
        assert np.array_equal(getattr(together, name), getattr(alone, name)), name


@pytest.mark.parametrize("case", [{"changes": DELAYED}, {"changes": RIPPLE}, {"laws": 8}], ids=str)
def test_what_lanes_cannot_do_is_run_alone(case):
    one = setup(**case)
    assert not one.in_lanes
    assert one.measured(one.law.gains).tobytes() == one.alone(one.law.gains)[0].tobytes()


def test_laws_that_differ_in_more_than_their_estimates_are_run_alone():
    axis = machine("emps2018")
    laws = [impedance_law(axis, 50.0, 100.0, cutoff) for cutoff in np.linspace(300.0, 600.0, LAWS).tolist()]
    assert not Setup.of(axis, laws, TASK).in_lanes
