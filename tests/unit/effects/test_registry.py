"""The registry: names, a user's own file, what is refused."""

import os
import subprocess
import sys

import numpy as np
import pytest

import emps_design.effects as effects
from emps_design.errors import AxisError

OWN = '''"""Air drag: a force that grows with the cube of speed."""

from emps_design.effects import Claims, Effect, Parameter


def force(q, v, t, tau, x, p, b):
    return p[0] * v**3


EFFECT = Effect(
    name="air_drag",
    label="Air drag",
    equation="F = c v^3",
    source="a user",
    parameters=(Parameter("cubic", "c", "N/(m/s)^3", linear=True, scale=100.0, text="drag"),),
    force=force,
    regressor=lambda motion, shape, b: (motion.v**3)[:, None],
    claims=Claims(parity="odd"),
)
'''


@pytest.fixture
def own_file(tmp_path):
    path = tmp_path / "air_drag.py"
    path.write_text(OWN, encoding="utf-8")
    yield path
    effects.REGISTRY.added.clear()


def test_a_users_file_takes_part(own_file):
    effect = effects.load_file(own_file)
    assert effects.get_effect("air_drag") is effect
    assert list(effects.known_effects())[-1] == "air_drag"
    assert effect.contribution({"cubic": 1000.0}, np.zeros(4), v=0.2) == pytest.approx(8.0)


def test_an_axis_may_name_it_and_simulate(own_file):
    from emps_design.machines import machine
    from emps_design.simulation import Plant

    effects.load_file(own_file)
    axis = machine("emps2019").replace(effects=[{"kind": "air_drag", "cubic": 2e4}])
    u = np.full(800, 2.0)
    assert Plant.of(axis).open_loop(u).v[-1] < 0.9 * Plant.of(machine("emps2019")).open_loop(u).v[-1]


def test_another_process_takes_what_one_has_compiled(own_file):
    environment = {**os.environ, effects.VARIABLE: str(own_file)}
    code = """
import numpy as np
from emps_design.machines import machine
from emps_design.simulation import Plant
axis = machine("emps2019").replace(effects=[{"kind": "air_drag", "cubic": 2e4}])
print(Plant.of(axis).open_loop(np.full(800, 2.0)).v[-1])
"""
    texts = [
        subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert texts[0] == texts[1]


def test_the_environment_names_files(own_file, tmp_path):
    second = tmp_path / "other.py"
    second.write_text(OWN.replace("air_drag", "other_drag"), encoding="utf-8")
    environment = {**os.environ, effects.VARIABLE: os.pathsep.join([str(own_file), str(second)])}
    code = "from emps_design.effects import known_effects as k; print(*list(k())[-2:])"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["air_drag", "other_drag"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("EFFECT = 3", "found EFFECT = 3, expected an emps_design.effects.Effect"),
        ("x = 1", "found EFFECT = None"),
        (OWN.replace('"air_drag"', '"backlash"'), "effect backlash: the package already has that name; choose another"),
        (
            OWN.replace('source="a user"', 'source="a user", channel="air"'),
            "channel 'air', expected one of controller, actuator",
        ),
        (OWN.replace("regressor=", "expression="), "expected both a regressor and linear parameters, or neither"),
        (OWN.replace("force=force", 'force=force, over="w"'), "over 'w', expected one of v, q, t"),
        (OWN.replace("force=force", "rate=force"), "expected both states and a rate, or neither"),
        (OWN.replace("force=force", 'force=force, play="gap"'), "found no parameter 'gap', expected one of cubic"),
    ],
)
def test_a_bad_file_is_told_by_name(tmp_path, text, message):
    path = tmp_path / "bad.py"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(AxisError, match="effect|bad.py") as caught:
        effects.load_file(path)
    assert message in str(caught.value)


def test_a_missing_or_foreign_file_is_told(tmp_path):
    with pytest.raises(AxisError, match=r"nowhere\.py: no such file; expected a Python file with an EFFECT"):
        effects.load_file(tmp_path / "nowhere.py")
    other = tmp_path / "effect.txt"
    other.write_text(OWN, encoding="utf-8")
    with pytest.raises(AxisError, match=r"found a name that does not end in \.py"):
        effects.load_file(other)


def test_unknown_names_get_the_nearest():
    with pytest.raises(AxisError, match="backlash"):
        effects.get_effect("backlsh")
    stribeck = effects.get_effect("stribeck_friction")
    with pytest.raises(AxisError, match=r"unknown parameter 'exces'.*has excess, stribeck_velocity, exponent"):
        stribeck.values({"exces": 1.0})
    with pytest.raises(AxisError, match="missing parameter stribeck_velocity, exponent"):
        stribeck.values({"excess": 1.0})
    with pytest.raises(ValueError, match=r"excess: found -1 N, expected a number in \[0, inf\] N"):
        stribeck.values({"excess": -1.0, "stribeck_velocity": 0.01, "exponent": 1.0})


def test_an_effect_without_a_hook_does_nothing_and_says_so():
    empty = effects.Effect(name="empty", label="", equation="", source="", parameters=())
    with pytest.raises(AxisError, match="effect empty: found no hook, expected at least one of force, dry"):
        empty.contribution({}, np.zeros(4))
