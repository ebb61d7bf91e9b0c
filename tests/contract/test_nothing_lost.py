"""What a command writes never costs what was there: inputs, other files, devices, links, modes, rights."""

import os
import re
import socket
import stat
import subprocess
import sys

import numpy as np
import pytest

from emps_design.cli import app
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record
from tests.studies import quick

WRITES = {
    "gains": "gains {axis} --crossover 100 --out {out}",
    "force": "force {axis} --k-e1 0.001 --environment 1000 --out {out}",
    "simulate": "simulate {axis} --record {record} --out {out}",
    "simulate --plot": "simulate {axis} --record {record} --plot {out}",
    "identify": "identify {record} --axis {axis} --out {out}",
    "observe": "observe {record} --axis {axis} --out {out}",
    "report": "report {axis} --record {record} --crossover 100 --out {out}",
    "demo": "demo --out {out}",
    "diagnose": "diagnose {record} --axis {axis} --out {out}",
    "init": "init {out}",
    "import": "import {record} --axis {axis} --out {out}",
}
NAMES = {
    "simulate": "out.npz",
    "simulate --plot": "out.png",
    "observe": "out.csv",
    "import": "imported.npz",
    "report": "out.html",
}
TO_A_FILE = [name for name in WRITES if name not in ("diagnose", "init")]
QUICK = ("gains", "observe", "simulate")


@pytest.fixture
def folder(tmp_path):
    synthetic_record(machine("emps2019"), laps=1, stroke=0.1).save(tmp_path / "record.npz")
    (tmp_path / "axis.toml").write_text(machine("emps2019").to_toml())
    return tmp_path


def run(folder, name, out, *more):
    line = WRITES[name].format(axis=folder / "axis.toml", record=folder / "record.npz", out=out)
    return app.run([*line.split(), *more])


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def refused(capsys, folder, name, out, why):
    before = content(folder)
    capsys.readouterr()
    assert run(folder, name, out) == 2
    printed, said = capsys.readouterr()
    assert printed == ""
    assert len(said.splitlines()) == 1, said  # before the work: no progress either
    assert re.search(why, said), said
    assert content(folder) == before


@pytest.mark.parametrize("name", WRITES)
def test_devices_pipes_and_sockets_are_refused(capsys, folder, name):
    refused(capsys, folder, name, "/dev/null", "is a device|ends in|found a file")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
    pipe = folder / NAMES.get(name, "out.toml")
    os.mkfifo(pipe)
    refused(capsys, folder, name, pipe, "is a pipe|found a file")
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    pipe.unlink()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(pipe))  # the path of a socket is short
        refused(capsys, folder, name, pipe, "is a socket|found a file")


@pytest.mark.parametrize("given", ["record.npz", "axis.toml"])
@pytest.mark.parametrize("name", TO_A_FILE)
def test_an_input_is_never_written_over(capsys, folder, name, given):
    reads = "{record}" in WRITES[name] if given == "record.npz" else "{axis}" in WRITES[name]
    why = "is an input of this command" if reads else "holds an axis file|has that name|holds a NumPy archive"
    refused(capsys, folder, name, folder / given, f"{why}|ends in")
    (folder / "link").symlink_to(folder / given)
    refused(capsys, folder, name, folder / "link", f"{why}|ends in|holds")
    os.link(folder / given, folder / "hard-link.npz")
    refused(capsys, folder, name, folder / "hard-link.npz", f"{why}|ends in|holds|takes")


def test_an_input_in_the_folder_of_results_is_kept(capsys, folder):
    (folder / "axis.toml").rename(folder / "model.toml")
    before = content(folder)
    assert app.run(["diagnose", f"{folder}/record.npz", "--axis", f"{folder}/model.toml", "--out", str(folder)]) == 2
    assert "model.toml is an input of this command" in capsys.readouterr().err
    assert content(folder) == before


@pytest.mark.parametrize("name", QUICK)
def test_another_kind_of_content_needs_force(capsys, folder, name):
    out = folder / NAMES.get(name, "out.toml")
    out.write_text("what somebody wrote by hand, with commas\nand a second line\n")
    refused(capsys, folder, name, out, "holds something else, expected .* give --force")
    assert run(folder, name, out, "--force") == 0
    first = out.read_bytes()
    assert run(folder, name, out) == 0  # its own kind
    assert out.read_bytes() == first


def test_the_demo_turns_no_record_into_a_page(capsys, folder):
    refused(capsys, folder, "demo", folder / "new.npz", "found 'new.npz', expected the name of a page")
    refused(capsys, folder, "demo", ".", "is a folder, expected the name of a file")
    (folder / "out.npz").write_text("mine")
    refused(capsys, folder, "demo", folder / "out.html", "out.npz holds something else")


@pytest.mark.parametrize("name", QUICK)
def test_a_link_is_written_through_and_modes_are_kept(folder, name):
    out, real = folder / NAMES.get(name, "out.toml"), folder / "elsewhere" / "real"
    real.parent.mkdir()
    real.touch()
    real.chmod(0o640)
    out.symlink_to(real)
    assert run(folder, name, out) == 0
    assert out.is_symlink()
    assert real.stat().st_size
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    assert [path.name for path in real.parent.iterdir()] == ["real"]
    real.unlink()
    assert run(folder, name, out) == 0  # a link to nothing yet
    assert out.is_symlink()
    assert real.stat().st_size


def test_links_that_lead_nowhere(capsys, folder):
    out = folder / "out.toml"
    out.symlink_to(folder / "none" / "real")
    refused(capsys, folder, "gains", out, "folder .*none does not exist")
    out.unlink()
    out.symlink_to(out)
    refused(capsys, folder, "gains", out, "Too many levels of symbolic links")


def test_names_that_are_too_long(capsys, folder):
    refused(capsys, folder, "gains", folder / ("x" * 300), "name too long")
    refused(capsys, folder, "gains", folder / "x\0y", "null")
    refused(capsys, folder, "diagnose", folder / ("x" * 300), "name too long")
    longest = folder / ("é" * 120 + ".toml")
    assert run(folder, "gains", longest) == 0
    assert longest.stat().st_size


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everything")
def test_what_is_protected_stays(capsys, folder):
    out = folder / "out.toml"
    out.touch(0o400)
    refused(capsys, folder, "gains", out, "write-protected")


SMALL_DISK = """
import resource, sys
from emps_design.cli import app
sys.dont_write_bytecode = True  # half a module of it would stay, and end whoever imports that next
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
import signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
sys.exit(app.run(sys.argv[1:]))
"""


@pytest.mark.parametrize("name", quick(["gains", "simulate", "observe"], 1, "the disk fills again and again"))
def test_a_full_disk_changes_nothing(folder, name):
    """A limit on the size of files stands for the disk: the same refusal in the middle of writing."""
    out = folder / NAMES.get(name, "out.toml")
    assert run(folder, name, out) == 0
    before = content(folder)
    program = SMALL_DISK.replace("1000", "300") if name == "gains" else SMALL_DISK
    line = WRITES[name].format(axis=folder / "axis.toml", record=folder / "record.npz", out=out).split()
    environment = {**os.environ, "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", "")}
    done = subprocess.run(
        [sys.executable, "-c", program, *line], capture_output=True, text=True, timeout=200, env=environment
    )
    assert done.returncode == 1
    assert f"{out}: cannot be written, File too large; nothing there was changed" in done.stderr
    assert content(folder) == before


def test_standard_output_that_takes_nothing(folder):
    if not os.path.exists("/dev/full"):
        pytest.skip("there is no /dev/full on this machine")
    command = [sys.executable, "-m", "emps_design.cli", "gains", "--crossover", "100", "--json"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=100)
    assert done.returncode == 1
    assert "No space left on device" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    closed = subprocess.run(["sh", "-c", '"$@" >&-', "sh", *command], stderr=subprocess.PIPE, text=True, timeout=100)
    assert closed.returncode == 1
    assert "standard output is closed" in closed.stderr
    assert len(closed.stderr.splitlines()) == 1


@pytest.mark.parametrize("kind", ["file", "folder", "link to a folder"])
def test_what_a_kill_left_aside_goes_and_blocks_nobody(folder, kind):
    left = folder / ".out.toml.machine.4194000.abcdefgh.part"
    kept = folder / "kept"
    kept.mkdir()
    (kept / "file").touch()
    if kind == "file":
        left.touch()
    elif kind == "folder":
        left.mkdir()
    else:
        left.symlink_to(kept)
    assert run(folder, "gains", folder / "out.toml") == 0
    assert not os.path.lexists(left)
    assert (kept / "file").exists()
    assert np.size(list(folder.glob(".*"))) == 0


def test_results_that_want_a_folder_do_not_take_a_file(tmp_path, capsys):
    (tmp_path / "notes").write_text("mine")
    assert app.run(["export", "emps2019", "--to", "c", "--out", str(tmp_path / "notes")]) == 2
    assert "notes: found a file, expected a folder for the results" in capsys.readouterr().err
    assert (tmp_path / "notes").read_text() == "mine"
