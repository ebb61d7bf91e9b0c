"""An axis file comes back as it was written; what cannot be meant is refused in one line that names the place."""

import math

import numpy as np
import pytest

from emps_design.axis import NO_LIMIT, Axis
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
    assert axis.drive.command_limit == 10.0
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
        ("[mechanics]", "parameters = []\n[mechanics]", "parameters: unknown key (known: name, motion, mechanics"),
        ("[mechanics]", "colour = 1\n[mechanics]", "colour: unknown key (known: name, motion, mechanics"),
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
        ("'position_pd'", "'pid'", "expected 'position_pd', 'ip_velocity', 'impedance', 'cascade', 'p' or 'none'"),
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


ROTARY = """
name = "joint"
motion = "rotary"
[mechanics]
mass = 5e-6
viscous = 5e-6
coulomb = 1.9e-3
[drive]
command = "current"
force_gain = 0.0257
command_limit = 2.0
[sampling]
period = 1e-3
encoder_resolution = 3e-6
"""


def test_a_rotary_axis_comes_back_and_speaks_its_own_units():
    axis = Axis.from_toml(ROTARY)
    assert (axis.motion, axis.drive.command_unit, axis.drive.command_limit) == ("rotary", "A", 2.0)
    written = axis.to_toml(comments=True)
    assert Axis.from_toml(written) == axis
    assert "# load-side equivalent inertia M [kg m^2]" in written
    assert "# G_tau = G_i r k_t [N m/A]" in written
    assert "# largest current [A]" in written
    assert "voltage" not in written
    assert "<td>N m/(rad/s)</td>" in axis._repr_html_()
    changed = axis.replace(drive={"command_limit": 3.0}, mechanics={"mass": 6e-6})
    assert (changed.drive.command_limit, changed.drive.command, changed.motion) == (3.0, "current", "rotary")


def test_a_command_in_percent_of_rated():
    axis = Axis.from_toml(
        TEXT.replace("force_gain = 35.15", 'command = "torque"\ncommand_unit = "%"\nforce_gain = 15.08').replace(
            "kv = 243.45", "kv = 596.0"
        )
    )
    assert Axis.from_toml(axis.to_toml()) == axis
    assert axis.drive.command_limit == NO_LIMIT
    assert "%/(m/s)" in axis.to_toml(comments=True)
    assert axis.to_dict()["drive"]["command_unit"] == "%"


@pytest.mark.parametrize(("command", "motion"), [("torque", "rotary"), ("force", "linear"), ("current", "rotary")])
def test_a_drive_without_a_limit_is_read_in_every_unit(command, motion):
    axis = Axis.from_dict(
        {
            "name": "drive",
            "motion": motion,
            "mechanics": {"mass": 1.0, "viscous": 0.0, "coulomb": 0.0},
            "drive": {"command": command, "force_gain": 1.0},
            "sampling": {"period": 1e-3},
        }
    )
    assert axis.drive.command_limit == NO_LIMIT


def test_a_duty_needs_a_voltage_only_where_there_is_one():
    axis = Axis.from_toml(ROTARY.replace('"current"', '"duty"').replace("command_limit = 2.0", "back_emf = 0.387"))
    assert (axis.drive.command_limit, axis.drive.command_unit, axis.drive.back_emf) == (1.0, "", 0.387)
    assert "[V/(rad/s)]" in axis.to_toml(comments=True)
    assert "[N m/V]" in axis.to_toml(comments=True)
    assert Axis.from_toml(axis.to_toml()) == axis


def test_one_limit_under_two_names():
    axis = Axis.from_toml(TEXT.replace("force_gain = 35.15", "force_gain = 35.15\ncommand_limit = 7.0"))
    assert axis == Axis.from_toml(TEXT.replace("force_gain = 35.15", "force_gain = 35.15\nvoltage_limit = 7.0"))
    assert "voltage_limit = 7.0" in axis.to_toml()
    assert axis.replace(drive={"command_limit": 8.0}) == axis.replace(drive={"voltage_limit": 8.0})
    assert axis.to_dict().keys() == {"name", "mechanics", "drive", "sampling", "controller"}
    assert list(axis.to_dict()["drive"]) == ["force_gain", "voltage_limit", "current_time_constant"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass = 5e-6", "mass = -1.0", "mechanics.mass: found -1.0 kg m^2, expected a number greater than 0 [kg m^2]"),
        ("mass = 5e-6", "mass = 1e300", "mechanics.mass: found 1e+300 kg m^2, expected a magnitude of at most 1e+07"),
        ("mass = 5e-6", "", "expected a number [kg m^2]: load-side equivalent inertia M"),
        ("command_limit = 2.0", "command_limit = 0", "drive.command_limit: found 0 A, expected a number greater"),
        ("command_limit = 2.0", "voltage_limit = 2.0", "drive.voltage_limit: found with a current command"),
        ("command_limit = 2.0", "back_emf = 2.0", "drive.back_emf: found with a current command"),
        ('"current"', '"current"\ncommand_unit = "V"', "drive.command_unit: found 'V', a unit of voltage, expected"),
        ('"current"', '"duty"\ncommand_unit = "%"', "drive.command_unit: found '%', expected none: a duty is a ratio"),
        ('"current"', "3", "drive.command: found 3, expected 'voltage', 'current', 'torque', 'force' or 'duty'"),
        ('"rotary"', '"round"', "motion: found 'round', expected 'linear' or 'rotary'"),
        (
            'command = "current"\nforce_gain = 0.0257\ncommand_limit = 2.0',
            "force_gain = 1.0\ncommand_limit = 2.0\nvoltage_limit = 3.0",
            "drive.voltage_limit: found 3.0 and command_limit 2.0, expected only one of them",
        ),
        (
            "force_gain = 0.0257",
            "force_gain = 0.0257\ncurrent_gain = 1.0\nreduction = 1.0\ntorque_constant = 2.0",
            "drive: force_gain 0.0257 N m/A is not current_gain x reduction x torque_constant = 2 N m/A",
        ),
    ],
)
def test_refused_in_its_own_units(old, new, message):
    assert old in ROTARY
    with pytest.raises(AxisError) as caught:
        Axis.from_toml(ROTARY.replace(old, new), "axis.toml")
    assert str(caught.value).startswith("axis.toml: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_gravity_needs_an_axis_that_turns():
    gravity = {"kind": "gravity", "torque": 3.0, "angle": 0.2}
    turning = machine("emps2019").replace(motion="rotary", effects=[gravity])
    assert Axis.from_toml(turning.to_toml()) == turning
    message = r"effects\.0\.kind: found 'gravity' on a linear axis, .*; gravity needs motion = 'rotary'"
    with pytest.raises(AxisError, match=message):
        machine("emps2019").replace(effects=[gravity])


def test_results_of_a_rotary_axis_in_python():
    from emps_design.control import design_velocity_loop
    from emps_design.identification import identify
    from emps_design.simulation import synthetic_record

    axis = Axis.from_toml(ROTARY).replace(
        mechanics={"mass": 1.15, "viscous": 8.1, "coulomb": 7.2},
        drive={"force_gain": 9.2, "command_limit": 10.0},
        controller={"kind": "position_pd", "kp": 22.0, "kv": 7.6},
    )
    shown = design_velocity_loop(axis, crossover=60.0, phase_margin_deg=60.0)._repr_html_()
    assert "<td>A/(rad/s)</td>" in shown
    found = identify(synthetic_record(axis, laps=1, stroke=0.1), axis)
    assert found.to_dict()["parameters"]["viscous"]["unit"] == "N m/(rad/s)"
    assert "<td>kg m^2</td>" in found._repr_html_()


@pytest.mark.parametrize("value", [True, np.array([1.0]), np.array([1.0, 2.0])])
def test_what_equals_a_number_and_is_none_does_not_replace_it(value):
    one = machine("emps2019").replace(mechanics={"mass": 1.0})
    with pytest.raises(AxisError, match=r"mechanics.mass: found .*, expected a number"):
        one.replace(mechanics={"mass": value})
