"""Where a record cannot tell two effects apart, diagnose writes the reference that can, and simulate runs it."""

import csv
import json

import numpy as np
import pytest

from emps_design.cli import app
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A folder with the diagnosis of a delay so short that a lag would do as well."""
    folder = tmp_path_factory.mktemp("experiment")
    axis = machine("emps2019").replace(effects=[{"kind": "actuator_delay", "delay": 0.3e-3}])
    synthetic_record(axis, stroke=0.1).save(folder / "record.npz")
    out = folder / "found"
    assert app.run(["diagnose", str(folder / "record.npz"), "--out", str(out)]) == 0
    return out


@pytest.mark.study("an experiment, simulated and estimated")
def test_the_reference_is_written_and_told(found):
    document = json.loads((found / "diagnosis.json").read_text(encoding="utf-8"))
    assert document["verdict"] == "ambiguous"
    experiment = document["experiment"]
    assert sorted(experiment["between"]) == ["actuator_delay", "actuator_lag"]
    assert experiment["over_noise"] > experiment["needed"] > 0
    assert experiment["distance"] > 0
    assert experiment["program"] in [row["program"] for row in experiment["menu"]]
    assert {"program", "distance", "over_noise"} <= set(experiment["menu"][0])
    with (found / experiment["file"]).open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert list(rows[0]) == ["t", "q_ref"]
    t, q_ref = (np.array([float(row[name]) for row in rows]) for name in ("t", "q_ref"))
    assert np.allclose(np.diff(t), 1e-3)
    assert t.size * 1e-3 == pytest.approx(experiment["duration"])
    assert q_ref.min() >= 0.0
    assert q_ref.max() <= 0.1
    assert experiment["text"][1:] in (found / "report.html").read_text(encoding="utf-8")


@pytest.mark.study("an experiment on the extended model")
def test_the_extended_model_runs_it_at_once(found, capsys):
    line = ["simulate", str(found / "model.toml"), "--reference", str(found / "experiment.csv"), "--json"]
    assert app.run(line) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["saturated_share"] == 0
    assert document["largest"]["velocity"] < 0.2
