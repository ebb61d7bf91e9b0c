"""The cascade against another implementation, written from the difference equations alone, and on a drive's records."""

import tomllib

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter, lfiltic

from emps_design.axis import Axis
from emps_design.discrepancy.preparation import law_voltage
from emps_design.errors import AxisError
from emps_design.laws import law_of
from emps_design.machines import machine
from emps_design.records import Record
from tests.contract.test_laws import ESTIMATED

T = 1e-3
FILTERS = (
    {"kind": "lowpass", "frequency": 350.0},
    {"kind": "notch", "frequency": 210.0, "damping": 0.6, "depth": 0.1333333333},
)
AHEAD = {"velocity": 0.95, "acceleration": 3.8, "coulomb": 1.9}
CASCADES = {
    "whole": {
        "position": {"kp": 45.0, "every": 4},
        "velocity": {"kp": 596.8, "ti": 0.018},
        "feedforward": AHEAD,
        "filters": FILTERS,
    },
    "of a profile": {
        "position": {"kp": 45.0, "every": 4},
        "velocity": {"kp": 596.8, "ti": 0.018},
        "feedforward": AHEAD | {"source": "profile"},
    },
    "plain": {"position": {"kp": 30.0}, "velocity": {"kp": 300.0, "ti": 0.05}},
    "ip": {"position": {"kp": 30.0, "every": 3}, "velocity": {"kp": 300.0, "ti": 0.05, "form": "ip"}},
    "no integral": {"position": {"kp": 30.0}, "velocity": {"kp": 300.0}, "filters": FILTERS[:1]},
    "ip with feed-forward": {
        "position": {"kp": 45.0, "every": 4},
        "velocity": {"kp": 596.8, "ti": 0.018, "form": "ip"},
        "feedforward": AHEAD,
    },
    "winds up": {"position": {"kp": 30.0}, "velocity": {"kp": 300.0, "ti": 0.05}, "anti_windup": "none"},
    "velocity": {"velocity": {"kp": 300.0, "ti": 0.05}, "filters": FILTERS[::-1]},
    "velocity with feed-forward": {
        "velocity": {"kp": 300.0, "ti": 0.05},
        "feedforward": {"acceleration": 3.8, "coulomb": 1.9},
    },
    "velocity ip": {"velocity": {"kp": 300.0, "ti": 0.05, "form": "ip"}},
}
EVERY = pytest.mark.parametrize("name", CASCADES)


def axis_with(name, **more) -> Axis:
    controller = {"kind": "cascade", **CASCADES[name], **more}
    return Axis.from_dict({**machine("emps2019").to_dict(), "controller": controller})


def filter_of(one):
    w0 = 2 * np.pi * one["frequency"]
    if one["kind"] == "lowpass":
        return bilinear([w0], [1.0, w0], 1 / T)
    wide = 2 * one["damping"] * w0
    return bilinear([1.0, one["depth"] * wide, w0**2], [1.0, wide, w0**2], 1 / T)


def estimated(one, q):
    """The velocity (n,) by what each estimator is: a line through points, a filter's own equation, a tracking loop."""
    if one["kind"] == "slope":
        n = one["points"]
        windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([[q[0]] * (n - 1), q]), n)
        return np.polyfit(T * np.arange(n), windows.T, 1)[0]
    difference = np.diff(q, prepend=q[0]) / T
    if one["kind"] == "filtered":
        w0 = 2 * np.pi * one["frequency"]
        return lfilter(*bilinear([w0], [1.0, w0], 1 / T), difference)
    pole, x, v, found = np.exp(-one["bandwidth"] * T), q[0], 0.0, []
    for measured in q:
        error = measured - (x + T * v)
        x, v = x + T * v + (1 - pole**2) * error, v + (1 - pole) ** 2 / T * error
        found.append(v)
    return np.array(found)


def command(c, r, q, limit, estimator="backward"):
    """The command (n,) of a cascade ``c`` for a reference ``r`` and positions ``q``, signal by signal."""
    velocity, ahead = c["velocity"], c.get("feedforward", {})
    before = np.concatenate(([q[0]] * 2, q))
    if isinstance(estimator, dict):
        v = estimated(estimator, q)
    else:
        v = (q - before[1:-1]) / T if estimator == "backward" else (q - before[:-2]) / (2 * T)
    if "position" in c:
        past = np.concatenate(([r[0]] * 2, r))
        vr, ar = (r - past[1:-1]) / T, (r - 2 * past[1:-1] + past[:-2]) / T**2
        direction = np.sign(vr)
        if ahead.get("source") == "profile":
            third = np.concatenate(([r[0]] * 3, r))[:-3]
            vr = vr + 0.5 * T * ar
            ar = ar + (r - 3 * past[1:-1] + 3 * past[:-2] - third) / T**2
        n, share = c["position"].get("every", 1), ahead.get("velocity", 0.0)
        wanted = np.repeat((c["position"]["kp"] * (r - q))[::n], n)[: r.size]
    else:
        vr, ar, wanted, share = r, np.diff(r, prepend=0.0) / T, 0.0, 1.0
        direction = np.sign(vr)
    e = wanted + share * vr - v
    proportional = velocity["kp"] * (-v if velocity.get("form") == "ip" else e)
    given = proportional + ahead.get("acceleration", 0.0) * ar + ahead.get("coulomb", 0.0) * direction
    steps = velocity["kp"] * T / velocity["ti"] * e if "ti" in velocity else 0.0 * e
    chain = [(*filter_of(one), lfiltic(*filter_of(one), [])) for one in c.get("filters", ())]
    u, integral = np.empty(r.size), 0.0
    for k in range(r.size):
        w = np.array([given[k] + integral + steps[k]])
        for i, (b, a, state) in enumerate(chain):
            w, state = lfilter(b, a, w, zi=state)
            chain[i] = (b, a, state)
        u[k] = np.clip(w[0], -limit, limit)
        if u[k] == w[0] or c.get("anti_windup") == "none":
            integral += steps[k]
    return u


def signals(name, seed=3):
    """A reference and positions that follow it badly enough for a limit to act, in part at rest."""
    random = np.random.default_rng(seed)
    t = np.arange(900) * T
    r = 0.05 * (1 - np.cos(9 * np.minimum(t, 0.7)))
    q = 0.05 * (1 - np.cos(9 * np.minimum(np.maximum(t - 0.01, 0.0), 0.7))) + 2e-5 * random.standard_normal(t.size)
    return (r, q) if "position" in CASCADES[name] else (np.gradient(r, T) + 0.02, q)


@EVERY
@pytest.mark.parametrize("estimator", ["backward", "two_tap"])
@pytest.mark.parametrize("limit", [1e9, 6.0])
def test_the_kernel_is_the_difference_equation(name, estimator, limit):
    axis = axis_with(name, velocity_estimator=estimator)
    law, (r, q) = law_of(axis, T), signals(name)
    memory = np.zeros(law.memory)
    found = np.array([law.kernel(k, r[k], q[k], 0.0, limit, law.gains, memory) for k in range(r.size)])
    expected = command(CASCADES[name], r, q, limit, estimator)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert limit > 1e3 or 0.05 < np.mean(np.abs(found) == limit) < 0.95
    assert law.follows == ("position" if "position" in CASCADES[name] else "velocity")


@EVERY
@pytest.mark.parametrize("estimator", ESTIMATED.values(), ids=ESTIMATED)
def test_the_kernel_is_the_difference_equation_with_other_estimators(name, estimator):
    law, (r, q) = law_of(axis_with(name, velocity_estimator=estimator), T), signals(name)
    memory = [0.0] * law.memory
    found = [law.kernel(k, r[k], q[k], 0.0, 9.0, law.gains, memory) for k in range(r.size)]
    expected = command(CASCADES[name], r, q, 9.0, estimator)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@EVERY
def test_the_simulation_runs_the_same_law(name):
    """The compiled kernel in the loop makes the command that the kernel computes from the run's own signals."""
    from emps_design.simulation import Plant

    axis = axis_with(name).replace(drive={"command_limit": 4.0})
    law = law_of(axis, T)
    q_ref = 0.05 * (1 - np.cos(9 * np.arange(700) * T))
    run = Plant.of(axis).closed_loop(q_ref)
    expected = command(CASCADES[name], law.reference(q_ref, T), run.q, 4.0)
    np.testing.assert_allclose(run.u, expected, atol=1e-7)
    assert 4.0 == np.abs(run.u).max() > 2 * np.abs(run.u).min()


def test_the_backward_difference_is_the_default():
    axis = axis_with("plain")
    assert axis.controller.velocity_estimator == "backward"
    assert axis.controller.velocity["form"] == "pi"
    assert Axis.from_toml(axis.to_toml()) == axis


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"velocity": {"kp": -1.0}}, r"controller\.velocity\.kp: found -1.0 .*, expected a number greater than 0"),
        ({"velocity": {}}, r"controller\.velocity\.kp: missing, expected a number .*: gain of the velocity loop"),
        ({"velocity": {"kp": 1.0, "tii": 2.0}}, r"controller\.velocity\.tii: unknown key, did you mean 'ti'\?"),
        ({"velocity": 3.0}, r"controller\.velocity: found 3.0, expected a table"),
        ({"velocity": {"kp": 1.0, "form": "pid"}}, r"controller\.velocity\.form: found 'pid', expected 'pi' or 'ip'"),
        ({"velocity": {"kp": 1e30}}, r"controller\.velocity\.kp: found 1e\+30 .* check its unit"),
        ({"position": {"kp": 1.0, "every": 2.5}}, r"controller\.position\.every: found 2.5 .* a whole number"),
        ({"position": {"kp": 1.0, "every": 0}}, r"controller\.position\.every: found 0 .* of at least 1"),
        ({"filters": {"kind": "lowpass"}}, r"controller\.filters: found .*, expected a list of tables"),
        ({"filters": [{"kind": "comb"}]}, r"controller\.filters\.0\.kind: found 'comb', expected 'lowpass' or"),
        (
            {"filters": [{"kind": "notch", "frequency": 10.0, "depth": 0.1}]},
            r"controller\.filters\.0\.damping: found None, expected a number: a notch has damping",
        ),
        (
            {"filters": [{"kind": "lowpass", "frequency": 10.0, "depth": 0.1}]},
            r"controller\.filters\.0\.depth: found 0.1, expected no depth of a low-pass",
        ),
        ({"anti_windup": "clamp"}, r"controller\.anti_windup: found 'clamp', expected 'hold' or 'none'"),
        (
            {"position": None, "feedforward": {"velocity": 0.5}},
            r"controller\.feedforward\.velocity: found 0.5, expected 1: without a position loop",
        ),
    ],
)
def test_a_wrong_number_is_told_with_its_place(table, message):
    with pytest.raises(AxisError, match=message):
        axis_with("plain", **table)


def misses(record, axis):
    """What the law of ``axis`` misses the recorded command by [N] after the start."""
    return (axis.drive.force_gain * (record.u - law_voltage(record, axis)))[20:]


@pytest.mark.parametrize("name", [name for name, table in CASCADES.items() if "position" in table])
def test_the_law_recomputes_a_command_to_its_noise(name):
    """As a drive's trace has it: the command with noise and three decimals, positions with seven of a millimetre."""
    from emps_design.simulation import Plant
    from emps_design.simulation.synthetic import trapezoid_laps

    axis, random = axis_with(name), np.random.default_rng(8)
    run = Plant.of(axis).closed_loop(trapezoid_laps(T, laps=1))
    u = np.round(run.u + 0.03 * random.standard_normal(run.u.size), 3)
    record = Record.from_arrays(T, np.round(run.q_ref, 10), np.round(run.q, 10), u)
    left = misses(record, axis) / axis.drive.force_gain
    assert np.std(left) == pytest.approx(0.03, rel=0.03)
    assert abs(np.mean(left)) < 1e-3
    wrong = axis.replace(controller={"velocity": {**CASCADES[name]["velocity"], "kp": 280.0}})
    assert np.std(misses(record, wrong)) > 1.1 * np.std(misses(record, axis))


def drive_record(folder, name):
    """Axis and record of a drive's export, read by hand here: its numbers, not the package's way to read them."""
    table = tomllib.loads((folder / "axis.toml").read_text(encoding="utf-8"))
    table.pop("record")
    text = (folder / name).read_bytes().decode("cp1252").splitlines()
    german = ";" in text[0]
    separator, first = (";", 5) if german else (",", 2)
    rows = [line.replace(",", "." if german else ",").split(separator) for line in text[first:] if line]
    columns = dict(zip(text[first - 1].split(separator), np.array(rows, dtype=float).T, strict=True))
    if german:
        u, q, r = columns["Momentensollwert [%]"], columns["Lageistwert [mm]"] / 1e3, columns["Lagesollwert [mm]"] / 1e3
    else:
        u, q, r = columns["cmd_A"], np.radians(columns["pos_deg"]), np.radians(columns["ref_deg"])
    return Axis.from_dict(table), Record.from_arrays(table["sampling"]["period"], r, q, u, name=name)


@pytest.mark.parametrize(("machine_name", "noise"), [("gantry", 1.2), ("joint", 0.12)])
@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("name", ["train.csv", "holdout.csv"])
def test_the_law_recomputes_the_commands_of_a_drive(servo_data, machine_name, noise, number, name):
    """What is left is the noise that the records were given, white, and nothing else."""
    axis, record = drive_record(servo_data / f"{machine_name}-none-{number}", name)
    left = misses(record, axis)
    assert np.std(left) == pytest.approx(noise, rel=4 / np.sqrt(2 * left.size))
    assert abs(np.mean(left)) < 0.01 * noise
    assert abs(np.corrcoef(left[1:], left[:-1])[0, 1]) < 4 / np.sqrt(left.size)


def test_what_comes_from_a_profile_is_its_generators_own_to_second_order():
    """At the sample: the velocity of t^3 misses T^2 / 3 times the jerk, that of t^2 and accelerations nothing."""
    plant, t = machine("emps2019").to_dict(), np.arange(400) * T
    found = []
    for ahead in ({"velocity": 1.0}, {"acceleration": 1.0}):
        controller = {"kind": "cascade", "position": {"kp": 1.0}, "velocity": {"kp": 1.0}}
        law = law_of(
            Axis.from_dict(plant | {"controller": controller | {"feedforward": ahead | {"source": "profile"}}}), T
        )
        for path in (t**2, t**3):
            memory = np.zeros(law.memory)
            u = [law.kernel(k, path[k], path[0], 0.0, 1e9, law.gains, memory) for k in range(t.size)]
            found.append((np.array(u) - path)[3:])
    expected = (2.0 * t, 3.0 * t**2 - 2.0 * T**2, 0.0 * t + 2.0, 6.0 * t)
    for given, exact in zip(found, expected, strict=True):
        np.testing.assert_allclose(given, exact[3:], atol=1e-7)


def test_without_a_position_loop_nothing_is_taken_from_a_profile():
    with pytest.raises(AxisError, match=r'feedforward.source: found "profile", expected none'):
        axis_with("velocity", feedforward={"source": "profile"})
