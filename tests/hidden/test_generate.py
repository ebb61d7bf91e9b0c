"""The generator keeps its promises: same seed same bytes, honest floors, healthy drives without a gap."""

import json
import tomllib

import numpy as np
import pytest

from tests.hidden.drives import EFFECTS, FURTHER, TURNING, UNKNOWN
from tests.hidden.generate import cases, main, make
from tests.hidden.plant import NAMES, numbers


def test_sets_are_complete():
    whole = cases("all")
    assert len(whole) == len({case.name for case in whole}) == 64
    singles = [case.effects[0] for case in whole if len(case.effects) == 1]
    assert all(singles.count(name) == 2 for name in (*EFFECTS, *UNKNOWN))
    assert sum(not case.effects for case in whole) == 8
    assert sum(len(case.effects) == 2 for case in whole) == 8


def test_effects_are_those_of_the_package():
    from emps_design.effects import EFFECTS as package

    assert {*EFFECTS, *FURTHER, *TURNING} == {effect.name for effect in package}
    assert set(TURNING) == {effect.name for effect in package if effect.motion}


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


def test_an_unknown_number_is_refused():
    assert numbers(spring=2.0)[NAMES.index("spring")] == 2.0
    with pytest.raises(KeyError, match="no such number of the plant: sprung"):
        numbers(sprung=2.0)
