"""The published figures of the EMPS data set, found again from the records."""

import numpy as np
import pytest
from scipy.io import loadmat

from emps_design.machines import machine
from emps_design.records import read_record
from emps_design.simulation import Plant, replay
from emps_design.simulation.scenarios import relative_error_percent

AXIS = machine("emps2019").replace(sampling={"encoder_resolution": 0.0})
VOLTS_PER_PULSE = 1.014  # V per unit of pulses_N, README of the data


def asymmetric():
    """Published asymmetric parameters, as mean and half difference."""
    forward, backward, up, down = 166.7061, 240.4236, 20.1440, 20.6277
    mechanics = {
        "mass": 95.1540,
        "viscous": 0.5 * (forward + backward),
        "coulomb": 0.5 * (up + down),
        "offset": 0.5 * (up - down),
    }
    difference = {"kind": "asymmetric_viscous_friction", "viscous_difference": 0.5 * (forward - backward)}
    return AXIS.replace(mechanics=mechanics, effects=[difference])


def test_symmetric_parameters(emps_data):
    errors = replay(AXIS, read_record(emps_data / "DATA_EMPS.mat")).relative_error_percent
    assert errors["position"] == pytest.approx(0.00109, rel=0.01)
    assert errors["force"] == pytest.approx(4.57, rel=0.01)


def test_the_diagrams_delay_and_clock(emps_data):
    raw = loadmat(emps_data / "DATA_EMPS.mat")
    t, q_ref, q, u = (raw[name].ravel() for name in ("t", "qg", "qm", "vir"))
    period = t[9] - t[8]
    clocked = np.interp(np.arange(t.size) * period, t, q_ref)
    axis = AXIS.replace(sampling={"computation_delay": 1})
    run = Plant.of(axis).closed_loop(clocked, q0=q[0], period=period)
    reaches = np.concatenate([[0.0], run.u[:-1]])
    assert relative_error_percent(q, run.position) == pytest.approx(0.01375, rel=0.01)
    assert relative_error_percent(u, reaches) == pytest.approx(5.85, rel=0.01)


@pytest.mark.parametrize(("axis", "figure"), [(AXIS, 5.4), (asymmetric(), 4.7)], ids=["symmetric", "asymmetric"])
def test_pulses_at_the_controllers_output(emps_data, axis, figure):
    """The voltage limit acts on the controller, and the pulses come behind it."""
    path = emps_data / "DATA_EMPS_PULSES.mat"
    record, pulses = read_record(path), VOLTS_PER_PULSE * loadmat(path)["pulses_N"].ravel().astype(float)
    run = Plant.of(axis).closed_loop(record.q_ref, disturbance=axis.drive.force_gain * pulses, q0=record.q[0])
    assert relative_error_percent(record.u, run.u + pulses) == pytest.approx(figure, rel=0.01)
    without = Plant.of(axis).closed_loop(record.q_ref, q0=record.q[0])
    assert relative_error_percent(record.u, without.u) > 30


def test_asymmetric_parameters(emps_data):
    errors = replay(asymmetric(), read_record(emps_data / "DATA_EMPS.mat")).relative_error_percent
    assert errors["force"] == pytest.approx(3.71, rel=0.01)
