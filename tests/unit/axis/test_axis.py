"""An axis file comes back as it was written; what cannot be meant is refused in one line that names the place."""

import math

import pytest

from emps_design.axis import Axis
from emps_design.errors import AxisError
from emps_design.machines import load_axis, machine, machine_names

TEXT = """
[mechanics]
mass = 95.1
viscous = 203.5
coulomb = 20.4
[drive]
force_gain = 35.15
[sampling]
period = 1e-3
[controller]
kind = "position_pd"
kp = 160.18
kv = 243.45
"""


def test_defaults():
    axis = Axis.from_toml(TEXT)
    assert axis.drive.voltage_limit == 10.0
    assert axis.sampling.computation_delay == 0
    assert axis.controller.velocity_estimator == "two_tap"
    assert axis.effects == ()
    assert axis.mechanics.array().tolist() == [95.1, 203.5, 20.4, 0.0]


@pytest.mark.parametrize("name", machine_names())
def test_embedded_machines_come_back(name):
    axis = machine(name)
    assert axis.name == name
    assert Axis.from_toml(axis.to_toml()) == axis


def test_two_quadrant_column_is_table_one():
    axis = machine("emps2018-two-quadrant")
    extra = axis.effects[0].parameters["viscous_difference"]
    assert axis.mechanics.viscous + extra == pytest.approx(474.9727)
    assert axis.mechanics.viscous - extra == pytest.approx(563.8568)
    assert axis.mechanics.coulomb + axis.mechanics.offset == pytest.approx(17.3811)
    assert axis.mechanics.coulomb - axis.mechanics.offset == pytest.approx(11.5846)


def test_force_gain_from_the_data_sheet():
    sheet = "current_gain = 2.0\nreduction = 1256.637\ntorque_constant = 0.014"
    axis = Axis.from_toml(TEXT.replace("force_gain = 35.15", sheet))
    assert axis.drive.force_gain == pytest.approx(2.0 * 1256.637 * 0.014)
    assert Axis.from_toml(axis.to_toml()) == axis


def test_effects_survive_a_file():
    parameters = {"excess": 8.0, "stribeck_velocity": 0.01, "exponent": 1.0}
    axis = machine("emps2019").replace(effects=[{"kind": "stribeck_friction", **parameters}])
    again = Axis.from_toml(axis.to_toml())
    assert again == axis
    assert again.effects[0].parameters == parameters
    assert again.replace(effects=again.effects).effects == axis.effects


def test_replace_keeps_the_rest():
    axis = machine("emps2019")
    changed = axis.replace(mechanics={"mass": 100.0}, sampling=axis.sampling, name="other")
    assert (changed.mechanics.mass, changed.mechanics.viscous, changed.name) == (100.0, 203.5034, "other")


def test_frozen():
    with pytest.raises(ValueError, match="frozen"):
        machine("emps2019").mechanics.mass = 1.0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass = 95.1", "mass = -1.0", "mechanics.mass: found -1.0 kg, expected a number greater than 0 [kg]"),
        ("mass = 95.1", "mass = nan", "mechanics.mass: found nan kg, expected a finite number"),
        ("mass = 95.1", "mass = 'big'", "mechanics.mass: found 'big', expected a number [kg]"),
        ("mass = 95.1", "mass = true", "mechanics.mass: found True, expected a number [kg]"),
        ("mass = 95.1", "", "mechanics.mass: missing, expected a number [kg]: load-side equivalent mass M"),
        ("viscous = 203.5", "viscuos = 203.5", "mechanics.viscuos: unknown key, did you mean 'viscous'?"),
        ("[drive]\nforce_gain = 35.15", "", "drive: missing, expected a table [drive]"),
        ("[mechanics]", "parameters = []\n[mechanics]", "parameters: unknown key (known: name, mechanics"),
        ("[mechanics]", "colour = 1\n[mechanics]", "colour: unknown key (known: name, mechanics"),
        ("period = 1e-3", "period = 0", "sampling.period: found 0 s, expected a number greater than 0"),
        ("period = 1e-3", "period = 1e-3\ncomputation_delay = 1.5", "computation_delay: found 1.5 samples, expected"),
        ("force_gain = 35.15", "current_gain = 2.0", "drive: give all of current_gain, reduction, torque_constant"),
        (
            "force_gain = 35.15",
            "force_gain = 35.15\ncurrent_gain = 2.0\nreduction = 1.0\ntorque_constant = 1.0",
            "drive: force_gain 35.15 N/V is not current_gain x reduction x torque_constant = 2 N/V",
        ),
        (
            "force_gain = 35.15",
            "current_gain = 'two'\nreduction = 1.0\ntorque_constant = 1.0",
            "drive: current_gain, reduction, torque_constant: expected three numbers",
        ),
        ("kp = 160.18", "", "controller: kind 'position_pd' needs kp"),
        ("'position_pd'", "'pid'", "found 'pid', expected 'position_pd', 'ip_velocity', 'impedance', 'cascade', 'p' or 'none'"),
        ("[sampling]", "[sampling", "axis.toml: not TOML, "),
    ],
)
def test_refused(old, new, message):
    text = TEXT.replace('"position_pd"', "'position_pd'")
    assert old in text
    with pytest.raises(AxisError) as caught:
        Axis.from_toml(text.replace(old, new), "axis.toml")
    assert message in str(caught.value)
    assert str(caught.value).startswith("axis.toml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        ({"kind": "stribek_friction"}, "expected one of"),
        ({"kind": "stribek_friction"}, "did you mean 'stribeck_friction'?"),
        ({}, "effects.0.kind: missing"),
        ({"kind": "stribeck_friction"}, "missing parameter excess, stribeck_velocity"),
        ({"kind": "stribeck_friction", "excess": "much"}, "effects.0.excess: found 'much', expected a number"),
        (
            {"kind": "stribeck_friction", "excess": 8.0, "stribeck_velocity": 0.01, "exponent": 5.0},
            "exponent: found 5, expected a number in [1, 2]",
        ),
        (
            {"kind": "stribeck_friction", "excess": 8.0, "velocity": 0.01},
            "effect stribeck_friction: unknown parameter 'velocity'",
        ),
        ({"kind": "stribeck_friction", "excess": math.inf}, "effects.0.excess: found inf, expected a finite number"),
    ],
)
def test_refused_effects(effect, message):
    table = {**machine("emps2019").to_dict(), "effects": [effect]}
    with pytest.raises(AxisError) as caught:
        Axis.from_dict(table, "axis.toml")
    assert message in str(caught.value)
    assert str(caught.value).startswith("axis.toml: ")


def test_effects_of_another_shape():
    for wrong in ("stribeck_friction", {"kind": "stribeck_friction"}, [3]):
        with pytest.raises(AxisError, match=r"axis\.toml: effects"):
            Axis.from_dict({**machine("emps2019").to_dict(), "effects": wrong}, "axis.toml")


def test_load(tmp_path):
    (tmp_path / "a.toml").write_text(TEXT)
    assert load_axis(tmp_path / "a.toml").mechanics.mass == 95.1
    assert load_axis("emps2018").name == "emps2018"
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe")
    (tmp_path / "huge.toml").write_text("#" * 2_000_000)
    for path, message in (
        (tmp_path / "none.toml", r"none\.toml: No such file or directory; expected a TOML axis file"),
        (tmp_path, "Is a directory; expected a TOML axis file"),
        (tmp_path / "b.toml", r"b\.toml: not UTF-8 text"),
        (tmp_path / "huge.toml", r"huge\.toml: found more than 1 MB"),
        ("emps2017", "found 'emps2017', expected a TOML file or one of emps2018, .* did you mean 'emps201"),
        ("a\0b.toml", "null"),
    ):
        with pytest.raises(AxisError, match=message):
            load_axis(path)
