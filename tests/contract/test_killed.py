"""Killed at any moment, a command leaves whole files or none; the next run cleans up after it."""

import json
import random
import signal
import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest

from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)

COMMANDS = {
    "gains": "gains {axis} --crossover 100 --phase-margin 60 --out {out}/model.toml",
    "simulate": "simulate {axis} --scenario replay --record {record} --out {out}/run.npz",
    "identify": "identify {record} --axis {axis} --out {out}/found.toml",
    "observe": "observe {record} --axis {axis} --out {out}/force.csv",
    "demo": "demo --out {out}/demo.html",
    "init": "init {out}/start --force",
}


def whole_html(path):
    assert path.read_text(encoding="utf-8").rstrip().endswith("</html>")


def whole_archive(path):
    with np.load(path, allow_pickle=False) as archive:
        assert all(np.asarray(archive[name]).size for name in archive.files)


def whole_csv(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[-1].count(",") == lines[0].count(",")


CHECKS = {
    ".toml": lambda path: tomllib.loads(path.read_text(encoding="utf-8")),
    ".json": lambda path: json.loads(path.read_text(encoding="utf-8")),
    ".npz": whole_archive,
    ".html": whole_html,
    ".csv": whole_csv,
    ".md": lambda path: path.read_text(encoding="utf-8"),
}


def files_of(folder):
    return sorted(path for path in folder.rglob("*") if path.is_file())


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_killed_at_any_moment(name, tmp_path):
    axis = machine("emps2019")
    synthetic_record(axis, laps=1).save(tmp_path / "record.npz")
    (tmp_path / "axis.toml").write_text(axis.to_toml())
    out = tmp_path / "out"
    out.mkdir()
    line = COMMANDS[name].format(record=tmp_path / "record.npz", axis=tmp_path / "axis.toml", out=out)
    command = [sys.executable, "-m", "emps_design.cli", *line.split()]

    def finish() -> float:
        start = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, timeout=200)
        return time.perf_counter() - start

    lasts = finish()
    expected = [path.relative_to(out) for path in files_of(out)]
    assert expected
    moments = random.Random(name)
    for sent in SIGNALS:
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            time.sleep(lasts * moments.uniform(0.3, 1.0))
            process.send_signal(sent)
            process.wait(timeout=60)
        for path in files_of(out):
            if ".part" not in str(path.relative_to(out)):
                CHECKS[path.suffix](path)
    finish()
    assert [path.relative_to(out) for path in files_of(out)] == expected
