"""The tables of the 2019 report, from the records it was made with."""

import numpy as np
import pytest

from emps_design.identification import identify
from emps_design.records import read_record

SYMMETRIC = {
    "mass": (95.1089, 0.1085),
    "viscous": (203.5034, 1.1460),
    "coulomb": (20.3935, 0.1012),
    "constant_force": (-3.1648, 0.0444),
}
ASYMMETRIC = {
    "mass": (95.1540, 0.0827),
    "viscous_positive": (166.7061, 1.2326),
    "coulomb_positive": (20.1440, 0.1088),
    "viscous_negative": (240.4236, 1.2346),
    "coulomb_negative": (20.6277, 0.1091),
}


@pytest.fixture(scope="module")
def laps(emps_data):
    return read_record(emps_data / "DATA_EMPS.mat")


@pytest.fixture(scope="module")
def pulses(emps_data):
    return read_record(emps_data / "DATA_EMPS_PULSES.mat")


@pytest.mark.parametrize(
    ("model", "table", "error"), [("symmetric", SYMMETRIC, 4.0834), ("asymmetric", ASYMMETRIC, 3.1117)]
)
def test_report_chain_gives_the_published_table(laps, model, table, error):
    found = identify(laps, model=model, filter="report")
    for name, (value, std) in table.items():
        assert found.parameters[name].value == pytest.approx(value, abs=0.01 * std)
        assert found.parameters[name].std == pytest.approx(std, rel=2e-3)
    assert found.relative_error_percent == pytest.approx(error, abs=1e-3)


def test_symmetric_parameters_judged_on_pulses(laps, pulses):
    held_out = identify(laps, filter="report", holdout=pulses).extra["held_out"]
    assert held_out["on"] == "DATA_EMPS_PULSES"
    assert held_out["relative_error_percent"] == pytest.approx(5.9824, abs=1e-3)


def test_published_deviations_are_too_small(laps):
    """The plain deviations of (15) count correlated samples as independent ones."""
    for estimate in identify(laps, filter="report").parameters.values():
        assert estimate.std_long_run > 1.5 * estimate.std
        assert estimate.std_hac > 1.5 * estimate.std


def test_hold_chain_tells_more_than_the_report(laps):
    """The hold modelled and rest left out: a smaller error, and a mass that the report's chain puts 0.4 kg too high."""
    report = identify(laps, model="asymmetric", filter="report")
    hold = identify(laps, model="asymmetric", cutoff=60.0)
    assert hold.rms_error < 0.75 * report.rms_error
    assert np.sum(hold.series["used"]) > 0.7 * len(hold.series["used"])
