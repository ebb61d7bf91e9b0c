"""Every command that runs a controller, on every law: it works, or refuses in one line what the law cannot do."""

import json

import numpy as np
import pytest

from emps_design.cli import app
from emps_design.laws import LAWS
from tests.contract.test_laws import axis_with

EVERY = pytest.mark.parametrize("kind", LAWS, ids=lambda kind: kind.name)
COMMANDS = {
    "gains": "gains {axis} --crossover 40",
    "simulate": "simulate {axis} --scenario reference --reference {reference}",
    "compensate": "compensate {axis} --stroke 0.02 --speed 0.05",
    "c": "export {axis} --to c --out {out}",
    "st": "export {axis} --to st --out {out}",
    "json": "export {axis} --to json --out {out}",
}


@pytest.mark.usefixtures("short_vectors")
@EVERY
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_on_every_law(kind, command, tmp_path, capsys):
    axis, reference = tmp_path / "axis.toml", tmp_path / "reference.csv"
    axis.write_text(axis_with(kind).to_toml(), encoding="utf-8")
    t = np.arange(600) * 1e-3
    rows = np.column_stack([t, 0.01 * (1.0 - np.cos(9.0 * t))])
    np.savetxt(reference, rows, delimiter=",", header="t,q_ref", comments="")
    line = COMMANDS[command].format(axis=axis, reference=reference, out=tmp_path / "out").split()
    status = app.run([*line, "--json"])
    out, error = capsys.readouterr()
    assert "Traceback" not in error
    assert "Warning" not in error
    if command == "compensate" and kind.follows == "rest position":
        assert status == 2
        assert "has no reference" in error
        return
    assert status == 0, error
    document = json.loads(out)
    if command == "compensate":
        rms = document["tracking_rms"]
        assert rms["with"] <= min(rms["without"], rms["baseline"])
