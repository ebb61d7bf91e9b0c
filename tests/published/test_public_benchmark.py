"""The public benchmark of the EMPS: its second record from voltage and 20 first samples alone, nothing decided on it.

Friction of another day acts in that record: open loop, 0.05 N of constant force move the end by millimetres.
"""

from itertools import combinations, pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares

from emps_design.effects import get_effect
from emps_design.machines import machine
from emps_design.records import read_record
from emps_design.simulation import Plant
from tests.published.test_real_machines import LAP

GIVEN = 20  # first samples that may be used
LAPS = 4  # of DATA_EMPS
# Beside mass, viscous, Coulomb and constant friction: effects, their one free number's size, and what is given.
ASYMMETRIC, BENT = ("asymmetric_viscous_friction", 20.0, ()), ("nonlinear_viscous_friction", 5.0, (0.5,))
MODELS = {
    "four numbers": (),
    "asymmetric": (ASYMMETRIC,),
    "bent": (BENT,),
    "asymmetric and bent": (ASYMMETRIC, BENT),
}


def astray(effects, x, record, start, stop):
    """Simulated minus measured position [m] of one stretch of ``record``, open loop from its first samples."""
    own = [(get_effect(kind), np.array([free, *given])) for (kind, _, given), free in zip(effects, x[4:], strict=True)]
    first = start + GIVEN
    speed = (record.q[first - 1] - record.q[first - 3]) / (2 * record.period)
    plant = Plant(machine("emps2019"), own)
    run = plant.open_loop(
        record.u[first:stop], q0=float(record.q[first]), v0=float(speed), baseline=x[:4], quantise=False
    )
    return run.q - record.q[first:stop]


def fitted(effects, record, stretches):
    """Least squares of the positions in open loop."""
    size = np.array([*machine("emps2019").mechanics.array(), *(size for _, size, _ in effects)])
    start = np.where(np.arange(size.size) < 4, 1.0, 0.2)  # times size
    lower = np.where(np.arange(size.size) < 3, 0.0, -np.inf)
    found = least_squares(
        lambda x: np.concatenate([1e3 * astray(effects, x * size, record, *part) for part in stretches]),
        start, bounds=(lower, np.inf), diff_step=1e-4, max_nfev=40,
        x_scale=[0.01, 0.05, 0.05, 0.1, 0.2, 0.2][: size.size],
    )  # fmt: skip
    return found.x * size


def rms(error):
    """In millimetres."""
    return 1e3 * float(np.sqrt(np.mean(np.square(error))))


@pytest.mark.study("the official score: every model on every set of laps")
def test_the_second_record_in_open_loop_by_the_model_that_the_laps_of_the_first_choose(emps_data):
    """The simplest model within a standard error of the least, each lap of the first record left out in turn."""
    record = read_record(emps_data / "DATA_EMPS.mat")
    laps = list(pairwise([*range(0, LAPS * LAP, LAP), len(record)]))
    missed = {
        name: np.array([
            rms(astray(effects, fitted(effects, record, laps[:k] + laps[k + 1 :]), record, *laps[k]))
            for k in range(LAPS)
        ])
        for name, effects in MODELS.items()
    }  # fmt: skip
    least = min(missed.values(), key=np.mean)
    within = least.mean() + least.std(ddof=1) / np.sqrt(LAPS)
    chosen = min((name for name in MODELS if missed[name].mean() <= within), key=lambda name: len(MODELS[name]))
    assert chosen == "asymmetric"
    assert missed[chosen].mean() < 2.0 < 2.5 < missed["four numbers"].mean()

    # How far a run of this length goes astray: over the whole record, by what two of its laps told.
    effects, whole = MODELS[chosen], (0, len(record))
    scores = [rms(astray(effects, fitted(effects, record, two), record, *whole)) for two in combinations(laps, 2)]
    pulses = read_record(emps_data / "DATA_EMPS_PULSES.mat")
    score = rms(astray(effects, fitted(effects, record, [whole]), pulses, 0, len(pulses)))
    assert min(scores) < score < max(scores)  # 6.5 mm; a fit that left 1.950 mm of the first, not 1.949, got 5.3
    assert max(scores) < 10.0
