"""Work side by side: in order, at any depth, and ended with whoever wanted it."""

import threading

import pytest

from emps_design.discrepancy.parallel import side_by_side


def test_calls_within_calls_keep_their_order():
    rows = [[10 * i + j for j in range(5)] for i in range(4)]
    assert side_by_side(lambda row: side_by_side(abs, [(x,) for x in row]), [(row,) for row in rows]) == rows


def test_an_idle_core_takes_rows_of_an_inner_call():
    seen, never = set(), threading.Event()

    def inner(row):
        never.wait(0.005)
        seen.add(threading.get_ident())

    def outer(rows):
        side_by_side(inner, [(row,) for row in range(rows)])

    side_by_side(outer, [(0,), (100,)])
    assert len(seen) == 2


def test_the_first_row_that_fails_is_raised_whichever_fails_first():
    late = threading.Event()

    def fails(row):
        if row == 1:
            late.wait(1)
        late.set()
        raise ValueError(f"row {row}")

    with pytest.raises(ValueError, match="row 1"):
        side_by_side(fails, [(1,), (2,)])


def test_an_interrupt_ends_what_the_other_thread_goes_on_with():
    started, never, done = threading.Event(), threading.Event(), []

    def inner(row):
        started.set()
        never.wait(0.01)
        done.append(row)

    def outer(row):
        if threading.current_thread() is threading.main_thread():
            started.wait(10)
            raise KeyboardInterrupt
        side_by_side(inner, [(i,) for i in range(10_000)])

    before = set(threading.enumerate())
    with pytest.raises(KeyboardInterrupt):
        side_by_side(outer, [(0,), (1,)])
    for thread in set(threading.enumerate()) - before:
        thread.join(10)
        assert not thread.is_alive()
    assert 0 < len(done) < 10_000
    assert side_by_side(abs, [(-1,), (-2,)]) == [1, 2]
