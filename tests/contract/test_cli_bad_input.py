"""Bad input: one line on standard error that says where, the exit status of the contract, nothing half-written."""

import os
import re

import numpy as np
import pytest

from emps_design.cli import app
from emps_design.machines import machine

N = 400
T = np.arange(N) * 1e-3
GOOD = {"t": T, "q_ref": 0.05 * np.sin(9 * T), "q": 0.05 * np.sin(9 * T) + 1e-4, "u": 2 * np.cos(9 * T)}
TABLE = "\n".join([",".join(GOOD), *(",".join(f"{x:.9g}" for x in row) for row in zip(*GOOD.values(), strict=True))])


def changed(column, index, value):
    values = GOOD[column].copy()
    values[index] = value
    return {**GOOD, column: values}


@pytest.fixture
def folder(tmp_path):
    """The bad files of the table below, and a good one of each kind."""
    archives = {
        "good": GOOD,
        "no-u": {name: GOOD[name] for name in ("t", "q_ref", "q")},
        "nan": changed("q", 17, np.nan),
        "backwards": changed("t", 99, 0.05),
        "mixed": {**GOOD, "t": np.concatenate([T[:200], 0.2 + 2 * T[:200]])},
        "three": {name: values[:3] for name, values in GOOD.items()},
        "mm": {**GOOD, "q": 2400 * GOOD["q"], "q_ref": 2400 * GOOD["q_ref"]},
        "lengths": {**GOOD, "u": GOOD["u"][:-1]},
    }
    for name, columns in archives.items():
        np.savez(tmp_path / f"{name}.npz", **columns)
    (tmp_path / "empty.csv").touch()
    (tmp_path / "text.mat").write_text(TABLE)
    (tmp_path / "word.csv").write_text(TABLE.replace("\n0.1,", "\n0.1,word"))
    (tmp_path / "a-folder").mkdir()
    axis = machine("emps2019").to_toml()
    (tmp_path / "negative.toml").write_text(axis.replace("mass = 95", "mass = -95"))
    (tmp_path / "unknown.toml").write_text(axis.replace("viscous =", "viscuos ="))
    (tmp_path / "broken.toml").write_text(axis.replace("[drive]", "[drive"))
    (tmp_path / "effect.toml").write_text(axis + '\n[[effects]]\nkind = "stribek_friction"\n')
    return tmp_path


RECORDS = {
    "empty.csv": "is empty",
    "text.mat": "found text, expected a MATLAB",
    "no-u.npz": "missing column u",
    "nan.npz": "column q, row 17: found nan",
    "backwards.npz": "column t, row 99: found time going backwards",
    "three.npz": "found 3 samples, expected at least 50",
    "mm.npz": "found a stroke of .* m, expected metres",
    "lengths.npz": "column u: found 399 samples, expected 400",
    "word.csv": "column 'q_ref': found 'word",
    "none.npz": "No such file or directory",
    "a-folder": "is a folder, expected",
}
AXES = {
    "negative.toml": "mechanics.mass: found -95.* kg, expected a number greater than 0",
    "unknown.toml": "mechanics.viscuos: unknown key, did you mean 'viscous'",
    "broken.toml": "not TOML",
    "effect.toml": "did you mean 'stribeck_friction'",
    "none.toml": "No such file or directory",
    "a-folder": "Is a directory",
    "emps2017": "expected a TOML file or one of emps2018",
}
READ_A_RECORD = {
    "identify": "identify {bad}",
    "observe": "observe {bad} --axis emps2019",
    "frf": "frf {bad} --axis emps2019",
    "law": "law {bad} --axis emps2019",
    "import": "import {bad} --axis emps2019 --out {folder}/out.npz",
    "diagnose": "diagnose {bad} --axis emps2019 --out {folder}/out",
    "report": "report --record {bad} --crossover 100 --out {folder}/out.html",
    "simulate": "simulate emps2019 --scenario replay --record {bad}",
}
READ_AN_AXIS = {
    "gains": "gains {bad} --crossover 100",
    "force": "force {bad} --k-e1 0.01",
    "impedance": "impedance {bad} --mass 50 --damping 100",
    "simulate": "simulate {bad} --scenario comanipulation",
    "identify": "identify {folder}/good.npz --axis {bad}",
    "observe": "observe {folder}/good.npz --axis {bad}",
    "frf": "frf {folder}/good.npz --axis {bad}",
    "law": "law {folder}/good.npz --axis {bad}",
    "excite": "excite {bad} --stroke 0.5 --speed 0.05",
    "diagnose": "diagnose {folder}/good.npz --axis {bad} --out {folder}/out",
    "report": "report {bad} --crossover 100 --out {folder}/out.html",
    "init": "init {folder}/start --machine {bad}",
    "import": "import {folder}/good.npz --axis {bad} --out {folder}/out.npz",
}
NUMBERS = [
    ("gains --crossover 100 --phase-margin 0", 3),
    ("gains --crossover 100 --phase-margin 90", 3),
    ("gains --crossover 100 --phase-margin -10", (2, 3)),
    ("gains --crossover -100", 2),
    ("gains --crossover nan", 2),
    ("gains --crossover 100 --bandwidth 160", 2),
    ("gains", 2),
    ("gains --crossover fast", 2),
    ("gains --crossover 100 --mass -5", 2),
    ("force --k-e1 0", 2),
    ("force --k-e1 -1", 2),
    ("force --k-e1 inf", 2),
    ("impedance --mass 0 --damping 100", 2),
    ("impedance --mass -50 --damping 100", 2),
    ("impedance --mass 50 --damping -1", 2),
    ("impedance --mass 50 --damping 100 --mismatch -1", 2),
    ("simulate --scenario dance", 2),
    ("simulate emps2019 --scenario replay", 2),
    ("identify {folder}/good.npz --model round", 2),
    ("identify", 2),
    ("report --crossover 100 --out {folder}/none/out.html", 2),
    ("report --crossover 100 --out {folder}/a-folder", 2),
    ("report --crossover 100", 2),
    ("demo --out {folder}/none/out.html", 2),
    ("init", 2),
    ("import {folder}/good.npz --out {folder}/out.html", 2),
    ("import {folder}/good.npz --time late", 2),
    ("import {folder}/good.npz --time 3:1", 2),
    ("import {folder}/good.npz --time 7:9", 2),
    ("init {folder}/empty.csv", 2),
    ("excite --stroke 0.5 --speed 0.05 --force-limit nan", 2),
    ("excite --stroke 0.5 --speed 0.05 --speed-limit nan", 2),
    ("excite --stroke 0.5 --speed 0.05 --jerk-limit nan", 2),
    ("excite --stroke 1e6 --speed 1e-3", 2),
    ("excite --stroke inf --speed 0.05", 2),
    ("frf {folder}/good.npz --to nan", 2),
    ("frf {folder}/good.npz --from nan", 2),
    ("nothing-of-the-kind", 2),
]


def listing(folder):
    return sorted((str(path), path.stat().st_size) for path in folder.rglob("*"))


def refused(capsys, folder, line, bad="", status=2):
    before = listing(folder)
    words = [word.format(bad=folder / bad if "." in bad or "-" in bad else bad, folder=folder) for word in line.split()]
    found = app.run(words)
    out, err = capsys.readouterr()
    problem = [text for text in err.splitlines() if not re.fullmatch(r"emps-design: [a-z ]+", text)]  # not progress
    assert found in (status if isinstance(status, tuple) else (status,)), err
    assert out == ""
    assert len(problem) == 1, err
    assert problem[0].startswith("emps-design: ")
    assert "Traceback" not in err
    assert listing(folder) == before
    return problem[0]


@pytest.mark.parametrize("bad", RECORDS)
@pytest.mark.parametrize("command", READ_A_RECORD)
def test_bad_records(capsys, folder, command, bad):
    line = refused(capsys, folder, READ_A_RECORD[command], bad)
    assert re.search(RECORDS[bad], line)
    assert bad in line


@pytest.mark.parametrize("bad", AXES)
@pytest.mark.parametrize("command", READ_AN_AXIS)
def test_bad_axes(capsys, folder, command, bad):
    line = refused(capsys, folder, READ_AN_AXIS[command], bad)
    assert re.search(AXES[bad], line)
    assert bad in line


@pytest.mark.parametrize(("line", "status"), NUMBERS)
def test_bad_numbers(capsys, folder, line, status):
    refused(capsys, folder, line, status=status)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read and write everything")
def test_rights(capsys, folder):
    (folder / "good.npz").chmod(0)
    assert "Permission denied" in refused(capsys, folder, READ_A_RECORD["identify"], "good.npz")
    (folder / "a-folder").chmod(0o500)
    line = refused(capsys, folder, "report --crossover 100 --out {folder}/a-folder/out.html")
    assert "cannot write there" in line


def test_init_does_not_overwrite(capsys, folder):
    start = folder / "start"
    assert app.run(["init", str(start)]) == 0
    (start / "axis.toml").write_text("mine")
    capsys.readouterr()
    assert "axis.toml, record.npz, record.csv, puzzle.npz, README.md exist already" in refused(
        capsys, folder, f"init {start}"
    )
    assert (start / "axis.toml").read_text() == "mine"
    assert app.run(["init", str(start), "--force"]) == 0
    assert (start / "axis.toml").read_text() != "mine"
