"""The law of a public record that is known to 5e-5 of its command: a velocity from the slope of four points."""

import pytest

from emps_design.identification.controller import TOLD, identify_law
from emps_design.importing import import_record
from emps_design.machines import load_axis
from tests.conftest import DATA
from tests.studies import quick

CASE = DATA / "public" / "cases" / "law-slope-of-four"
pytestmark = pytest.mark.skipif(not CASE.is_dir(), reason=f"the public records are not in {CASE}")


@pytest.mark.slow("a search over structures, 10,000 samples")
@pytest.mark.parametrize("name", quick(["pd_c1", "pd_c10"], 1, "the other record"))
def test_the_slope_of_four_points_is_told(name):
    """Three notches and kp 87.6 passed for it, with 1.4 % of the command left."""
    axis = load_axis(str(CASE / "axis.toml"))
    found = identify_law(import_record(CASE / f"{name}.npz", axis), axis.units)
    assert found.verdict == TOLD, found.reason
    table = found.controller
    assert table["velocity_estimator"] == {"kind": "slope", "points": 4}
    assert table["position"]["kp"] == pytest.approx(200.0, rel=2e-3)
    assert table["velocity"]["kp"] == pytest.approx(0.01, rel=2e-3)
    assert table["feedforward"]["velocity"] == pytest.approx(1.0, rel=1e-5)
    assert "filters" not in table
    assert found.residual_share < 2e-4
