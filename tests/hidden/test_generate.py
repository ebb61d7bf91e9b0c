"""The generator keeps its promises: same seed same bytes, honest floors, healthy drives without a gap."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from tests.hidden.drives import EFFECTS, FURTHER, TURNING, UNKNOWN, draw_drive
from tests.hidden.generate import SKIP, SMALL, Case, cases, limit_at_share, main, make, refit, run
from tests.hidden.plant import NAMES, numbers
from tests.hidden.programs import laps


def test_sets_are_complete():
    whole = cases("all")
    assert len(whole) == len({case.name for case in whole}) == 70
    singles = [case.effects[0] for case in whole if len(case.effects) == 1]
    assert all(singles.count(name) == 2 for name in (*EFFECTS, *UNKNOWN))
    assert sum(not case.effects for case in whole) == 8
    assert sum(len(case.effects) == 2 for case in whole) == 8


@pytest.mark.parametrize(
    ("which", "effects", "unknown"), [("several", (3, 4), 0), ("beside", (2,), 1), ("unknown", (1,), 1)]
)
def test_sets_that_go_on(which, effects, unknown):
    drawn = cases(which, 12, seed=3)
    assert len({case.name for case in drawn}) == 12
    assert {len(case.effects) for case in drawn} == set(effects)
    assert all(sum(name in UNKNOWN for name in case.effects) == unknown for case in drawn)
    assert cases(which, 5, seed=3) == drawn[:5]


def test_in_a_crowded_case_a_motor_is_at_its_limit_or_there_is_play():
    drawn = cases("crowded", 24, seed=3)
    assert {case.effects[0] for case in drawn} == {"actuator_saturation", "backlash"}
    assert all(len(set(case.effects)) == len(case.effects) in (3, 4) for case in drawn)
    assert not any({"backlash", "flexible_coupling"} <= set(case.effects) for case in drawn)


def test_limit_is_reached_for_the_given_share():
    drive = draw_drive(np.random.default_rng(4))
    q_ref = laps(np.random.default_rng(4), drive.travel, list(drive.speeds), drive.acceleration, 1, drive.period)
    limit = limit_at_share(drive, q_ref, {}, 0.1)
    u = run(drive, q_ref, numbers(clip=limit))[1]
    assert np.mean(np.abs(u[SKIP:]) >= limit) == pytest.approx(0.1, abs=0.01)


@pytest.mark.study("generates six cases")
def test_a_small_effect_is_a_share_of_an_ordinary_one():
    assert {case.share for case in cases("small", 6)} == set(SMALL)
    case = Case(("elastic_force",), 1, 0)
    whole, tenth = (make(each, seed=2)["truth.json"] for each in (case, replace(case, share=0.1)))
    stiffness = [truth["parameters"]["elastic_force"]["stiffness"] for truth in (whole, tenth)]
    assert stiffness[1] == pytest.approx(0.1 * stiffness[0])
    assert tenth["own_gap"]["elastic_force"] == pytest.approx(0.1 * whole["own_gap"]["elastic_force"], rel=0.25)


def test_effects_are_those_of_the_package():
    from emps_design.effects import EFFECTS as package

    assert {*EFFECTS, *FURTHER, *TURNING} == {effect.name for effect in package}
    assert set(TURNING) == {effect.name for effect in package if effect.motion}


@pytest.mark.study("a generated case")
def test_folder_of_a_case(tmp_path):
    for name in ("a", "b"):
        assert main([str(tmp_path / name), "--seed", "3", "--cases", "quick", "--only", "position_ripple-1"]) == 0
    case = tmp_path / "a" / "position_ripple-1"
    for file in ("axis.toml", "truth.json", "train.npz", "holdout.npz"):
        assert (case / file).read_bytes() == (tmp_path / "b" / case.name / file).read_bytes()
    truth = json.loads((case / "truth.json").read_text())
    assert truth["effects"] == ["position_ripple"]
    assert truth["detectable"]
    assert truth["baseline_closed_loop"] > 1.5 * truth["floor_closed_loop"]
    mass = tomllib.loads((case / "axis.toml").read_text())["mechanics"]["mass"]
    assert 0.95 < mass / truth["baseline"]["mass"] < 1.05
    record = np.load(case / "train.npz")
    lap = record["t"].size // 3
    np.testing.assert_array_equal(record["q_ref"][:lap], record["q_ref"][lap : 2 * lap])


def test_a_healthy_drive_has_no_gap():
    truth = make(cases("healthy")[0], seed=5)["truth.json"]
    assert truth["effects"] == ["none"]
    assert truth["baseline_closed_loop"] == pytest.approx(truth["floor_closed_loop"], rel=0.02)


def test_a_baseline_stays_within_its_bounds():
    rng = np.random.default_rng(4)
    drive = draw_drive(rng)
    q_ref = laps(rng, drive.travel, drive.speeds, drive.acceleration, 1, drive.period)
    u = run(replace(drive, viscous=-2 * drive.viscous), q_ref, numbers())[1]  # a plant that drives itself
    fitted = refit(drive, q_ref, u)
    assert fitted.viscous == 0.0
    assert fitted.mass == pytest.approx(drive.mass, rel=0.05)


def test_an_unknown_number_is_refused():
    assert numbers(spring=2.0)[NAMES.index("spring")] == 2.0
    with pytest.raises(KeyError, match="no such number of the plant: sprung"):
        numbers(sprung=2.0)
