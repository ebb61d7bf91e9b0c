"""Parameters where a record holds structure without a name: closer to the truth than any least squares."""

import numpy as np
import pytest
from scipy.signal import lfilter

from emps_design.discrepancy import diagnose
from emps_design.effects import get_effect
from emps_design.identification import identify
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import trapezoid_laps

LIBRARY = (get_effect("elastic_force"),)


def record(axis, seed: int, memory: float) -> Record:
    """A record of ``axis`` whose friction grows with ``memory`` [N] of where it has moved in the last 0.3 s."""
    period = axis.sampling.period
    q_ref = trapezoid_laps(period, stroke=0.1, speed=0.2, laps=3)
    share = period / 0.3
    direction = np.sign(np.gradient(q_ref))
    wake = memory * lfilter([share], [1.0, share - 1.0], direction)
    noise = 4e-3 * np.random.default_rng(seed).standard_normal(q_ref.size)
    run = Plant.of(axis).closed_loop(q_ref, voltage_noise=noise, disturbance=-wake)
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=period, name=f"run {seed}")


@pytest.mark.study("whole diagnoses")
@pytest.mark.parametrize("mass", [0.5, 1.0, 2.5])
def test_the_model_of_what_has_no_name_is_a_better_estimate_than_least_squares(mass):
    demo = machine("emps2019")
    true = demo.replace(mechanics={"mass": mass * demo.mechanics.mass}, controller={"kv": mass * demo.controller.kv})
    measured = record(true, 1, 9.0 * mass)
    answer = diagnose(measured, true, holdout=record(true, 2, 9.0 * mass), library=LIBRARY)
    assert answer.verdict == "unnamed"
    off = abs(answer.axis.mechanics.mass / true.mechanics.mass - 1)
    squares = [
        abs(identify(measured, true, filter=c).parameters["mass"].value / true.mechanics.mass - 1)
        for c in ("report", "hold")
    ]
    assert off < 0.005
    assert off < 0.5 * min(squares)
    stated = answer.to_dict()["parameters"]["mass"]["extended"]
    assert stated["value"] == answer.axis.mechanics.mass
    assert np.allclose(answer.trace.baseline, answer.trace.extended)


def test_on_a_healthy_record_it_is_the_fit_itself():
    from emps_design.discrepancy.calibration import calibrate, first_noise
    from emps_design.discrepancy.confirmation import robust
    from emps_design.discrepancy.preparation import prepare

    axis = machine("emps2019")
    preparation = prepare((record(axis, 3, 0.0),), axis, LIBRARY, None, None, None)
    baseline = calibrate(preparation, *first_noise(preparation), 0, 0, lambda stage, done: None).baseline
    again = robust(baseline)
    for place in range(4):
        apart = abs(again.model.baseline[place] - baseline.model.baseline[place])
        assert apart < 3 * baseline.std(-1, place)
