"""The commands gains, force and derive: keys, exit statuses, one-line messages, a start-up without heavy imports."""

import json
import subprocess
import sys

import pytest

from emps_design.cli.app import run
from emps_design.machines import machine


def document(capsys, *arguments, status=0):
    assert run([*arguments, "--json"]) == status
    return json.loads(capsys.readouterr().out)


def test_gains_of_the_paper(capsys):
    found = document(capsys, "gains", "--crossover", "100", "--phase-margin", "60")
    assert found["k_v1"] == pytest.approx(556.766, abs=5e-4)
    assert found["t_v"] == pytest.approx(8.45505e-3, abs=5e-9)
    assert found["plant_input"]["crossover"] == pytest.approx(197.15, abs=0.01)
    assert found["sampled"]["phase_margin_deg"] == pytest.approx(39.18, abs=0.01)
    assert found["feasible_phase_margin_deg"] == pytest.approx([2.35, 90.0], abs=1e-3)
    assert found["requested"] == {"crossover": 100.0, "phase_margin_deg": 60.0}
    assert any("bandwidth has two meanings" in warning for warning in found["warnings"])


def test_gains_from_a_bandwidth_say_so(capsys):
    found = document(capsys, "gains", "emps2019", "--bandwidth", "160", "--phase-margin", "60")
    assert found["bandwidth"] == pytest.approx(160.0)
    assert found["requested"] == {"bandwidth": 160.0, "phase_margin_deg": 60.0}


def test_numbers_given_take_the_place_of_the_axis(capsys):
    numbers = ["--mass", "10", "--viscous", "20", "--force-gain", "5", "--period", "0.0005"]
    found = document(capsys, "gains", "--crossover", "50", *numbers)
    assert found["k_v1"] == pytest.approx((10 * 50 * 3**0.5 - 20) / 5)
    assert found["sampled"]["period"] == 0.0005


def test_retuned_gains(capsys):
    found = document(capsys, "gains", "--crossover", "100", "--phase-margin", "50", "--retune")
    assert found["retuned"]
    assert found["sampled"]["phase_margin_deg"] == pytest.approx(50.0, abs=1e-6)
    assert found["sampled"]["crossover"] == pytest.approx(100.0)
    assert any("at the plant input (crossover 100 rad/s, phase margin 50 deg)" in text for text in found["warnings"])


def test_unstable_design_exits_4_and_still_prints(capsys):
    arguments = ("gains", "--crossover", "100", "--phase-margin", "80", "--computation-delay", "1")
    found = document(capsys, *arguments, status=4)
    assert not found["sampled"]["stable"]
    assert found["sampled"]["phase_margin_deg"] is None
    assert "unstable" in found["warnings"][0]
    assert "largest pole is 1.04" in found["reason"]
    nearest = found["nearest"]
    again = document(
        capsys, "gains", "--computation-delay", "1", "--crossover", str(nearest["crossover"]),
        "--phase-margin", str(nearest["phase_margin_deg"]),
    )  # fmt: skip
    assert again["sampled"]["stable"]


@pytest.mark.parametrize("phase", ["0", "90", "-10", "2"])
def test_infeasible_pair_exits_3_with_the_nearest(capsys, phase):
    found = document(capsys, "gains", "--crossover", "100", "--phase-margin", phase, status=3)
    assert "limit binds" in found["reason"]
    assert {"crossover", "phase_margin_deg"} <= set(found["nearest"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gains"], "found neither of crossover and bandwidth"),
        (["gains", "--crossover", "1", "--bandwidth", "1"], "found both of crossover and bandwidth"),
        (["gains", "--crossover", "100", "--mass", "-5"], "mechanics.mass: found -5"),
        (["gains", "--crossover", "100", "--mismatch", "2"], "mismatch: found 2"),
        (["gains", "--crossover", "100", "--mismatch", "0.02", "--sigma-from", "x"], "found both --mismatch and"),
        (["gains", "--crossover", "100", "--sigma-from", "nowhere.json"], "nowhere.json: No such file"),
        (["gains", "--crossover", "100", "--velocity", "0"], "velocity: found 0 m/s"),
        (["gains", "nosuch", "--crossover", "100"], "axis: found 'nosuch'"),
        (["force"], "k_e1: found none"),
        (["force", "--k-e1", "0"], "k_e1: found 0"),
        (["force", "--k-e1", "-1"], "k_e1: found -1"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(capsys, arguments, message):
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert message in err


@pytest.mark.parametrize(
    ("text", "message"),
    [("not json", "not JSON"), ("{}", "no 'parameters' table"), ('{"parameters": {"mass": {}}}', "mass has no std")],
)
def test_identification_that_is_none(capsys, tmp_path, text, message):
    (tmp_path / "identified.json").write_text(text)
    assert run(["gains", "--crossover", "100", "--sigma-from", str(tmp_path / "identified.json")]) == 2
    assert message in capsys.readouterr().err


def test_mismatch_and_identified_deviations(capsys, tmp_path):
    found = document(capsys, "gains", "--crossover", "100", "--mismatch", "0.02")
    assert found["mismatch"]["stable_share"] == 1.0
    parameters = {"mass": {"value": 115.7, "std": 0.3}, "viscous": {"value": 475.0, "std": 9.0}}
    (tmp_path / "identified.json").write_text(json.dumps({"parameters": parameters}))
    found = document(capsys, "gains", "--crossover", "100", "--sigma-from", str(tmp_path / "identified.json"))
    assert found["mismatch"]["corners"] == 4


@pytest.mark.parametrize(
    ("entry", "share"),
    [
        ({"std": 0.3, "std_long_run": 0.9}, 1.8),
        ({"std": 0.3, "interval_95": [110.0, 120.0]}, 5.0),  # a filter's error and Student's t are in the interval
        ({"std": 0.3, "interval_95": [115.0, 116.0], "interval_95_bootstrap": [113.0, 117.0]}, 2.0),
        ({"mean": 115.0, "spread": 2.0, "std": 0.3}, 4.0),  # several records
        ({"std": 0.3, "std_bootstrap": None, "interval_95_bootstrap": None}, 0.6),
    ],
)
def test_the_whole_uncertainty_counts(capsys, tmp_path, entry, share):
    parameters = {"mass": entry, "viscous": {"std": 9.0}}
    (tmp_path / "identified.json").write_text(json.dumps({"parameters": parameters}))
    found = document(capsys, "gains", "--crossover", "100", "--sigma-from", str(tmp_path / "identified.json"))
    assert found["mismatch"]["errors"]["mass"] == pytest.approx(share / 115.7315)


def test_force_against_a_wall(capsys):
    found = document(capsys, "force", "--k-e1", "0.01", "--environment", "1e4")
    assert found["stable"]
    limits = found["k_e1_max"]
    assert limits["sensor_only"]["continuous"] == pytest.approx(100 * 3**0.5 / 1e4)
    assert limits["continuous"] == limits["sensor_and_carriage"]["continuous"]
    unstable = document(capsys, "force", "--k-e1", "0.02", "--environment", "1e4", status=4)
    assert not unstable["stable"]
    assert unstable["nearest"]["k_e1"] < limits["sampled"]


def test_force_uses_the_gains_of_the_axis(capsys, tmp_path):
    from emps_design.machines import machine

    controller = {"kind": "ip_velocity", "k_v1": 500.0, "t_v": 0.01, "k_e1": 0.004}
    (tmp_path / "axis.toml").write_text(machine("emps2018").replace(controller=controller).to_toml())
    found = document(capsys, "force", str(tmp_path / "axis.toml"))
    assert (found["k_v1"], found["t_v"], found["k_e1"]) == (500.0, 0.01, 0.004)
    assert found["operator"]["hand"] == pytest.approx(250.0)


def test_force_goes_around_the_loop_that_the_drive_runs(capsys, tmp_path):
    controller = {"kind": "cascade", "position": {"kp": 20.0}, "velocity": {"kp": 300.0, "ti": 0.03}}
    low = [{"kind": "lowpass", "frequency": 200.0}]
    path = tmp_path / "drive.toml"
    path.write_text(machine("emps2018").replace(controller={**controller, "filters": low}).to_toml())
    found = document(capsys, "force", str(path), "--k-e1", "0.004", "--environment", "1e4")
    assert (found["structure"], found["k_v1"], found["t_v"], found["filters"]) == ("pi", 300.0, 0.03, low)
    line = ("force", "--k-e1", "0.004", "--environment", "1e4", "--crossover", "60", "--structure", "pi")
    assert document(capsys, *line)["structure"] == "pi"
    assert run([*line, "--out", str(tmp_path / "force.toml")]) == 2
    assert "found a PI velocity loop, expected IP without filters" in capsys.readouterr().err
    assert not (tmp_path / "force.toml").exists()


def test_designs_become_axis_files(capsys, tmp_path):
    gains, force = str(tmp_path / "gains.toml"), str(tmp_path / "force.toml")
    found = document(capsys, "gains", "--crossover", "80", "--out", gains)
    assert found["out"] == gains
    again = document(capsys, "force", gains, "--k-e1", "0.004", "--out", force)
    assert (again["k_v1"], again["t_v"]) == (found["k_v1"], found["t_v"])
    assert document(capsys, "force", force)["k_e1"] == 0.004
    unstable = tmp_path / "unstable.toml"
    document(capsys, "gains", "--crossover", "900", "--out", str(unstable), status=4)
    assert not unstable.exists()
    assert run(["gains", "--crossover", "80", "--out", str(tmp_path / "missing" / "x.toml")]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_derive_prints_steps_and_errata(capsys):
    found = document(capsys, "derive")
    numbers = [step["number"] for step in found["cascade"]["steps"] if step["number"]]
    assert numbers == ["6", "7", "7", "8", "9", "9", "9", "10", "11", "10"]
    assert {"8", "9", "10", "13", "15", "18", "26", "30"} <= {step["number"] for step in found["errata"]}
    assert found["cost_of_printed_30"]["printed"]["apparent_mass"] == pytest.approx(73.8, abs=0.05)
    assert found["warnings"] == []
    assert run(["derive", "--latex", "--json"]) == 2  # one document or the other
    assert "--json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        (["gains", "--crossover", "100", "--mismatch", "0.02"], 0, "is stable"),
        (["gains", "--crossover", "100", "--phase-margin", "85", "--computation-delay", "2"], 4, "is UNSTABLE"),
        (["force", "--k-e1", "0.01", "--environment", "1e4"], 0, "sensor and carriage"),
        (["derive"], 0, "Where the paper differs"),
    ],
)
def test_text_output(capsys, arguments, status, expected):
    assert run(arguments) == status
    assert expected in capsys.readouterr().out


def test_gains_start_without_heavy_imports():
    """The start-up budget: none of the slow libraries on the way to the numbers."""
    program = (
        "import sys; from emps_design.cli.app import run; "
        "status = run(['gains', '--crossover', '100', '--phase-margin', '60', '--mismatch', '0.02', '--json']); "
        "slow = {'control', 'sympy', 'scipy', 'numba', 'matplotlib', 'statsmodels', 'rich'} & set(sys.modules); "
        "sys.exit(f'imported {sorted(slow)}' if slow else status)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["sampled"]["stable"]
