"""Files that come into the studio and work that goes on beside it: axis files, a second record, report and figures."""

import asyncio

import pytest

pytest.importorskip("panel", reason="the extra 'studio' is not installed")

from panel.widgets import FileDownload

from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record
from emps_design.studio import files_view
from emps_design.studio.app import Session
from emps_design.studio.panes import AxisFile
from tests.unit.unlike_axes import JOINT

AXIS = machine("emps2019").replace(name="mine", sampling={"period": 5e-4})


def opened(field: AxisFile, content: bytes, name: str = "mine.toml") -> None:
    """Choose a file in ``field``."""
    field.field.filename, field.field.value = name, content


@pytest.fixture
def session():
    return Session(machine("emps2018"))


def test_an_axis_file_is_opened_in_the_design_tab_and_records_are_taken_for_ones_of_it(session):
    opened(session.design.file, AXIS.to_toml().encode())
    assert session.state.axis == AXIS
    assert (session.state.frequency, session.state.filter) == (100.0, 500.0)
    assert "Changed with mine: sampling period 0.5 ms" in session.design.message.object
    assert session.data._axis == AXIS
    heavier = AXIS.replace(mechanics={"mass": 120.0})
    opened(session.design.file, heavier.to_toml().encode())  # the same file, edited
    assert session.state.axis == session.data._axis == heavier


def test_an_axis_file_opened_beside_a_record_is_the_axis_of_the_record(session):
    session.data._show(synthetic_record(AXIS, laps=1, stroke=0.1))
    opened(session.design.file, JOINT.to_toml().encode(), "joint.toml")
    assert session.data.machine.value == "emps2019"  # the record stays one of its own axis
    opened(session.data.file, AXIS.to_toml().encode())
    assert session.data._axis == session.state.axis == AXIS


def test_an_axis_file_with_the_name_of_an_embedded_machine_is_another(session):
    opened(session.design.file, AXIS.replace(name="emps2018").to_toml().encode())
    assert session.state.axis.name == "emps2018 of mine.toml"
    assert session.design.machines["emps2018"] == machine("emps2018")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"mass = [", "mine.toml: not TOML"),
        (b"\xff\xfe", "mine.toml: not UTF-8 text, expected an axis file"),
        (b"[mechanics]\nmass = -1\n", "mine.toml: "),
    ],
)
def test_a_file_that_is_no_axis_is_refused_in_one_line_and_nothing_changes(session, content, message):
    before = session.state
    for view in (session.design, session.data):
        opened(view.file, content, "C:\\axes\\mine.toml")
        assert message in view.message.object
        assert 'role="alert"' in view.message.object
        assert view.file.field.value is None
    assert session.state == before


def test_a_second_record_is_held_out(session, at_once, tmp_path):
    files = {}
    for seed, name in ((1, "first.npz"), (2, "second.npz")):
        synthetic_record(AXIS, laps=1, seed=seed).save(tmp_path / name)
        files[name] = (tmp_path / name).read_bytes()
    view = session.data
    opened(view.file, AXIS.to_toml().encode())
    view.second.value = {"second.npz": files["second.npz"]}  # before the first: it is there once that is
    view.drop.value = {"first.npz": files["first.npz"]}
    assert (view.record.name, view.held_out.name) == ("first", "second")
    assert "held out second" in view.message.object
    view._start("Identify")
    assert " on second." in view.message.object
    assert view.model.mechanics.mass == pytest.approx(AXIS.mechanics.mass, rel=0.01)
    view.second.value = {"broken.npz": b"no archive"}
    assert (view.held_out, view.model, view.result.object) == (None, None, "")
    assert "second record: broken.npz" in view.message.object
    view.second.value = {"second.npz": files["second.npz"]}
    view.second.value = {}
    assert view.held_out is None
    assert "held out" not in view.message.object


def test_a_long_download_runs_beside_the_page_and_one_at_a_time(session, monkeypatch):
    monkeypatch.setattr(files_view, "report_html", lambda now, measured, progress: "page")
    files, begun = session.files, []
    monkeypatch.setattr(files.job, "start", lambda work, done, failed: begun.append((work, done, failed)) or True)
    report = files.view.select(FileDownload)[0].callback

    async def page() -> tuple[bytes, str]:
        waiting = asyncio.ensure_future(report())
        await asyncio.sleep(0)
        at_work = files.message.object
        work, done, _ = begun.pop()
        done(work(lambda stage, share: None))
        return (await waiting).read(), at_work

    data, at_work = asyncio.run(page())
    assert data == b"page"
    assert "report.html is being made" in at_work
    assert "report.html is in the browser" in files.message.object
    files.job._poll = object()  # as it is while work goes on
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(report())
    assert "Another job is running" in files.message.object
