"""Every command on a rotary axis told a current and on a linear one told a torque in %: no unit of another machine."""

import json
import re

import pytest

from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.discrepancy import diagnose
from emps_design.report.assemble import assemble_report
from emps_design.simulation.synthetic import synthetic_record
from tests.axes import JOINT

GANTRY = {
    "name": "gantry",
    "mechanics": {"mass": 62.0, "viscous": 310.0, "coulomb": 48.0},
    "drive": {"command": "torque", "command_unit": "%", "force_gain": 15.08, "command_limit": 145.0},
    "sampling": {"period": 1e-3, "encoder_resolution": 1e-8},
    "controller": {"kind": "position_pd", "kp": 45.0, "kv": 400.0},
}
AXES = {"joint": JOINT, "gantry": GANTRY}
COMMANDS = {
    "gains": "gains {axis} --crossover 60 --mismatch 0.02",
    "gains unstable": "gains {axis} --crossover 2000 --phase-margin 20",
    "force": "force {axis} --k-e1 0.01 --environment 1000 --crossover 60",
    "force unstable": "force {axis} --k-e1 5 --environment 100000 --crossover 60",
    "force refused": "force {axis} --crossover 60",
    "impedance": "impedance {axis} --mass 50 --damping 100 --mismatch 0.02 --plants 2",
    "impedance refused": "impedance {axis} --mass -1 --damping 100",
    "replay": "simulate {axis} --scenario replay --record {record}",
    "breakaway": "simulate {axis} --scenario breakaway --rate 20",
    "comanipulation": "simulate {axis} --scenario comanipulation --mass 50 --damping 100 --plants 2",
    "bench": "simulate {axis} --scenario bench",
    "identify": "identify {record} --axis {axis}",
    "output error": "identify {record} --axis {axis} --estimator oe",
    "several": "identify {record} {record} --axis {axis}",
    "observe": "observe {record} --axis {axis} --out {folder}/observed.csv --force",
    "diagnose": "diagnose {record} --axis {axis} --out {folder}/found --force",
    "diagnose an effect": "diagnose {puzzle} --axis {axis} --out {folder}/named --force",
    "report": "report {axis} --record {record} --crossover 60 --k-e1 0.01 --mass 50 --damping 100 "
    "--out {folder}/page.html --force",
    "compensate": "compensate {axis}",
    "excite": "excite {axis} --stroke 2 --speed 0.2 --out {folder}/excitation.csv --force",
    "init": "init {folder}/started --machine {axis} --force",
}
VOLTAGE = r"(?<![\w/(])m?V(?![\w^])|\bV/|/V\b|[Vv]oltage(?!_)|\bvolts?\b"
WRONG = {
    "joint": re.compile(
        rf"{VOLTAGE}|\bkg\b(?! m\^2)|(?<![\w\\])N(?! m\b)(?![\w^(:=-])|(?<!\w)(?<!N )[mµun]?m/s|\[m\b"
        r"|(?<=\d )[mµn]?m\b(?! )|\bN m m\b|\bnewtons?\b(?! metre)|\bcarriage\b"
    ),
    "gantry": re.compile(rf"{VOLTAGE}|N m\b(?!/A)|kg m\^2|\brad/s/|m%"),
}
NAMES = re.compile(r'"\w+":|"voltage"|# .*extended by.*')  # keys, and what is a name among the values
# What is about the paper's machine, or about no machine.
OF_THE_PAPER = re.compile(
    r"<svg.*?</svg>|<style.*?</style>|<span translate=.no.>.*?</span>|Unit of the torque constant.*?</tr>|on the EMPS",
    re.DOTALL,
)


def wrong(name: str, text: str) -> list[str]:
    """Units of another machine in ``text``, with what is around them."""
    text = OF_THE_PAPER.sub("", text)
    return [text[max(0, m.start() - 40) : m.end() + 30].replace("\n", " ") for m in WRONG[name].finditer(text)]


@pytest.fixture(scope="module", params=AXES)
def machine(request, tmp_path_factory):
    """The name of an axis, and the files of it."""
    folder = tmp_path_factory.mktemp(request.param)
    axis = Axis.from_dict(AXES[request.param])
    (folder / "axis.toml").write_text(axis.to_toml())
    synthetic_record(axis, laps=1, stroke=0.1).save(folder / "record.npz")
    ripple = {"kind": "position_ripple", "amplitude": 0.5 * axis.mechanics.coulomb, "period": 0.02, "phase": 0.5}
    synthetic_record(axis.replace(effects=[ripple]), laps=1, stroke=0.1).save(folder / "puzzle.npz")
    return request.param, folder


def run(command: str, folder, capsys) -> str:
    """Run a command of the table and return everything that it printed."""
    names = {name: folder / f"{name}.{kind}" for name, kind in (("axis", "toml"), ("record", "npz"), ("puzzle", "npz"))}
    status = app.run(command.format(folder=folder, **names).split())
    printed = capsys.readouterr()
    assert status in (0, 2, 4), printed.err
    return printed.out + printed.err


def once(work, kept, key):
    """``work``, whose first result is ``kept`` under ``key`` and given ever after."""

    def asked(*arguments, **options):
        if key not in kept:
            kept[key] = work(*arguments, **options)
        return kept[key]

    return asked


@pytest.fixture(scope="module")
def kept(machine):
    """Results that several tests of one axis look at."""
    return {}


LONG = ("impedance", "diagnose", "diagnose an effect", "report")


@pytest.mark.parametrize(
    "command",
    [pytest.param(name, marks=[pytest.mark.study("long commands")] if name in LONG else []) for name in COMMANDS],
)
def test_no_unit_of_another_machine(machine, kept, command, capsys, monkeypatch, sketched):
    name, folder = machine
    monkeypatch.setenv("COLUMNS", "250")  # no unit in two lines
    # What takes longest is computed once, for the lines, for the document and for the pictures.
    monkeypatch.setattr("emps_design.discrepancy.diagnose", once(diagnose, kept, command))
    monkeypatch.setattr("emps_design.report.assemble.assemble_report", once(assemble_report, kept, "report"))
    assert wrong(name, run(COMMANDS[command], folder, capsys)) == []
    document = run(f"{COMMANDS[command]} --json", folder, capsys)
    assert wrong(name, NAMES.sub("", document)) == []
    for page in [*folder.glob("*.html"), *folder.glob("*/*.html"), *folder.glob("*/*.json"), *folder.glob("*/*.toml")]:
        text = page.read_text()
        assert wrong(name, NAMES.sub("", text)) == [], page


def test_the_axes_have_their_own_units(machine, capsys):
    name, folder = machine
    gains = run(COMMANDS["gains"], folder, capsys)
    found = json.loads(run(f"{COMMANDS['identify']} --json", folder, capsys).partition("\nemps-design")[0])
    units = {key: entry["unit"] for key, entry in found["parameters"].items()}
    if name == "joint":
        assert "A/(rad/s)" in gains
        assert "rpm" in gains
        assert units == {"mass": "kg m^2", "viscous": "N m/(rad/s)", "coulomb": "N m", "constant_force": "N m"}
    else:
        assert "%/(m/s)" in gains
        assert units == {"mass": "kg", "viscous": "N/(m/s)", "coulomb": "N", "constant_force": "N"}


@pytest.mark.study("a whole report of each axis")
def test_pictures_too(machine, kept):
    from matplotlib.text import Text

    name, folder = machine
    report = once(assemble_report, kept, "report")
    page = report(folder / "axis.toml", folder / "record.npz", crossover=60.0, k_e1=0.01, mass=50.0, damping=100.0).page
    written = [text.get_text() for picture in page.pictures() for text in picture.figure.findobj(Text)]
    assert len(written) > 100
    assert [found for text in written for found in wrong(name, text)] == []
