"""What is written: names that languages take, the same bytes every time, refusals, and the running error itself."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from emps_design.cli import app
from emps_design.codegen import export_controller
from emps_design.codegen.block import Ahead, Block
from emps_design.codegen.languages import functions_in_c, functions_in_st
from emps_design.codegen.program import ARRAY, REAL
from emps_design.codegen.reader import read_program
from emps_design.codegen.targets import block_name, commit, single_precision
from emps_design.codegen.vectors import Runner, Stepper, vectors_of
from emps_design.compensation import FeedForward
from emps_design.effects import EFFECTS
from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.observer import ForceObserver, observe_online


@pytest.mark.parametrize(
    "name", ["", "3-axis", "int", "END_IF", "a__b_", "Ü", "x" * 200, "con", "*/ #include <evil.h>"]
)
def test_a_name_is_an_identifier(name):
    found = block_name(name)
    assert re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", found)
    assert len(found) <= 44
    assert found.lower() not in ("int", "con", "end_if")


def test_same_axis_same_bytes_and_its_hashes():
    for target in ("c", "json"):
        first, second = (export_controller(machine("emps2019"), target) for _ in range(2))
        assert first.files == second.files
        for name, text in first.files.items():
            assert first.to_dict()["sha256"][name] == hashlib.sha256(text.encode()).hexdigest()
    page = export_controller(machine("emps2019"), "c").files["README.md"]
    assert first.to_dict()["sha256"]["emps2019.json"] not in page
    assert hashlib.sha256(export_controller(machine("emps2019"), "c").files["emps2019.c"].encode()).hexdigest() in page


def test_a_hostile_name_stays_inside_comments():
    axis = machine("emps2019").replace(name='*/ int evil; /* "`x` ?? ' + "long " * 60)
    files = export_controller(axis, "c").files
    for name, text in files.items():
        if name.endswith((".c", ".h")):
            outside = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
            assert "evil" not in outside.replace(block_name(axis.name), "").replace(block_name(axis.name).upper(), "")


def test_json_has_gains_equations_and_vectors(tmp_path, capsys):
    assert app.run(["export", "emps2019", "--to", "json", "--out", str(tmp_path / "new"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["files"] == ["emps2019.json"]
    document = json.loads((tmp_path / "new" / "emps2019.json").read_text(encoding="utf-8"))
    assert document["gains"][0]["value"] == 160.18 * 243.45
    assert document["equations"][0] == "v[k] = (q[k] - q[k-2]) / 0.002"
    assert len(document["vectors"]["u"]) == said["vectors"]["rows"] == len(document["vectors"]["memory"])
    assert document["units"]["u"] == "V"
    assert document["effects"] == []


def test_what_is_there_is_not_overwritten(tmp_path, capsys):
    line = ["export", "emps2019", "--to", "c", "--out", str(tmp_path)]
    assert app.run(line) == 0
    assert app.run(line) == 0  # its own files it may replace
    (tmp_path / "Makefile").write_text("all:\n\techo mine\n")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert app.run(line) == 2
    assert "Makefile holds something else, expected code of emps-design" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert app.run([*line, "--force"]) == 0


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("export emps2018 --to c --out {out}", "controller.kind: found 'none', expected"),
        ("export emps2019 --to ada --out {out}", "--to: found 'ada', expected one of c, "),
        ("export emps2019 --to c --out {out}/a/b", "does not exist; make it first"),
    ],
)
def test_bad_input_is_one_line(line, message, tmp_path, capsys):
    assert app.run(line.format(out=tmp_path / "out").split()) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_page_says_from_which_axis_record_and_commit(tmp_path, capsys):
    axis = tmp_path / "model.toml"
    axis.write_text("# mine.toml, extended; phases are those of *) puzzle\n" + machine("emps2019").to_toml())
    assert app.run(["export", str(axis), "--to", "st", "--out", str(tmp_path / "code")]) == 0
    page = (tmp_path / "code" / "README.md").read_text(encoding="utf-8")
    file_hash = hashlib.sha256(axis.read_bytes()).hexdigest()
    assert f"read from model.toml, SHA-256 {file_hash}: mine.toml, extended; phases are those of   puzzle." in page
    assert (f"(commit {commit()})" in page) == bool(commit())
    assert bool(commit()) == (Path(__file__).parents[3] / ".git").exists()


def test_no_number_is_exported_from_a_record():
    axis = machine("emps2019").replace(controller={"kind": "p", "kp": {"record": "kp", "scale": 1.0}})
    with pytest.raises(InputError, match="kp"):
        export_controller(axis, "c")


def switching(x, memory):
    """A sum that begins anew above 1: ten times 0.1 is below it in double precision, above it in single."""
    memory[0] = memory[0] + 0.1 * x
    if memory[0] > 1.0:
        memory[0] = 0.0
    return 2.0 * memory[0]


def test_a_comparison_that_falls_the_other_way_is_noticed():
    """In both precisions the bits of the same operations by hand, and the comparison that differs first."""
    program, ways = read_program(switching, (REAL, ARRAY)), ([], [])
    by_hand = ((np.float64, switching), (np.float32, _switching_in_single))
    for (real, plain), noted in zip(by_hand, ways, strict=True):
        kernel = Runner(program, real, lambda condition, noted=noted: noted.append(bool(condition)) or condition)
        memory, expected = [real(0.0)], [real(0.0)]
        for _ in range(25):
            assert kernel(real(1.0), memory) == plain(real(1.0), expected)
        assert memory[0].dtype == real
    assert np.flatnonzero(np.not_equal(*ways))[0] == 9


def _switching_in_single(x, memory):
    memory[0] = memory[0] + np.float32(0.1) * x
    if memory[0] > np.float32(1.0):
        memory[0] = np.float32(0.0)
    return np.float32(2.0) * memory[0]


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_every_effect_is_in_the_exported_observer_and_its_feed_forward_or_refused(effect):
    """In both languages; the observer's equation has the bits of the one that runs on records."""
    axis = machine("emps2018").replace(motion=effect.motion or "linear")
    axis = axis.replace(effects=[{"kind": effect.name, **effect.checks[0][0]}])
    if effect.rate or effect.channel != "plant" or effect.over == "t":
        with pytest.raises(InputError, match=f"found {effect.name}, it .*; remove these effects"):
            Block.observer(axis, 20.0)
        return
    block, ahead = Block.observer(axis, 20.0), Ahead.of(FeedForward.of(axis, (effect.name,)))
    for program in (block.program, *(part.program for part in ahead.parts)):
        sizes = dict(zip(list(program.kernel.parameters)[5:], (8, 4), strict=False))
        assert functions_in_c(program, "x", {})[0]
        assert functions_in_st(program, "x", "LREAL", sizes)[0]
    q, u = (0.3 * np.sin(np.arange(300) / w) for w in (40.0, 33.0))
    force, _ = block.run(np.arange(300) == 0, np.concatenate([u[:1], u[:-1]]), q, np.zeros(300))
    np.testing.assert_array_equal(force, observe_online(ForceObserver(axis, 20.0), q, u))
    assert not np.array_equal(force, observe_online(ForceObserver(axis.replace(effects=[]), 20.0), q, u))


@pytest.mark.parametrize("kind", ["position_pd", "cascade"])
def test_the_measured_step_has_the_bits_of_the_vectors(kind):
    controllers = {"position_pd": {"kp": 160.18, "kv": 243.45}, "cascade": {"velocity": {"kp": 40.0, "ti": 0.05}}}
    vectors = vectors_of(Block.of(machine("emps2019").replace(controller={"kind": kind, **controllers[kind]})))
    stepper = None
    for i, sample in enumerate(zip(vectors.reference, vectors.q, vectors.f_ext, strict=True)):
        stepper = Stepper(vectors.block, np.float64) if vectors.start[i] else stepper
        assert stepper.step(sample, ()) == vectors.u[i]
    assert 0.0 < vectors.difference.max() < 1e-4
    assert np.all(vectors.tolerance >= 4.0 * vectors.difference)


def test_where_single_precision_overflows_there_is_no_tolerance():
    block = Block.of(machine("emps2019"))
    vectors = vectors_of(replace(block, law=replace(block.law, gains=1e36 * np.asarray(block.law.gains))))
    beyond = ~np.isfinite(vectors.difference)
    assert 0 < np.count_nonzero(beyond) < beyond.size
    np.testing.assert_array_equal(np.isfinite(vectors.tolerance), ~beyond)
    assert None in vectors.to_dict()["single"]
    assert f"{np.count_nonzero(beyond)} samples have no bound" in single_precision(vectors)
