"""Units of FMI 3.0 in another tool: the controller to the bit, the machine with every effect as our simulations."""

import io
import shutil
import zipfile
from functools import cache

import numpy as np
import pytest

import emps_design.effects as effects
from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.codegen import export, export_controller
from emps_design.codegen.export import controller_unit, machine_unit, machine_vectors
from emps_design.compensation import compensate
from emps_design.effects import EFFECTS
from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.simulation import Plant, trapezoid_laps
from tests.studies import quick
from tests.unit.compensation.test_compensation import EFFECTS_HERE

fmpy = pytest.importorskip("fmpy")
pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
ALONE = ("together", "presliding_friction", "backlash", "flexible_coupling", "end_stop", "gravity", "actuator_lag")
PROGRAM = trapezoid_laps(1e-3, 0.05, 0.15, 1.0, laps=1)
OWN = """
import math
from emps_design.effects.effect import Effect, Parameter

def braked(v, most):
    return most * math.tanh(v / 0.01) if most > 0.0 else 0.0

def force(q, v, t, tau, x, p, b):
    total = 0.0
    for i in range(3):
        total += braked(v, p[0]) / (1 + i)
    return total + x[0]

def rate(q, v, t, tau, x, p, b, level, dx):
    dx[0] = (p[0] * v - x[0]) / 0.05

def initial(q0, p, b):
    return (0.5 * q0,)

EFFECT = Effect(
    name="mine", label="Mine", equation="F", source="here",
    parameters=(Parameter("size", "a", "N", lower=0.0, starts=(1.0,)),), force=force, rate=rate, initial=initial,
    states=(Parameter("z", "z", "N"),),
)
"""


def replayed(unit, folder, signals, outputs, period, **start):
    """What the unit shows (n, outputs) when it is given ``signals`` [n, ...] at every sample."""
    from fmpy.validation import validate_fmu

    path = folder / "unit.fmu"
    path.write_bytes(unit)
    assert validate_fmu(str(path)) == []
    n = len(next(iter(signals.values())))
    given = np.zeros(n, dtype=[("time", float), *((name, float) for name in signals)])
    given["time"] = np.arange(n) * period
    for name, values in signals.items():
        given[name] = values
    found = fmpy.simulate_fmu(
        str(path), stop_time=(n - 1) * period, output_interval=period, input=given, output=outputs, start_values=start
    )
    assert len(found) == n
    return [found[name] for name in outputs]


def instances(unit, folder, count, said=None):
    """So many running instances of a unit."""
    path = folder / "unit.fmu"
    path.write_bytes(unit)
    description, said = fmpy.read_model_description(str(path)), [] if said is None else said
    assert description.coSimulation.canGetAndSetFMUstate
    made = [
        fmpy.instantiate_fmu(
            fmpy.extract(str(path), str(folder / f"unit_{i}")), description, "CoSimulation",
            logger=lambda environment, status, category, message: said.append(message.decode()),
        ) for i in range(count)
    ]  # fmt: skip
    for one in made:
        one.enterInitializationMode(startTime=0.0)
        one.exitInitializationMode()
    return made


@cache
def unit_with(name):
    """The unit of the axis called ``name`` of those below."""
    return machine_unit("m", dict(with_every_effect())[name])


@cache
def plain_unit():
    """The unit of an axis without effects."""
    return machine_unit("m", machine("emps2019"))


def with_every_effect():
    """Axes that have every effect between them: each of these alone, the others together."""
    tables = {one.name: {"kind": one.name, **one.checks[0][0]} for one in EFFECTS}
    yield "together", machine("emps2019").replace(effects=[tables[name] for name in tables if name not in ALONE])
    for name in ALONE[1:]:
        yield (
            name,
            machine("emps2019").replace(
                effects=[tables[name], tables["actuator_delay"]], **({"motion": "rotary"} if name == "gravity" else {})
            ),
        )


@pytest.mark.parametrize(
    ("name", "axis"), quick(with_every_effect(), lambda case: case[0] == "together", "a unit for each"), ids=ALONE
)
def test_the_machine_moves_as_in_our_simulation(name, axis, tmp_path):
    """Bit for bit under the same command; within 1e-9 m is what is promised."""
    u = Plant.of(machine("emps2019").replace(motion=axis.motion)).closed_loop(PROGRAM[:1500]).u
    push = 5.0 * np.sin(0.02 * np.arange(u.size))
    run = Plant.of(axis).open_loop(u, disturbance=push, q0=0.02)
    signals = {"u": u, "f_ext": push}
    q, position, v = replayed(unit_with(name), tmp_path, signals, ["q", "position", "v"], 1e-3, q_start=0.02)
    assert np.ptp(run.position) > 1e-3
    np.testing.assert_array_equal(q, run.q)
    np.testing.assert_allclose(position, run.position, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(v, run.v, rtol=0.0, atol=1e-9)


def stepped(made, commands, first, period):
    """What a machine shows (n, 3) after each sample from number ``first`` on, given these commands."""
    rows = []
    for k, u in enumerate(commands, start=first):
        made.setFloat64([1], [u])
        made.doStep(k * period, period)
        rows.append(made.getFloat64([3, 4, 5]))
    return np.array(rows)


@pytest.mark.parametrize(
    ("name", "axis"), quick(with_every_effect(), lambda case: case[0] == "together", "a unit for each"), ids=ALONE
)
def test_a_master_steps_back_and_the_machine_moves_the_same_again(name, axis, tmp_path):
    """Whatever was done in between, and as often as it likes; the state of one instance is for no other."""
    made, other = instances(unit_with(name), tmp_path, 2)
    u, period = 3.0 * np.sin(0.03 * np.arange(600)), axis.sampling.period
    stepped(made, u[:300], 0, period)
    state = made.getFMUState()
    first = stepped(made, u[300:], 300, period)
    assert np.ptp(first, axis=0).min() > 0.0
    for between in (-u[:200], u[:0]):
        stepped(made, between, 600, period)
        made.setFMUState(state)
        np.testing.assert_array_equal(stepped(made, u[300:], 300, period), first)
    with pytest.raises(fmpy.fmi1.FMICallException):
        other.setFMUState(state)
    made.freeFMUState(state)
    stepped(other, u[:300], 0, period)
    np.testing.assert_array_equal(stepped(other, u[300:], 300, period), first)


@pytest.mark.parametrize(
    "more",
    quick([[{"kind": "actuator_lag", "time_constant": 2e-4}], []], 1, "without the lag"),
    ids=["behind a lag", "alone"],
)
def test_a_users_effect_and_a_real_current_loop_are_in_the_machine(more, tmp_path):
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    effects.load_file(tmp_path / "mine.py")
    try:
        table = machine("emps2018").to_dict()
        table["drive"]["current_time_constant"] = 5e-4
        table["sampling"]["computation_delay"] = 2
        axis = Axis.from_dict(table).replace(effects=[{"kind": "mine", "size": 3.0}, *more])
        u = 3.0 * np.sin(0.01 * np.arange(1500))
        run = Plant.of(axis).open_loop(u, q0=0.1)
        (position,) = replayed(
            machine_unit("m", axis), tmp_path, {"u": u}, ["position"], axis.sampling.period, q_start=0.1
        )
        np.testing.assert_allclose(position, run.position, rtol=0.0, atol=1e-9)
        assert np.ptp(position) > 1e-3
    finally:
        effects.REGISTRY.added.clear()


@pytest.mark.parametrize("compensated", [False, True])
def test_the_controller_answers_as_ours_to_the_bit(compensated, tmp_path):
    axis = machine("emps2019").replace(effects=EFFECTS_HERE[:2])
    exported = export_controller(axis, "json", compensate(axis, PROGRAM).to_dict() if compensated else None)
    vectors = exported.vectors
    rows = np.flatnonzero(vectors.start)[1], np.flatnonzero(vectors.start)[3]  # in motion, in and out of the limit
    part = slice(rows[0], rows[1])
    given = [vectors.reference, vectors.q, vectors.f_ext, *vectors.motion]
    start = np.arange(rows[1] - rows[0]) == 0
    one = exported.block.run(start, *(signal[part] for signal in given[:3]), tuple(x[part] for x in given[3:]))[0]
    signals = {name: signal[part] for name, signal in zip(vectors.titles, given, strict=True)}
    (u,) = replayed(controller_unit("c", exported.block, vectors), tmp_path, signals, ["u"], 1e-3)
    np.testing.assert_array_equal(u[1:].view(np.int64), one[:-1].view(np.int64))


@pytest.mark.study("all units")
def test_the_folder_has_both_units_and_says_what_is_in_them(tmp_path, capsys, monkeypatch):
    assert app.run(["export", "emps2019", "--to", "fmu", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "emps2019_machine.fmu" in page
    assert export.binary_for() in page
    inside = zipfile.ZipFile(tmp_path / "emps2019.fmu").namelist()
    assert "sources/emps2019.c" in inside
    assert f"binaries/{export.binary_for()}/emps2019.so" in inside
    rows = np.genfromtxt(tmp_path / "machine.csv", delimiter=",", names=True)
    (position,) = replayed(
        (tmp_path / "emps2019_machine.fmu").read_bytes(), tmp_path, {"u": rows["u"]}, ["position"], 1e-3
    )
    np.testing.assert_allclose(position, rows["position"], rtol=0.0, atol=1e-9)
    capsys.readouterr()
    monkeypatch.setattr(export.shutil, "which", lambda name: None)
    assert app.run(["export", "emps2019", "--to", "fmu", "--out", str(tmp_path / "new")]) == 0
    assert "no C compiler was found" in capsys.readouterr().err
    assert not any("binaries" in name for name in zipfile.ZipFile(tmp_path / "new" / "emps2019.fmu").namelist())


@pytest.mark.study("four units")
def test_the_same_axis_gives_the_same_bytes():
    assert machine_unit("m", machine("emps2019")) == plain_unit()


def test_the_vectors_of_a_machine_move_it_both_ways_against_a_constant_force():
    axis = machine("emps2019")
    axis = axis.replace(mechanics={"offset": 0.9 * axis.mechanics.coulomb})
    v = np.array([float(row.split(",")[3]) for row in machine_vectors(axis).splitlines()[1:]])
    assert v.min() < 0.0 < v.max()


def test_what_a_unit_refuses(tmp_path):
    """A step that is no whole number of samples, an output that is set, a value that is not finite."""
    said = []
    (made,) = instances(plain_unit(), tmp_path, 1, said)
    for refused in (
        lambda: made.setFloat64([3], [1.0]),
        lambda: made.setFloat64([1], [float("nan")]),
        lambda: made.getFloat64([99]),
    ):
        with pytest.raises(fmpy.fmi1.FMICallException):
            refused()
    made.doStep(0.0, 2e-3)
    with pytest.raises(fmpy.fmi1.FMICallException):
        made.doStep(2e-3, 5e-4)
    made.terminate()
    made.freeInstance()
    assert [line.split(",")[0] for line in said] == [
        "found a value reference that cannot be set", "found a value that is not finite",
        "found a value reference that is not there", "found a step that is no whole number of samples",
    ]  # fmt: skip


def test_outputs_of_a_run_that_has_ended_are_its_last(tmp_path):
    (made,) = instances(plain_unit(), tmp_path, 1)
    stepped(made, np.full(100, 5.0), 0, machine("emps2019").sampling.period)
    last = made.getFloat64([3, 4, 5])
    made.terminate()
    assert made.getFloat64([3, 4, 5]) == last
    made.reset()
    made.enterInitializationMode(startTime=0.0)
    assert made.getFloat64([4])[0] == 0.0 < last[1]
    made.freeInstance()


def test_a_command_that_is_ages_on_its_way_is_refused():
    axis = machine("emps2019").replace(sampling={"period": 1e-6})
    late = axis.replace(effects=[{"kind": "actuator_delay", "delay": 0.02}])
    with pytest.raises(InputError, match="found a dead time of .* samples, expected at most 4096"):
        machine_unit("m", late)
    assert io.BytesIO(machine_unit("m", axis)).read(2) == b"PK"
