"""A closed loop that diverges: exit status 4 with its JSON, the reason, and a number of the controller that runs."""

import json

import numpy as np
import pytest

from emps_design.cli.app import run
from emps_design.control.discretisation import sample_axis
from emps_design.errors import SimulationError, UnstableError
from emps_design.machines import machine
from emps_design.simulation.scenarios import follow, replay
from emps_design.simulation.synthetic import synthetic_record

LIGHT = machine("emps2019").replace(
    mechanics={"mass": 0.05, "viscous": 0.1, "coulomb": 0.01, "offset": 0.0},
    drive={"force_gain": 0.5},
    sampling={"period": 2.5e-4, "encoder_resolution": 1e-6},
    controller={"kp": 100.0, "kv": 20.0},
)


def largest_pole(axis):
    """Of the position law around the linear plant, written out here."""
    plant, T = sample_axis(axis), axis.sampling.period
    kp, kv, n = axis.controller.kp, axis.controller.kv, plant.C.size
    loop, volts = np.zeros((n + 2, n + 2)), np.zeros(n + 2)
    volts[:n], volts[n + 1] = -(kp * kv + 0.5 * kv / T) * plant.C, 0.5 * kv / T
    loop[:n, :n], loop[n, :n], loop[n + 1, n] = plant.Phi, plant.C, 1.0
    loop[:n] += np.outer(plant.G0, volts)
    return np.max(np.abs(np.linalg.eigvals(loop)))


def sine(axis, amplitude=0.05):
    t = np.arange(round(4.0 / axis.sampling.period)) * axis.sampling.period
    return amplitude * (1.0 - np.cos(2.0 * t))


@pytest.mark.parametrize(
    ("axis", "numbers"),
    [
        (machine("emps2019"), {"kp": 5000.0}),
        (machine("emps2019"), {"kv": 9000.0}),
        (LIGHT, {"kp": 40000.0}),
        (LIGHT, {"kv": 3000.0}),
    ],
    ids=["kp", "kv", "light-kp", "light-kv"],
)
def test_the_number_proposed_is_stable_by_its_poles_with_room_to_spare(axis, numbers):
    bad = axis.replace(controller=numbers)
    assert largest_pole(bad) > 1.0
    with pytest.raises(UnstableError, match="nearest that works: k") as caught:
        follow(bad, sine(axis))
    nearest = caught.value.nearest
    assert len(nearest) == 1
    assert largest_pole(bad.replace(controller=nearest)) < 1.0
    (name, value), own = next(iter(nearest.items())), bad.controller
    toward = 1.2 if getattr(own, name) > value else 1.0 / 1.2
    assert largest_pole(bad.replace(controller={name: toward * value})) < 1.0
    follow(bad.replace(controller=nearest), sine(axis))


def test_what_no_number_of_the_controller_mends():
    """Friction that drives the carriage harder than the voltage can hold it."""
    effect = {"kind": "asymmetric_viscous_friction", "viscous_difference": -5000.0}
    axis = machine("emps2019").replace(effects=[effect])
    with pytest.raises(UnstableError, match="changing a single controller parameter does not make it stable") as caught:
        follow(axis, sine(axis, 0.3))
    assert caught.value.nearest == {}


def test_the_command_says_so_and_exits_4(tmp_path, capsys):
    record = tmp_path / "record.npz"
    synthetic_record(machine("emps2019"), laps=1, stroke=0.1).save(record)
    (tmp_path / "axis.toml").write_text(machine("emps2019").replace(controller={"kp": 5000.0}).to_toml())
    words = ["simulate", str(tmp_path / "axis.toml"), "--scenario", "replay", "--record", str(record)]
    assert run([*words, "--json"]) == 4
    caught = capsys.readouterr()
    document = json.loads(caught.out)
    assert "the loop is unstable" in document["reason"]
    assert document["reason"] in caught.err
    better = machine("emps2019").replace(controller=document["nearest"])
    (tmp_path / "axis.toml").write_text(better.to_toml())
    assert run([*words, "--json"]) == 0


def test_an_open_loop_that_diverges_has_no_nearest(tmp_path, capsys):
    record = synthetic_record(machine("emps2019"), laps=1, stroke=0.1)
    record.save(tmp_path / "record.npz")
    effect = {"kind": "asymmetric_viscous_friction", "viscous_difference": -5000.0}
    axis = machine("emps2019").replace(effects=[effect], controller={"kind": "none"})
    with pytest.raises(SimulationError):
        replay(axis, record)
    (tmp_path / "axis.toml").write_text(axis.to_toml())
    assert run(["simulate", str(tmp_path / "axis.toml"), "--record", str(tmp_path / "record.npz"), "--json"]) == 4
    assert json.loads(capsys.readouterr().out)["nearest"] == {}
