"""The command `frf`: its table, picture and JSON, and what it refuses."""

import json
import re

import numpy as np
import pytest

from emps_design.cli.app import run as command
from emps_design.frequency_response import read_response
from tests.unit.frequency_response.cases import experiment, two_mass


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder, axis = tmp_path_factory.mktemp("frf"), two_mass()
    experiment(axis).save(folder / "record.npz")
    (folder / "axis.toml").write_text(axis.to_toml())
    return folder


def test_json_and_files(files, capsys):
    record, axis, out, plot = (str(files / name) for name in ("record.npz", "axis.toml", "out.csv", "out.png"))
    assert command(["frf", record, "--axis", axis, "--out", out, "--plot", plot, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["method"] == "periodic"
    assert len(document["frequency_hz"]) == len(document["std"]) == document["lines"]
    assert document["spectral_ratio"]["difference"]["largest"] > 0.0
    assert [one["kind"] for one in document["resonances"]] == ["antiresonance", "resonance"]
    assert (files / "out.csv").read_text().splitlines()[0] == "frequency_hz,magnitude,phase_deg,coherence,std"
    assert np.allclose(read_response(out).magnitude, document["magnitude"], rtol=1e-8)
    assert (files / "out.png").read_bytes().startswith(b"\x89PNG")


def test_text(files, capsys):
    assert command(["frf", str(files / "record.npz"), "--axis", str(files / "axis.toml"), "--to", "100Hz"]) == 0
    text = capsys.readouterr().out
    assert "antiresonance at 46." in text
    assert "ratio of spectra" in text
    assert "Fitted, two masses" in text
    assert re.search(r"^ mass +95\.", text, re.MULTILINE)
    assert "the model is within the 95 % circle" in text


def test_the_report_shows_the_response_beside_the_model(files, capsys, sketched):
    record, out, page = (str(files / name) for name in ("record.npz", "seen.csv", "page.html"))
    assert command(["frf", record, "--out", out]) == 0
    assert command(["report", "emps2019", "--frf", out, "--crossover", "30", "--out", page]) == 0
    text = (files / "page.html").read_text()
    assert "Measured response seen" in text
    assert re.search(r"<b>Figure 1\. ([^<]*?)\.</b>", text)[1] == "Measured frequency response"
    assert "Fitted, two masses" in text
    assert "emps2019: the model is within the 95 % circle" in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--to", "600Hz"], "found a frequency of 600 Hz, expected at most the Nyquist frequency, 500 Hz"),
        (
            ["--to", "nan"],
            "found a frequency of nan Hz, expected at most the Nyquist frequency, 500 Hz, and at least 0",
        ),
        (["--from", "nan"], "found a frequency of nan Hz, expected at most the Nyquist frequency, 500 Hz"),
        (["--from=-3"], "found a frequency of -3 Hz, expected at most the Nyquist frequency, 500 Hz, and at least 0"),
        (["--to", "0"], "found a band from 0 to 0 Hz"),
        (["--method", "welsh"], "--method: found 'welsh', expected one of auto, periodic, stepped, local-polynomial"),
        (["--instrument", "excite"], "--instrument: found 'excite', expected one of excitation, reference"),
        (["--out", "r.txt"], "--out: found 'r.txt', expected a name that ends in .csv or .mat"),
        (["--plot", "r.csv"], "--plot: found 'r.csv', expected a name that ends in .png, .svg or .pdf"),
    ],
)
def test_bad_input_is_one_line(files, capsys, options, message):
    assert command(["frf", str(files / "record.npz"), *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
