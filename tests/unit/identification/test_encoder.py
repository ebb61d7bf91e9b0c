"""A coarse encoder and little else that is noise: what its steps do to the estimates is in the intervals."""

import numpy as np
import pytest

from emps_design.identification import identify
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant, trapezoid_laps

PERIOD = 1e-3
FINE = machine("emps2019").replace(controller={"kp": 30.0, "kv": 100.0})
COARSE = FINE.replace(sampling={"encoder_resolution": 5e-5})
SLOW = FINE.replace(
    mechanics={"mass": 200.0}, sampling={"encoder_resolution": 1e-4}, controller={"kp": 20.0, "kv": 60.0}
)


LIGHT = FINE.replace(
    mechanics={"mass": 5.0, "viscous": 20.0, "coulomb": 3.0, "offset": -0.5},
    drive={"force_gain": 5.0},
    sampling={"encoder_resolution": 2e-5},
    controller={"kp": 60.0, "kv": 60.0},
)


def recorded(axis, at=0.0, speed=0.0947, acceleration=1.031, laps=1):
    """A record whose reference stands ``at`` [m] against the encoder."""
    q_ref = trapezoid_laps(PERIOD, 0.1, speed, acceleration, laps=laps) + at
    noise = 2e-3 * np.random.default_rng(round(at / 1e-6)).standard_normal(q_ref.size)
    run = Plant.of(axis).closed_loop(q_ref, voltage_noise=noise)
    return Record.from_arrays(PERIOD, q_ref, run.q, run.u, name=f"at {at:g} m")


@pytest.mark.study("every phase of the steps")
@pytest.mark.parametrize(
    ("estimator", "axis", "motion"),
    [("ls", LIGHT, (0.1847, 3.07, 1)), ("oe", COARSE, (0.0947, 1.031, 2))],
    ids=("least squares", "output error"),
)
def test_intervals_hold_the_mass_at_any_phase_of_the_steps(estimator, axis, motion):
    """Those of the residual alone do not: it is the same all along, and the steps tell where the axis starts."""
    inside, by_residual = 0, 0
    for i in range(16):
        record = recorded(axis, 7.3e-4 + 0.34 * axis.sampling.encoder_resolution * i, *motion)
        found = identify(record, axis, estimator=estimator)
        mass, off = found.parameters["mass"], found.parameters["mass"].value - axis.mechanics.mass
        inside += abs(off) < 0.5 * np.diff(mass.interval_95)[0]
        by_residual += abs(off) < found.residual.quantile * mass.std_long_run
    assert inside >= 15 > by_residual + 3


@pytest.mark.parametrize("estimator", ["ls", "auto", "oe"])
def test_nothing_is_added_where_the_encoder_is_fine(estimator):
    for axis in (FINE, FINE.replace(sampling={"encoder_resolution": 0.0})):
        found = identify(recorded(axis), axis, estimator=estimator)
        for one in found.parameters.values():
            assert not one.encoder
            assert np.diff(one.interval_95)[0] == pytest.approx(2.0 * found.residual.quantile * one.std_long_run)


def test_output_error_is_taken_for_a_mass_that_noise_hides_from_the_others():
    record = recorded(SLOW, speed=0.047, acceleration=0.51)
    assert not identify(record, SLOW, estimator="ls").parameters["mass"].determined
    found = identify(record, SLOW, holdout=record)
    assert found.estimator == "output_error"
    low, high = found.parameters["mass"].interval_95
    assert low < 200.0 < high < 1.03 * low
    assert found.warnings[-1].startswith("mass: by output error: its column of the measured motion is mostly noise")
    assert found.extra["held_out"]["on"] == record.name
    assert "hausman_test" in found.extra


def test_output_error_is_not_taken_where_it_contradicts_the_others():
    """A controller that did not make the record: its simulation asks for other friction."""
    record = recorded(SLOW, speed=0.047, acceleration=0.51)
    wrong = SLOW.replace(controller={"kp": 26.0, "kv": 60.0})
    assert identify(record, wrong, estimator="oe").parameters["mass"].determined
    found = identify(record, wrong)
    assert found.estimator != "output_error"
    assert not found.parameters["mass"].determined
