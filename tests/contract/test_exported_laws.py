"""Every law as C: the compiler has nothing to say, the vectors hold, and long runs have the simulation's bits."""

import ctypes
import json
import re
import shutil
import subprocess
from functools import cache

import numpy as np
import pytest

import emps_design.laws as laws
from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.codegen import export_controller, export_observer
from emps_design.compensation import compensate
from emps_design.compensation.feedforward import motion_ahead
from emps_design.errors import InputError
from emps_design.laws import LAWS, get_law, law_of
from emps_design.machines import machine
from emps_design.observer import ForceObserver, as_driven, observe_online
from emps_design.records import Record
from emps_design.simulation import Plant, trapezoid_laps
from tests.contract.test_laws import ESTIMATED, GIVEN, OWN, OWN_TABLE, axis_with
from tests.studies import quick
from tests.unit.compensation.test_compensation import DUTY, EFFECTS_HERE

pytestmark = pytest.mark.usefixtures("short_vectors")

CC = shutil.which("cc")
EVERY = pytest.mark.parametrize("kind", LAWS, ids=lambda kind: kind.name)
LIGHT = {  # fast, fine, turning
    "motion": "rotary",
    "mechanics": {"mass": 2e-3, "viscous": 1e-2, "coulomb": 0.05, "offset": 0.01},
    "sampling": {"period": 1.25e-4, "encoder_resolution": 1e-6},
}
ON_LIGHT = [
    {"kind": "gravity", "torque": 0.08, "angle": 0.4},
    {"kind": "friction_ripple", "amplitude": 0.01, "phase": 1.0, "period": 0.02},
]
HEIGHTS = {f"height_{i + 1}": height for i, height in enumerate((1.0, 3.0, 2.0, -1.0, 0.0, 4.0))}
MAPS = [{"kind": kind, "start": -0.1, "end": 0.1, **HEIGHTS} for kind in ("force_map", "friction_map")]
STOP = {"kind": "end_stop", "stiffness": 1e4, "position": 0.05, "side": 1.0}
OBSERVERS = {
    "observer": {},
    "observer with effects": {"effects": EFFECTS_HERE[:7]},
    "observer of a light arm": {**LIGHT, "effects": ON_LIGHT},
    "observer of 30 t": {"mechanics": {"mass": 3e4, "coulomb": 900.0}, "effects": [*MAPS, STOP, EFFECTS_HERE[4]]},
}
OBSERVED = pytest.mark.parametrize("name", quick(OBSERVERS, {"observer with effects"}.__contains__, "other observers"))
ESTIMATORS = pytest.mark.parametrize(
    "estimator", quick(["backward", "two_tap", *ESTIMATED.values()], 1, "other estimators")
)
LONG_RUN = 20_000  # samples
compiled = pytest.mark.skipif(CC is None, reason="needs a C compiler")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wconversion", "-O2", "-ffp-contract=off"]
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def written(axis, folder):
    exported = export_controller(axis, "c")
    exported.write(folder)
    return exported


def make_check(folder, *arguments):
    return subprocess.run(["make", "-B", "check", *arguments], cwd=folder, capture_output=True, text=True, check=False)


class Compiled:
    """The exported block of a folder, compiled, called sample by sample."""

    def __init__(self, folder, exported, single=False):
        name, single_flag = exported.name, [f"-D{exported.name.upper()}_SINGLE"] if single else []
        library = folder / f"{name}{'_single' if single else ''}.so"
        subprocess.run(
            [CC, *STRICT, *single_flag, "-shared", "-fPIC", "-o", library, folder / f"{name}.c", "-lm"], check=True
        )
        number = ctypes.c_float if single else ctypes.c_double

        class State(ctypes.Structure):
            # the memory twice: of the law on its reference too
            _fields_ = (("k", ctypes.c_longlong), ("memory", number * max(2, 2 * exported.block.law.memory)))

        self.state, self.library = State(), ctypes.CDLL(str(library))
        self.begin, self.step = getattr(self.library, f"{name}_init"), getattr(self.library, f"{name}_step")
        self.step.restype, self.number, self.pointer = number, number, ctypes.POINTER(State)

    def run(self, *inputs):
        self.step.argtypes = [self.pointer, *[self.number] * len(inputs)]
        self.begin(ctypes.byref(self.state))
        here = ctypes.byref(self.state)
        rows = zip(*(one.tolist() for one in inputs), strict=True)
        return np.array([self.step(here, *row) for row in rows])


def assert_proved(folder, exported):
    """``make check`` builds both precisions and they hold, under the sanitizers too; every row has a tolerance."""
    done, rows = make_check(folder), exported.vectors.q.size
    assert done.returncode == 0, done.stderr
    assert f"double precision: {rows} of {rows} rows with the same bits" in done.stdout
    assert f"single precision: {rows} of {rows} rows within their bound" in done.stdout
    assert ", 0 rows without" in done.stdout
    assert make_check(folder, f"CFLAGS=-O1 -g {' '.join(SANITIZERS)}").returncode == 0


@compiled
@EVERY
@ESTIMATORS
def test_the_folder_proves_itself(kind, estimator, tmp_path):
    """Both precisions build without a warning and hold on the vectors, also under the sanitizers."""
    exported = written(axis_with(kind, velocity_estimator=estimator), tmp_path)
    assert_proved(tmp_path, exported)


def laps(axis, law, samples=LONG_RUN):
    """A closed loop of so many samples: what the law was given, and what it answered."""
    t = np.arange(samples) * axis.sampling.period
    q_ref = 0.08 * (1.0 - np.cos(1.3 * t)) + 0.02 * np.sin(7.0 * t) * np.minimum(t, 1.0)
    push = 40.0 * np.sin(2.1 * t) * (np.sin(0.7 * t) > 0.5)
    run = Plant.of(axis).closed_loop(q_ref, disturbance=push, method="general")
    return law.reference(q_ref, axis.sampling.period), run


@compiled
@EVERY
@ESTIMATORS
@pytest.mark.parametrize("samples", quick([LONG_RUN, 100_000], 1, "100,000 samples"))
def test_a_long_run_has_the_simulations_bits(kind, estimator, samples, tmp_path):
    axis = axis_with(kind, velocity_estimator=estimator).replace(drive={"current_time_constant": 5e-4})
    exported = written(axis, tmp_path)
    reference, run = laps(axis, exported.block.law, samples)
    assert np.ptp(run.position) > 0.01
    found = Compiled(tmp_path, exported).run(reference, run.q, run.f_ext)
    assert found.size == samples
    np.testing.assert_array_equal(found.view(np.int64), run.u.view(np.int64))


@compiled
def test_an_estimator_that_filters_has_the_simulations_bits(tmp_path):
    """A slope of four points in the law that keeps an acceleration besides."""
    axis = axis_with(get_law("impedance"), velocity_estimator=ESTIMATED["slope"])
    exported = written(axis, tmp_path)
    reference, run = laps(axis, exported.block.law, 5000)
    found = Compiled(tmp_path, exported).run(reference, run.q, run.f_ext)
    np.testing.assert_array_equal(found.view(np.int64), run.u.view(np.int64))


def assert_noticed(folder, changed):
    """What ``make check`` builds and runs first fails: that in double precision, which knows every bit."""
    build = ["make", "-B", "check_double", "CFLAGS=-O1 -std=c99 -ffp-contract=off"]
    subprocess.run(build, cwd=folder, capture_output=True, check=True)
    done = subprocess.run(["./check_double", "vectors.csv"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode != 0, f"{changed}: {done.stdout}"


def numbers_of(source):
    """Places of the numbers of the gains and of the limit in C ``source``."""
    table = source.index("static const real LIMIT")
    return [
        (match.start(1), match.end(1))
        for match in re.finditer(r"R\(([^)]*)\)", source)
        if table <= match.start() < source.index("};", table)
    ]


@compiled
@pytest.mark.parametrize(
    "kind",
    quick(LAWS, lambda law: law.name not in ("cascade", "impedance"), "many coefficients"),
    ids=lambda kind: kind.name,
)
def test_one_changed_coefficient_is_noticed(kind, tmp_path):
    """A gain that is off by one in 10,000, or a switch that stands otherwise, fails ``make check``."""
    exported = written(axis_with(kind), tmp_path)
    path = tmp_path / f"{exported.name}.c"
    source = path.read_text(encoding="utf-8")
    places = numbers_of(source)
    assert len(places) == 1 + len(exported.block.law.gains)
    for start, end in places:
        value = float(source[start:end])
        counts = value in range(2, 10)  # of filters, of samples
        changed = value - 1.0 if counts else 1.0 - value if value in (0.0, 1.0) else value * (1.0 + 1e-4)
        path.write_text(f"{source[:start]}{changed!r}{source[end:]}", encoding="utf-8")
        assert_noticed(tmp_path, f"{source[start:end]} -> {changed!r}")


PROGRAM = trapezoid_laps(1e-3, 0.05, 0.15, 1.0, laps=1)
LONG = trapezoid_laps(1e-3, 0.05, 0.15, 1.0, laps=100)[:LONG_RUN]
CASCADE = {"kind": "cascade", "velocity": {"kp": 40.0, "ti": 0.05, "form": "ip"}}
COMPENSATED = {
    "rigid": {},
    "velocity": {"controller": CASCADE},
    "limited": {"controller": {**CASCADE, "position": {"kp": 6.0}}, "drive": {"command_limit": 2.0}},
    "several": {"effects": EFFECTS_HERE[:4]},
    "itself": {"effects": [EFFECTS_HERE[4]]},
    "late": {"effects": [EFFECTS_HERE[5], EFFECTS_HERE[7]]},
    "back-EMF": {"effects": [EFFECTS_HERE[4]], **DUTY},
    "maps": {"effects": MAPS},
}


@cache
def compensation(name):
    """An axis and what compensates its effects."""
    axis = machine("emps2019").replace(**COMPENSATED[name])
    return axis, compensate(axis, PROGRAM)


@cache
def compensated_run(name):
    """What goes into a compensated block in a long closed loop, and the command of the simulation."""
    axis, found = compensation(name)
    law, ahead = law_of(axis, 1e-3).on_error(), found.feedforward.along(LONG)
    run = Plant.of(axis).closed_loop(LONG, voltage_noise=ahead, law=law, method="general")
    return (LONG, run.q, run.f_ext, *motion_ahead(LONG, 1e-3, found.feedforward.wait)), run.u


def compensated_block(name, target):
    """A block of a law with its compensation."""
    axis, found = compensation(name)
    return export_controller(axis, target, found.to_dict())


@compiled
@pytest.mark.parametrize("name", quick(COMPENSATED, {"velocity", "several"}.__contains__, "other compensations"))
def test_a_compensated_law_has_the_simulations_bits(name, tmp_path):
    """``make check`` with the feed-forward inside, and a long closed loop with it."""
    exported, (inputs, u) = compensated_block(name, "c"), compensated_run(name)
    exported.write(tmp_path)
    assert_proved(tmp_path, exported)
    answers = Compiled(tmp_path, exported).run(*inputs)
    assert answers.size == LONG_RUN
    np.testing.assert_array_equal(answers.view(np.int64), u.view(np.int64))


def block_called(name):
    """A block in C: of a law, of a compensated law, of an observer."""
    if name in OBSERVERS:
        return export_observer(machine("emps2018").replace(**OBSERVERS[name]), "c", 30.0)
    if name in COMPENSATED:
        return compensated_block(name, "c")
    return export_controller(axis_with(get_law(name)), "c")


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="needs cppcheck")
@pytest.mark.parametrize("name", [*GIVEN, *{**COMPENSATED, **OBSERVERS}])
def test_a_static_checker_has_nothing_to_say(name, tmp_path):
    exported = block_called(name)
    exported.write(tmp_path)
    looks = [
        "--enable=warning,style,performance,portability",
        "--inconclusive",
        "--std=c99",
        "--quiet",
        "--error-exitcode=1",
    ]
    for macro in ([], [f"-D{exported.name.upper()}_SINGLE"]):
        done = subprocess.run(["cppcheck", *looks, *macro, tmp_path], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout + done.stderr) == (0, "")


@compiled
@pytest.mark.study("a program for every number of a feed-forward")
def test_one_changed_number_of_the_feed_forward_is_noticed(tmp_path):
    exported = compensated_block("several", "c")
    exported.write(tmp_path)
    path = tmp_path / f"{exported.name}.c"
    source = path.read_text(encoding="utf-8")
    begin = source.index("_position_ripple_")
    for match in re.finditer(r"R\((\d+\.\d+)\)", source[begin : source.index("void ", begin)]):
        value, start = float(match[1]), begin + match.start(1)
        if value in (0.0, 1.0, 1e-4):
            continue
        changed = f"{source[:start]}{value * (1.0 + 1e-6)!r}{source[begin + match.end(1) :]}"
        path.write_text(changed, encoding="utf-8")
        assert_noticed(tmp_path, match[0])


def observed(name, target):
    """An observer, what goes into it in a long run, and the force that is seen on line."""
    axis = machine("emps2018").replace(**OBSERVERS[name])
    t = np.arange(LONG_RUN) * axis.sampling.period
    q, u = 0.1 * np.sin(9.0 * t) * (t > 0.2), 2.0 * np.sin(9.1 * t)
    inputs = np.concatenate([u[:1], u[:-1]]), q, np.zeros(q.size)
    return export_observer(axis, target, 30.0), inputs, observe_online(ForceObserver(axis, 30.0), q, u)


@compiled
@OBSERVED
def test_the_observer_is_the_one_that_runs_on_line(name, tmp_path):
    exported, inputs, force = observed(name, "c")
    exported.write(tmp_path)
    assert_proved(tmp_path, exported)
    found = Compiled(tmp_path, exported).run(*inputs)
    np.testing.assert_array_equal(found.view(np.int64), force.view(np.int64))


def test_what_a_back_emf_brakes_is_in_the_exported_observer():
    axis = machine("emps2019").replace(**DUTY)
    record = Record.from_arrays(1e-3, *(0.1 * np.sin(np.arange(500) / w) for w in (40.0, 41.0, 30.0)))
    driven, rest = as_driven(axis.replace(drive={"current_time_constant": 0.0}), record)
    seen = observe_online(ForceObserver(rest, 30.0), driven.q, driven.u)
    block = export_observer(axis, "json", 30.0).block
    given = np.concatenate([record.u[:1], record.u[:-1]])
    force, _ = block.run(np.arange(500) == 0, given, record.q, np.zeros(500))
    np.testing.assert_allclose(force, seen, rtol=1e-9)
    assert axis.drive.braking * np.ptp(record.q) > 0.1


@pytest.mark.parametrize(
    ("effect", "reason"),
    [
        (
            {"kind": "actuator_lag", "time_constant": 1e-3},
            "actuator_lag, it has a state that does not follow from",
        ),
        ({"kind": "actuator_deadzone", "width": 0.1}, "actuator_deadzone, it acts in the actuator, not as a force of"),
        (
            {"kind": "friction_drift", "change": 0.3, "time_constant": 9.0},
            "friction_drift, it depends on the time within",
        ),
    ],
)
def test_an_effect_that_cannot_be_observed_on_line_is_refused(effect, reason):
    axis = machine("emps2018").replace(effects=[EFFECTS_HERE[0], effect])
    with pytest.raises(
        InputError, match=rf"observer of emps2018: found {reason}.*; remove these effects from the axis"
    ):
        export_observer(axis, "c", 20.0)


def test_an_observer_that_cannot_be_exported_is_refused(tmp_path, capsys):
    line = ["export", "emps2018", "--observer", "20", "--out", str(tmp_path / "new"), "--to"]
    assert app.run([*line, "fmu"]) == 2
    assert "--to: found 'fmu' for an observer, expected one of c, st, json" in capsys.readouterr().err
    assert app.run([*line, "c", "--compensation", "x.json"]) == 2
    assert "--compensation: cannot be combined with --observer" in capsys.readouterr().err
    assert app.run([*line, "json"]) == 0
    for cutoff in ("nan", "0", "500"):
        assert app.run(["export", "emps2018", "--observer", cutoff, "--out", str(tmp_path / "x"), "--to", "c"]) == 2
        assert f"found {cutoff} Hz, expected between 0 and 500 Hz" in capsys.readouterr().err


def test_a_compensation_of_another_axis_is_refused():
    axis = machine("emps2019")
    found = compensate(axis, PROGRAM).to_dict()
    for other, document, message in (
        (axis.replace(name="other"), found, "run compensate on this axis"),
        (axis, {**found, "kept": ["position_ripple"]}, "expected those of emps2019"),
        (axis, {}, "expected the document that compensate writes"),
        (axis, {**found, "law_taken_off": False}, "run compensate on this axis again"),
        (axis.replace(controller={"kp": 100.0}), found, "with other parameters or another controller"),
    ):
        with pytest.raises(InputError, match=message):
            export_controller(other, "c", document)


@pytest.mark.parametrize("reversal", [np.nan, np.inf, -1.0, 1e-300, True])
def test_a_compensation_with_an_impossible_speed_is_refused(reversal):
    axis, found = compensation("rigid")
    with pytest.raises(InputError, match=r"found a reversal of .*, expected the speed that compensate writes"):
        export_controller(axis, "json", {**found.to_dict(), "reversal": reversal})
    unmarked = {key: value for key, value in found.to_dict().items() if key != "axis_sha256"}
    with pytest.raises(InputError, match="with other parameters or another controller"):
        export_controller(axis, "json", unmarked)


@pytest.mark.parametrize("name", ["rigid", "velocity"])
def test_the_document_says_that_the_law_is_on_its_error(name):
    """By its own words: the equations on the error, and the feed-forward beside them, in every language."""
    axis, _ = compensation(name)
    made = json.loads(str(compensated_block(name, "json").files["emps2019.json"]))
    assert made["law_on_error"]
    assert "q[k]: position less reference" in made["equations"][-2]
    assert made["equations"][-1].startswith("command[k] = u[k] + feedforward(")
    for target, file in (("c", "emps2019.h"), ("st", "emps2019.st")):
        text = str(compensated_block(name, target).files[file])
        assert made["equations"][-1] in text
        assert "the position of the reference [m]" in text
    alone = json.loads(str(export_controller(axis, "json").files["emps2019.json"]))
    assert not alone["law_on_error"]
    assert alone["equations"] == made["equations"][:-2]


def test_a_compensation_that_keeps_nothing_is_said_to():
    axis, found = compensation("rigid")
    exported = export_controller(axis, "json", {**found.to_dict(), "kept": []})
    assert exported.block.ahead is None
    assert exported.to_dict()["warnings"] == ["the compensation has no useful term: only the law was exported"]
    assert export_controller(axis, "json").to_dict()["warnings"] == []


def test_code_of_an_unstable_loop_is_not_written(tmp_path, capsys):
    path, out = tmp_path / "axis.toml", tmp_path / "code"
    table = {"kind": "cascade", "position": {"kp": 30.0}, "velocity": {"kp": 3e5, "ti": 0.05}}
    path.write_text(machine("emps2019").replace(controller=table).to_toml())
    for target in ("c", "st", "fmu", "json"):
        assert app.run(["export", str(path), "--to", target, "--out", str(out)]) == 4
        assert "the velocity loop is unstable; no code was exported" in capsys.readouterr().err
        assert not out.exists()


@compiled
def test_a_users_law_is_exported_like_ours(tmp_path):
    own = tmp_path / "hardening.py"
    own.write_text(OWN, encoding="utf-8")
    laws.load_file(own)
    try:
        axis = Axis.from_dict({**machine("emps2019").to_dict(), "controller": OWN_TABLE})
        exported = written(axis, tmp_path)
        assert make_check(tmp_path).returncode == 0
        assert "not checked: the law is not linear" in exported.to_dict()["warnings"][0]
        reference, run = laps(axis, exported.block.law, 5000)
        np.testing.assert_array_equal(Compiled(tmp_path, exported).run(reference, run.q, run.f_ext), run.u)
    finally:
        laws.REGISTRY.added.clear()


@compiled
@EVERY
def test_single_precision_differs_by_what_was_measured(kind, tmp_path):
    """The compiled code differs from double precision by the very difference that was measured here."""
    exported = written(axis_with(kind), tmp_path)
    vectors = exported.vectors
    single = Compiled(tmp_path, exported, single=True)
    first = np.flatnonzero(vectors.start)
    for start, end in zip(first, [*first[1:], vectors.q.size], strict=True):
        part = slice(start, end)
        apart = np.abs(single.run(vectors.reference[part], vectors.q[part], vectors.f_ext[part]) - vectors.u[part])
        np.testing.assert_array_equal(apart, vectors.difference[part])
        assert np.all(apart <= vectors.tolerance[part])
    assert np.isfinite(vectors.tolerance[first[1] : first[2]]).all()
    assert set(GIVEN) == {kind.name for kind in LAWS}
