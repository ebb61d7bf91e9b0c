"""Which controller made a record: structure and gains from closed loops that the tests compute themselves."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from emps_design.cli.app import run
from emps_design.errors import RecordError
from emps_design.identification.controller import AMBIGUOUS, NOT_TOLD, TOLD, identify_law
from emps_design.identification.controller.fit import CommandFilter, LawFit, covariance, fit, with_deviations
from emps_design.identification.controller.identify_law import signals_of
from emps_design.identification.controller.regressors import LawStructure, Timing
from emps_design.identification.controller.wording import numbers_of
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.records.layout import Layout
from tests.studies import quick
from tests.unit.identification.controller.closed_loop import Loop

# A loop, the numbers that have to be found, and the structure.
CASES = {
    "position_pd, backward, coarse encoder": (
        Loop(kp=30.0, kv=300.0, step=1e-5, noise=0.1),
        {"kp": 30.0, "kv": 300.0},
        {"kind": "position_pd", "velocity_estimator": "backward"},
    ),
    "position_pd, two-tap": (
        Loop(kp=60.0, kv=300.0, step=1e-6, two_tap=True, noise=0.01),
        {"kp": 60.0, "kv": 300.0},
        {"kind": "position_pd", "velocity_estimator": "two_tap"},
    ),
    "ip_velocity, two-tap": (
        Loop(kp=None, kv=400.0, ti=0.05, form="ip", share=1.0, two_tap=True, noise=0.01),
        {"k_v1": 400.0, "t_v": 0.05},
        {"kind": "ip_velocity", "velocity_estimator": "two_tap"},
    ),
    "velocity reference": (
        Loop(kp=None, kv=300.0, ti=0.04, velocity_reference=True, lowpass=200.0, noise=0.02),
        {"velocity.kp": 300.0, "velocity.ti": 0.04, "filters.0.frequency": 200.0},
        {"kind": "cascade", "velocity.form": "pi", "filters.0.kind": "lowpass"},
    ),
    "ip cascade": (
        Loop(kp=20.0, kv=400.0, ti=0.03, form="ip", share=0.5, lowpass=150.0, noise=0.02),
        {"position.kp": 20.0, "velocity.kp": 400.0, "velocity.ti": 0.03, "feedforward.velocity": 0.5}
        | {"filters.0.frequency": 150.0},
        {"kind": "cascade", "position.every": 1, "velocity.form": "ip", "filters.0.kind": "lowpass"},
    ),
    "late by a sample": (
        Loop(kp=20.0, kv=400.0, ti=0.03, share=1.0, acceleration=5.0, delay=1, noise=0.02),
        {"position.kp": 20.0, "velocity.kp": 400.0, "velocity.ti": 0.03, "feedforward.acceleration": 5.0},
        {"kind": "cascade", "velocity.form": "pi", "feedforward.velocity": 1.0},
    ),
    "two notches": (
        Loop(kp=20, kv=400, ti=0.05, share=0.9, notches=((120, 0.5, 0.1), (310, 0.4, 0.2)), noise=0.02, samples=8000),
        {"position.kp": 20.0, "velocity.kp": 400.0, "velocity.ti": 0.05, "feedforward.velocity": 0.9}
        | {"filters.0.frequency": 120.0, "filters.1.frequency": 310.0},
        {"kind": "cascade", "filters.0.kind": "notch", "filters.1.kind": "notch"},
    ),
    "position loop and integral alike": (
        Loop(kp=25.0, kv=400.0, ti=0.04, share=1.0, noise=0.02),
        {"position.kp": 25.0, "velocity.kp": 400.0, "velocity.ti": 0.04},
        {"kind": "cascade", "feedforward.velocity": 1.0},
    ),
    "fed forward from a profile": (
        Loop(kp=25.0, kv=400.0, ti=0.04, share=0.9, acceleration=3.0, profile=True, noise=0.01),
        {"position.kp": 25.0, "velocity.kp": 400.0, "velocity.ti": 0.04, "feedforward.acceleration": 3.0},
        {"kind": "cascade", "feedforward.source": "profile", "velocity_estimator": "backward"},
    ),
    "at its limit": (
        Loop(kp=25.0, kv=400.0, ti=0.04, share=0.9, limit=14.0, noise=0.02, samples=8000),
        {"position.kp": 25.0, "velocity.kp": 400.0, "velocity.ti": 0.04, "feedforward.velocity": 0.9},
        {"kind": "cascade", "velocity.form": "pi"},
    ),
    "at its limit a quarter of the time": (
        Loop(kp=25.0, kv=400.0, ti=0.04, share=0.5, limit=9.0, noise=0.02, samples=8000, seed=1),
        {"position.kp": 25.0, "velocity.kp": 400.0, "velocity.ti": 0.04, "feedforward.velocity": 0.5},
        {"kind": "cascade", "velocity.form": "pi"},
    ),
    "IP, for a sample or two at its limit": (
        Loop(kp=25.0, kv=400.0, ti=0.04, form="ip", limit=12.0, noise=0.0005, samples=8000),
        {"position.kp": 25.0, "velocity.kp": 400.0, "velocity.ti": 0.04},
        {"kind": "cascade", "velocity.form": "ip"},
    ),
    "slope of four points": (
        Loop(kp=30.0, kv=300.0, share=1.0, estimator=("slope", 4), noise=0.02),
        {"position.kp": 30.0, "velocity.kp": 300.0},
        {"kind": "cascade", "feedforward.velocity": 1.0, "velocity_estimator": {"kind": "slope", "points": 4}},
    ),
    "filtered difference": (
        Loop(kp=20.0, kv=400.0, ti=0.04, share=0.9, estimator=("filtered", 60.0), noise=0.02),
        {"position.kp": 20.0, "velocity.kp": 400.0, "velocity.ti": 0.04, "velocity_estimator.frequency": 60.0},
        {"kind": "cascade", "velocity_estimator.kind": "filtered"},
    ),
    "tracking loop": (
        Loop(kp=20.0, kv=300.0, estimator=("tracking", 500.0), noise=0.002),
        {"kp": 20.0, "kv": 300.0, "velocity_estimator.bandwidth": 500.0},
        {"kind": "position_pd", "velocity_estimator.kind": "tracking"},
    ),
    "proportional, at its limit": (
        Loop(kp=3000.0, proportional=True, limit=25.0, friction=(150.0, 6.0), noise=0.05),
        {"kp": 3000.0},
        {"kind": "p"},
    ),
}


def record_of(loop: Loop) -> Record:
    r, q, u = loop.run()
    if not loop.velocity_reference:
        return Record.from_arrays(loop.period, r, q, u, name="loop")
    record = Record.from_arrays(loop.period, q, q, u, name="loop")
    return replace(record, velocity_reference=r, q_ref_recorded=False)


def at(table, name: str):
    for key in name.split("."):
        table = table[int(key)] if isinstance(table, list) else table[key]
    return table


# The others search filters or limits, or several rates at once, and take longer.
QUICK = (
    "position_pd, backward, coarse encoder",
    "proportional, at its limit",
)


@pytest.mark.parametrize("name", quick(CASES, QUICK.__contains__, "a search over structures"))
def test_structure_and_gains_of_a_loop(name):
    loop, numbers, structure = CASES[name]
    found = identify_law(record_of(loop))
    assert found.verdict == TOLD or (found.verdict == AMBIGUOUS and "every" in found.reason), found.reason
    assert {key: at(found.controller, key) for key in structure} == structure
    assert found.delay == loop.delay
    assert len(found.controller.get("filters", [])) == (loop.lowpass is not None) + len(loop.notches)
    for key, true in numbers.items():
        value, std = at(found.controller, key), at(found.std, key)
        assert value == pytest.approx(true, rel=0.03), key
        assert abs(value - true) < 4.0 * std, (key, value, std)
    assert found.residual_rms == pytest.approx(loop.noise, rel=0.1)
    if np.isfinite(loop.limit):
        assert found.limit == pytest.approx(loop.limit, rel=2e-3)


@pytest.mark.study("a search over structures and rates at 4 kHz")
def test_a_cascade_at_4_khz_with_everything():
    loop = Loop(
        kp=40.0, every=4, kv=500.0, ti=0.02, share=0.8, acceleration=4.5, coulomb=5.0, lowpass=300.0,
        notches=((180.0, 0.6, 0.15),), period=0.25e-3, samples=12000, noise=0.05,
    )  # fmt: skip
    found = identify_law(record_of(loop))
    table = found.controller
    assert table["position"]["every"] == 4
    wanted = {"position.kp": 40.0, "velocity.kp": 500.0, "velocity.ti": 0.02, "feedforward.velocity": 0.8}
    wanted |= {"feedforward.acceleration": 4.5, "feedforward.coulomb": 5.0}
    for key, true in wanted.items():
        assert at(table, key) == pytest.approx(true, rel=0.03), key
        assert abs(at(table, key) - true) < 4.0 * at(found.std, key), key
    frequencies = {one["kind"]: one["frequency"] for one in table["filters"]}
    assert frequencies == {"lowpass": pytest.approx(300.0, rel=0.06), "notch": pytest.approx(180.0, rel=0.03)}


@pytest.mark.study("coverage over 200 noises")
def test_deviations_hold_the_truth_as_often_as_they_say():
    """95 % within two deviations: 200 noises on one run of a loop, at its own structure."""
    loop = Loop(kp=20.0, kv=400.0, ti=0.03, share=0.9, lowpass=150.0, noise=0.0, samples=4000)
    r, q, clean = loop.run()
    rng = np.random.default_rng(5)
    true = {"position.kp": 20.0, "velocity.kp": 400.0, "velocity.ti": 0.03, "feedforward.velocity": 0.9}
    true |= {"filters.0.frequency": 150.0}
    structure = LawStructure(acceleration=False, coulomb=False, offset=False)
    start = LawFit(structure, Timing(), (CommandFilter.lowpass(140.0),), 0.0, np.zeros(0), 1.0, 1)
    within = dict.fromkeys(true, 0)
    for _ in range(200):
        record = Record.from_arrays(loop.period, r, q, clean + rng.normal(0.0, 0.03, clean.size))
        signals = signals_of(record)
        fitted = fit(signals, start)
        found = with_deviations(fitted, covariance(signals, fitted, None), lambda one: numbers_of(one, False))
        for name, value in true.items():
            within[name] += abs(found[name][0] - value) < 2.0 * found[name][1]
    assert all(181 <= count <= 199 for count in within.values()), within  # 191, four deviations of the count


@pytest.mark.study("searches over structures")
@pytest.mark.parametrize(
    "name", quick(["position_pd, backward, coarse encoder", "velocity reference"], 1, "another loop")
)
def test_two_records_tell_more_than_one(name):
    loop, numbers, structure = CASES[name]
    several = [record_of(replace(loop, seed=seed, samples=1700 + 300 * seed)) for seed in (0, 1)]
    one, both = identify_law(several[0]), identify_law(several)
    assert (both.verdict, both.record) == (TOLD, "loop + loop")
    assert {key: at(both.controller, key) for key in structure} == structure
    for key, true in numbers.items():
        assert at(both.std, key) < 0.9 * at(one.std, key), key
        assert abs(at(both.controller, key) - true) < 4.0 * at(both.std, key), key


def test_it_says_how_far_apart_two_rates_are_that_fit_alike(capsys, tmp_path):
    """Three deviations, by what the other rate leaves of the command without noise: too near, whatever the method."""
    loop = Loop(kp=20.0, every=2, kv=400.0, ti=0.03, share=0.9, noise=0.0, samples=4000)
    r, q, clean = loop.run()
    structure = LawStructure(acceleration=False, coulomb=False, offset=False)
    start = LawFit(structure, Timing(every=1), (), 0.0, np.zeros(0), 1.0, 1)
    left = np.sqrt(fit(signals_of(Record.from_arrays(loop.period, r, q, clean)), start).cost)
    noise = np.random.default_rng(1).normal(0.0, left / 3.0, clean.size)
    Record.from_arrays(loop.period, r, q, clean + noise).save(tmp_path / "weak.npz")
    assert run(["law", str(tmp_path / "weak.npz"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == AMBIGUOUS
    assert found["equivalents"][0]["position"]["every"] == 1
    rival = next(one for one in found["tried"] if "position loop every 1," in one["terms"])
    assert rival["apart"] == pytest.approx(3.0, abs=0.1)
    assert found["notes"][0].startswith("the nearest of them is 3 standard deviations of the noise apart")
    assert "separating them requires 5.2: about 3 times as much" in found["notes"][0]
    for name in ("position.kp", "velocity.kp", "velocity.ti", "feedforward.velocity"):  # the deviations reach the rival
        distance = abs(at(found["equivalents"][0], name) - at(found["controller"], name))
        assert at(found["std"], name) >= 0.99 * distance, name


def test_records_of_unlike_columns_are_no_one_controllers():
    record = record_of(Loop(kp=30.0, kv=300.0, noise=0.01, samples=300))
    irregular = replace(record, measured={"t": record.t, "q_ref": record.q_ref, "q": record.q, "u": record.u})
    slower = Record.from_arrays(2e-3, record.q_ref, record.q, record.u, name="slow")
    followed = replace(record, velocity_reference=record.q, q_ref_recorded=False)
    for other, line in (
        (slower, "slow: period: found 0.002 s, expected 0.001 s as in loop"),
        (followed, "reference: found a velocity, expected a position"),
        (irregular, "found irregular samples"),
    ):
        with pytest.raises(RecordError, match=line):
            identify_law([record, other])


def test_it_says_why_it_cannot_tell():
    loop = Loop(kp=30.0, kv=300.0, noise=0.01, samples=1500)
    r, q, u = loop.run()
    record = Record.from_arrays(loop.period, r, q, u)
    cases = {
        "no reference": replace(record, q_ref_recorded=False),
        "axis is at rest": replace(record, q=np.zeros(q.size)),
        "command is constant": replace(record, u=np.ones(u.size)),
        "expected at least": record.part(0, 150),
    }
    for reason, one in cases.items():
        found = identify_law(one)
        assert (found.verdict, found.controller) == (NOT_TOLD, None)
        assert reason in found.reason
        with pytest.raises(ValueError, match=reason):
            found.to_toml()


def test_of_rates_that_fit_alike_every_one_is_named():
    """A position loop that hardly acts: the true rate is the one given, or among the equivalents."""
    for seed, every in ((32, 2),):
        loop = Loop(kp=3.0, every=every, kv=300.0, share=0.9, noise=0.3, samples=3000, seed=seed)
        found = identify_law(record_of(loop))
        tables = [found.controller, *found.equivalents]
        assert every in {table.get("position", {}).get("every", 1) for table in tables}, found.reason


def test_a_polled_position_that_is_older_than_the_command_tells_its_gain():
    """Irregular samples of u = kp (r - q), the position read 2 ms before the command, both in the steps of a servo."""
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.uniform(4.8e-3, 5.8e-3, 1200))
    r, q, newer = 1.2 * np.sin(0.4 * t**2), *(1.15 * np.sin(0.4 * (t + at - 0.06) ** 2) for at in (0.0, 2e-3))
    u = np.trunc(0.57 * (r - newer) * 885.0) / 885.0
    record = Record.from_arrays(5e-3, r, np.round(q / 1.534e-3) * 1.534e-3, u)
    columns = {"t": t, "q_ref": r, "q": record.q, "u": u}
    found = identify_law(replace(record, measured=columns))
    assert (found.verdict, found.controller["kind"]) == (TOLD, "p")
    assert found.controller["kp"] == pytest.approx(0.57, rel=0.015)
    assert abs(found.controller["kp"] - 0.57) < 3.0 * found.std["kp"]
    assert "ms before the one that the controller used" in " ".join(found.notes)


@pytest.mark.study("a search over structures")
def test_an_open_loop_has_no_law():
    t = np.arange(2000) * 1e-3
    rng = np.random.default_rng(3)
    u = np.sin(7.0 * t) + 0.5 * np.sign(np.sin(23.0 * t)) + 0.3 * rng.normal(size=t.size).cumsum() / 30.0
    speed = 0.0
    q = np.zeros(t.size)
    for k in range(1, t.size):
        speed += 1e-3 * (u[k - 1] - 3.0 * speed)
        q[k] = q[k - 1] + 1e-3 * speed
    record = Record.from_arrays(1e-3, 0.1 * np.sin(5.0 * t), np.round(q / 1e-6) * 1e-6, u)
    assert identify_law(record).verdict == NOT_TOLD


@pytest.mark.slow("two searches over structures")
def test_the_command_prints_the_table_and_never_reads_the_one_in_the_axis(tmp_path, capsys):
    record = record_of(Loop(kp=30.0, kv=300.0, noise=0.01, samples=700, seed=1))
    record.save(tmp_path / "trace.csv")
    out = tmp_path / "law.toml"
    said = []
    for kp, more in ((160.0, ["--json"]), (3.0, [])):  # the second time over what it wrote itself
        axis = tmp_path / f"{kp}.toml"
        axis.write_text(machine("emps2019").replace(controller={"kp": kp}).to_toml())
        capsys.readouterr()
        assert run(["law", str(tmp_path / "trace.csv"), "--axis", str(axis), "--out", str(out), *more]) == 0
        said.append((capsys.readouterr().out, out.read_bytes()))
    (document, written), (text, again) = said
    assert written == again
    answer = json.loads(document)
    assert tomllib.loads(written.decode())["controller"] == answer["controller"]
    assert answer["controller"]["kp"] == pytest.approx(30.0, rel=0.01)
    assert set(answer["std"]) == {"kp", "kv"}
    assert 0.0 < answer["residual"]["share"] < 0.01
    assert "[controller]" in text


@pytest.mark.study("a search over structures")
def test_no_structure_is_listed_twice():
    found = identify_law(record_of(Loop(kp=30.0, kv=300.0, noise=0.01, samples=1000)))
    terms = [row["terms"] for row in found.tried]
    assert len(set(terms)) == len(terms) > 1


@pytest.mark.study("a search over structures")
def test_lost_samples_leave_the_law_told():
    """A clock of which samples are missing, as of a drive that loses telegrams: one alone, three in a row, many."""
    loop = Loop(kp=25.0, kv=400.0, ti=0.04, share=0.5, noise=0.02)
    r, q, u = loop.run()
    lost = [1000, 2500, 2501, 2502, *np.random.default_rng(0).integers(100, 5900, 60)]
    kept = ~np.isin(np.arange(r.size), lost)
    t, layout = loop.period * np.arange(r.size), Layout(period=loop.period)
    record = Record.from_arrays(t[kept], r[kept], q[kept], u[kept], layout=layout)
    found = identify_law(record)
    assert found.verdict == "told"
    for key, true in {"position.kp": 25.0, "velocity.kp": 400.0, "velocity.ti": 0.04}.items():
        assert abs(at(found.controller, key) - true) < 4.0 * at(found.std, key), key
    assert found.residual_rms == pytest.approx(loop.noise, rel=0.1)


@pytest.mark.study("a search over rates and sources")
def test_a_position_loop_in_every_eighth_sample_is_not_taken_for_a_profile():
    """Neither its rate nor the source of the feed-forward is seen from where the other is wrong."""
    loop = Loop(kp=25.0, kv=400.0, ti=0.04, form="ip", every=8, share=0.5, noise=0.02)
    found = identify_law(record_of(loop))
    assert found.verdict == TOLD
    assert found.controller["position"]["every"] == 8
    assert "source" not in found.controller["feedforward"]
    assert found.controller["position"]["kp"] == pytest.approx(25.0, rel=2e-3)


@pytest.mark.study("two searches over structures")
def test_a_reference_recorded_in_coarse_steps_hides_what_is_fed_forward():
    """1e-7 m at 1 kHz is 0.2 m/s^2 of noise in its second difference: filters and gains would make up for that."""
    loop = Loop(kp=20.0, kv=400.0, ti=0.02, share=0.9, acceleration=3.0, noise=0.02)
    r, q, u = loop.run()
    assert identify_law(Record.from_arrays(loop.period, r, q, u)).verdict == TOLD
    found = identify_law(Record.from_arrays(loop.period, np.round(r / 1e-7) * 1e-7, q, u))
    assert found.verdict == NOT_TOLD
    assert "recorded in steps of 1e-07, whose derivatives mask the feed-forward" in found.reason
