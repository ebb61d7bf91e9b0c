"""Every control law keeps the contract: words, units, bounds, axis file there and back; and so does a user's own."""

import re
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest

import emps_design.laws as laws
from emps_design.axis import Axis
from emps_design.errors import AxisError, InputError
from emps_design.laws import LAWS, field_at, fields_of, law_of, leaves, unit_of
from emps_design.machines import machine

GIVEN = {
    "position_pd": {"kp": 160.18, "kv": 243.45},
    "ip_velocity": {"k_v1": 400.0, "t_v": 0.02, "k_e1": 0.002},
    "impedance": {"mass": 50.0, "damping": 100.0, "filter": 300.0},
    "cascade": {
        "position": {"kp": 30.0, "every": 2},
        "velocity": {"kp": 300.0, "ti": 0.05},
        "feedforward": {"velocity": 0.9, "acceleration": 2.5, "coulomb": 0.4},
        "filters": [
            {"kind": "lowpass", "frequency": 250.0},
            {"kind": "notch", "frequency": 110.0, "damping": 0.5, "depth": 0.2},
        ],
    },
    "p": {"kp": 300.0},
}
ESTIMATED = {  # velocity estimators with a number
    "slope": {"kind": "slope", "points": 4},
    "filtered": {"kind": "filtered", "frequency": 60.0},
    "tracking": {"kind": "tracking", "bandwidth": 400.0},
}
DIMENSIONLESS = {"damping", "depth", "velocity"}  # of a notch, and a share of the velocity
EVERY = pytest.mark.parametrize("kind", LAWS, ids=lambda kind: kind.name)


def axis_with(kind, machine_name="emps2018", **more) -> Axis:
    table = {**machine(machine_name).to_dict(), "controller": {"kind": kind.name, **GIVEN[kind.name], **more}}
    return Axis.from_dict(table)


def test_one_file_a_law():
    from pathlib import Path

    files = {path.stem for path in Path(laws.library.__file__).parent.glob("*.py")} - {"__init__"}
    assert {kind.name for kind in LAWS} == files
    assert {kind.name for kind in LAWS} == set(GIVEN)


@EVERY
def test_parameters_have_words_and_units(kind):
    for path, value in leaves(GIVEN[kind.name]):
        field = field_at(kind.name, path)
        assert field.description
        assert unit_of(field) or path[-1] in DIMENSIONLESS or isinstance(value, str)
    assert all(field.description for field in kind.table.model_fields.values())
    assert kind.label
    assert kind.source


@EVERY
def test_axis_file_there_and_back(kind):
    axis = axis_with(kind)
    assert Axis.from_toml(axis.to_toml()) == axis
    assert Axis.from_toml(axis.to_toml(comments=True)) == axis
    read = dict(leaves(axis.controller.parameters))
    for path, value in leaves(GIVEN[kind.name]):
        assert read[path] == value
        if path[0] != "filters":  # inline tables have no line of their own
            assert field_at(kind.name, path).description in axis.to_toml(comments=True)


@EVERY
def test_a_parameter_out_of_bounds_or_missing_is_told(kind):
    for name in kind.needs:
        with pytest.raises(AxisError, match=rf"controller\.{name}: found -1.0.*, expected a (number|table)"):
            axis_with(kind, **{name: -1.0})
        with pytest.raises(AxisError, match=f"controller: kind '{kind.name}' needs {name}"):
            axis_with(kind, **{name: None})
    with pytest.raises(AxisError, match=r"controller\.gian: unknown key \(known: kind, "):
        axis_with(kind, gian=1.0)


def changed(table, path, value):
    """A copy of a ``[controller]`` table in which the number at ``path`` is another."""
    if not path:
        return value
    key, rest = path[0], path[1:]
    if isinstance(table, dict):
        return {**table, key: changed(table[key], rest, value)}
    return [changed(one, rest, value) if i == int(key) else one for i, one in enumerate(table)]


def run_as_written(lines, signals, n):
    """The commands (n,) of a difference equation as it is printed for a drive, run line by line from rest."""
    series = {name: defaultdict(float, enumerate(values.tolist())) for name, values in signals.items()}
    for name in re.findall(r"(\w+)\[k", " ".join(lines)):
        series.setdefault(name, defaultdict(float))
    program = [re.sub(r"^(.*?)   \((v\[k\] [<>] 0)[^)]*\)$", r"if \2: \1", line) for line in lines]
    code = compile("\n".join(program), "words", "exec")
    for k in range(n):
        exec(code, {**series, "k": k, "sign": np.sign})
    return np.array([series["u"][k] for k in range(n)])


@EVERY
@pytest.mark.parametrize("estimator", ["two_tap", "backward", *ESTIMATED.values()])
def test_the_words_run_as_a_program_command_what_the_kernel_does(kind, estimator):
    axis = axis_with(kind, velocity_estimator=estimator)
    law, n = law_of(axis, 1e-3), 200
    t, rng = np.arange(n) * 1e-3, np.random.default_rng(3)
    q = 0.02 * np.sin(12.0 * t) ** 2 + 1e-5 * np.cumsum(rng.normal(size=n)) * (t > 0.01)
    signals = {"q": q, "f_ext": 30.0 * np.sin(40.0 * t)}
    signals["v_ref"] = 0.3 * np.sin(20.0 * t)
    signals["q_ref"] = q + 4e-4 * np.sin(50.0 * t)
    limit = axis.drive.command_limit
    kernel = law.commands(signals["v_ref" if law.follows == "velocity" else "q_ref"], q, limit, signals["f_ext"])
    kernel = np.clip(kernel, -limit, limit)  # by the drive, where the law leaves that to it
    assert np.ptp(kernel) > 0.1
    table = kind.table(**axis.controller.parameters)
    written = run_as_written(kind.equations(table, axis, 1e-3), signals, n)
    np.testing.assert_allclose(written, kernel, atol=1e-5)


@EVERY
@pytest.mark.parametrize("estimator", ["two_tap", "backward", *ESTIMATED.values()])
def test_the_words_mention_every_gain(kind, estimator):
    """The difference equation printed for a drive moves with every parameter, and with the period."""
    axis = axis_with(kind, velocity_estimator=estimator)
    table = kind.table(**axis.controller.parameters)
    said = kind.equations(table, axis, 1e-3)
    numbers = [(path, value) for path, value in leaves(GIVEN[kind.name]) if not isinstance(value, str)]
    for path, value in numbers:
        moved = value + 1 if isinstance(value, int) else 0.9 * value
        other = kind.table(**changed(axis.controller.parameters, path, moved))
        assert kind.equations(other, axis, 1e-3) != said, path
    assert kind.equations(table, axis, 2e-3) != said or kind.name == "p"  # which has no velocity
    assert kind.equations(table, axis.replace(drive={"command_limit": 7.0}), 1e-3) != said


@EVERY
@pytest.mark.parametrize("estimator", ["two_tap", "backward"])
def test_a_law_that_says_state_feedback_is_that(kind, estimator):
    """What the fused runs compute in place of the kernel, and no other law may run there."""
    from emps_design.simulation import Plant

    axis = axis_with(kind, velocity_estimator=estimator)
    if not kind.state_feedback:
        with pytest.raises(InputError, match="expected one of auto, general for this axis"):
            Plant.of(axis).closed_loop(np.zeros(9), method="plain")
        return
    law, q, reference = law_of(axis, 1e-3), *np.random.default_rng(5).normal(0.0, 0.1, (2, 40))
    memory = np.zeros(law.memory)
    found = [law.kernel(k, reference[k], q[k], 0.0, 1e9, law.gains, memory) for k in range(40)]
    before = np.concatenate([[q[0]] * 2, q])
    v = (q - before[:40]) / 2e-3 if estimator == "two_tap" else (q - before[1:41]) / 1e-3
    np.testing.assert_allclose(found, law.gains[0] * (reference - q) - law.gains[1] * v, rtol=1e-12, atol=1e-9)
    assert law.gains[2:].tolist() == [1e3, estimator == "two_tap"]


@EVERY
@pytest.mark.parametrize("estimator", ["two_tap", "backward", *ESTIMATED.values()])
def test_a_law_finds_its_own_parameters_in_a_record(kind, estimator):
    """What ``propose`` answers makes the recorded voltage, where the record was made with other numbers."""
    if kind.propose is None:
        assert kind.name != "position_pd"
        return
    axis = axis_with(kind, velocity_estimator=estimator)
    law, random = law_of(axis, 1e-3), np.random.default_rng(6)
    reference, q, memory = *np.cumsum(random.normal(0.0, 1e-4, (2, 300)), axis=1), np.zeros(law.memory)
    u = np.array([law.kernel(k, reference[k], q[k], 0.0, np.inf, law.gains, memory) for k in range(300)])
    u[:20] = np.nan
    found = kind.propose(reference, q, u, axis.controller, 1e-3)
    assert found == pytest.approx({name: GIVEN[kind.name][name] for name in found}, rel=1e-9)
    assert set(found) == set(kind.needs)
    assert kind.propose(reference, q, -u, axis.controller, 1e-3) is None


@EVERY
def test_parameters_of_other_kinds_wait_in_the_table(kind):
    more = {name: value for given in GIVEN.values() for name, value in given.items()} | GIVEN[kind.name]
    axis = axis_with(kind, **more)
    kept = dict(leaves(axis.controller.parameters))
    assert {path: kept[path] for path, _ in leaves(more)} == dict(leaves(more))
    assert Axis.from_toml(axis.to_toml()) == axis
    np.testing.assert_array_equal(law_of(axis, 1e-3).gains, law_of(axis_with(kind), 1e-3).gains)


def test_no_law_has_no_gains():
    axis = machine("emps2018")
    assert axis.controller.kind == "none"
    assert axis.controller.kp is None
    with pytest.raises(AttributeError, match="controller: found 'gain', expected one of kind, kp"):
        _ = axis.controller.gain


OWN = '''"""A position law with a spring that hardens: u = kp (r - q) + kc (r - q)^3 - kv v."""

from emps_design.laws import LawKind, LawTable, Positive, parameter, velocity_in_words


def hardening(k, reference, q, f_ext, limit, gains, memory):
    if k == 0:
        memory[0] = q
    v = (q - memory[0]) * gains[3]
    memory[0] = q
    e = reference - q
    return gains[0] * e + gains[1] * e * e * e - gains[2] * v


class Table(LawTable):
    kp: Positive = parameter("gain on the position error", "V/m")
    kc: Positive = parameter("gain on its cube", "V/m^3")
    kv: Positive = parameter("gain on the velocity", "V/(m/s)")


LAW = LawKind(
    name="hardening",
    label="position law with a hardening spring",
    source="a user",
    table=Table,
    kernel=hardening,
    gains=lambda p, axis, period: (p.kp, p.kc, p.kv, 1.0 / period),
    memory=1,
    equations=lambda p, axis, period: (velocity_in_words(p, period), f"u[k] = {p.kp:g} * e[k]"),
)
'''


@pytest.fixture
def own_file(tmp_path):
    path = tmp_path / "hardening.py"
    path.write_text(OWN, encoding="utf-8")
    yield path
    laws.REGISTRY.added.clear()


OWN_TABLE = {"kind": "hardening", "kp": 39000.0, "kc": 1e6, "kv": 243.0, "velocity_estimator": "backward"}


def test_a_users_law_is_an_axis_like_ours(own_file):
    laws.load_file(own_file)
    axis = Axis.from_dict({**machine("emps2019").to_dict(), "controller": OWN_TABLE})
    assert Axis.from_toml(axis.to_toml(comments=True)) == axis
    assert "# gain on its cube [V/m^3]" in axis.to_toml(comments=True)
    assert fields_of("hardening")["kp"].json_schema_extra["unit"] == "V/m"  # its own meaning, not the position law's
    from emps_design.simulation import Plant

    q_ref = 0.05 * (1.0 - np.cos(np.arange(2000) * 3e-3))
    run = Plant.of(axis).closed_loop(q_ref)
    error = q_ref - run.q
    v = np.diff(run.q, prepend=run.q[0]) / 1e-3
    np.testing.assert_allclose(run.u, 39000.0 * error + 1e6 * error**3 - 243.0 * v, atol=1e-9)
    assert np.abs(error).max() < 1e-3


def test_the_environment_names_files(own_file, tmp_path):
    import os

    path = tmp_path / "axis.toml"
    base = machine("emps2019").to_dict()
    laws.load_file(own_file)
    path.write_text(Axis.from_dict({**base, "controller": OWN_TABLE}).to_toml(), encoding="utf-8")
    environment = {**os.environ, laws.VARIABLE: str(own_file)}
    code = f"from emps_design import load_axis; print(load_axis({str(path)!r}).controller.kc)"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1000000.0"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("LAW = 3", "found LAW = 3, expected an emps_design.laws.LawKind"),
        (OWN.replace('"hardening"', '"impedance"'), "law impedance: the package already has that name; choose another"),
        (
            OWN.replace("memory=1,", 'memory=1, follows="force",'),
            "follows 'force', expected one of position, velocity, rest",
        ),
        (OWN.replace("table=Table", "table=dict"), "expected a class derived from LawTable"),
    ],
)
def test_a_bad_file_is_told_by_name(tmp_path, text, message):
    path = tmp_path / "bad.py"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(AxisError, match="law|bad.py") as caught:
        laws.load_file(path)
    assert message in str(caught.value)


def test_unknown_kinds_are_told():
    with pytest.raises(AxisError, match="did you mean 'impedance'"):
        laws.get_law("impedence")
    with pytest.raises(AxisError, match=r"controller\.kind: found 3, expected 'position_pd', "):
        Axis.from_dict({**machine("emps2019").to_dict(), "controller": {"kind": 3}})


def recorded(**given):
    return axis_with(laws.get_law("p"), kp={"record": "gain", **given})


def test_a_gain_may_come_from_the_record():
    """A single number, a column of one number, a column that changes: in the law, and in the simulation."""
    from emps_design.simulation import Plant

    axis = recorded(scale=100.0)
    assert Axis.from_toml(axis.to_toml(comments=True)) == axis
    for column in (200, np.int64(200), np.full(50, 200.0)):
        assert law_of(axis, 1e-3, {"gain": column}).gains.tolist() == [20000.0]
    column = np.where(np.arange(300) < 100, 200.0, 90.0)
    law = law_of(axis, 1e-3, {"gain": column})
    q_ref = 1e-4 * np.arange(300.0)
    run = Plant.of(axis).closed_loop(q_ref, law=law)
    np.testing.assert_allclose(run.u, np.clip(100.0 * column * (q_ref - run.q), -10.0, 10.0), atol=1e-9)
    with pytest.raises(InputError, match="law: found gains for 300 samples, expected 200: those of its own record"):
        Plant.of(axis).closed_loop(q_ref[:200], law=law)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            None,
            r"controller\.kp: is taken from column 'gain' of a record, found no record; expected a record with that",
        ),
        ({"kp": 3.0}, r"controller\.kp: is taken from column 'gain' of a record, found kp; expected"),
        ({"gain": -3.0}, r"controller\.kp: found -6 from column 'gain' of the record times 2; .* greater than 0"),
        ({"gain": "high"}, r"controller\.kp: column 'gain' of the record has no numbers"),
    ],
)
def test_a_gain_that_the_record_does_not_give_is_told(columns, message):
    with pytest.raises(AxisError, match=message):
        law_of(recorded(scale=2.0), 1e-3, columns)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"record": 3}, r"controller\.kp\.record: found 3, expected text in quotes"),
        ({"record": "kp", "scal": 2.0}, r"controller\.kp\.scal: unknown key, did you mean 'scale'\?"),
        ({"scale": 2.0}, r"controller\.kp\.record: missing"),
        ("kp", r"controller\.kp: found 'kp', expected a number \[V/m\]"),
    ],
)
def test_a_gain_that_is_neither_number_nor_column_is_told(given, message):
    with pytest.raises(AxisError, match=message):
        axis_with(laws.get_law("p"), kp=given)


def test_a_gain_that_a_record_gives_is_kept_beside_another_law():
    axis = machine("emps2018").replace(controller={"kind": "p", "kp": {"record": "kp", "scale": 2.0}})
    designed = axis.replace(controller={"kind": "ip_velocity", "k_v1": 550.0, "t_v": 8.5e-3})
    assert Axis.from_dict(designed.to_dict()).to_toml() == designed.to_toml()
    back = designed.replace(controller={"kind": "p"})
    assert back.controller.kp == axis.controller.kp
