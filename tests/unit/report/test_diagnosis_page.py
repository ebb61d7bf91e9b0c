"""The page of a diagnosis, from invented data that keeps to the protocol."""

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from emps_design.cli.output import Terminal
from emps_design.commands.diagnose import _written
from emps_design.discrepancy.request import interval_from_text
from emps_design.discrepancy.view import diagnosis_view
from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.report.diagnosis import VERDICTS, axis_before, design_change, diagnosis_page
from emps_design.report.diagnosis_sections import before_after_figure, in_plain_words
from emps_design.units import LINEAR, Units


@dataclass
class View:
    quantity: str
    unit: str
    x: np.ndarray
    before: np.ndarray
    after: np.ndarray
    band: Any = None
    marks: Any = ()
    title: str = ""


@dataclass
class Trace:
    name: str
    t: np.ndarray
    measured: np.ndarray
    baseline: np.ndarray
    extended: np.ndarray
    used: np.ndarray
    window: Any = None


@dataclass
class Diagnosis:
    document: dict
    views: list = field(default_factory=list)
    trace: Any = None

    def to_dict(self):
        return self.document


def document(verdict="named"):
    gap = {
        "unit": "N",
        "floor": 0.39,
        "train": {"baseline": 1.55, "extended": 0.41},
        "holdout": {"baseline": 1.6, "extended": 0.42},
    }
    return {
        "schema": "emps-design/diagnosis/1",
        "verdict": verdict,
        "sentence": "Below 9 mm/s, both ways, the carriage needs up to 7 N more than the model: Stribeck friction, "
        "7.4 ± 0.6 N, v_s 8 mm/s; held-out force error 1.6 N → 0.42 N, noise 0.39 N.",
        "findings": [
            {
                "effect": "stribeck_friction",
                "label": "Stribeck friction",
                "equivalents": ["presliding_friction"],
                "where": {"channel": "plant", "text": "below 9 mm/s, in both directions", "velocity": [-0.009, 0.009]},
                "parameters": {
                    "excess": {"value": 7.4, "std": 0.6, "unit": "N"},
                    "velocity": {"value": 0.008, "std": 0.0007, "unit": "m/s", "per_record": True},
                },
                "p_value": 0.0004,
                "gap_before": 1.6,
                "gap_after": 0.42,
                "note": "Seen at every reversal.",
            }
        ],
        "gap": gap,
        "gap_inverse_60hz": gap,
        "model_file": "model.toml",
        "candidates": [
            {"effect": "stribeck_friction", "label": "Stribeck friction", "gap": 0.41, "statistic": 310.0,
             "threshold": 21.0, "accepted": True, "note": ""},
            {"effect": "backlash", "label": "Backlash", "gap": 1.2, "statistic": 60.0, "threshold": 21.0,
             "accepted": False, "note": "explains less than half"},
            {"effect": "actuator_lag", "label": "Actuator lag", "gap": 1.54, "statistic": 3.0, "threshold": 21.0,
             "accepted": False, "note": "below the threshold"},
        ],
        "parameters": {
            "mass": {"unit": "kg", "axis": 95.1, "baseline": {"value": 96.2, "std": 0.2},
                     "extended": {"value": 95.15, "std": 0.1}},
            "coulomb": {"unit": "N", "axis": 20.4, "baseline": {"value": 23.0, "std": 0.3},
                        "extended": {"value": 20.5, "std": 0.1}},
        },
        "not_excluded": [
            {"effect": "backlash", "label": "Backlash", "size": 8e-6, "unit": "m", "text": "gap 8.0 µm or more"},
        ],
        "remedies": ["Compensate the friction at low speed, or dither."],
        "experiment": {
            "text": "slow triangles of 2 to 20 mm/s", "program": "slow_triangles", "file": "experiment.csv",
            "between": ["stribeck_friction", "presliding_friction"], "distance": 0.7, "over_noise": 38.2, "needed": 6.4,
            "menu": [{"program": "slow_triangles", "text": "triangles", "distance": 0.7, "over_noise": 38.2}],
        },
        "records": [{"name": "train.npz", "role": "train", "sha256": "ab" * 32}],
        "warnings": ["The record has few low speeds."],
        "calibration": "The threshold is the largest statistic of 199 simulated healthy records.",
    }  # fmt: skip


def invented(verdict="named"):
    rng = np.random.default_rng(3)
    t = np.arange(12_000) * 1e-3
    velocity = np.linspace(-0.12, 0.12, 241)
    stribeck = 7.4 * np.sign(velocity) * np.exp(-np.abs(velocity) / 0.008)
    noise = rng.normal(0, 0.3, 241)
    force = 60 * np.sin(2 * np.pi * t / 6) + 20 * np.sign(np.cos(2 * np.pi * t / 6))
    small, large = rng.normal(0, 0.4, t.size), 1.6 * np.sin(9 * t)
    views = [
        View("velocity", "m/s", velocity, stribeck + noise, noise, np.full(241, 0.6), ((-0.009, 0.009),)),
        View("position", "m", np.linspace(0, 0.25, 100), noise[:100], noise[100:200], np.full(100, 0.6)),
        View("time", "s", t, large, small),
        View(
            "frequency",
            "Hz",
            np.linspace(0.5, 100, 200),
            np.abs(noise[:200]),
            np.abs(noise[:200]) / 2,
            np.full(200, 0.5),
        ),
    ]
    return Diagnosis(
        document(verdict), views, Trace("holdout.npz", t, force, force - large, force - small, t > 0.05, (2.0, 5.0))
    )


def test_the_first_screen_has_the_sentence_then_where_then_before_and_after(sketched):
    html = diagnosis_page(invented()).html()
    places = [
        html.index(s)
        for s in (
            "Below 9 mm/s",
            "1.60 N",
            "Where.",
            "Before and after.",
            "Candidates.",
        )
    ]
    assert places == sorted(places)


def test_the_page_tells_everything_the_diagnosis_knows(sketched):
    html = diagnosis_page(invented()).html()
    for phrase in (
        "7.40 ± 0.60 N", "6.63 to 9.37 mm/s", "presliding friction", "&lt; 0.001", "explains less than half",
            "96.20 ± 0.20 kg",
        "8.0 µm", "Compensate the friction", "slow triangles", "38.2", "6.4 standard deviations",
        "--reference experiment.csv", "ab" * 32,
        "few low speeds", "199 simulated healthy records", "99 %", "model.toml",
    ):  # fmt: skip
        assert phrase in html, phrase


def test_the_reference_to_record_is_drawn_where_there_is_one(sketched):
    diagnosis = invented()
    without = diagnosis_page(diagnosis).html()
    t = np.arange(2000) * 1e-3
    diagnosis.experiment = SimpleNamespace(t=t, q_ref=0.01 * np.sin(t))
    html = diagnosis_page(diagnosis).html()
    assert "slow triangles, 2 s" in html
    assert html.count("<svg") == without.count("<svg") + 1
    diagnosis.experiment.q_ref = None
    assert diagnosis_page(diagnosis).html() == without


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_a_page_even_with_the_contract_alone(verdict):
    contract = document(verdict)
    bare = {key: contract[key] for key in ("schema", "verdict", "findings", "gap", "model_file")}
    bare["findings"] = [] if verdict in ("nothing-missing", "unnamed", "parameters-only") else bare["findings"]
    bare["gap"] = {"unit": "N", "floor": None, "train": {"baseline": 1.0, "extended": None}}
    html = diagnosis_page(Diagnosis(bare)).html()
    assert VERDICTS[verdict][1] in html


def test_the_first_screen_says_what_was_found_how_sure_what_is_left_and_what_to_record():
    diagnosis = invented("partly-named")
    finding = diagnosis.document["findings"][0]
    finding["confirmed"] = {"share": 0.97, "std": 0.04}
    finding["where"]["force"] = {"value": 7.4, "unit": "N", "sense": "more"}
    text = "2.3 N rms over the noise; it follows position"
    unexplained = {"rms": 2.3, "share": 0.18, "over": ["position"], "text": text}
    map_ = {"velocity": [-0.1, 0.1], "position": [0.0, 0.1], "force": [[1.0, -1.0], [2.0, -2.0]]}
    diagnosis.document["unexplained"] = unexplained | {"map": map_}
    plain = in_plain_words(diagnosis.document)
    assert "one cause has been found: Stribeck friction" in plain
    assert "was not used to find it agrees" in plain
    assert "No known cause explains the rest" in plain
    found, *after = diagnosis_view(diagnosis.document, LINEAR)[2:]
    assert found.rows[0][-1] == "0.97 +- 0.04"
    assert after[0].text.startswith("Next experiment: ")
    assert "2.3 N rms over the noise" in diagnosis_page(diagnosis).html()


def test_what_an_unknown_force_of_one_kind_would_leave_stands_beside_what_the_effects_do():
    """They were fitted beside it: without it the force error may be no less than before."""
    diagnosis = invented("partly-named")
    units = {"velocity": "m/s", "position": "m", "force": "N"}
    map_ = {"velocity": [-0.1, 0.1], "position": [0.0, 0.1], "force": [[1.0, -1.0], [2.0, -2.0]], "units": units}
    unexplained = {"rms": 2.3, "share": 0.18, "over": [], "text": "2.3 N", "kind": "", "map": map_}
    diagnosis.document["unexplained"] = unexplained
    assert "with the unknown force" not in diagnosis_page(diagnosis).html()
    unexplained |= {"kind": "an inertia that varies", "kind_leaves": 0.4567}
    html = diagnosis_page(diagnosis).html()
    assert html.index("force error after") < html.index("with the unknown force") < html.index("noise floor")
    assert "0.457 N" in html
    assert "like an inertia that varies" in html


def closest(document):
    """What a document says of the model that follows most closely."""
    gap = {"train": {"extended": 0.4}, "holdout": {"extended": 0.35}}
    text = "the records are followed to 0.35 N with a friction over the travel; it names no cause"
    return {"text": text, "gap": gap, "gap_inverse_60hz": gap, "model_file": "closest_model.toml"}


def test_the_model_that_follows_most_closely_stands_beside_the_named_one(sketched):
    found = invented()
    found.document["closest"] = closest(found.document)
    found.document["simulation"] = "closed loop"
    html = diagnosis_page(found).html()
    assert "names no cause" in html
    assert "closest_model.toml" in html
    assert "0.35" in html


def test_the_terminal_says_what_was_found_what_to_record_and_what_was_written(capsys):
    shown = document()
    shown["closest"] = closest(shown)
    finding = shown["findings"][0]
    finding["confirmed"] = None
    Terminal().print_view((*diagnosis_view(shown, Units()), *_written(shown, Path("found"))))
    text = " ".join(capsys.readouterr().out.split())
    assert text.startswith("named Below 9 mm/s")
    for words in (
        "Stribeck friction", "1.6", "0.42", "0.000", "Next experiment: slow triangles",
        "Closest model: the records are followed to 0.35 N", "Remedy: Compensate the friction",
        "Written: found/report.html, model.toml, diagnosis.json, holdout_prediction.csv, experiment.csv, "
        "closest_model.toml", "emps-design simulate found/model.toml --reference found/experiment.csv",
    ):  # fmt: skip
        assert words in text
    finding["confirmed"] = {"share": 1.02, "std": 0.05}
    shown["experiment"] = None
    Terminal().print_view(diagnosis_view(shown, Units()))
    text = " ".join(capsys.readouterr().out.split())
    assert "confirmed" in text
    assert "Written" not in text
    assert "Next experiment" not in text


@pytest.mark.parametrize(
    ("text", "message"),
    [("5", "found '5', expected START:STOP"), ("5:x", "expected START:STOP"), ("5:4", "a start before the stop")],
)
def test_an_interval_that_is_none_is_refused(text, message):
    with pytest.raises(InputError, match=message):
        interval_from_text(text)
    assert interval_from_text("0:4.5") == (0.0, 4.5)


def test_what_lost_does_not_come_before_the_answer(sketched):
    html = diagnosis_page(invented()).html()
    order = [html.index(f">{title}<") for title in ("What is missing", "What to record next", "Candidates")]
    assert order == sorted(order)


def test_a_healthy_machine_needs_nothing():
    document = {"verdict": "nothing-missing", "findings": [], "gap": {"train": {}}}
    assert "nothing has to be added" in in_plain_words(document)


def test_same_diagnosis_same_bytes_and_small():
    html = diagnosis_page(invented()).html()
    assert html == diagnosis_page(invented()).html()
    assert len(html.encode()) < 3_000_000


def test_the_page_says_what_the_better_model_changes_in_the_design(sketched):
    delayed = machine("emps2019").replace(effects=[{"kind": "actuator_delay", "delay": 1.6e-3}])
    diagnosis = invented()
    diagnosis.axis = delayed
    html = diagnosis_page(diagnosis).html()
    lost = np.degrees(1.6e-3 * 204.0)  # crossover at the plant input times the delay
    rows = {row["quantity"]: row for row in design_change(machine("emps2019"), delayed)}
    margins = [float(rows["phase margin of the old gains"][key].rstrip("°")) for key in ("before", "after")]
    assert margins[0] - margins[1] == pytest.approx(lost, abs=0.3)
    assert "phase margin of the old gains" in html
    before = axis_before(delayed, diagnosis.document["parameters"])
    assert before.effects == ()
    assert before.mechanics.mass == 96.2


def test_gains_that_the_better_model_makes_unstable_are_named():
    slow = machine("emps2019").replace(effects=[{"kind": "actuator_delay", "delay": 9e-3}])
    rows = design_change(machine("emps2019"), slow)
    assert {"quantity": "the old gains", "before": "stable", "after": "unstable"}.items() <= rows[2].items()


def test_a_model_without_gains_for_the_specification_says_why():
    stiff = machine("emps2019").replace(mechanics={"viscous": 1e6})
    rows = design_change(machine("emps2019"), stiff)
    assert "lower limit binds" in rows[0]["note"]


def test_candidates_that_were_never_fitted_are_drawn_by_their_statistic(sketched):
    diagnosis = invented("nothing-missing")
    diagnosis.document["findings"] = []
    for candidate in diagnosis.document["candidates"]:
        candidate.update(gap=None, accepted=False)
    html = diagnosis_page(diagnosis).html()
    assert "No candidate explained enough to be fitted" in html


def test_what_was_not_fitted_is_not_drawn():
    t = np.arange(6000) * 1e-3
    missed = np.where(t < 3.0, 50.0, np.sin(t))  # most of it where nothing counts
    trace = Trace("run", t, missed, np.zeros(t.size), 0.9 * missed, t >= 3.0)
    top, bottom = before_after_figure(Diagnosis({}, [], trace)).axes
    drawn = [line.get_xdata() for axes in (top, bottom) for line in axes.lines if len(line.get_xdata()) > 2]
    assert len(drawn) == 5
    assert min(x.min() for x in drawn) >= 3.0
