"""Strokes and laps, and what fits and what selects."""

import numpy as np
import pytest

from emps_design.discrepancy import rules
from emps_design.discrepancy.preparation import prepare
from emps_design.discrepancy.records import find_lap, find_strokes, split
from emps_design.discrepancy.unknown_force import missing_force
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation.synthetic import synthetic_record, trapezoid_laps


def record(q_ref: np.ndarray) -> Record:
    zero = np.zeros(q_ref.size)
    return Record(t=np.arange(q_ref.size) * 1e-3, q_ref=q_ref, q=q_ref, u=zero, period=1e-3)


def test_a_lap_is_found_to_the_sample():
    q_ref = trapezoid_laps(1e-3, stroke=0.1, laps=3)
    assert find_lap(q_ref) == q_ref.size // 3


def test_what_does_not_repeat_has_no_lap():
    t = np.arange(20000) * 1e-3
    assert find_lap(np.sin(t) + np.sin(np.sqrt(2) * t)) == 0


def test_strokes_end_where_the_direction_changes():
    q_ref = trapezoid_laps(1e-3, stroke=0.1, laps=2)
    strokes = find_strokes(q_ref, 1e-3)
    assert len(strokes) == 12
    assert strokes[0][0] == 0
    assert strokes[-1][1] == q_ref.size
    for start, stop in strokes:
        moving = np.sign(np.diff(q_ref[start:stop]))
        assert abs(moving.sum()) == np.abs(moving).sum()


@pytest.mark.parametrize("laps", [1, 3])
def test_every_allowed_sample_fits_or_selects_and_none_does_both(laps):
    q_ref = trapezoid_laps(1e-3, stroke=0.1, laps=laps)
    parts = split(record(q_ref))
    assert not (parts.fit & parts.select).any()
    assert parts.used[rules.START_UP :].all()
    assert not parts.used[: rules.START_UP].any()
    assert parts.fit.sum() > parts.select.sum() > 0


def test_a_shaft_that_turns_on_and_on_is_cut_into_pieces_of_at_least_a_turn():
    strokes = find_strokes(np.linspace(0.0, 5.5 * 2 * np.pi, 5000), 1e-3)
    assert [stop - start for start, stop in strokes] == [1000] * 5
    assert len(find_strokes(np.linspace(0.0, 400.0, 20000), 1e-3)) == 12
    assert len(find_strokes(np.linspace(0.0, 6.0, 5000), 1e-3)) == 1  # less than a turn


def test_two_strokes_are_split_within():
    """Every part has as much of the motion as of the time: a long rest behind a step tells little."""
    step = np.minimum(np.arange(5000) / 400.0, 1.0)
    q = np.concatenate([step, 1.0 - step])
    parts = split(record(q), parts=4)
    assert len(parts.strokes) == 8
    moving = np.abs(np.gradient(q)) > 0
    for part in (parts.fit, parts.select):
        assert 0.2 < np.mean(part[moving]) < 0.8
    axis = machine("emps2019").replace(controller={"kind": "none"})
    two = Record.from_arrays(1e-3, 0.1 * q, 0.1 * q, np.gradient(q) * 1e3 + 0.1 * np.sin(np.arange(q.size)))
    (prepared,) = prepare((two,), axis, (), None, None, None).start.problem.splits
    assert len(prepared.strokes) == 8


def test_what_is_not_allowed_is_not_used():
    q_ref = trapezoid_laps(1e-3, stroke=0.1, laps=3)
    allowed = np.arange(q_ref.size) < q_ref.size // 2
    assert not split(record(q_ref), allowed).used[~allowed].any()


def test_what_confirms_is_not_seen_by_what_is_searched():
    axis = machine("emps2019")
    lap = synthetic_record(axis, laps=1, stroke=0.1)
    push = {"kind": "external_force", "start": 2 * lap.duration, "duration": 0.5, "every": 0.0}
    whole, other = (
        synthetic_record(axis.replace(effects=[{**push, "amplitude": force}]), laps=3) for force in (10.0, 30.0)
    )
    end = 2 * len(lap)
    assert np.array_equal(other.u[:end], whole.u[:end])
    assert not np.array_equal(other.u, whole.u)
    windows = (0.0, end * whole.period), (end * whole.period, np.inf)
    one, another = (prepare((made,), axis, (), None, *windows) for made in (whole, other))
    (searched,), (made,) = one.start.problem.records, one.start.problem.splits
    assert len(searched) == made.used.size == end
    assert made.strokes[-1][1] == end
    assert len(one.held_out.problem.records[0]) == len(whole)
    seen, again = (missing_force(prepared.start)[0].force for prepared in (one, another))
    assert np.array_equal(seen, again)


def test_single_strokes_of_several_records_take_turns():
    stroke = record(np.linspace(0.0, 0.1, 400))
    parts = [split(stroke, before=before) for before in range(3)]
    assert [bool(part.fit.any()) for part in parts] == [True, True, False]
    assert [bool(part.select.any()) for part in parts] == [False, False, True]
