"""What the studio says: no green word over what is unstable, and each record, unit and gain is that of its own axis."""

import asyncio
import json
import re
from dataclasses import replace

import pytest

pytest.importorskip("panel", reason="the extra 'studio' is not installed")

from panel.widgets import FileDownload

from emps_design import discrepancy
from emps_design.control.impedance.law import FrictionModel, impedance_law
from emps_design.control.impedance.passivity import Clock, extended_loop
from emps_design.control.impedance.robustness import verdict
from emps_design.errors import EmpsError
from emps_design.machines import machine
from emps_design.progress import no_progress
from emps_design.report import Section
from emps_design.report.page import inline, sentence_of
from emps_design.simulation.synthetic import synthetic_record
from emps_design.studio import files_view
from emps_design.studio.app import Session
from emps_design.studio.data_view import NAMED_MODEL, diagnose_work
from emps_design.studio.design_view import DesignView, laws_view, numbers_view
from emps_design.studio.motion_view import CompensationView, move
from emps_design.studio.simulation_view import simulate
from emps_design.studio.state import State
from emps_design.view import html
from tests.unit.unlike_axes import JOINT

CASCADE = {
    "kind": "cascade",
    "position": {"kp": 60.0, "every": 4},
    "velocity": {"kp": 150.0, "ti": 0.04},
    "filters": [{"kind": "lowpass", "frequency": 300.0}],
}
DRIVE = machine("emps2018").replace(name="drive", controller=CASCADE)
FLEXIBLE = machine("emps2018").replace(
    name="flexible", effects=[{"kind": "flexible_coupling", "frequency": 45.0, "damping": 0.03, "share": 0.3}]
)
LATE = JOINT.replace(name="late", sampling={"period": 0.1e-3, "computation_delay": 8})
RECORD = synthetic_record(machine("emps2019"), laps=1, stroke=0.1)
SLOW = [{"kind": "lowpass", "frequency": 0.3}] * 3  # with which no loop is stable


def state(**values) -> State:
    return State.of(machine("emps2018")).changed(**values)


def view_of(now: State) -> DesignView:
    return DesignView(now, {now.axis.name: now.axis}, lambda state: None)


def told(text: str) -> str:
    """The level of the message ``text``."""
    return re.search(r'<div class="message (\w+)"', text)[1]


@pytest.mark.parametrize(("frequency", "kp", "clips"), [(20.0, 36.0, False), (12.0, 60.0, True)])
def test_a_motion_under_an_unstable_cascade_is_stopped_whether_the_command_clips_or_not(frequency, kp, clips):
    found = move(state(frequency=frequency, position_kp=kp), None, None, no_progress)
    assert not found.loop.stable
    assert (found.runs["this design"].to_dict()["saturated_share"] > 0.0) == clips
    level, text = found.verdict()
    assert level == "bad"
    assert text.startswith("The cascade of this design is unstable. there and back, kp")


def test_the_motion_tab_shows_the_stop_beside_a_stable_controller_of_the_axis(at_once):
    session = Session(machine("emps2018"))
    session.design.turn("frequency", 30.0)
    session.design.turn("position_kp", 60.0)
    session.motion._start()
    assert told(session.motion.message.object) == "bad"
    assert "is unstable" in session.motion.message.object
    session.design.turn("position_kp", 20.0)
    session.motion._start()
    assert told(session.motion.message.object) == "good"
    assert "unstable" not in session.motion.message.object


def test_a_position_loop_that_is_unstable_around_a_slow_design_is_said_in_the_design_tab():
    view = view_of(State.of(DRIVE))
    assert told(view.message.object) == "note"
    view.turn("phase_margin_deg", 60.0)
    view.turn("frequency", 12.0)
    assert view.design.sampled.stable
    assert view.design.refused.startswith("the axis file's position loop with kp = 60 is unstable")
    assert told(view.message.object) == "bad"
    assert inline(sentence_of(view.design.refused)) in view.message.object


def test_the_design_tab_begins_with_the_worst_loop_that_will_run():
    view = view_of(State.of(machine("emps2018")))
    assert told(view.verdict.object) == "good"
    assert "<b>Safe.</b> The worst loop, the velocity loop, has 39.2 deg" in view.verdict.object
    view = view_of(State.of(machine("emps2018")).with_axis(DRIVE))  # whose velocity loop alone meets the requirements
    assert "meets" in view.numbers.object
    assert told(view.verdict.object) == "warning"
    assert "<b>Caution.</b> The whole loop has" in view.verdict.object
    view.turn("frequency", 12.0)
    assert told(view.verdict.object) == "bad"
    assert "Do not run" in view.verdict.object


def test_gains_handed_out_say_that_the_kept_position_loop_is_unstable():
    asked = State.of(DRIVE).changed(phase_margin_deg=60.0)
    slow, fast = (json.loads(files_view.gains_json(asked.changed(frequency=f))) for f in (12.0, 100.0))
    assert slow["reason"].startswith("the axis file's position loop with kp = 60 is unstable around")
    assert [loop["stable"] for loop in slow["kept_position_loop"]["loops"]][-1] is False
    assert "reason" not in fast
    assert [loop["stable"] for loop in fast["kept_position_loop"]["loops"]][-1] is True
    with pytest.raises(EmpsError, match="no controller is written: the axis file's position loop"):
        files_view.model_toml(asked.changed(frequency=12.0))


def test_an_impedance_law_that_a_coupling_makes_unstable_is_unstable_in_the_design_tab():
    now = State.of(FLEXIBLE)
    law = impedance_law(FLEXIBLE, now.mass, now.damping, now.filter)
    assert not extended_loop(FLEXIBLE, law).stable
    assert verdict(law, FrictionModel.of(FLEXIBLE), Clock.of(FLEXIBLE)) != "unstable"  # which knows no coupling
    flexible, rigid = (html(laws_view(one, files_view.velocity_design(one))) for one in (now, state()))
    assert flexible.count('<b class="no">unstable</b>') == 2  # exact, and over-estimated
    assert "unstable" not in rigid


@pytest.mark.study("a diagnosis")
def test_a_gap_that_no_effect_explains_is_no_good_news(monkeypatch):
    sought = discrepancy.diagnose
    monkeypatch.setattr(
        discrepancy, "diagnose", lambda record, axis, holdout, progress, closest: sought(record, axis, library=())
    )
    axis = machine("emps2019")
    ripple = {"kind": "position_ripple", "amplitude": 6.0, "phase": 0.7, "period": 0.005}
    record = synthetic_record(axis.replace(effects=[ripple]), laps=1)
    assert sought(record, axis, library=()).to_dict()["verdict"] == "unnamed"
    found = diagnose_work(record, axis, {"sought": NAMED_MODEL}, no_progress)
    assert found["advice"].level == "caution"
    healthy = synthetic_record(axis, laps=4, stroke=0.06, speed=0.2)
    assert diagnose_work(healthy, axis, {"sought": NAMED_MODEL}, no_progress)["advice"].level == "safe"


def test_a_wall_that_is_bounced_off_for_ever_stops_a_law_that_is_stable_in_the_air():
    found = simulate(state(wall=150.0, mismatch_percent=0.0, plants=0))
    assert found.worst["verdict"] == "stable"
    assert found.wall.verdict == "bouncing"
    level, text = found.verdict()
    assert level == "bad"
    assert text.endswith("Pushed into the wall of 150 N/mm it is bouncing; the poles of the loop are unstable there.")
    soft = simulate(state(wall=10.0, mismatch_percent=0.0, plants=0))
    assert soft.verdict()[0] == "good"
    assert "wall" not in soft.verdict()[1]


def test_the_worst_plant_is_drawn_the_way_round_that_its_verdict_is_of():
    tilted = machine("emps2018").replace(name="tilted", mechanics={"offset": -6.0})
    found = simulate(State.of(tilted).changed(mass=25.0, filter=300.0, task="pushed", plants=0))
    assert found.worst["verdict"] == found.runs["worst estimates"].verdict == "limit_cycle"
    assert "Worst estimates: limit cycle." in found.captions()["task"]
    assert re.search(r"0 random plants is in a limit cycle, with velocities from −.* mm/s to ", found.verdict()[1])
    at_rest = replace(found, runs={**found.runs, "worst estimates": found.runs["exact estimates"]})
    assert "is limit cycle by its poles (stable in the 10.0 s drawn)" in at_rest.verdict()[1]


def test_a_design_that_follows_less_closely_than_the_controller_in_place_is_no_good_news():
    now = State.of(machine("emps2019"))
    alone, ahead = (
        move(now.changed(feedforward=one), None, None, no_progress) for one in ("none", "velocity and acceleration")
    )
    for found, level in ((alone, "warning"), (ahead, "good")):
        errors = [run.to_dict()["tracking_error"] for run in found.runs.values()]
        assert (errors[0]["largest"] > errors[1]["largest"]) == (level == "warning")
        assert found.verdict()[0] == level
        assert ("controller follows more closely" in found.verdict()[1]) == (level == "warning")


def test_poles_at_the_wall_say_that_the_effects_of_the_axis_are_not_in_them():
    found = simulate(State.of(FLEXIBLE).changed(plants=0, mismatch_percent=0.0))
    assert found.verdict()[0] == "bad"
    rows = dict(found.view()[0].rows)
    assert rows["poles of the loop at that wall, without the effects"] == "<b>stable</b>"


def test_what_was_found_for_a_design_is_withdrawn_where_the_next_is_refused(at_once):
    now = state()
    view = CompensationView(lambda: now)
    view._start()
    assert view.compensation is not None
    assert not view.download.disabled
    refused = now.changed(filters=SLOW)
    with pytest.raises(EmpsError):
        files_view.designed(refused)
    view.show(refused)
    assert view.compensation is None
    assert view.download.disabled
    assert view.picture.object == view.message.object == ""


def test_a_turn_to_a_refused_design_reaches_every_tab(at_once):
    session = Session(machine("emps2018"))
    session.compensation._start()
    assert session.compensation.compensation is not None
    session.design.turn("filters", SLOW)
    assert session.design.design.refused
    assert session.state == session.design.state
    assert len(session.state.filters) == 3
    assert session.compensation.compensation is None
    assert session.compensation.download.disabled


def test_a_pinned_design_of_another_axis_has_its_name_and_its_unit():
    joint, carriage = (files_view.velocity_design(State.of(axis)) for axis in (JOINT, machine("emps2018")))
    table = html(numbers_view(state(), carriage, joint))
    assert "<th>pinned, joint</th>" in table
    assert "<code>A/(rad/s)</code>" in table
    alike = html(numbers_view(state(), carriage, files_view.velocity_design(state(frequency=60.0))))
    assert "<th>pinned</th>" in alike
    assert "<code>" not in alike


def test_the_unit_of_a_pinned_design_is_not_put_into_those_of_the_axis():
    session = Session(machine("emps2018"))
    session.design.machines[JOINT.name] = JOINT
    session.design.machine.options = list(session.design.machines)
    session.design.pin.value = True
    session.design.machine.value = "joint"
    assert "k_v1 [A/(rad/s)]" in session.design.numbers.object
    assert "<th>pinned, emps2018</th>" in session.design.numbers.object
    assert "<code>V/(m/s)</code>" in session.design.numbers.object


def test_a_long_delay_is_designed_with_and_comes_back_from_a_file():
    now = State.of(LATE)
    assert now.computation_delay == 8
    assert State.from_toml(now.to_toml()) == now
    view = view_of(now)
    assert view.design is not None
    assert view.design.axis.sampling.computation_delay == 8
    assert view.knobs["computation_delay"].slider.value == view.knobs["computation_delay"].slider.end == 8
    view.turn("frequency", now.frequency / 2.0)  # nothing of the delay
    assert view.state.axis.sampling.computation_delay == 8


def test_a_high_position_gain_of_an_axis_comes_back_from_a_file():
    quick = DRIVE.replace(controller={**CASCADE, "position": {"kp": 25000.0}})
    now = State.of(quick)
    assert now.position_kp == 25000.0
    assert State.from_toml(now.to_toml()) == now


def load(session: Session, now: State) -> None:
    session.files.load.filename, session.files.load.value = "state.toml", now.to_toml().encode()


def test_a_state_of_an_embedded_machine_leaves_the_machine_in_the_list_as_it_was():
    session = Session(JOINT)
    load(session, state(period_ms=4.0, computation_delay=3, frequency=20.0))
    assert (session.state.period_ms, session.state.axis.sampling.computation_delay) == (4.0, 3)
    assert session.design.machines["emps2018"] == machine("emps2018")
    session.design.machine.value = "joint"
    session.design.machine.value = "emps2018"
    assert (session.state.period_ms, session.state.computation_delay) == (1.0, 0)


def test_the_axis_of_a_loaded_state_is_offered_for_a_record():
    session = Session(JOINT)
    before = session.data.machine.value
    load(session, State.of(DRIVE))
    assert "drive" in session.design.machine.options
    assert session.data.machine.options == session.design.machine.options
    assert session.data.machine.value == before
    session.data.machine.value = "drive"
    assert session.data._axis == DRIVE


def test_the_same_file_is_loaded_twice():
    session, now = Session(JOINT), state(frequency=80.0)
    load(session, now)
    assert session.files.load.value is None
    session.design.turn("frequency", 50.0)
    load(session, now)
    assert session.state.frequency == session.design.design.crossover == 80.0
    assert told(session.files.message.object) == "good"
    session.files.load.value = b"x"
    assert told(session.files.message.object) == "bad"
    assert session.files.load.value is None
    assert session.state.frequency == 80.0


def test_a_position_gain_of_an_axis_file_stays_with_that_axis():
    moved = State.of(DRIVE).with_axis(machine("emps2018"))
    assert moved.position_kp == State.of(machine("emps2018")).position_kp == 20.0
    assert State.of(DRIVE).changed(position_kp=33.0).with_axis(machine("emps2018")).position_kp == 33.0
    assert state().with_axis(DRIVE).position_kp == 60.0


@pytest.fixture
def short(monkeypatch, sketched):
    """Reports without the section on the impedance law, which takes longest."""
    monkeypatch.setattr("emps_design.report.impedance.impedance_section", lambda *arguments: Section("Left out"))


@pytest.mark.study("whole reports")
def test_a_record_is_identified_with_its_own_axis_whatever_is_designed_on(short):
    other = machine("emps2018").replace(drive={"force_gain": 70.0})
    session = Session(other, RECORD)
    session.data.machine.value, session.data.filter.value = "emps2019", "paper"
    page = files_view.report_html(session.state, session.data.measured)
    record = page[page.index("<h2>Record") :]
    masses = set(re.findall(r">mass</th><td[^>]*>([\d.]+)</td>", record))
    assert masses, "no table of parameters"
    for mass in masses:
        assert float(mass) == pytest.approx(95.1, abs=1.0)  # twice as much with the other force gain
    assert "filter paper:" in record
    assert "identified below, with the drive of emps2019" in page


@pytest.mark.study("a whole report")
def test_a_record_of_other_units_is_left_out_of_the_report_and_the_page_says_so(short):
    page = files_view.report_html(state(), {"record": RECORD, "record_axis": JOINT, "record_filter": "paper"})
    assert "The record was made on joint, an axis with other units, and is not on this page." in page
    assert "<h2>Record" not in page


def test_the_report_is_handed_out_with_the_record_its_axis_and_its_filter(at_once, monkeypatch):
    asked = []
    monkeypatch.setattr(files_view, "report_html", lambda now, measured, progress: asked.append(measured) or "page")
    session = Session(JOINT, RECORD)
    session.data.machine.value, session.data.filter.value = "emps2019", "paper"
    button = session.files.view.select(FileDownload)[0]
    assert asyncio.run(button.callback()).read() == b"page"
    session.data._withdraw()
    asyncio.run(button.callback())
    assert asked == [{"record": RECORD, "record_axis": machine("emps2019"), "record_filter": "paper"}, {}]
