"""Inertias of public records, of which an independent estimate or a data sheet tells: the default holds them."""

from dataclasses import replace

import pytest

from emps_design.identification import identify
from emps_design.importing import import_record
from emps_design.machines import load_axis
from tests.conftest import DATA

PUBLIC = DATA / "public"
pytestmark = pytest.mark.skipif(not PUBLIC.is_dir(), reason=f"the public records are not in {PUBLIC}")


def read(record, axis):
    axis = load_axis(str(PUBLIC / axis))
    return import_record(PUBLIC / record, axis), axis


@pytest.mark.parametrize(
    ("axis", "name"),
    [("axis_law.toml", "law"), pytest.param("axis.toml", "none", marks=pytest.mark.study("looks for the law"))],
)
def test_steps_of_a_proportional_loop(axis, name):
    """0.71 kg by output error in free run; least squares at 200 Hz, as it was chosen, gave 0.24."""
    record, axis = read("cases/step-record-cutoff/record.npz", f"cases/step-record-cutoff/{axis}")
    mass = identify(record, axis).parameters["mass"]
    low, high = mass.interval_95
    assert low < 0.71 < high < 1.3 * low
    assert mass.value == pytest.approx(0.71, rel=0.1)


def test_a_pendulum_of_three_milliradians_a_step():
    """1.85e-4 kg m^2 +- 5 %; at 84 Hz, as it was chosen, noise left a quarter of it."""
    record, axis = read("qube_furuta/150615.npz", "qube_furuta/axis.toml")
    mass = identify(replace(record, q_ref_recorded=False), axis).parameters["mass"]  # the law is none of one axis
    low, high = mass.interval_95
    assert low < 1.85e-4 < high < 1.3 * low


@pytest.mark.parametrize("record", ["local_30cm", "range_0.00_0.41", "range_0.49_0.77"])
def test_carts_whose_command_comes_late(record):
    """6.2 to 6.6 kg; the lag of the command makes structure, which is said."""
    found = identify(*read(f"cart_aau/{record}.npz", "cart_aau/axis.toml"))
    low, high = found.parameters["mass"].interval_95
    assert low < 6.2 < 6.6 < high
    assert 6.1 < found.parameters["mass"].value < 6.7
    assert any("diagnose" in text for text in found.warnings)
