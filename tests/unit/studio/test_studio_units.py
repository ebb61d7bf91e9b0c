"""What the tabs say has the words and units of the axis: nothing is left to translate."""

import pytest

from emps_design.progress import no_progress
from emps_design.simulation.synthetic import synthetic_record
from emps_design.studio.data_view import identify_work, observe_work
from emps_design.studio.design_view import laws_view, numbers_view, verdict_message
from emps_design.studio.files_view import velocity_design
from emps_design.studio.motion_view import move
from emps_design.studio.simulation_view import simulate
from emps_design.studio.state import State, differences_in_words
from emps_design.view import html
from tests.axes import KINDS, machine_of
from tests.rewriting import rewritten


@pytest.fixture(params=KINDS)
def axis(request):
    """An axis of each kind."""
    return machine_of(request.param)


def changed(axis, *texts) -> list[str]:
    """The ``texts`` that a translation would change."""
    return [text for text in texts if rewritten(axis.units, text) != text]


def test_the_design_tab(axis):
    state = State.of(axis)
    design = velocity_design(state)
    lighter = axis.replace(name="other", sampling={"period": 5e-4})
    carried = differences_in_words(state.changed(k_e1=2.0 * state.k_e1), State.of(axis).with_axis(lighter))
    assert "k_e1" in carried
    texts = html(numbers_view(state, design, design)), html(laws_view(state, design)), verdict_message(design), carried
    assert changed(axis, *texts) == []


def test_the_motion_tab(axis):
    found = move(State.of(axis), None, None, no_progress)
    assert changed(axis, found.verdict()[1], str(found)) == []


def test_the_simulation_tab(axis):
    found = simulate(State.of(axis).changed(plants=0))
    assert changed(axis, found.verdict()[1], str(found), *found.captions().values()) == []


def test_the_data_tab(axis):
    record = synthetic_record(axis, laps=1, stroke=0.1)
    choices = {"friction": "symmetric", "chain": "hold", "held_out": record}
    for outcome in (identify_work(record, axis, choices, no_progress), observe_work(record, axis, {}, no_progress)):
        assert changed(axis, outcome["text"], outcome["advice"].text) == []
