"""Cases in which a study once called safe what is not, and axes from 0.05 kg at 4 kHz to 20 t at 100 Hz."""

import numpy as np
import pytest

from emps_design.comanipulation.assessment import assess_impedance
from emps_design.comanipulation.run import run_task
from emps_design.comanipulation.scenario import run_comanipulation
from emps_design.comanipulation.study import mismatch_study
from emps_design.comanipulation.task import fitted_task, guided_task, pushed_task
from emps_design.comanipulation.wall import push_into_wall, wall_limit
from emps_design.control.impedance.law import FrictionModel, impedance_law
from emps_design.control.impedance.passivity import Clock
from emps_design.control.impedance.robustness import creep_speed, drift_threshold, verdict
from emps_design.machines import machine
from emps_design.report.impedance import impedance_section


def axis_of(mass, viscous, coulomb, force_gain, period=1e-3, lag=0.0, step=5e-8):
    return machine("emps2018").replace(
        mechanics={"mass": mass, "viscous": viscous, "coulomb": coulomb, "offset": 0.0},
        drive={"force_gain": force_gain, "current_time_constant": lag},
        sampling={"period": period, "encoder_resolution": step},
    )


STIFF = axis_of(300.0, 500.0, 150.0, 60.0, lag=5e-4)  # 120 N of the standard hand do not break it away
FINE = axis_of(20.0, 50.0, 4.0, 10.0, step=1e-6)
LIGHT = axis_of(0.05, 0.5, 0.2, 1.0, period=2.5e-4, lag=1e-4, step=1e-7)
HEAVY = axis_of(20e3, 8e3, 1.5e3, 3e3, period=1e-2, lag=2e-3, step=1e-6)
AXES = [(STIFF, 150.0, 200.0), (FINE, 10.0, 25.0), (LIGHT, 0.03, 0.3), (HEAVY, 12e3, 4e3), (HEAVY, 12e3, 40e3)]


def over(error):
    return {"mass": error, "viscous": error, "coulomb": error}


@pytest.mark.parametrize(("axis", "mass", "damping"), AXES)
@pytest.mark.parametrize("error", [-0.02, 0.0, 0.02])
def test_the_task_moves_every_axis_and_the_verdict_is_that_of_the_closed_form(axis, mass, damping, error):
    law = impedance_law(axis, mass, damping)
    off, plant = law.with_errors(over(error)), FrictionModel.of(axis)
    found = run_task(axis, off, fitted_task(axis, law, 0.02))
    assert abs(found.measures.release_v[0]) > 0.1
    assert found.verdict == verdict(off, plant, Clock.of(axis), axis.sampling.encoder_resolution)
    if error > 0.0:
        assert found.verdict == "creeping"
        assert found.measures.drift[0] == pytest.approx(creep_speed(off, plant), rel=5e-3)


def test_a_hand_that_is_too_weak_gives_no_verdict():
    law = impedance_law(STIFF, 150.0, 200.0)
    study = mismatch_study(STIFF, law, 0.02, 20, task=guided_task(1e-3)).to_dict()
    assert study["verdicts"]["no_motion"] == 20
    assert study["stable_share"] == study["bounded_share"] == 0.0
    assert study["worst"]["verdict"] == "no_motion"
    pushed = run_comanipulation(STIFF, 0.02, plants=5, mass=150.0, damping=200.0, force=120.0).to_dict()
    assert pushed["verdict"] == "no_motion"
    assert "a push of 120 N does not move the carriage: it is below the break-away force of 150 N" in pushed["warnings"]
    assert any(word.startswith("no verdict for") for word in pushed["warnings"])
    moved = run_comanipulation(STIFF, 0.02, plants=5, mass=150.0, damping=200.0).to_dict()
    assert moved["verdict"] == "creeping"


@pytest.mark.parametrize(("estimator", "share"), [("two_tap", 0.5), ("backward", 1.0)])
@pytest.mark.parametrize("steps", [0.8, 1.2])
def test_creep_ends_where_the_threshold_says(estimator, share, steps):
    """A creep somewhat slower than the threshold ends, a faster one goes on for as long as one looks."""
    axis = FINE.replace(sampling={"encoder_resolution": 1e-5})
    period, step = axis.sampling.period, 1e-5
    threshold = drift_threshold(period, step, estimator)
    assert threshold == pytest.approx(share * step / period)
    law = impedance_law(axis, 10.0, 25.0, velocity_estimator=estimator)
    error = steps * threshold * law.damping / 4.0  # of the Coulomb friction
    found = run_task(axis, law.with_errors({"coulomb": error}), guided_task(period, free=30.0, watched=1.0))
    last = found.q[-1] - found.q[-1001]
    assert (last == 0.0) == (steps < 1.0)
    assert found.verdict == ("stable" if steps < 1.0 else "creeping")


def test_a_slow_limit_cycle_is_watched_long_enough():
    axis = machine("emps2018")
    law = impedance_law(axis, 50.0, 100.0, 50.0)
    task = fitted_task(axis, law, 0.02)
    assert task.period * (len(task.push) - task.end) > 5.0  # several periods of the oscillation
    assert run_task(axis, law, task).verdict == "limit_cycle"
    assert run_task(axis, law, guided_task(1e-3, 40.0)).verdict == "limit_cycle"


def test_a_slow_law_gets_the_time_it_needs():
    axis = machine("emps2018")
    slow = fitted_task(axis, impedance_law(axis, 200.0, 20.0), 0.0)  # 10 s
    assert (len(slow.push) - slow.release) * slow.period > 80.0
    endless = fitted_task(axis, impedance_law(axis, 200.0, 0.01), 0.0)
    assert "the slowest mode needs" in endless.warnings[0]


def test_what_the_encoder_keeps_moving_is_said():
    axis = machine("emps2018")
    exact = mismatch_study(axis, impedance_law(axis, 50.0, 100.0), 0.0, 0)
    assert exact.plant(0)["verdict"] == "stable"
    assert 0.025e-3 < exact.measures.drift[0] < 0.1e-3
    assert any("encoder quantisation causes it" in word for word in exact.warnings)


def test_changes_beyond_the_mismatch_are_tried_and_said():
    axis = machine("emps2018")
    study = mismatch_study(axis, impedance_law(axis, 18.94, 100.0, 500.0), 0.02, 0)
    found = {one["what"]: one["verdict"] for one in study.to_dict()["beyond"]}
    assert len(found) == 3
    assert found["one more sample of delay"] == "unstable"
    assert np.all(study.verdict < 5)
    assert any("one more sample of delay: unstable" in word for word in study.warnings)


@pytest.mark.parametrize(("mismatch", "cycles_at"), [(0.0, 24e3), (0.02, 14e3)])
def test_the_wall_limit_is_below_what_cycles(mismatch, cycles_at):
    axis = machine("emps2018")
    law = impedance_law(axis, 50.0, 100.0)
    found = wall_limit(axis, law, mismatch)
    assert 0.25 * cycles_at < found.simulated < cycles_at < found.linear
    off = law.with_errors(found.errors)
    assert push_into_wall(axis, off, cycles_at, found.push).verdict == "bouncing"
    assert push_into_wall(axis, off, found.simulated, found.push).verdict in ("at rest", "calming")


def test_without_friction_the_poles_decide_at_the_wall():
    axis = machine("emps2018").replace(mechanics={"coulomb": 0.0}, sampling={"encoder_resolution": 0.0})
    found = wall_limit(axis, impedance_law(axis, 50.0, 100.0))
    assert found.predicted == found.linear
    assert 0.7 * found.linear < found.simulated <= found.linear


@pytest.mark.study("random plants")
def test_no_plant_is_called_stable_where_the_poles_are_not():
    axis = STIFF.replace(drive={"current_time_constant": 5e-3}, sampling={"computation_delay": 2})
    found = assess_impedance(axis, 10.0, 200.0, 0.02, plants=20)
    document = found.to_dict()
    assert max(abs(pole) for pole in document["sampled"]["poles"]) > 1.01
    assert document["mismatch"]["worst"]["verdict"] == "unstable"
    assert document["mismatch"]["stable_share"] == 0.0
    weak = mismatch_study(axis, found.law, 0.02, 20, task=pushed_task(1e-3, force=1.0))  # nothing moves
    assert weak.to_dict()["verdicts"]["unstable"] == 20
    html = "".join(str(block) for block in impedance_section(found).blocks)
    assert "unstable" in html


def test_pushes_take_the_same_time_after_the_release():
    axis = machine("emps2018")
    law = impedance_law(axis, 50.0, 100.0)
    pushed, guided = fitted_task(axis, law, 0.02, force=40.0), fitted_task(axis, law, 0.02)
    assert (pushed.release, pushed.end, len(pushed.push)) == (guided.release, guided.end, len(guided.push))
    np.testing.assert_array_equal(pushed.push[: pushed.release], pushed_task(1e-3).push[: pushed.release])
