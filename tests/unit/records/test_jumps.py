"""A position that wraps is unwrapped where the axis file says so; one that jumps is refused, a hard stop is not."""

import re

import numpy as np
import pytest

from emps_design import Record, load_axis
from emps_design.errors import RecordError
from emps_design.importing import import_bytes
from emps_design.machines import machine

PERIOD = 1e-3
T = PERIOD * np.arange(4000)
ANGLE = 400.0 * np.sin(2.0 * T) ** 3  # deg, beyond a turn both ways
TURNS = {"column": "angle", "unit": "deg", "modulo": 360.0}
WRAPPED = {"position": TURNS, "reference": TURNS | {"column": "target"}}


@pytest.fixture(scope="module")
def axis():
    return machine("emps2019").replace(motion="rotary", sampling={"period": PERIOD})


def export(angle, target):
    command = np.cos(2.0 * T) + 0.1 * np.random.default_rng(0).standard_normal(T.size)
    rows = (f"{t:.3f};{q:.6f};{r:.6f};{u:.6f}" for t, q, r, u in zip(T, angle, target, command, strict=True))
    return "\n".join(["t;angle [deg];target [deg];u", *rows]).encode()


@pytest.mark.parametrize("start", [0.0, 359.9, -100.0])
def test_a_position_that_wraps_is_unwrapped_beside_its_reference(axis, start):
    target = start + ANGLE
    angle = target - 5.0 * np.cos(2.0 * T)  # which begins anew some samples away from it, or a turn apart
    record = import_bytes(export(angle % 360.0, target % 360.0), "trace.csv", axis.replace(record=WRAPPED))
    np.testing.assert_allclose(np.degrees(np.ptp(record.q)), np.ptp(angle), atol=1e-5)
    np.testing.assert_allclose(np.degrees(record.q_ref - record.q), target - angle, atol=1e-5)


def test_one_of_the_two_may_count_on(axis):
    only = axis.replace(record=WRAPPED | {"reference": {"column": "target", "unit": "deg"}})
    record = import_bytes(export((ANGLE - 1.0) % 360.0, ANGLE), "trace.csv", only)
    np.testing.assert_allclose(np.degrees(record.q), ANGLE - 1.0, atol=1e-5)


def test_the_modulo_counts_as_the_numbers_of_the_file(axis):
    counts = {"unit": "counts", "scale": -2.0 * np.pi / 4096, "modulo": 4096.0}
    mapped = axis.replace(record={"position": counts | {"column": "angle"}, "reference": counts | {"column": "target"}})
    steps = np.round(ANGLE / 360.0 * 4096)
    record = import_bytes(export(steps % 4096, steps % 4096).replace(b" [deg]", b""), "trace.csv", mapped)
    np.testing.assert_allclose(record.q, -2.0 * np.pi / 4096 * (steps - steps[0]), atol=1e-9)


def test_an_axis_file_keeps_its_modulo_and_gives_it_to_positions_alone(axis, tmp_path):
    (tmp_path / "axis.toml").write_text(axis.replace(record=WRAPPED).to_toml())
    assert load_axis(tmp_path / "axis.toml").record.position.modulo == 360.0
    with pytest.raises(ValueError, match="command: found modulo 2, expected it only for position and reference"):
        axis.replace(record={"command": {"column": "u", "modulo": 2.0}})


def recorded(q, q_ref=None):
    return Record.from_arrays(PERIOD, q if q_ref is None else q_ref, q, np.cos(2.0 * T), name="run")


def changed(values, place, by):
    return values + by * np.isin(np.arange(values.size), place)


STROKE = 0.1 * np.sin(2.0 * T) ** 3
STEP = 1e-6


@pytest.mark.parametrize(
    ("q", "at", "by"),
    [
        (STROKE % 0.08, 0.594, -0.08),  # wraps
        (changed(STROKE, 1500, 0.01), 1.499, 0.01),  # one bad sample
        (changed(STROKE, [1500, 1501], -0.01), 1.499, -0.01),
        (changed(STROKE, np.arange(1500, 1506), 0.5), 1.499, 0.5),  # more of them
        (changed(STROKE, np.arange(2000, 4000), 0.02), 1.999, 0.02),  # set anew
    ],
)
def test_a_position_that_jumps_is_refused_with_its_time(q, at, by):
    with pytest.raises(RecordError, match="^run: column q, .* found a jump by") as caught:
        recorded(np.round(q / STEP) * STEP, STROKE)
    found = re.search(r"at (\S+) s: found a jump by (\S+) m in one sample", str(caught.value))
    assert float(found[1]) == pytest.approx(at, abs=1e-9)
    assert float(found[2]) == pytest.approx(by, abs=5e-4)


def test_an_axis_that_mostly_rests_and_has_a_coarse_encoder_has_lost_nothing():
    for step in (1e-5, 2e-5, 1e-4):
        t = PERIOD * np.arange(30_000)
        move = np.clip(t - 15.0, 0.0, 0.02)
        r = 0.5 * (move / 0.02 - np.sin(2.0 * np.pi * move / 0.02) / (2.0 * np.pi)) * 0.02
        q = np.round(np.roll(r, 1) / step) * step
        assert len(Record.from_arrays(PERIOD, r, q, np.cos(t), name="run")) == t.size


def test_a_jump_of_the_reference_a_stop_at_full_speed_and_a_lost_sample_are_taken():
    step = np.round(STROKE / STEP) * STEP
    assert len(recorded(step, np.where(T > 1.0, 0.05, 0.0))) == T.size
    hit = np.minimum(0.5 * T, 0.6)  # 0.5 m/s, and not one step more
    assert len(recorded(np.round(hit / STEP) * STEP)) == T.size
    lost = np.delete(np.concatenate([step, step[-1:]]), 700)
    assert len(recorded(lost)) == T.size
