"""``emps-design impedance``: keys, exit status, and one line for bad input."""

import json
import re

import pytest

from emps_design.cli.app import run
from tests.studies import quick

QUICK = pytest.mark.usefixtures("few_estimates")
SEARCH = pytest.mark.study("the nearest law that works under a mismatch")


def called(capsys, *arguments: str) -> tuple[int, str, str]:
    status = run(["impedance", *arguments])
    out, err = capsys.readouterr()
    return status, out, err


def test_json_has_the_contracts_keys(capsys):
    status, out, _ = called(
        capsys, "--mass", "50", "--damping", "100", "--mismatch", "0.02", "--plants", "10", "--json"
    )
    found = json.loads(out)
    assert status == 0
    assert found["derived"] == {"apparent_mass": 50.0, "apparent_damping": 100.0, "coulomb_left": 0.0}
    assert {k: round(v, 1) for k, v in found["printed"].items()} == {
        "apparent_mass": 73.8, "apparent_damping": 235.8, "coulomb_left": 6.3
    }  # fmt: skip
    assert found["sampled"]["stable"] is True
    assert all(abs(complex(*pole)) < 1.0 for pole in found["sampled"]["poles"])
    mismatch = found["mismatch"]
    assert 1e3 * mismatch["creep_speed"] == pytest.approx(3.84, abs=0.005)
    assert mismatch["dead_band"] == pytest.approx(0.3476, abs=1e-4)
    assert mismatch["worst"]["verdict"] == "creeping"
    assert mismatch["bounded_share"] == 1.0
    assert mismatch["stable_share"] < 0.8  # the others creep
    assert set(mismatch["not_varied"]) >= {"force_gain", "filter"}
    assert {one["verdict"] for one in mismatch["beyond"]} <= {"creeping", "limit_cycle", "unstable"}
    assert found["equivalent_loop"]["k_e1"] == 0.01
    assert found["equivalent_loop"]["criterion"] == "low_frequency"
    assert any("Coulomb factor of 0.9804" in warning for warning in found["warnings"])


@QUICK
@pytest.mark.study("a study under mismatch, twice")
def test_same_call_same_bytes(capsys):
    arguments = ("--mass", "50", "--damping", "100", "--mismatch", "0.02", "--plants", "3", "--json")
    assert called(capsys, *arguments)[1] == called(capsys, *arguments)[1]


@QUICK
@pytest.mark.parametrize(
    "arguments",
    [
        ("--mass", "50", "--damping", "100", "--mismatch", "0.02", "--filter", "200", "--unfiltered-current"),
        pytest.param(("--mass", "1", "--damping", "5", "--mismatch", "0.02"), marks=SEARCH),
        pytest.param(("--mass", "50", "--damping", "100", "--filter", "inf"), marks=SEARCH),
        pytest.param(("--mass", "13.1", "--damping", "100", "--filter", "200", "--mismatch", "0.4"), marks=SEARCH),
    ],
)
def test_unstable_law_exits_4_with_the_nearest_stable_one(capsys, arguments):
    drawn = ("--plants", "5") if "--mismatch" in arguments else ()  # without a mismatch there is nothing to draw
    status, out, err = called(capsys, *arguments, *drawn, "--json")
    found = json.loads(out)
    assert status == 4
    assert found["reason"].startswith("unstable: ")
    assert err.strip().splitlines()[-1] == f"emps-design: {found['reason']}"
    nearest = found["nearest"]
    again = [f"--{name}={value!r}" for name, value in nearest.items()]
    if "--mismatch" in arguments:
        again += ["--mismatch", arguments[arguments.index("--mismatch") + 1], "--plants", "0"]
    assert called(capsys, *again, "--json")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--mass", "0", "--damping", "100"), "M_a: found 0, expected more than 0"),
        (("--mass", "50", "--damping", "-1"), "damping B: found -1, expected at least 0"),
        (("--mass", "50", "--damping", "100", "--mismatch", "1.5"), "mismatch: found 1.5"),
        (("--mass", "50", "--damping", "100", "--filter", "5000"), "filter: found 5000 rad/s, expected less than the"),
        (("--mass", "fifty", "--damping", "100"), "--mass"),
        (("--damping", "100"), "--mass: found none, expected M_a [kg]"),
        (("--mass", "50"), "--damping: found none, expected B [N/(m/s)]"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(capsys, arguments, message):
    status, out, err = called(capsys, *arguments, "--json")
    assert status == 2
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    assert message in err


@QUICK
@pytest.mark.study("a study under mismatch")
def test_text_output_names_what_an_engineer_signs(capsys):
    status, out, _ = called(capsys, "emps2018-two-quadrant", "--mass", "50", "--damping", "100", "--mismatch", "0.02",
                            "--plants", "1")  # fmt: skip
    assert status == 0
    for words in ("as printed", "creep speed", "dead band", "Coulomb factor", "plants that come to rest", "worst"):
        assert words in out


LIGHT = {
    "mechanics": {"mass": 0.3, "viscous": 2.0, "coulomb": 0.8, "offset": 0.0},
    "drive": {"force_gain": 2.0},
}


@QUICK
def test_a_light_carriage_is_felt_in_four_digits(capsys, axis, tmp_path):
    path = tmp_path / "light.toml"
    path.write_text(axis.replace(**LIGHT).to_toml(), encoding="utf-8")
    out = called(capsys, str(path), "--mass", "0.15", "--damping", "0.55")[1]
    cells = [re.split(r"\s{2,}", line.strip()) for line in out.splitlines()]
    rows = {label: values for label, *values in cells}
    assert rows["derived"] == ["0.15", "0.55", "0"]
    assert rows["(30) as printed"] == ["0.2", "1.033", "0.2667"]


@QUICK
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "B = 100 N/(m/s), filter 500 rad/s exact estimates"),
        (("--force-sensor",), "with a force sensor, (28)"),
        *quick(
            [
                (("--unfiltered-current", "--filter", "50"), "filter 50 rad/s, current unfiltered"),
                (("--stiffness", "300"), "K = 300 N/m"),
                (("--coulomb-factor", "0.8"), "Coulomb factor 0.8"),
            ],
            0,
            "more options",
        ),
    ],
)
def test_the_header_names_what_was_asked_of_the_law(capsys, arguments, words):
    assert words in " ".join(called(capsys, "--mass", "80", "--damping", "100", *arguments)[1].split())


@QUICK
def test_with_a_force_sensor_its_own_law_is_felt(capsys):
    """(28): tau_e = M_a qdd + B qd + M_a/M F_c (1 - c), and nothing of the estimated force of (30)."""
    given = ("--mass", "50", "--damping", "100", "--force-sensor", "--coulomb-factor", "0.8")
    out = called(capsys, *given)[1]
    assert "as printed" not in out
    row = next(line for line in out.splitlines() if "(28), measured force" in line)
    left = 50.0 / 115.7315 * 0.2 * 17.3811
    assert re.split(r"\s{2,}", row.strip())[1:] == ["50", "100", f"{left:.4g}"]


@QUICK
def test_zero_damping_is_said_to_coast(capsys):
    status, out, _ = called(capsys, "--mass", "50", "--damping", "0", "--json")
    found = json.loads(out)
    assert status == 0
    assert found["equivalent_loop"]["k_e1"] is None
    assert any("the released carriage does not come to rest" in warning for warning in found["warnings"])


@QUICK
def test_scenario_with_an_unstable_law_exits_4(capsys):
    status = run(
        ["simulate", "--scenario", "comanipulation", "--mass", "1", "--damping", "100", "--plants", "0", "--json"]
    )
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert status == 4
    assert found["verdict"] == "unstable"
    assert found["nearest"]["mass"] > 1.0
    assert found["reason"] in err
    assert run(["simulate", "--scenario", "comanipulation", "--plants", "0", "--json"]) == 0
    capsys.readouterr()


@QUICK
def test_numbers_of_the_axis_controller_are_the_default(capsys, axis, tmp_path):
    path = tmp_path / "own.toml"
    own = axis.replace(controller={"kind": "impedance", "mass": 70.0, "damping": 150.0, "filter": 300.0})
    path.write_text(own.to_toml(), encoding="utf-8")
    status, out, _ = called(capsys, str(path), "--json")
    law = json.loads(out)["law"]
    assert status == 0
    assert (law["mass"], law["damping"], law["filter"]) == (70.0, 150.0, 300.0)
