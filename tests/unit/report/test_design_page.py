"""The page of ``report`` and its command: what was asked beside what is achieved, instability before any margin."""

import json
import re

import numpy as np
import pytest

from emps_design.cli.app import run
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.limits import retune_velocity_loop
from emps_design.control.verdict import measure_step, second_order_step
from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.report import Page, Section
from emps_design.report.assemble import assemble_report
from emps_design.report.design import design_page, design_results
from emps_design.report.loop_figures import broken_loops, velocity_loop_figures

EVERYTHING = {
    "crossover": 100.0, "phase_margin_deg": 60.0, "k_e1": 0.01, "environment": 1e4, "mass": 50.0, "damping": 100.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def page():
    """The words of a whole page; other tests look at its pictures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("emps_design.report.page.svg", lambda figure, key="": "<svg ></svg>")
        return assemble_report("emps2018", **EVERYTHING).page.html()


@pytest.fixture
def undrawn(monkeypatch):
    """Reports without their pictures: for tests of what is decided, not of what is drawn."""
    empty = Section("Left out")
    monkeypatch.setattr("emps_design.report.assemble.design_page", lambda results: Page("title", "", (), ()))
    monkeypatch.setattr("emps_design.report.record.record_section", lambda *arguments: empty)
    monkeypatch.setattr("emps_design.report.impedance.impedance_section", lambda *arguments: empty)


@pytest.mark.slow("a whole report")
def test_the_page_shows_the_gains_and_the_margins_of_all_four_loops(page):
    for phrase in ("556.8 V/(m/s)", "8.455 ms", "60.0°", "60.2°", "39.2°"):
        assert phrase in page, phrase
    cells = re.findall(r"<td[^>]*>([^<]*)", page)
    assert {"556.766", "8.45505", "60", "60.23", "39.18", "159.9", "25.45", "unbounded"} <= set(cells)


def test_the_page_has_every_picture_with_a_caption(page):
    titles = re.findall(r"<b>Figure \d+\. ([^<]*?)\.</b>", page)
    assert {"Nyquist diagrams", "Closed-loop poles", "Step response", "Largest force gain"} <= set(titles)
    assert {"Where the law is stable", "Apparent impedance", "Mismatch of ±2 %"} <= set(titles)
    assert len(titles) == page.count("<svg ") == 15


def test_the_page_of_a_pi_design_shows_and_says_pi(sketched):
    drive = {"kind": "cascade", "velocity": {"kp": 99.0, "ti": 0.1}, "filters": [{"kind": "lowpass", "frequency": 200}]}
    axis = machine("emps2018").replace(controller=drive)
    page = design_page(design_results(retune_velocity_loop(axis, crossover=60.0))).html()
    for phrase in ("The PI velocity loop", "gains retuned for the sampled loop", "With PI it is the loop"):
        assert phrase in page, phrase
    assert "IP velocity loop" not in page
    assert "It crosses 0 dB at a higher" not in page


def test_the_page_tells_what_the_printed_law_costs_and_where_print_and_derivation_differ(page):
    for phrase in (
        ">73.81<",
        ">235.8<",
        ">6.296<",
        "creep speed, mm/s",
        ">3.841<",
        "(18) is printed with the opposite sign",
        "break-away force, at rest",
        ">17.38<",
    ):
        assert phrase in page, phrase


def test_a_page_has_the_sections_that_were_asked_for(sketched):
    """No force loop and no impedance law, and no word of theirs, unless asked for or in the axis's controller."""
    report = assemble_report("emps2018", crossover=100.0)
    html = report.page.html()
    assert report.impedance is None
    assert report.results.force is None
    assert not {"impedance", "force_loop"} & set(report.to_dict())
    assert "<h2>Force loop" not in html
    assert "<h2>Impedance law" not in html
    assert 'class="bad"' not in html
    assert not [text for text in report.warnings if "creep" in text or "passive" in text]


@pytest.mark.study("whole reports")
def test_the_axis_brings_its_own_sections(undrawn):
    axis = machine("emps2018")
    cascaded = axis.replace(controller={"kind": "ip_velocity", "k_v1": 556.0, "t_v": 8.4e-3, "k_e1": 2e-3})
    assert assemble_report(cascaded, crossover=100.0).results.force.k_e1 == 2e-3
    impedance = axis.replace(controller={"kind": "impedance", "mass": 60.0, "damping": 120.0})
    assert assemble_report(impedance, crossover=100.0).impedance.law.mass == 60.0
    assert assemble_report(axis, crossover=100.0, hand=50.0).results.force.hand == 50.0


def test_captions_name_no_colour_of_a_line(page):
    """The palette is for colour-blind readers; what one sees as red another sees as orange. Legends name the lines."""
    captions = [piece.partition("<h2>")[0].partition("<svg")[0] for piece in re.split(r"<b>Figure \d+\.", page)[1:]]
    assert len(captions) == 15
    named = [text for text in captions if re.search(r"\b(red|blue|orange|green|purple)\b", text, re.IGNORECASE)]
    assert named == []


@pytest.mark.study("a whole report")
def test_an_unstable_impedance_law_is_announced_first(sketched):
    report = assemble_report("emps2018", crossover=100.0, mass=1.0, damping=1.0)
    html = report.page.html()
    body = html[html.index("<body>") :]
    assert not report.impedance.stable
    assert body.index("The impedance law is unstable") < body.index("phase margin</th>")


@pytest.mark.study("two whole reports")
def test_the_page_is_small_closed_and_repeatable():
    page, again = (assemble_report("emps2018", **EVERYTHING).page.html() for _ in range(2))
    assert page == again
    assert len(page.encode()) < 3_000_000
    assert not re.findall(r'(?:src|href)="(?!#)', page)


def test_an_unstable_sampled_loop_is_announced_before_any_margin(sketched):
    axis = machine("emps2018").replace(sampling={"computation_delay": 1})
    design = design_velocity_loop(axis, crossover=100.0, phase_margin_deg=80.0)
    html = design_page(design_results(design)).html()
    body = html[html.index("<body>") :]
    assert body.index("the sampled velocity loop is unstable") < body.index("phase margin</th>")
    assert body.count("<td>undefined</td>") >= 10


def test_the_frequency_responses_are_those_of_the_margins():
    for loop in broken_loops(design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)):
        for curve in loop.curves:
            at = curve.response(np.array([curve.margins.crossover]))[0]
            assert abs(at) == pytest.approx(1.0, abs=1e-9)
            assert np.degrees(np.angle(-at)) == pytest.approx(curve.margins.phase_margin_deg, abs=1e-6)


def test_figures_are_matplotlib_objects_by_name():
    figures = velocity_loop_figures(design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0))
    assert sorted(figures) == ["bode_parts", "bode_plant_input", "bode_velocity_error", "nyquist", "poles", "step"]
    assert all(figure.axes for figure in figures.values())


@pytest.mark.parametrize("z", [0.2, 0.6, 0.9])
def test_overshoot_and_peak_agree_with_the_closed_form(z):
    t = np.linspace(0.0, 40.0, 40_001)
    step = measure_step(t, second_order_step(1.0, z, t))
    damped = np.sqrt(1.0 - z * z)
    assert step.overshoot_percent == pytest.approx(100.0 * np.exp(-np.pi * z / damped), rel=1e-5)
    assert step.peak_time == pytest.approx(np.pi / damped, abs=2e-3)


def test_second_order_step_is_continuous_through_critical_damping():
    t = np.linspace(0.0, 10.0, 50)
    assert second_order_step(1.0, 1.0, t) == pytest.approx(second_order_step(1.0, 1.0 + 1e-7, t), abs=1e-6)
    assert second_order_step(1.0, 1.0, t) == pytest.approx(second_order_step(1.0, 1.0 - 1e-7, t), abs=1e-6)


def test_a_response_that_does_not_settle_has_no_settling_time():
    t = np.linspace(0.0, 1.0, 100)
    assert measure_step(t, 0.5 * t).settling_time is None


def test_a_record_gives_the_mechanics_unless_told_otherwise(emps_data, sketched):
    record = emps_data / "DATA_EMPS.mat"
    report = assemble_report(record=record, crossover=100.0, record_filter="report")
    assert report.results.velocity.axis.mechanics.mass == pytest.approx(95.1089, abs=0.1085)
    html = report.page.html()
    assert "identified from DATA_EMPS" in html
    assert report.identifications[0].sha256 in html
    assert re.search(r"4\.08\d\d % of the force", html)


@pytest.mark.study("looks for the law of a record")
def test_an_axis_that_is_named_stays_as_it_is(emps_data, undrawn):
    report = assemble_report("emps2018", emps_data / "DATA_EMPS.mat", crossover=100.0, model="asymmetric")
    assert report.results.velocity.axis == machine("emps2018")
    assert [one.model for one in report.identifications] == ["asymmetric", "symmetric"]
    assert "as in its file" in report.results.notes[0]


def test_bad_combinations_are_refused():
    with pytest.raises(
        InputError, match="`design_on`: found 'reccord', expected one of record, axis, did you mean 'record'"
    ):
        assemble_report("emps2018", crossover=100.0, design_on="reccord")
    with pytest.raises(InputError, match="found 'record' without a record"):
        assemble_report("emps2018", crossover=100.0, design_on="record")
    with pytest.raises(InputError, match="found one of mass and damping, expected both"):
        assemble_report("emps2018", crossover=100.0, mass=50.0)


def test_command_writes_the_page_and_one_json_document(tmp_path, capsys):
    out = tmp_path / "r.html"
    assert run(["report", "--crossover", "100", "--phase-margin", "60", "--out", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["velocity_loop"]["k_v1"] == pytest.approx(556.766, abs=1e-3)
    assert out.read_text().startswith("<!DOCTYPE html>")
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


def test_command_exits_four_for_an_unstable_loop_and_still_writes_the_page(tmp_path, capsys, undrawn):
    axis, out = tmp_path / "slow.toml", tmp_path / "r.html"
    axis.write_text(machine("emps2018").replace(sampling={"computation_delay": 1}).to_toml())
    assert run(["report", str(axis), "--crossover", "100", "--phase-margin", "80", "--out", str(out), "--json"]) == 4
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert document["velocity_loop"]["sampled"]["stable"] is False
    assert document["reason"].startswith("the sampled loop with these gains is unstable")
    assert document["nearest"]["velocity_loop"]["phase_margin_deg"] < 80.0
    assert document["reason"] in captured.err
    assert out.exists()


def test_command_exits_four_for_a_force_gain_that_is_unstable(tmp_path, capsys, undrawn):
    report = ["report", "emps2018", "--out", str(tmp_path / "r.html"), "--force", "--json"]
    assert run([*report, "--k-e1", "1"]) == 4
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert document["reason"] in captured.err
    nearest = document["nearest"]["force_loop"]["k_e1"]
    assert document["nearest"] == {"force_loop": {"k_e1": nearest}}
    assert f"{nearest / 0.99:.5g} (m/s)/N" in document["reason"]
    assert run([*report, "--k-e1", str(nearest)]) == 0
    assert "reason" not in json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("arguments", "message", "status"),
    [
        (["--crossover", "100", "--out", "missing/r.html"], "missing does not exist", 2),
        (["--crossover", "100", "--phase-margin", "90", "--out", "r.html"], "upper limit binds", 3),
        (["--crossover", "-1", "--out", "r.html"], "expected a positive number of rad/s", 2),
        (["--crossover", "100", "--k-e1", "0", "--out", "r.html"], "k_e1: found 0", 2),
        (["--record", "nothing.mat", "--out", "r.html"], "nothing.mat", 2),
        (["--record-filter", "paper", "--out", "r.html"], "--record-filter: requires --record", 2),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing_behind(tmp_path, monkeypatch, capsys, arguments, message, status):
    monkeypatch.chdir(tmp_path)
    assert run(["report", *arguments]) == status
    lines = [
        line for line in capsys.readouterr().err.splitlines() if "found" in line or "exist" in line or message in line
    ]
    assert any(message in line for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_retuned_gains_meet_the_specification_on_the_drive(undrawn):
    velocity = assemble_report("emps2018", crossover=150.0, phase_margin_deg=50.0, retune=True).results.velocity
    assert velocity.sampled.margins.phase_margin_deg == pytest.approx(50.0, abs=1e-6)
    assert velocity.sampled.margins.crossover == pytest.approx(150.0, abs=1e-6)


def test_a_cascade_shows_the_margins_of_its_own_loops(sketched):
    cascade = {"kind": "cascade", "position": {"kp": 30.0, "every": 2}, "velocity": {"kp": 300.0, "ti": 0.05}}
    axis = machine("emps2019").replace(controller=cascade)
    report = assemble_report(axis, crossover=100.0)
    loops = report.to_dict()["controller_loops"]
    assert [(loop["name"], round(loop["phase_margin_deg"])) for loop in loops] == [
        ("velocity loop", 71), ("position loop", 77), ("whole loop", 57),
    ]  # fmt: skip
    page = report.page.html()
    assert "Controller of the axis" in page
    assert re.search(r"position loop(<[^>]*>|\s)+whole loop", page)
    assert "the loops of the cascade controller are stable" in page
    hot = assemble_report(axis.replace(controller={"velocity": {"kp": 30000.0}}), crossover=100.0)
    assert "the loops of the cascade controller are UNSTABLE" in hot.page.html()
    assert not hot.loops[-1].margins.stable
    assert "controller_loops" not in assemble_report("emps2018", crossover=100.0).to_dict()
