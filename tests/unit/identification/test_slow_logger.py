"""A record that is slower than the drive: its command is not held between samples."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.identification import identify
from emps_design.machines import machine
from emps_design.records import Record

AXIS = machine("emps2019")


@pytest.fixture(scope="module")
def whole(simulate):
    return simulate(3, std=0.1)


def every(record: Record, n: int) -> Record:
    """Every n-th sample of ``record``, and with it no controller that could be known."""
    t, r, q, u = (x[::n].copy() for x in (record.t, record.q_ref, record.q, record.u))
    return Record.from_arrays(t, r, q, u)


@pytest.mark.parametrize("n", [1, 10, 20])
def test_the_truth_is_in_the_intervals_of_a_slow_logger(whole, truth, n):
    """At 100 and at 50 Hz of a drive at 1 kHz, which a held command misses in viscous friction."""
    axis = AXIS.replace(controller={"kind": "none"}, sampling={"period": n * 1e-3})
    found = identify(every(whole, n), axis, estimator="ls")
    assert ("faster-drive" in [message.code for message in found.warnings]) is (n > 1)
    for name, value in truth.items():
        low, high = found.parameters[name].interval_95
        assert low <= value <= high, name
        assert high - low < 0.1 * max(truth["coulomb"], abs(value)), name


@pytest.mark.parametrize("delay", [6e-3, -4e-3])
def test_a_command_that_a_bus_delays_is_said_and_the_intervals_hold_it(whole, truth, delay):
    """Without a reference and a controller, so that nothing but the motion tells it."""
    axis = AXIS.replace(controller={"kind": "none"})
    moved = replace(whole, u=np.interp(whole.t - delay, whole.t, whole.u), q_ref_recorded=False)
    found = identify(moved, axis)
    (said,) = [message for message in found.warnings if message.code == "command-recorded-late"]
    assert said.values["delay"] == pytest.approx(delay, rel=0.2)
    assert f"ms {'later' if delay > 0 else 'earlier'} than it acts" in said
    for name, value in truth.items():
        low, high = found.parameters[name].interval_95
        assert low <= value <= high, name
