"""A healthy machine whose loop has much gain for its encoder: the steps of a simulated encoder are no gap."""

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.discrepancy import diagnose
from emps_design.simulation.synthetic import point_to_point, synthetic_record

SLOW = Axis.from_dict(
    {
        "name": "slow",
        "mechanics": {"mass": 200.0, "viscous": 4000.0, "coulomb": 90.0, "offset": -300.0},
        "drive": {"command": "torque", "command_unit": "%", "force_gain": 30.0, "command_limit": 100.0},
        "sampling": {"period": 1e-3, "encoder_resolution": 1e-7},
        "controller": {"kind": "cascade", "position": {"kp": 20.0}, "velocity": {"kp": 900.0, "ti": 0.04}},
    }
)
HEAVY = Axis.from_dict(
    {
        "name": "heavy",
        "mechanics": {"mass": 900.0, "viscous": 600.0, "coulomb": 180.0, "offset": 25.0},
        "drive": {"command": "torque", "command_unit": "%", "force_gain": 42.0, "command_limit": 250.0},
        "sampling": {"period": 5e-4, "encoder_resolution": 1e-6},
        "controller": {
            "kind": "cascade",
            "position": {"kp": 12.0, "every": 2},
            "velocity": {"kp": 1200.0, "ti": 0.05},
            "feedforward": {"velocity": 1.0, "acceleration": 20.0},
        },
    }
)


def record(axis, stroke, speed, seed):
    period, still = axis.sampling.period, np.zeros(200)
    ways = [point_to_point(period, stroke, speed * s, a * speed**2 / stroke) for s, a in ((1, 3), (0.5, 2), (0.25, 4))]
    q_ref = np.concatenate([still, *(part for way in ways for part in (way, still + stroke, way[::-1], still))])
    return synthetic_record(axis, q_ref=q_ref, seed=seed)


@pytest.mark.study("whole diagnoses of two machines")
@pytest.mark.parametrize(("axis", "stroke", "speed"), [(SLOW, 0.01, 0.004), (HEAVY, 5.0, 2.0)], ids=["slow", "heavy"])
def test_a_healthy_machine_is_healthy(axis, stroke, speed):
    train, holdout = (record(axis, stroke, speed, seed) for seed in (31, 32))
    guess = axis.replace(mechanics={"mass": 0.8 * axis.mechanics.mass, "coulomb": 0.8 * axis.mechanics.coulomb})
    found = diagnose(train, guess, holdout=holdout)
    assert found.verdict == "parameters-only"
    assert found.axis.mechanics.mass == pytest.approx(axis.mechanics.mass, rel=0.02)
    assert found.holdout.extended > 1.3 * found.noise.force  # as it would be with a second encoder's steps on top
