"""When something happened: an interval of all instants that the record does not separate holds the true one."""

import numpy as np
import pytest

from emps_design.discrepancy import diagnose
from emps_design.effects import get_effect
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record
from tests.studies import quick

AXIS = machine("emps2019")


def found(effect, seed=1):
    record = synthetic_record(AXIS.replace(effects=[effect]), laps=3, seed=seed)
    (finding,) = diagnose(record, AXIS, library=(get_effect(effect["kind"]),)).findings
    return record, finding.parameters


@pytest.mark.study("whole diagnoses")
@pytest.mark.parametrize("time", quick([6.2, 6.9, 7.7, 9.3], 1, "other instants"))
def test_a_mass_put_on_at_constant_speed_was_put_on_somewhere_in_that_stretch(time):
    record, parameters = found({"kind": "mass_change", "change": 0.2, "time": time}, seed=int(10 * time))
    value, deviation = parameters["time"]["value"], parameters["time"]["std"]
    assert abs(value - time) < 2.0 * deviation
    accelerates = np.abs(np.gradient(np.gradient(record.q_ref, record.period), record.period)) > 0.05
    before, after = (record.t[accelerates & side] for side in (record.t < time, record.t > time))
    assert 2.0 * deviation < 0.6 * (after.min() - before.max())  # no more than the stretch
    assert before.max() < value < after.min()
    assert parameters["change"]["value"] == pytest.approx(0.2, abs=4.0 * parameters["change"]["std"])


@pytest.mark.study("a whole diagnosis")
def test_a_push_began_when_it_began():
    """Its edges show, so that next to nothing is moved."""
    push = {"kind": "external_force", "amplitude": 20.0, "start": 2.3, "duration": 0.5, "every": 5.3}
    record, other = (synthetic_record(AXIS.replace(effects=[push]), laps=3, seed=seed) for seed in (1, 2))
    (finding,) = diagnose(record, AXIS, library=(get_effect("external_force"),), holdout=other).findings
    parameters = finding.parameters  # of the whole record: no lap of it is kept closed
    for name in ("start", "every"):
        assert parameters[name]["value"] == pytest.approx(push[name], abs=max(2e-3, 3.0 * parameters[name]["std"]))
        assert parameters[name]["std"] < 5e-3
