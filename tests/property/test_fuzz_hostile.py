"""What somebody means harm with, or nothing at all: options, destinations, names, documents, hosts.

Each kind is tried as often as ``make fuzz`` says. A command answers with a status of the contract and at most one line
beside its progress; what it does not write stays as it was; text stays text wherever it is shown.
"""

import contextlib
import html.parser
import io
import json
import os
import stat

import numpy as np
import pytest
from hypothesis import given, strategies as st

from emps_design.cli import app
from emps_design.cli.output import Terminal
from emps_design.discrepancy import rules
from emps_design.discrepancy.preparation import check_records
from emps_design.errors import EmpsError, InputError, RecordError, one_line
from emps_design.files import destination, write_text
from emps_design.machines import machine
from emps_design.records import Record, read_record
from emps_design.report.page import Facts, Line, Page, Picture, Section, Table
from emps_design.report.style import subplots
from emps_design.simulation.synthetic import read_reference
from emps_design.view import LINES
from tests.property.fuzzing import fuzz

STATUSES = (0, 2, 3, 4)
EXTREMES = (0.0, -0.0, 5e-324, 1e-308, 1e-15, 1e-9, 1e9, 1e15, 1e150, 1.7e308, float("inf"), float("nan"))
NUMBERS = st.sampled_from(EXTREMES) | st.floats() | st.floats(1e-3, 1e3) | st.integers(-(10**25), 10**25)
WORDS = NUMBERS.map(str) | st.text(max_size=8) | st.sampled_from(["1e999", "0x10", "1_0", "--", "-", "é", "\x1b[31m"])
ANY_TEXT = st.text(st.characters(exclude_categories=()), max_size=60) | st.sampled_from(
    [
        "<script>alert(1)</script>",
        "[red]",
        "$\\frac$",
        "\x1b]0;x\x07",
        "\u202e",
        "{{ 7 * 7 }}",
        "&lt;",
        "a\nb",
        "\udcff",
        "`fit_time`",
    ]
)


def run(*words):
    """Status, standard output and standard error of a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = app.run(list(words))
    return status, out.getvalue(), err.getvalue()


def refused(call, *arguments):
    """What ``call`` was refused with; nothing where it was not."""
    try:
        call(*arguments)
    except InputError as error:
        return str(error)
    return ""


OPTIONS = {
    "gains": "crossover bandwidth phase-margin mismatch velocity mass viscous coulomb force-gain voltage-limit "
    "current-time-constant period encoder-resolution computation-delay velocity-estimator at",
    "force": "k-e1 hand environment sensor-delay crossover bandwidth phase-margin velocity mass viscous force-gain "
    "period",
}


@pytest.mark.filterwarnings("ignore")
@fuzz
@given(data=st.data())
def test_options_with_any_values(data):
    command = data.draw(st.sampled_from(sorted(OPTIONS)))
    given = data.draw(st.lists(st.tuples(st.sampled_from(OPTIONS[command].split()), WORDS), max_size=4))
    basis = ["--crossover", "100"] if command == "gains" else ["--k-e1", "0.001"]
    basis = basis if data.draw(st.booleans()) else []
    status, out, err = run(command, *basis, *(w for name, word in given for w in (f"--{name}", word)), "--json")
    assert status in STATUSES, err
    assert "Traceback" not in err
    assert len(err.splitlines()) <= 1 + (status == 0)
    if status in (0, 4):
        json.loads(out, parse_constant=lambda word: pytest.fail(word))
    elif status == 2:
        assert out == ""


TABLES = {"mechanics": "mass viscous coulomb offset", "drive": "force_gain voltage_limit current_time_constant"}
TABLES["sampling"] = "period encoder_resolution computation_delay"


@pytest.mark.filterwarnings("ignore")
@fuzz
@given(data=st.data())
def test_axes_with_extreme_numbers(data, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp()
    table = machine("emps2018").to_dict()
    for key in ("current_gain", "reduction", "torque_constant"):
        table["drive"].pop(key, None)
    for _ in range(data.draw(st.integers(1, 4))):
        name = data.draw(st.sampled_from(sorted(TABLES)))
        table[name][data.draw(st.sampled_from(TABLES[name].split()))] = data.draw(NUMBERS)
    lines = [f"name = {json.dumps(table['name'])}"]
    for name in TABLES:
        lines += [f"[{name}]", *(f"{key} = {value!r}" for key, value in table[name].items())]
    path = folder / "extreme.toml"
    path.write_text("\n".join(lines))
    status, out, err = run("gains", str(path), "--crossover", "100", "--json")
    assert status in STATUSES, err
    if status in (0, 4):
        json.loads(out, parse_constant=lambda word: pytest.fail(word))
    assert len(err.splitlines()) <= 1


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["parameters", "mass", "viscous", "std", "value"]) | st.text(max_size=3), inner
        )
    ),
    max_leaves=12,
)


@pytest.mark.filterwarnings("ignore")
@fuzz
@given(content=JSON.map(json.dumps).map(str.encode) | st.binary(max_size=60) | st.integers(1, 50_000).map(b"[".__mul__))
def test_identifications_that_are_none(content, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "identified.json"
    path.write_bytes(content)
    status, _, err = run("gains", "--crossover", "100", "--sigma-from", str(path), "--json")
    assert status in STATUSES, err
    assert len(err.splitlines()) <= 1


def place(folder, kind, name):
    """Something at ``folder/name`` that is not to be replaced, or is."""
    path = folder / name
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/null")
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "link to nothing":
        path.symlink_to(folder / "none" / "x")
    elif kind == "link":
        (folder / "real").write_text("old")
        path.symlink_to(folder / "real")
    elif kind == "file":
        path.write_text("old")
        path.chmod(0o640)
    return path


NAMES = st.text(st.characters(exclude_characters="/\0"), min_size=1, max_size=300).filter(
    lambda n: n not in (".", "..")
)
KINDS = ("nothing", "file", "link", "folder", "pipe", "device", "loop", "link to nothing")


@fuzz
@given(name=NAMES, kind=st.sampled_from(KINDS), text=st.text(max_size=20))
def test_destinations(name, kind, text, tmp_path_factory):
    folder = tmp_path_factory.mktemp("d")
    try:
        os.fsencode(name)
        path = place(folder, kind, name)
    except (OSError, UnicodeError):  # no such name on this file system
        path = folder / name
        kind = "impossible"
    refusal = refused(write_text, path, text)
    if refusal:
        assert kind not in ("file", "link", "nothing")
        assert len(refusal.splitlines()) == 1
        assert not [left for left in os.listdir(folder) if left.endswith(".part") and left != name]
        return
    assert kind in ("file", "link", "nothing")
    assert path.read_bytes().decode("utf-8") == text
    assert path.is_symlink() == (kind == "link")
    if kind == "file":
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert len(os.listdir(folder)) == (2 if kind == "link" else 1)


class Tags(html.parser.HTMLParser):
    """Counts the tags of a page by name."""

    def __init__(self, page):
        super().__init__()
        self.found: dict[str, int] = {}
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.found[tag] = self.found.get(tag, 0) + 1
        assert not [name for name, _ in attributes if name.startswith("on")]


def page(text):
    blocks = (Facts(((text, text, text),)), *(Line(text, style) for style in LINES))
    return Page(text, text, blocks, (Section(text, Table([text], [[text]], text)),)).html()


PLAIN = Tags(page("plain")).found


@fuzz
@given(text=ANY_TEXT.filter(str.strip))
def test_text_on_a_page_stays_text(text):
    assert Tags(page(text)).found == PLAIN
    page(text).encode("utf-8")


@fuzz
@given(text=ANY_TEXT)
def test_text_on_a_terminal_and_in_json_stays_text(text):
    assert one_line(text).isprintable()
    document = Terminal().json_text({"name": text, "inside": [text]})
    assert json.loads(document) == {"name": text, "inside": [text]}
    assert all(c.isprintable() or c == "\n" for c in document)
    assert str(EmpsError(text)).isprintable()


@fuzz
@given(
    content=st.binary(max_size=300) | st.text(max_size=300).map(lambda t: ("t,q_ref\n" + t).encode("utf-8", "replace"))
)
def test_references_that_are_none(content, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "reference.csv"
    path.write_bytes(content)
    assert len(refused(read_reference, path, 1e-3).splitlines()) <= 1


@fuzz
@given(headers=st.dictionaries(st.sampled_from(["Host", "Origin"]), st.text(max_size=30)), port=st.integers(1, 65535))
def test_hosts(headers, port):
    access = pytest.importorskip("emps_design.studio.app", reason="the extra 'studio' is not installed")
    assert not access.local(headers, port) or headers["Host"].rpartition(":")[0] in access.NAMES
    good = {"Host": f"localhost:{port}"}
    assert access.local(good, port)
    assert not access.local({**good, "Origin": f"http://{headers.get('Host', 'x')}.example:{port}"}, port)


def test_devices_and_pipes_are_not_read(tmp_path):
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    for path in (pipe, "/dev/zero"):
        for words in (
            ("gains", "--crossover", "100", "--sigma-from", path),
            ("gains", path, "--crossover", "100"),
            ("identify", path),
            ("simulate", "--reference", path),
        ):
            status, out, err = run(*map(str, words))
            assert (status, out) == (2, "")
            assert "is not an ordinary file" in err
    with pytest.raises(InputError, match="is a device"):
        destination("/dev/zero")


def test_sizes_are_checked_before_they_are_allocated(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"t;" + b"q;" * 7_500_000 + b"\n")
    with pytest.raises(RecordError, match="found a line of more than 100000 characters"):
        read_record(tmp_path / "a.csv")
    for words, why in (
        (("simulate", "--scenario", "breakaway", "--rate", "1e-3"), "expected at most 5000 s"),
        (("identify", str(tmp_path / "a.csv"), "--bootstrap", "9" * 20), "--bootstrap"),
        (("simulate", "--scenario", "comanipulation", "--plants", "9" * 20), "--plants"),
        (("init", str(tmp_path / "start"), "--seed", "-1"), "--seed"),
    ):
        status, out, err = run(*words)
        assert (status, out) == (2, "")
        assert why in err
        assert len(err.splitlines()) == 1


def test_a_diagnosis_says_how_much_memory_it_will_not_take():
    wave = np.sin(np.arange(rules.MOST_SAMPLES + 1) * 1e-3)
    record = Record.from_arrays(1e-3, wave, wave, wave, name="hour")
    with pytest.raises(
        RecordError, match=r"hour: found 1000001 samples, expected at most 1000000 in all: .* kB of mem"
    ):
        check_records((record,), machine("emps2019"))


def test_a_picture_takes_any_name():
    figure, axes = subplots(height=1.0)
    axes.plot([0, 1])
    assert (
        "alert" not in Tags(Page("a", "", (Picture(figure, "<img onerror=alert(1)>", '"><script>'),), ()).html()).found
    )
