"""The studio without a browser: its state, what can be reached, what it hands out, what it lets in."""

import http.client
import json
import socket
import threading
import time
import zipfile
from contextlib import closing
from dataclasses import replace
from io import BytesIO
from itertools import combinations
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest

pytest.importorskip("panel", reason="the extra 'studio' is not installed")

from emps_design import discrepancy
from emps_design.advice import Advice
from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.control.position import PositionLoopDesign
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.gains import PI_WITH_REFERENCE_FILTER
from emps_design.discrepancy.closest import Closest
from emps_design.errors import EmpsError, InputError, RecordError, SpecificationError
from emps_design.figures import BLUE, GREY, RED
from emps_design.laws.library.cascade import Filter
from emps_design.machines import machine, machine_names
from emps_design.report import velocity_loop_figures
from emps_design.simulation.scenarios import follow
from emps_design.simulation.synthetic import synthetic_record, there_and_back
from emps_design.studio import controls, files_view, panes
from emps_design.studio.app import Session
from emps_design.studio.data_view import CLOSEST_MODEL, LIMIT_MB, DataView, observe_work, read_upload
from emps_design.studio.design_view import DesignView
from emps_design.studio.files_view import figures_zip, report_html
from emps_design.studio.motion_view import COMPENSATION_DESIGN, COMPENSATION_OWN
from emps_design.studio.panes import Job
from emps_design.studio.plots import KINDS, LoopPlots, PlanePlot, feasible, plane, reachable_frequencies
from emps_design.studio.simulation_view import simulate
from emps_design.studio.state import CHOICES, SPECIFICATIONS, TASKS, State
from tests.browser.conftest import Studio
from tests.unit.report.test_colours import SEEN_BY, lab

LOW = [{"kind": "lowpass", "frequency": 150.0}]
NOTCH = {"kind": "notch", "frequency": 48.0, "damping": 0.5, "depth": 0.1}


def state(**values) -> State:
    return State.of(machine("emps2018")).changed(**values)


def test_a_state_goes_to_a_file_and_comes_back():
    saved = state(phase_margin_deg=47.5, computation_delay=2, current_ms=0.75, specification="bandwidth")
    saved = saved.changed(structure="PI", filters=[*LOW, {**NOTCH, "frequency": "48Hz"}])
    saved = replace(saved.changed(task="pushed", push=60.0, plants=0, friction="asymmetric"), pinned=state(hand=5.0))
    back = State.from_toml(saved.to_toml())
    assert back == saved
    assert back.axis.sampling.computation_delay == 2
    assert back.axis.drive.current_time_constant == pytest.approx(0.75e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[studio", "not TOML"),
        ("x = 1", r"expected the tables \[studio\] and \[axis\]"),
        ("[studio]\nphase = 1\n", "unknown key 'phase'"),
        ("[studio]\nphase_margin_deg = 90.0\n", "phase_margin_deg: found 90.0, expected 1 to 89"),
        ("[studio]\nphase_margin_deg = true\n", "phase_margin_deg: found True"),
        ("[studio]\nplants = 2.5\n", "plants: found 2.5, expected a whole number, 0 to 10000"),
        (
            '[studio]\nfilter = "30 V"\n',
            "filter: frequency: found '30 V', expected a number in rad/s, or one such as 30Hz",
        ),
        ('[studio]\nmass = "30"\n', "mass: found '30', expected 1 to 200"),
        ('[studio]\nstructure = "pid"\n', "structure: found 'pid', expected IP or PI or PI with reference filter"),
        ('[studio]\nfilters = [{kind = "notch", frequency = 50}]\n', "filters.0: .*damping: found None"),
        ('[studio]\nfilters = [{kind = "lowpass", frequency = "5 V"}]\n', "filters.0: frequency: found '5 V'"),
        ("[studio]\nfilters = 3\n", "filters: found 3, expected up to 8 tables"),
        ('[studio]\nspecification = "speed"\n', "specification: found 'speed', expected crossover or bandwidth"),
    ],
)
def test_a_damaged_state_is_refused_in_one_line(text, message):
    axis = "\n".join(f"[axis.{k[1:]}" if (k := line).startswith("[") else line for line in _axis_lines())
    with pytest.raises(InputError, match=message) as caught:
        State.from_toml(text if "x = 1" in text or text == "[studio" else f"{text}[axis]\n{axis}")
    assert "\n" not in str(caught.value)


def _axis_lines() -> list[str]:
    lines = machine("emps2018").to_toml().splitlines()
    return [line for line in lines if not line.startswith("#")]


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_ends_of_the_reach_are_where_stability_ends(delay):
    now = state(computation_delay=delay)
    found = feasible(now)
    choice = CHOICES["phase_margin_deg"]
    for phase, inside in ((found.low, True), (found.high, True), (found.low - 1, False), (found.high + 1, False)):
        if not choice.lower < phase < choice.upper:
            continue
        stable = design_velocity_loop(now.axis, crossover=100.0, phase_margin_deg=phase).sampled.stable
        assert stable == inside, (phase, stable)
    assert found.nearest(89.0) == found.high


def test_where_nothing_can_be_reached_the_reason_is_said():
    found = feasible(state(frequency=600.0, computation_delay=5, period_ms=5.0))
    assert found.empty
    assert "unstable with every phase margin" in found.text
    assert found.nearest(60.0) is None


@pytest.mark.parametrize(("structure", "filters"), [("IP", []), ("PI", LOW), ("PI with reference filter", [])])
@pytest.mark.parametrize("specification", SPECIFICATIONS)
def test_the_plane_agrees_with_single_designs(specification, structure, filters):
    axis = machine("emps2018")
    now = State.of(axis).changed(specification=specification, structure=structure, filters=filters)
    found = plane(now, columns=6, rows=6)
    for (row, column), place in np.ndenumerate(found.kind):
        asked = {**now.requested, specification: float(found.x[column]), "phase_margin_deg": float(found.y[row])}
        if KINDS[place] == "no positive gains":
            with pytest.raises(Exception, match="phase margin"):
                design_velocity_loop(axis, **asked)
            continue
        margins = design_velocity_loop(axis, **asked).sampled.margins
        expected = 1 if not margins.stable else 3 if margins.phase_margin_deg >= 30.0 else 2
        assert place == expected, asked


@pytest.mark.parametrize("specification", SPECIFICATIONS)
def test_beyond_the_reachable_frequencies_every_phase_margin_is_unstable(specification):
    axis = machine("emps2018")
    _, highest = reachable_frequencies(State.of(axis).changed(specification=specification))
    stable = [
        [
            design_velocity_loop(axis, **{specification: frequency, "phase_margin_deg": float(phase)}).sampled.stable
            for phase in range(1, 90)
        ]
        for frequency in (highest, highest + 1.0)
    ]
    assert any(stable[0])
    assert not any(stable[1])


def test_a_frequency_out_of_reach_moves_to_the_nearest_and_the_page_says_so():
    view = DesignView(state(), {name: machine(name) for name in machine_names()}, lambda state: None)
    view.turn("frequency", 600.0)
    assert view.state.frequency == reachable_frequencies(state())[1]
    assert "unstable with every phase margin" in view.message.object
    assert f"moved from 600 to {view.state.frequency:g} rad/s" in view.message.object
    assert view.knobs["frequency"].slider.end == view.state.frequency


def test_a_turn_shows_the_librarys_numbers():
    view = DesignView(state(), {name: machine(name) for name in machine_names()}, lambda state: None)
    for frequency in np.linspace(60.0, 140.0, 9):
        view.knobs["frequency"].slider.value = float(frequency)
    design = design_velocity_loop(machine("emps2018"), crossover=140.0, phase_margin_deg=60.0)
    assert view.design.k_v1 == design.k_v1
    assert f"{design.sampled.margins.phase_margin_deg:.1f}°" in view.numbers.object
    assert view.knobs["frequency"].field.value == "140"


def test_a_refused_number_leaves_field_pictures_and_numbers_as_they_were():
    view = DesignView(state(), {name: machine(name) for name in machine_names()}, lambda state: None)
    design, numbers = view.design, view.numbers.object
    view.knobs["frequency"].field.value = "2000"
    assert view.state.frequency == view.knobs["frequency"].slider.value == 100.0
    assert view.knobs["frequency"].field.value == "100"
    assert view.design is design
    assert view.numbers.object == numbers
    assert "found 2000" in view.message.object
    assert "the design is unchanged" in view.message.object


@pytest.mark.parametrize("name", [name for name, choice in CHOICES.items() if choice.label.endswith("[rad/s]")])
def test_every_frequency_is_understood_with_its_unit_and_the_page_says_what_it_took(name):
    view = DesignView(state(), {name: machine(name) for name in machine_names()}, lambda state: None)
    view.knobs[name].field.value = " 30 Hz"
    assert getattr(view.state, name) == view.knobs[name].slider.value == pytest.approx(60 * np.pi)
    assert view.knobs[name].field.value == "188.496"
    assert "30 Hz is 188.496 rad/s." in view.message.object
    view.knobs[name].field.value = "200"
    assert getattr(view.state, name) == 200.0
    assert "200 is " not in view.message.object
    for wrong in ("30 V", "thirty", "nan", "1kHz"):
        view.knobs[name].field.value = wrong
        assert getattr(view.state, name) == 200.0
        assert view.knobs[name].field.value == "200"
        assert "the design is unchanged" in view.message.object
    document = state().to_toml().replace(f"\n{name} = {getattr(state(), name)}", f'\n{name} = "30Hz"')
    assert getattr(State.from_toml(document), name) == pytest.approx(60 * np.pi)


def test_structure_and_filters_are_those_of_the_axis_until_others_are_chosen():
    drive = {"kind": "cascade", "velocity": {"kp": 300.0, "ti": 0.03}, "filters": LOW}
    axes = {"drive": machine("emps2018").replace(name="drive", controller=drive), "emps2018": machine("emps2018")}
    view = DesignView(State.of(axes["drive"]), axes, lambda state: None)
    assert (view.state.structure, view.words["structure"].value, len(view.filters.fields)) == ("PI", "PI", 1)
    assert "PI, 1 filter" in view.numbers.object
    assert "largest [(m/s)/N]" in view.laws.object  # the force loop goes around PI with its filters too
    view.machine.value = "emps2018"
    assert (view.words["structure"].value, view.filters.fields) == ("IP", [])
    view.words["structure"].value = "PI with reference filter"
    view.filters._add("notch")
    view.filters.fields[0]["frequency"].value = " 70 Hz"
    assert view.filters.fields[0]["frequency"].value == "70"
    view.filters.fields[0]["depth"].value = "0.2"
    notch = Filter(kind="notch", frequency=70.0, damping=0.3, depth=0.2)
    assert view.design.filters == view.state.filters == (notch,)
    asked = {"crossover": view.state.frequency, "phase_margin_deg": view.state.phase_margin_deg}
    design = design_velocity_loop(axes["emps2018"], **asked, structure=PI_WITH_REFERENCE_FILTER, filters=(notch,))
    assert view.design.k_v1 == design.k_v1
    assert f"{design.sampled.margins.phase_margin_deg:.1f}°" in view.numbers.object
    assert json.loads(files_view.gains_json(view.state))["filters"] == [notch.model_dump(exclude_none=True)]
    assert Axis.from_toml(files_view.model_toml(view.state)).controller.filters[0]["frequency"] == 70.0
    for name, wrong in (("frequency", "70 V"), ("depth", "2"), ("damping", ""), ("frequency", "-3")):
        before = view.filters.fields[0][name].value
        view.filters.fields[0][name].value = wrong
        assert "the design is unchanged" in view.message.object, wrong
        assert view.filters.fields[0][name].value == before
        assert view.state.filters == (notch,)
    view.filters._remove(0)
    assert view.state.filters == view.design.filters == ()


def test_a_refused_upload_takes_the_record_before_it_away():
    axis = machine("emps2019")
    record = synthetic_record(axis, laps=1, stroke=0.1)
    view = DataView(lambda: {axis.name: axis}, axis.name, state, lambda *turn: None, lambda axis: None, record)
    view._done({"advice": Advice("safe", "as known"), "text": "Identified", "html": "<p>result</p>", "model": axis})
    assert not view.take.disabled
    view.drop.value = {"empty.csv": b"t,q\n0,0\n"}
    assert view.record is None
    assert view.model is None
    assert view.take.disabled
    assert all(button.disabled for button in view.buttons.values())
    assert view.result.object == ""
    assert "<svg" not in view.about.object
    assert 'role="alert"' in view.message.object


def test_a_result_goes_when_a_choice_that_it_read_is_another():
    axis, other = machine("emps2019"), machine("emps2018")
    record = synthetic_record(axis, laps=1, stroke=0.1)
    machines = {one.name: one for one in (axis, other)}
    view = DataView(lambda: machines, axis.name, state, lambda *turn: None, lambda axis: None, record)

    def found(work):
        view._work = work
        view._done({"advice": Advice("safe", "as known"), "text": "found", "html": "<p>result</p>", "model": axis})

    found("Identify")
    view.filter.value = "paper"
    assert (view.result.object, view.model, view.record) == ("", None, record)
    found("Observe")
    view.filter.value = view.filter.options[0]
    assert "result" in view.result.object  # the observer has no filter to choose
    view.machine.value = other.name
    assert (view.result.object, view.model, view.record) == ("", None, record)


@pytest.mark.parametrize(
    ("level", "shown"), [("safe", "good"), ("caution", "warning"), ("do-not-run", "bad")], ids=lambda one: one
)
def test_a_result_of_a_record_begins_with_what_to_do_with_it(level, shown):
    axis = machine("emps2019")
    view = DataView(lambda: {axis.name: axis}, axis.name, state, lambda *turn: None, lambda axis: None)
    view._done({"advice": Advice(level, "the model leaves 14 %"), "text": "mass 3 kg", "html": "", "model": None})
    said = view.message.object
    assert f'class="message {shown}"' in said
    title = level.replace("-", " ").capitalize()
    assert said.index(f"<b>{title}") < said.index("The model leaves 14 %") < said.index("mass 3 kg")


def test_a_motion_along_a_record_goes_with_that_record():
    axis = machine("emps2019")
    session = Session(axis, synthetic_record(axis, laps=1, stroke=0.1))
    session.motion._of = session.state = session.state.changed(motion="record")
    session.motion._along, session.motion.table.object = session.data.record, "a result"
    session.data.filter.value = "paper"  # the record stays
    assert session.motion.table.object == "a result"
    session.data._show(synthetic_record(axis, laps=2))
    assert session.motion.table.object != "a result"


def test_the_columns_of_an_export_are_chosen_and_read():
    axis = machine("emps2019")
    made = synthetic_record(axis, laps=1, stroke=0.1)
    rows = "\n".join(
        f"{1e3 * t:.3f};{1e3 * q:.6f};{1e3 * q_ref:.6f};{u:.6f}"
        for t, q, q_ref, u in zip(made.t, made.q, made.q_ref, made.u, strict=True)
    )
    view = DataView(lambda: {axis.name: axis}, axis.name, state, lambda *turn: None, lambda axis: None)
    assert not view.columns.view.visible
    view.drop.value = {"trace.csv": f"Zeit [ms];Kanal 1;Kanal 2;Spannung\n{rows}\n".encode()}
    assert view.record is None  # two channels may be anything
    assert 'role="alert"' in view.message.object
    assert view.columns.view.visible
    assert view.columns.titles["t"].value == "Zeit [ms]"
    assert view.columns.titles["q"].options == ["none", "Zeit [ms]", "Kanal 1", "Kanal 2", "Spannung"]
    for name, title, unit in (("q", "Kanal 1", "mm"), ("q_ref", "Kanal 2", "mm"), ("u", "Spannung", "V")):
        view.columns.titles[name].value, view.columns.units[name].value = title, unit
    view.columns.button.clicks += 1
    assert np.allclose(view.record.q, made.q, atol=1e-9)
    assert not view.buttons["Identify"].disabled
    assert view._axis.record.position.column == "Kanal 1"
    view.columns.units["q"].value = "m"
    view.columns.button.clicks += 1
    assert view.record is None
    assert "expected metres on the load side" in view.message.object
    view.drop.value = {"plain.csv": f"t [ms];q [mm];q_ref [mm];u\n{rows}\n".encode()}
    assert not view.columns.view.visible
    assert len(view.record) == len(made)
    assert view._axis == axis


def test_pinning_keeps_the_design_beside_the_new_one():
    view = DesignView(state(), {name: machine(name) for name in machine_names()}, lambda state: None)
    view.pin.value = True
    lines = view.plots.nyquist.sources["lines"]
    kept = list(lines.data["x"][-1])
    assert lines.data["color"].count(GREY) == 2  # the unit circle, and the pinned design
    view.knobs["frequency"].field.value = "150"
    assert "pinned" in view.numbers.object
    assert list(lines.data["x"][-1]) == kept
    view.pin.value = False
    assert lines.data["color"].count(GREY) == 1


def test_a_loaded_state_shows_in_every_tab_with_its_pinned_design():
    session = Session(machine("emps2018"))
    pinned = state(frequency=60.0)
    session._loaded(replace(state(wall=25.0, task="pushed", seed=7, friction="asymmetric"), pinned=pinned))
    assert session.design.knobs["wall"].field.value == 25.0
    assert session.simulation.fields["wall"].field.value == 25.0
    assert session.simulation.task.value == "pushed"
    assert session.simulation.fields["seed"].field.value == 7
    assert session.data.friction.value == "asymmetric"
    assert session.design.pinned.crossover == pytest.approx(60.0)
    assert session.design.pin.value
    session.simulation.fields["mismatch_percent"].field.value = 4.0
    assert session.design.knobs["mismatch_percent"].slider.value == 4.0
    assert State.from_toml(session.state.to_toml()).mismatch_percent == 4.0


def test_a_pinned_design_that_cannot_be_is_refused_and_nothing_changes():
    session = Session(machine("emps2018"))
    before = session.state
    with pytest.raises(SpecificationError):
        session._loaded(replace(state(frequency=50.0), pinned=state(frequency=5.0, phase_margin_deg=1.0)))
    assert session.state == before


@pytest.mark.parametrize("task", TASKS)
def test_a_simulation_has_traces_the_wall_and_a_verdict(task):
    stages = []
    found = simulate(state(task=task, plants=0), lambda stage, share: stages.append(stage))
    assert found.verdict()[0] == "warning"
    assert "corners and 0 random plants is creeping" in found.verdict()[1]
    rows = dict(found.view()[0].rows)
    assert rows["pushed into a wall of 10 N/mm"].startswith("<b>at rest, at most ")
    assert rows["poles of the loop at that wall"] == "<b>stable</b>"
    assert found.figures().keys() == found.captions().keys() == {"task", "wall", "plants"}
    assert stages[-1] == "drawing"


def test_effects_act_on_every_simulated_plant():
    ripple = {"kind": "position_ripple", "amplitude": 2.0, "period": 0.0025, "phase": 0.5}
    axis = machine("emps2018")
    for task in ("pushed", "guided"):
        smooth, rippled = (
            simulate(State.of(one).changed(task=task, plants=0)).study.measures.work
            for one in (axis, axis.replace(effects=[ripple]))
        )
        assert np.all(smooth != rippled)


def test_a_law_that_diverges_is_shown_as_unstable():
    ripple = {"kind": "position_ripple", "amplitude": 2.0, "period": 0.0025, "phase": 0.5}
    found = simulate(State.of(machine("emps2018").replace(effects=[ripple])).changed(task="pushed", plants=0, mass=2.0))
    assert dict(found.view()[0].rows)["verdict, exact estimates"] == "<b>unstable</b>"
    assert found.wall.verdict == "unstable"
    assert found.figures()["task"].axes


@pytest.mark.study("whole reports")
def test_the_report_is_about_the_state(sketched):
    text = files_view.report_html(state(mass=80.0, damping=150.0, filter=400.0))
    assert '<th>derived</th><td class="number">80</td><td class="number">150</td>' in text


@pytest.mark.study("a whole report, twice")
def test_exports_are_whole_repeatable_and_read_by_the_library():
    now = state(phase_margin_deg=50.0, plants=20)  # drawn at random, as any number of them is
    assert json.loads(files_view.gains_json(now))["k_v1"] == files_view.velocity_design(now).k_v1
    model = Axis.from_toml(files_view.model_toml(now))
    assert model.controller.kind == "ip_velocity"
    archive = files_view.figures_zip(now, "svg")
    assert archive == files_view.figures_zip(now, "svg")
    names = zipfile.ZipFile(BytesIO(archive)).namelist()
    assert {"bode_plant_input.svg", "force_loop.svg", "simulation_wall.svg"} <= set(names)


def test_no_controller_of_an_unstable_loop_is_handed_out():
    now = state(frequency=300.0, phase_margin_deg=20.0, computation_delay=2)
    assert not files_view.velocity_design(now).sampled.stable
    assert json.loads(files_view.gains_json(now))["sampled"]["stable"] is False
    with pytest.raises(EmpsError, match="no controller is written: the sampled loop with these gains is unstable"):
        files_view.model_toml(now)


def test_an_upload_is_read_like_a_file_and_its_name_leads_nowhere(tmp_path):
    lines = ["t,q_ref,q,u"] + [f"{k * 1e-3:.3f},{k * 1e-5},{k * 1e-5},{np.sin(k):.6f}" for k in range(500)]
    record = read_upload("../../etc/passwd/run.csv", "\n".join(lines), machine("emps2019"))
    assert len(record) == 500
    assert record.name == "run"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("run.pkl", b"x", "run.pkl: found suffix .pkl, expected one of .mat, .csv, .txt, .tsv, .npz"),
        ("run", b"x", "found suffix none"),
        ("run.npz", b"not a zip", "run.npz"),
        ("run.csv", b"", "run.csv"),
        ("run.csv", b"0" * (LIMIT_MB * 10**6 + 1), f"expected at most {LIMIT_MB} MB"),
    ],
)
def test_bad_uploads_are_refused_without_a_path(name, content, message):
    with pytest.raises(RecordError, match=message) as caught:
        read_upload(name, content, machine("emps2019"))
    assert "/tmp" not in str(caught.value)


def test_a_pickle_inside_an_archive_is_not_opened():
    class Trap:
        def __reduce__(self):
            return (print, ("opened",))

    out = BytesIO()
    np.savez(out, t=np.array([Trap()], dtype=object), q=np.zeros(1))
    with pytest.raises(RecordError, match=r"trap\.npz"):
        read_upload("trap.npz", out.getvalue(), machine("emps2019"))


def test_a_job_that_runs_refuses_a_second_one():
    job = Job()
    job._poll = object()
    assert job.running
    assert not job.start(lambda progress: None, print, print)


@pytest.fixture
def polled(monkeypatch):
    """What calls the polls of jobs by hand until none is left, where no page calls them."""
    polls = []

    class Callback:
        def stop(self):
            polls.clear()

    def until_done():
        end = time.monotonic() + 60.0  # moments on an idle machine
        while polls and time.monotonic() < end:
            polls[0]()
            time.sleep(0.05)

    monkeypatch.setattr(panes.pn.state, "add_periodic_callback", lambda poll, period: polls.append(poll) or Callback())
    return until_done


def deaf(progress):
    """Work that never looks up."""
    while True:
        sum(range(1000))


def test_work_that_never_looks_up_is_cancelled(polled):
    said = []
    job = Job()
    assert job.start(deaf, lambda result: said.append("done"), said.append)
    job.stop()
    polled()
    assert said == [panes.CANCELLED]
    assert not job.running


def test_work_begun_while_other_work_stops_is_done_once_that_has_ended(polled):
    said = []
    job = Job()
    assert job.start(deaf, said.append, said.append)
    job.stop()
    assert job.start(lambda progress: "first", said.append, said.append)
    job.stop()  # pressed once more: the newest counts
    assert job.start(lambda progress: "second", said.append, said.append)
    polled()
    assert said == ["second"]
    assert not job.running


def ask(address, path, **headers):
    place = urlsplit(address)
    with closing(http.client.HTTPConnection(place.hostname, place.port, timeout=20)) as connection:
        connection.request("GET", path, headers=headers)
        with connection.getresponse() as answer:
            return answer.status, answer.getheader("Set-Cookie")


@pytest.mark.slow("starts a studio of its own")
def test_the_studio_answers_this_machine_and_its_token_only():
    studio = Studio()
    try:
        place = urlsplit(studio.address)
        whole = f"{place.path}?{place.query}"
        status, cookie = ask(studio.address, whole)
        assert status == 200
        kept = {"Cookie": cookie.split(";")[0]}
        script = "/static/js/bokeh.min.js"
        assert ask(studio.address, script, **kept)[0] == 200
        assert ask(studio.address, script, Host=f"localhost:{place.port}", **kept)[0] == 200
        upgrade = {
            "Upgrade": "websocket",
            "Connection": "Upgrade",
            "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Version": "13",
        }
        rebound = f"rebound.example:{place.port}"
        assert ask(studio.address, "/")[0] == 403
        assert ask(studio.address, "/?token=guessed")[0] == 403
        assert ask(studio.address, whole, Host=rebound)[0] == 403
        assert ask(studio.address, whole, Host=f"127.0.0.1:{place.port + 1}")[0] == 403
        assert ask(studio.address, whole, Origin="http://elsewhere.example")[0] == 403
        assert ask(studio.address, script)[0] == 403
        assert ask(studio.address, "/ws", **upgrade)[0] == 403
        assert ask(studio.address, "/ws", Host=rebound, Origin=f"http://{rebound}", **upgrade, **kept)[0] == 403
    finally:
        status, _ = studio.interrupt()
    assert status == 130


def test_a_port_that_is_taken_is_told_in_one_line(capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert run(["studio", "--port", str(port)]) == 2
    said = capsys.readouterr().err.strip()
    assert f"--port: cannot listen on 127.0.0.1:{port}" in said
    assert "\n" not in said


def test_a_record_that_cannot_be_read_is_told_before_anything_is_served(capsys):
    assert run(["studio", "--record", "nowhere.mat"]) == 2
    assert "nowhere.mat" in capsys.readouterr().err


def test_two_threads_draw_what_one_does():
    from emps_design.report import style
    from emps_design.report.diagrams import impedance_law_diagram

    alone = style.svg(impedance_law_diagram())
    drawn = []
    threads = [threading.Thread(target=lambda: drawn.append(style.svg(impedance_law_diagram()))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert drawn == [alone] * 3


@pytest.mark.parametrize("reader", SEEN_BY)
def test_what_can_be_specified_is_told_apart_by_every_reader(reader):
    for one, other in combinations(PlanePlot.COLORS, 2):
        assert np.linalg.norm(lab(one, SEEN_BY[reader]) - lab(other, SEEN_BY[reader])) > 15.0, (one, other)


def test_labels_and_tables_are_in_the_units_of_the_axis():
    joint = Axis.from_dict(
        {
            "name": "joint",
            "motion": "rotary",
            "mechanics": {"mass": 1.15, "viscous": 8.1, "coulomb": 7.2},
            "drive": {"command": "current", "force_gain": 9.2, "command_limit": 10.3},
            "sampling": {"period": 1e-3, "encoder_resolution": 3e-6},
        }
    )
    session = Session(joint)
    design = session.design
    assert design.knobs["k_e1"].field.label == "Torque gain k_e1 [(rad/s)/(N m)]"
    assert design.knobs["mass"].field.label == design.knobs["mass"].slider.label == "Apparent inertia M_a [kg m^2]"
    assert session.simulation.fields["push"].field.label == "Push [N m]"
    assert "k_v1 [A/(rad/s)]" in design.numbers.object
    assert "Torque loop" in design.titles["Force loop"].object
    assert "N/(m/s)" not in design.laws.object
    design.machine.value = "emps2018"
    assert design.knobs["mass"].field.label == "Apparent mass M_a [kg]"
    assert session.simulation.fields["push"].field.label == "Push [N]"
    assert "k_v1 [V/(m/s)]" in design.numbers.object


def test_an_excited_record_gives_its_response_and_the_axis_that_fits_it():
    from emps_design.studio.data_view import response_work
    from tests.unit.frequency_response.cases import experiment, two_mass

    stages = []
    found = response_work(experiment(two_mass(), 3, count=2), machine("emps2019"), {}, lambda *at: stages.append(at))
    assert "the model is within the 95 % circle" in found["text"]
    assert "Fitted, two masses" in found["html"]
    assert found["model"].effects[0].kind == two_mass().effects[0].kind
    assert stages[-1] == ("drawing", 0.8)


def test_the_law_of_a_record_is_shown_and_designed_on(monkeypatch):
    from emps_design.identification import controller
    from emps_design.studio.data_view import law_work

    axis = machine("emps2019")
    record = synthetic_record(axis, laps=1, stroke=0.1)
    table = {"kind": "cascade", "position": {"kp": 12.0}, "velocity": {"kp": 300.0, "ti": 0.05}}
    told = controller.LawEstimate("r", controller.TOLD, "", table, {"velocity": {"kp": 3.0}}, 0.01, 0.02, "V")
    monkeypatch.setattr(controller, "identify_law", lambda record, unit: told)
    found = law_work(record, axis, {}, lambda *at: None)
    assert "position = { kp = 12.0 }" in found["html"]
    assert "velocity.kp" in found["html"]
    assert State.of(found["model"]).structure == "PI"
    assert (found["model"].mechanics, State.of(found["model"]).position_kp) == (axis.mechanics, 12.0)
    untold = replace(told, verdict="not told", reason="it never moves", controller=None, std={})
    monkeypatch.setattr(controller, "identify_law", lambda record, unit: untold)
    found = law_work(record, axis, {}, lambda *at: None)
    assert found["model"] is None
    assert "not told: it never moves" in found["html"]


@pytest.mark.study("looks for the law of a record")
def test_the_law_goes_on_the_axis_that_was_identified(at_once, monkeypatch):
    from emps_design.identification import controller

    axis = machine("emps2019").replace(mechanics={"mass": 80.0}, controller={"kind": "none"})
    view = DataView(lambda: {axis.name: axis}, axis.name, state, lambda *turn: None, lambda axis: None)
    view._show(synthetic_record(machine("emps2019"), laps=1, stroke=0.1))
    table = {"kind": "position_pd", "kp": 12.0, "kv": 300.0}
    told = controller.LawEstimate("r", controller.TOLD, "", table, {"kp": 3.0}, 0.01, 0.02, "V")
    monkeypatch.setattr(controller, "identify_law", lambda record, unit: told)
    view._start("Identify")
    identified = view.model.mechanics
    assert identified.mass == pytest.approx(95.1, abs=1.0)
    view._start("Law")
    assert view.model.mechanics == identified
    assert view.model.controller.kp == 12.0


@pytest.mark.study("a diagnosis")
def test_the_model_that_follows_most_closely_is_designed_on_where_it_is_sought(at_once, monkeypatch):
    closest = machine("emps2019").replace(mechanics={"mass": 91.0})
    asked = []

    def diagnose(record, axis, holdout, progress, closest=False):
        asked.append(closest)
        return answer if closest else replace(answer, closest=None)

    record = synthetic_record(machine("emps2019"), laps=3)
    answer = discrepancy.diagnose(record, machine("emps2019"), library=())
    answer = replace(answer, closest=Closest("it follows", closest))
    monkeypatch.setattr(discrepancy, "diagnose", diagnose)
    view = DataView(lambda: {"axis": machine("emps2019")}, "axis", state, lambda *turn: None, lambda axis: None)
    view._show(record)
    view._start("Diagnose")
    assert view.model.mechanics == answer.axis.mechanics
    assert "Closest model: it follows" not in view.result.object
    view._work = "Diagnose"  # as it is once a job has begun
    view.sought.value = CLOSEST_MODEL
    assert view.model is None  # of the other choice
    view._start("Diagnose")
    assert view.model.mechanics.mass == 91.0
    assert "Closest model: it follows" in view.result.object
    assert asked == [False, True]


@pytest.mark.study("long motions")
def test_a_motion_of_ones_own_is_simulated_under_the_design_and_under_the_drive(at_once):
    drive = {"kind": "cascade", "position": {"kp": 12.0, "every": 2}, "velocity": {"kp": 300.0, "ti": 0.05}}
    session = Session(machine("emps2018").replace(name="own", controller={**drive, "filters": LOW}))
    view, turn = session.motion, session.design.turn
    turn("frequency", 60.0)
    turn("stroke", 0.05)
    view._start()
    loop = PositionLoopDesign(session.design.design, 12.0, 2, {})
    program = np.concatenate([np.zeros(100), there_and_back(1e-3, 0.05, 0.2, 1.0, 0.1)])
    for name, axis in (("this design", loop.axis()), ("the axis's own controller", session.state.axis)):
        expected = follow(axis, program).to_dict()["tracking_error"]
        assert view.motion_runs.runs[name].to_dict()["tracking_error"] == expected
    assert "kp 12 1/s, every 2. sample" in view.message.object
    assert "<svg" in view.picture.object
    turn("required_phase_deg", 20.0)  # nothing that a motion depends on
    assert "<svg" in view.picture.object
    for name, value in (("position_kp", 8.0), ("filters", []), ("structure", "IP"), ("feedforward", "velocity")):
        turn(name, value)
        assert view.motion_runs is None, name
        assert view.picture.object == view.message.object == ""
        view._start()
    assert view.motion_runs.loop.axis(velocity=1.0).controller == view.motion_runs.runs["this design"].axis.controller
    assert view.motion_runs.runs["this design"].axis.controller.velocity["form"] == "ip"
    session.design.machine.value = "emps2018"  # has no controller
    assert view.motion_runs is None
    view._start()
    assert list(view.motion_runs.runs) == ["this design"]
    assert "does not follow a position" in view.message.object


def test_a_motion_from_a_file_or_the_records_reference(at_once):
    axis = machine("emps2019")
    session = Session(axis, synthetic_record(axis, laps=1, stroke=0.1))
    view = session.motion
    session.design.turn("motion", "file")
    view._start()
    assert "found no file" in view.message.object
    view.file.filename, view.file.value = "C:\\way.csv", b"t,q_ref [mm]\n0,0\n1,50\n2,50\n"
    view._start()
    run = view.motion_runs.runs["this design"].run
    assert run.q_ref[[0, 500, 1000, 2000]] == pytest.approx([0.0, 0.025, 0.05, 0.05])
    assert "way.csv, interpolated linearly" in view.message.object
    view.file.value = b"t,q_ref\n0,0\n0,1\n"
    assert view.motion_runs is None
    view._start()
    assert "way.csv: column t: sample 1 is not later than the one before" in view.message.object
    session.design.turn("motion", "record")
    view._start()
    np.testing.assert_allclose(view.motion_runs.runs["this design"].run.q_ref, session.data.record.q_ref, atol=1e-12)
    assert not view.file.visible
    session.design.turn("motion", "there and back")
    session.design.turn("speed", 1e-5)
    view._start()
    assert "take a shorter stroke or pause" in view.message.object
    assert view.picture.object == ""


def test_a_simulation_of_other_numbers_is_taken_away(at_once):
    session = Session(machine("emps2018"))
    view = session.simulation
    session.design.turn("plants", 0)
    view._start()
    assert "<svg" in view.pictures["task"].object
    session.design.turn("frequency", 80.0)  # of the velocity loop: the impedance law has none
    assert "<svg" in view.pictures["task"].object
    session.design.turn("mass", 60.0)
    assert view.message.object == view.pictures["task"].object == ""


def test_a_number_typed_before_the_last_has_its_answer_is_not_put_back(monkeypatch):
    session = Session(machine("emps2018"))
    session.design.turn("filters", LOW)
    waiting = []
    monkeypatch.setattr(controls, "after_this_event", waiting.append)
    monkeypatch.setattr(controls, "after_this_event", waiting.append)
    fields, cut_off = session.simulation.fields, session.design.filters.fields[0]["frequency"]
    fields["plants"].field.value, fields["wall"].field.value, cut_off.value = 0, 200.0, "90"  # none answered yet
    for answer in waiting:
        answer()
    assert (session.state.plants, session.state.wall, session.state.filters[0].frequency) == (0, 200.0, 90.0)
    assert (fields["wall"].field.value, cut_off.value) == (200.0, "90")


@pytest.mark.study("a whole study of feed-forward")
def test_what_is_fed_forward_is_chosen_tried_and_handed_out(at_once, tmp_path):
    ripple = {"kind": "position_ripple", "amplitude": 6.0, "phase": 0.7, "period": 0.005}
    gap = {"kind": "backlash", "gap": 1e-4, "frequency": 60.0, "damping": 0.1, "share": 0.4}
    session = Session(machine("emps2019").replace(name="own", effects=[ripple, gap]))
    view = session.compensation
    assert view.terms.value == ["inertia", "viscous", "coulomb", "constant", "position_ripple"]
    assert "backlash is not compensated" in view.not_compensated.object
    assert view.download.disabled
    view.controller.value = COMPENSATION_OWN
    view._start()
    found, best = view.compensation, view.compensation.achieved
    assert "position_ripple" in found.feedforward.terms
    errors = {"without feed-forward": found.without, "with all terms in use": best}
    for label, rms in errors.items():
        assert f'<th>{label}</th><td class="number">{rms:.4g}</td><td>m</td>' in view.table.object
    assert "keep kv below" in view.table.object
    assert "<svg" in view.picture.object
    with zipfile.ZipFile(view._folder()) as folder:
        folder.extractall(tmp_path)
    document = json.loads((tmp_path / "compensation.json").read_text())
    assert document["tracking_rms"]["with"] == best
    line = ["export", str(tmp_path / "axis.toml"), "--compensation", str(tmp_path / "compensation.json"), "--to", "c"]
    assert run([*line, "--out", str(tmp_path / "again")]) == 0
    made = {path.name: path.read_bytes() for path in (tmp_path / "again").iterdir()}
    assert made == {path.name: path.read_bytes() for path in (tmp_path / "code").iterdir()}
    view.terms.value = ["inertia", "viscous", "coulomb", "constant"]
    assert view.compensation is None
    assert view.download.disabled
    view._start()
    assert best < view.compensation.achieved < view.compensation.without
    session.design.machine.value = "emps2018"  # has no controller: the design's is taken
    assert view.compensation is None
    assert "position_ripple" not in view.terms.value
    view._start()
    assert view.controller.options == [COMPENSATION_DESIGN]
    assert view.compensation.axis.controller == files_view.designed(session.state).controller
    session.design.turn("frequency", 80.0)
    assert view.compensation is None


def test_poles_outside_the_unit_circle_are_told_from_those_inside():
    plots = LoopPlots()
    for crossover, outside in ((100.0, 0), (3000.0, 1)):
        design = design_velocity_loop(machine("emps2018"), crossover=crossover)
        plots.update(design, state(place="velocity error"))
        poles = plots.z_plane.sources["marks"].data
        size, color = np.hypot(poles["x"], poles["y"]), np.array(poles["color"])
        assert np.all(size[color == BLUE] < 1.0)
        assert np.all(size[color == RED] >= 1.0)
        assert len(size) == len(design.sampled.poles)
        assert (np.sum(color == RED) > 0) == outside
        assert plots.z_plane.legend.visible == outside


def test_the_studio_draws_what_the_page_draws():
    plots, design = LoopPlots(), design_velocity_loop(machine("emps2018"), crossover=100.0)
    plots.update(design, state(place="plant input"))
    figure = velocity_loop_figures(design)["bode_plant_input"]
    for live, axes in zip((plots.magnitude, plots.phase), figure.axes, strict=False):
        drawn = [(line.get_color(), line.get_ydata()[0]) for line in axes.get_lines() if len(line.get_xdata()) > 100]
        shown = live.sources["lines"].data
        assert [(c, y[0]) for c, y in zip(shown["color"], shown["y"], strict=True) if len(y) > 100] == drawn
        assert live.plot.yaxis.axis_label == axes.get_ylabel()


def test_the_report_of_a_state_is_asked_for_what_the_controls_hold(monkeypatch):
    def asked(axis, **options):
        page = SimpleNamespace(html=lambda: "a page")
        requests.append((axis, options))
        return SimpleNamespace(page=page)

    now, requests = state(phase_margin_deg=55.0, mass=70.0, mismatch_percent=3.0), []
    monkeypatch.setattr("emps_design.report.assemble.assemble_report", asked)
    assert report_html(now) == "a page"
    ((axis, options),) = requests
    assert axis == now.axis
    assert (options["phase_margin_deg"], options["mass"]) == (55.0, 70.0)
    assert options["mismatch"] == pytest.approx(0.03)


def test_pictures_of_a_state_are_in_one_archive_with_the_same_bytes_each_time(monkeypatch):
    run = SimpleNamespace(figures=dict)
    monkeypatch.setattr("emps_design.studio.simulation_view.simulate", lambda *_: run)
    monkeypatch.setattr("emps_design.report.style.svg", lambda figure, key="": f"<svg>{key}</svg>")
    first, second = (figures_zip(state(), "svg") for _ in range(2))
    assert first == second
    with zipfile.ZipFile(BytesIO(first)) as archive:
        names = archive.namelist()
        assert {"block_diagram.svg", "force_limit.svg", "force_loop.svg"} < set(names)
        assert archive.read("force_loop.svg") == b"<svg>force_loop</svg>"


def test_a_force_that_is_observed_says_how_small_a_one_it_would_see():
    said = []
    record = synthetic_record(machine("emps2019"), laps=1, stroke=0.05)
    shown = observe_work(record, machine("emps2019"), None, lambda *now: said.append(now))
    assert shown["text"].startswith("Observed with emps2019: forces below ")
    assert shown["advice"]
    assert [share for _, share in said] == [0.2, 0.7]
