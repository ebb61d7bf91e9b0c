"""The noise of a record in which nothing repeats: an effect that few strokes do not predict is not taken for it."""

import itertools

import numpy as np
import pytest

from emps_design.discrepancy.calibration import first_noise
from emps_design.discrepancy.preparation import prepare
from emps_design.effects import EFFECTS
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import point_to_point

ARM = machine("emps2019").replace(motion="rotary")
NOISE = 4e-3  # V
PLACES = (0.0, 0.5, 0.1, 0.75, -0.05, 0.4, 0.2)  # rad


def few_strokes(effects) -> Record:
    """Six strokes, no two over the same travel."""
    moves = [
        start + np.sign(stop - start) * point_to_point(1e-3, abs(stop - start), 0.4, 2.0)
        for start, stop in itertools.pairwise(PLACES)
    ]
    q_ref = np.concatenate(moves)
    noise = NOISE * np.random.default_rng(0).standard_normal(q_ref.size)
    run = Plant.of(ARM.replace(effects=effects)).closed_loop(q_ref, voltage_noise=noise)
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3)


@pytest.mark.parametrize(
    "effects", [[], [{"kind": "gravity", "torque": 60.0, "angle": 0.3}]], ids=["healthy", "an arm's weight"]
)
def test_what_the_encoder_and_the_command_add_is_the_noise_and_no_weight(effects):
    preparation = prepare((few_strokes(effects),), ARM, EFFECTS, None, None, None)
    _, floor = first_noise(preparation)
    assert not floor.from_laps
    assert floor.force == pytest.approx(NOISE * ARM.drive.force_gain, rel=0.5)
