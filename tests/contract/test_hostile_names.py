"""Names hold anything: pages show them as text, terminals as one line, and no figure trips over them."""

import html.parser
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.commands.diagnose import DiagnoseRequest
from emps_design.errors import AxisError
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record

MARKUP = "<script>alert(1)</script><img src=x onerror=alert(2)> \"' & [/red][bold] $\\frac$ {0} {% x %} :smile:"
FILE = "<script>alert(3)<img onerror=alert(4)> [bold red]x $\\frac$ {}"  # what a file system takes as a name
PACKAGE = Path(__file__).parents[2] / "emps_design"


class Tags(html.parser.HTMLParser):
    """Every tag and attribute of a page."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.attributes = set(), set()
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attributes}


def harmless(page):
    found = Tags(page)
    assert not found.tags & {"script", "img", "iframe", "object", "embed", "base", "link"}
    assert not [name for name in found.attributes if name.startswith("on")]
    assert "alert(1)" in page or "alert(3)" in page  # as text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile")
    axis = machine("emps2019").replace(name=MARKUP)
    (folder / f"{FILE}.toml").write_text(axis.to_toml())
    record = synthetic_record(axis, laps=1, stroke=0.1)
    record.save(folder / f"{FILE}.npz")
    with np.load(folder / f"{FILE}.npz") as archive:
        np.savez(folder / f"{FILE}.npz", **archive, **{"<script>alert(5)": archive["u"]})
    return folder


def run(capsys, *words):
    status = app.run([str(word) for word in words])
    out, err = capsys.readouterr()
    assert status == 0, err
    assert "\x1b" not in out + err
    return out


@pytest.mark.study("a whole report")
def test_the_report(capsys, folder):
    axis, record, out = folder / f"{FILE}.toml", folder / f"{FILE}.npz", folder / "page.html"
    run(capsys, "report", axis, "--record", record, "--design-on", "record", "--crossover", 100, "--out", out)
    harmless(out.read_text())


@pytest.mark.study("a diagnosis and its page")
def test_the_diagnosis(capsys, folder):
    axis, record, out = folder / f"{FILE}.toml", folder / f"{FILE}.npz", folder / f"{FILE}"
    run(capsys, "diagnose", record, "--axis", axis, "--out", out)
    harmless((out / "report.html").read_text())
    assert json.loads((out / "diagnosis.json").read_text())["records"][0]["name"] == FILE
    assert Axis.load(out / "model.toml").name == MARKUP


def test_the_head_of_a_model_is_one_comment(tmp_path, capsys, folder):
    """A line break in the name of the axis file would end the comment in which it stands."""
    request = DiagnoseRequest((synthetic_record(machine("emps2019"), laps=1),), machine("emps2019"))
    assert replace(request, sources={"axis": "two\nlines.toml"}).axis_name == "two lines.toml"


def test_text_on_the_terminal(capsys, folder):
    axis, record = folder / f"{FILE}.toml", folder / f"{FILE}.npz"
    said = run(capsys, "identify", record, "--axis", axis)
    assert FILE in " ".join(said.split())  # markup is text, not a style
    run(capsys, "observe", record, "--axis", axis)
    run(capsys, "gains", axis, "--crossover", 100)
    run(capsys, "force", axis, "--k-e1", 0.001, "--environment", 1000)
    run(capsys, "simulate", axis, "--record", record, "--plot", folder / "run.png")


@pytest.mark.parametrize("name", ["a\x1b[31mred", "two\nlines", "bell\x07", "\u202eright to left", "\x9b31m"])
def test_control_characters(capsys, tmp_path, name):
    with pytest.raises(AxisError, match=r"^a\.toml: name: found .*, expected text on one line") as told:
        Axis.from_dict({**machine("emps2019").to_dict(), "name": name}, "a.toml")
    assert str(told.value).isprintable()
    path = tmp_path / f"{name}.npz"
    synthetic_record(machine("emps2019"), laps=1, stroke=0.03, speed=0.15).save(path)
    for line in (["simulate", "--scenario", "replay", "--record", path], ["import", path, "--json"]):
        out = run(capsys, *line)
        assert all(c.isprintable() or c == "\n" for c in out)


def test_names_that_are_no_text(capfdbinary, tmp_path, sketched):
    """A name on Linux is bytes; those that are no UTF-8 come as lone surrogates."""
    path = tmp_path / "r\udcff.npz"
    synthetic_record(machine("emps2019"), laps=1, stroke=0.03, speed=0.15).save(path)
    axis = tmp_path / "a\udcff.toml"
    axis.write_text(machine("emps2019").to_toml())
    out = tmp_path / "o\udcff.html"
    assert app.run(["report", str(axis), "--record", str(path), "--crossover", "100", "--out", str(out), "--json"]) == 0
    document = json.loads(capfdbinary.readouterr().out)
    assert document["out"] == str(out)
    assert out.read_text(encoding="utf-8")
    assert app.run(["identify", str(path), "--axis", str(axis), "--out", str(tmp_path / "m\udcff.toml")]) == 0


def test_text_becomes_html_at_one_place():
    """``Html(f"...")`` would take what is inserted for markup."""
    for path in PACKAGE.rglob("*.py"):
        assert not re.search(r"\bHtml\(\s*r?f[\"']", path.read_text(encoding="utf-8")), path


def test_the_terminal_is_written_at_one_place():
    for path in (PACKAGE / "cli").glob("*.py"):
        if path.name != "output.py":
            assert not re.search(r"(?<![\w.])print\(|\bConsole\(", path.read_text(encoding="utf-8")), path
