"""Verdict, headline and exit status of an impedance law are those of the worst plant that is simulated."""

import json

import pytest

from emps_design.cli.app import run
from emps_design.comanipulation.assessment import SWINGS, assess_impedance
from emps_design.comanipulation.run import run_task
from emps_design.comanipulation.task import fitted_task
from emps_design.control.impedance.law import impedance_law
from emps_design.control.sampled import worst_loop
from emps_design.machines import machine

BELT = machine("emps2018").replace(
    name="belt",
    mechanics={"mass": 25.0, "viscous": 60.0, "coulomb": 8.0, "offset": 0.0},
    drive={"force_gain": 20.0, "command_limit": 24.0, "current_time_constant": 0.5e-3},
    sampling={"encoder_resolution": 2e-5},
)
ASKED = ("--mass", "5", "--damping", "60", "--mismatch", "0.02", "--plants", "5")


@pytest.fixture(scope="module")
def belt(tmp_path_factory):
    path = tmp_path_factory.mktemp("belt") / "belt.toml"
    path.write_text(BELT.to_toml(), encoding="utf-8")
    return str(path)


@pytest.mark.usefixtures("few_estimates")
@pytest.mark.parametrize("command", [("impedance",), ("simulate", "--scenario", "comanipulation")], ids="-".join)
def test_five_unstable_plants_of_five_exit_4(command, belt, capsys):
    """The poles are stable, with exact estimates and at every corner: only the simulation has the encoder."""
    name, *rest = command
    assert run([name, belt, *rest, *ASKED, "--json"]) == 4
    out, err = capsys.readouterr()
    found = json.loads(out)
    study = found["mismatch"] if name == "impedance" else found["study"]
    assert found["verdict"] == study["worst"]["verdict"] == "unstable"
    assert study["verdicts"]["unstable"] == 5
    assert found["headline"].startswith("unstable: the released carriage diverges or oscillates between the limits")
    assert "in 13 of 13 plants simulated within +-2 %" in found["headline"]
    assert found["reason"].startswith(found["headline"])
    assert found["reason"] in err
    law = impedance_law(BELT, found["nearest"]["mass"], found["nearest"]["damping"], found["nearest"]["filter"])
    assert run_task(BELT, law, fitted_task(BELT, law)).verdict not in SWINGS


@pytest.mark.usefixtures("no_walls")
def test_the_law_that_is_proposed_passes_where_the_other_failed():
    nearest = assess_impedance(BELT, 5.0, 60.0, 0.02, plants=0).nearest
    again = assess_impedance(BELT, nearest["mass"], nearest["damping"], 0.02, nearest["filter"], plants=100, seed=3)
    assert again.stable


def test_a_law_without_a_mismatch_is_refused_where_it_swings(belt, capsys):
    assert run(["impedance", belt, "--mass", "5", "--damping", "60", "--json"]) == 4
    found = json.loads(capsys.readouterr().out)
    assert found["sampled"]["stable"]
    assert found["verdict"] == found["sampled"]["simulated"] == "unstable"
    assert found["wall_limit"] == {}  # nothing to press against a wall


@pytest.mark.study("32 plants")
def test_creep_is_in_the_headline_with_how_many_and_exits_0(capsys):
    assert run(["impedance", "emps2018-two-quadrant", "--mass", "50", "--damping", "100", "--mismatch", "0.02"]) == 0
    first = " ".join(capsys.readouterr().out.split())
    said = "CREEPING: the released carriage creeps on in 176 of 232 plants simulated within +-2 %, at up to 3.84 mm/s"
    assert first.startswith(said)


@pytest.mark.study("long runs")
@pytest.mark.parametrize(("resolution", "ended"), [(5e-8, False), (2e-5, True)])
def test_a_creep_that_the_encoder_ends_is_none(resolution, ended):
    """One of 3.84 mm/s shows no step of 20 um in two periods: the estimate is 0 and nothing drives the carriage."""
    axis = machine("emps2018").replace(sampling={"encoder_resolution": resolution})
    found = assess_impedance(axis, 50.0, 100.0, 0.02, plants=0)
    document = found.to_dict()["mismatch"]
    assert 1e3 * document["creep_speed_exact_encoder"] == pytest.approx(3.84, abs=0.005)
    assert document["creep_speed"] == (0.0 if ended else document["creep_speed_exact_encoder"])
    assert ("creeping" in document["verdicts"] and found.verdict == "creeping") != ended
    assert any("makes the released carriage creep" in text for text in found.to_dict()["warnings"]) != ended


@pytest.mark.usefixtures("few_estimates")
@pytest.mark.parametrize(("name", "mass"), [("emps2019", 190.2178), ("emps2018", 231.463)])
def test_twice_the_mass_is_singular_in_the_printed_law_alone(name, mass, capsys):
    assert run(["impedance", name, "--mass", str(mass), "--damping", "500", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["derived"] == {"apparent_mass": mass, "apparent_damping": 500.0, "coulomb_left": 0.0}
    assert set(found["printed"].values()) == {None}
    assert any(text.startswith("printed is undefined: with M_a = 2 M") for text in found["warnings"])
    assert run(["impedance", name, "--mass", str(mass), "--damping", "500"]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if "(30) as printed" in line)
    assert row.count("undefined") == 3


@pytest.mark.usefixtures("few_estimates")
@pytest.mark.parametrize(
    ("effect", "mass", "damping"),
    [
        ({"kind": "flexible_coupling", "frequency": 80.0, "damping": 0.05, "share": 0.1}, 30.0, 300.0),
        ({"kind": "stribeck_friction", "excess": 5.0, "stribeck_velocity": 0.1, "exponent": 2.0}, 60.0, 100.0),
    ],
)
def test_effects_and_wrong_estimates_together_decide(effect, mass, damping):
    """Neither the effect with exact estimates nor estimates off by 20 % on the rigid axis are unstable."""
    axis = machine("emps2018").replace(effects=[effect])
    assert assess_impedance(axis, mass, damping).poles_stable
    assert assess_impedance(axis.replace(effects=[]), mass, damping, 0.2, plants=0).poles_stable
    both = assess_impedance(axis, mass, damping, 0.2, plants=0)
    assert (both.verdict, worst_loop(both.loops).margins.stable) == ("unstable", False)
    assert both.reason.startswith("unstable: at a corner of +-20 % a pole reaches modulus 1.00")
    proposed = assess_impedance(axis, **(both.nearest or {}), mismatch=0.2, plants=0)
    assert proposed.stable
    assert worst_loop(proposed.loops).margins.stable
