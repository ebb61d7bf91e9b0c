"""The exact core: against solve_ivp with events, against itself in three forms, and in closed form."""

import numpy as np
import pytest

from emps_design.machines import machine
from emps_design.records import read_record
from emps_design.simulation import Plant
from tests.physics.reference import Reference

AXIS = machine("emps2019").replace(sampling={"encoder_resolution": 0.0})


def replay(record, method, samples=None):
    return Plant.of(AXIS).closed_loop(record.q_ref[:samples], q0=record.q[0], method=method)


@pytest.mark.study("25,000 samples by an adaptive solver")
@pytest.mark.timeout(900)
def test_replay_of_the_record_is_that_of_solve_ivp(emps_data):
    record = read_record(emps_data / "DATA_EMPS.mat")
    reference = Reference(AXIS).positions(record.q_ref, q0=record.q[0], closed=True)
    for method in ("plain", "folded", "general"):
        assert np.abs(replay(record, method).position - reference).max() < 1e-12


def test_first_strokes_of_the_record_are_those_of_solve_ivp(emps_data):
    record = read_record(emps_data / "DATA_EMPS.mat")
    reference = Reference(AXIS).positions(record.q_ref[:1500], q0=record.q[0], closed=True)
    for method in ("plain", "folded", "general"):
        assert np.abs(replay(record, method, 1500).position - reference).max() < 1e-12


def test_three_forms_give_one_motion(emps_data):
    record = read_record(emps_data / "DATA_EMPS.mat")
    plain, folded, general = (replay(record, method) for method in ("plain", "folded", "general"))
    for other in (folded, general):
        assert np.abs(other.position - plain.position).max() < 1e-14
        assert np.abs(other.force - plain.force).max() < 1e-8
        np.testing.assert_allclose(other.events, plain.events, atol=1e-12)


def test_slide_to_rest_in_closed_form():
    mass, viscous, coulomb, _ = AXIS.mechanics.array()
    axis = AXIS.replace(mechanics={"offset": 0.0})
    v0, tau = 0.3, mass / viscous
    run = Plant.of(axis).open_loop(np.zeros(2000), v0=v0)
    stop = tau * np.log1p(viscous * v0 / coulomb)
    travel = tau * v0 - coulomb / viscous * stop
    assert run.crossings == pytest.approx([stop], abs=1e-14)
    assert run.position[-1] == pytest.approx(travel, abs=1e-15)
    assert run.stick_intervals == pytest.approx(np.array([[stop, 2.0]]), abs=1e-14)


def test_friction_without_viscous_part_in_closed_form():
    axis = AXIS.replace(mechanics={"viscous": 0.0, "offset": 0.0})
    mass, _, coulomb, _ = axis.mechanics.array()
    run = Plant.of(axis).open_loop(np.zeros(500), v0=0.05)
    assert run.position[-1] == pytest.approx(0.5 * mass * 0.05**2 / coulomb, abs=1e-15)


def test_carriage_stays_while_friction_holds_and_leaves_beyond():
    axis = AXIS.replace(mechanics={"offset": 0.0})
    hold = axis.mechanics.coulomb / axis.drive.force_gain
    assert not Plant.of(axis).open_loop(np.full(100, 0.999999 * hold)).position.any()
    assert Plant.of(axis).open_loop(np.full(100, 1.000001 * hold)).position[-1] > 0


def test_one_hour_is_linear_in_length():
    q_ref = 0.1 * np.sin(2 * np.pi * 0.3e-3 * np.arange(3_600_000))
    run = Plant.of(AXIS).closed_loop(q_ref)
    part = Plant.of(AXIS).closed_loop(q_ref[:10_000])
    np.testing.assert_array_equal(run.position[:10_000], part.position)
    assert run.lost_events == 0
