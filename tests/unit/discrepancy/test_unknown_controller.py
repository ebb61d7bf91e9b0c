"""Records of others: slow, without a law, moved by hand, turning for ever. Twins of them, simulated."""

import numpy as np
import pytest

from emps_design.discrepancy import diagnose
from emps_design.discrepancy.checks.preparation import prepare
from emps_design.discrepancy.checks.unknown_controller import with_known_command
from emps_design.discrepancy.model.bands import as_many, cutoff, told_up_to
from emps_design.discrepancy.model.fit import fit
from emps_design.discrepancy.model.following import Lead
from emps_design.effects import get_effect
from emps_design.simulation import Plant
from tests.unit.discrepancy.slow_twins import endless, joint, moved_by_hand, robot

SHORT = tuple(map(get_effect, ("gravity", "elastic_force", "stribeck_friction", "actuator_delay")))
WEIGHT = {"kind": "gravity", "torque": 37.0, "angle": 3.0}


def compared(record, axis, library=()):
    (one,), _, slow, notes = with_known_command((record,), axis)
    return prepare((one,), slow, library, None, None, None).start, notes


@pytest.mark.parametrize("period", [0.01, 0.02, 0.05])
def test_a_joint_without_a_law_is_found_at_any_rate(period):
    record, axis = robot(period=period)
    start, _ = compared(record, axis)
    mass, viscous, coulomb, _ = fit(start).model.baseline
    true = joint().mechanics
    assert mass == pytest.approx(true.mass, rel=0.15)
    assert viscous == pytest.approx(true.viscous, rel=0.1)
    assert coulomb == pytest.approx(true.coulomb, rel=0.1)


def test_a_guide_leads_any_model_and_its_force_is_what_the_model_lacks():
    """The same as an inverse model, whatever the mass of what is led; the exact solution is that of small steps."""
    record, axis = robot(period=0.02)
    (one,), _, slow, _ = with_known_command((record,), axis)
    lead = Lead.along(one, slow.mechanics.mass)
    how = {"q0": float(lead.way[0, 0]), "v0": float(lead.way[0, 1]), "intention": lead.way, "quantise": False}
    for share in (0.05, 1.0, 5.0):
        baseline = slow.mechanics.array() * [share, 1.0, 0.0, 0.0]
        plant = Plant(slow, [], (lead.guide,))
        run = plant.open_loop(one.u, baseline=baseline, **how)
        stepped = plant.open_loop(one.u, baseline=baseline, method="general", **how)
        assert np.abs(run.position - stepped.position).max() < 1e-8
        _, v, a = lead.way.T
        lacks = baseline[0] * a + baseline[1] * (v + 0.5 * one.period * a) - one.u
        assert np.std(lead.force(run, *baseline[:2])[:-1] - lacks[:-1]) < 0.02 * np.std(lacks)


def test_a_command_that_was_logged_beside_the_motion_is_moved_and_said():
    record, axis = robot()
    late = type(record)(**{**vars(record), "u": np.concatenate((record.u[:1], record.u[:-1]))})
    moved = [with_known_command((one,), axis) for one in (record, late)]
    assert not any("was logged" in note for note in moved[0][-1])
    assert any("was logged" in note and "after" in note for note in moved[1][-1])
    fits = [fit(compared(one, axis)[0]).model.baseline for one in (record, late)]
    assert fits[1] == pytest.approx(fits[0], rel=0.05, abs=0.1)


def test_what_is_too_fast_for_a_record_is_said_and_a_fast_one_hides_nothing():
    record, axis = robot(period=0.05)
    _, notes = compared(record, axis)
    assert "Nothing above 8 Hz can be told" in notes
    assert with_known_command((record,), axis.replace(controller=joint().controller))[0] == (record,)
    assert cutoff(1e-3) == 60.0
    assert as_many(500, 1e-3) == 500


@pytest.mark.slow("a light arm is led by a stiff guide")
def test_the_weight_of_an_arm_that_is_moved_by_hand_is_the_first_name():
    record, axis = moved_by_hand(3.3)
    answer = diagnose(record, axis, library=SHORT[:2])
    assert [f.effect for f in answer.findings] == ["gravity"]
    assert answer.findings[0].parameters["torque"]["value"] == pytest.approx(3.3, rel=0.02)
    assert answer.axis.sampling.period == axis.sampling.period


@pytest.mark.slow("a diagnosis of a minute of motion")
def test_the_weight_of_a_slow_joint_is_the_first_name():
    record, axis = robot((WEIGHT,))
    answer = diagnose(record, axis, library=SHORT)
    assert [f.effect for f in answer.findings] == ["gravity"]
    assert answer.findings[0].parameters["torque"]["value"] == pytest.approx(37.0, rel=0.05)
    assert any("Nothing above" in text for text in answer.details["warnings"])
    assert "can be told." in answer.sentence


@pytest.mark.slow("a diagnosis of a minute of motion")
def test_a_trace_of_20_ms_of_a_healthy_joint_lacks_nothing():
    record, axis = robot(period=0.02, seed=3)
    answer = diagnose(record, axis, library=SHORT)
    assert answer.findings == ()


def test_a_shaft_that_turns_for_ever_is_answered():
    record, axis = endless()
    assert np.ptp(record.q) > 1000.0  # rad
    answer = diagnose(record, axis, library=SHORT)
    assert answer.findings == ()


def test_a_coarser_encoder_tells_less():
    record, _ = robot()
    told = [told_up_to(record, resolution) for resolution in (1e-5, 1e-3, 1e-1)]
    assert told[0] > told[1] > told[2]
