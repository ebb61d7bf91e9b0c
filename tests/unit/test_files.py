"""Files are whole or absent, and what a killed process leaves aside goes with the next writing."""

import errno
import fcntl
import os
import signal
import subprocess
import sys

import pytest

from emps_design import files
from emps_design.errors import InputError
from emps_design.files import write_aside, write_text, write_together

HALF_WAY = """
import sys, time
from emps_design.files import write_aside
with write_aside(sys.argv[1]) as aside:
    aside.write_text("half")
    print("half", flush=True)
    time.sleep(60)
"""


def killed_half_way(path, program=HALF_WAY) -> int:
    """Kill a process while it writes ``path``; its number."""
    with subprocess.Popen([sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "half\n"
        process.kill()
    assert process.returncode == -signal.SIGKILL
    return process.pid


def test_a_kill_leaves_the_old_file_and_the_next_writing_cleans_up(tmp_path):
    path = tmp_path / "[a] model.toml"  # brackets mean something to glob
    write_text(path, "old")
    process = killed_half_way(path)
    assert path.read_text() == "old"
    assert [str(process) in left.name for left in tmp_path.glob(".*.part")] == [True]
    write_text(path, "new")
    assert [left.name for left in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "new"


def test_what_another_writes_at_this_moment_stays(tmp_path):
    path = tmp_path / "model.toml"
    with write_aside(path) as aside:
        aside.write_text("first")
        write_text(path, "second")
        assert aside.exists()
    assert path.read_text() == "first"


def test_what_is_removed_as_abandoned_stays_locked_until_it_is_gone(tmp_path, monkeypatch):
    path, remove, taken = tmp_path / "model.toml", files._remove, []
    killed_half_way(path)

    def removing(left):
        if left.exists():
            with left.open() as another, pytest.raises(BlockingIOError):
                fcntl.flock(another, fcntl.LOCK_EX | fcntl.LOCK_NB)
            taken.append(left)
        remove(left)

    monkeypatch.setattr(files, "_remove", removing)
    write_text(path, "new")
    assert len(taken) == 1
    assert [left.name for left in tmp_path.iterdir()] == [path.name]


def test_a_file_that_another_removes_before_it_is_locked_is_made_again(tmp_path, monkeypatch):
    make, made = files._new_file, []

    def new_file(folder, start):
        made.append(make(folder, start))
        if len(made) == 1:
            made[0].unlink()
        return made[-1]

    monkeypatch.setattr(files, "_new_file", new_file)
    write_text(tmp_path / "model.toml", "whole")
    assert len(made) == 2
    assert [path.read_text() for path in tmp_path.iterdir()] == ["whole"]


def test_a_file_system_without_locks_is_written_and_nothing_there_is_taken_for_abandoned(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    left = tmp_path / ".model.toml.1.abcdefgh.part"
    left.touch()
    monkeypatch.setattr(fcntl, "flock", refuse)
    write_text(tmp_path / "model.toml", "whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == [left.name, "model.toml"]


def test_a_folder_that_cannot_be_looked_into_is_written(tmp_path, monkeypatch):
    def refuse(_):
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as closed:
        closed.setattr(os, "listdir", refuse)
        write_text(tmp_path / "model.toml", "whole")
    assert os.listdir(tmp_path) == ["model.toml"]


def test_a_failure_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), write_aside(tmp_path / "model.toml") as aside:
        aside.write_text(str(1 / 0))
    assert list(tmp_path.iterdir()) == []


def test_no_folder_is_told_before_the_work(tmp_path):
    with pytest.raises(InputError, match="folder .* does not exist; make it first"):
        write_text(tmp_path / "nowhere" / "model.toml", "")
    with pytest.raises(InputError, match="is a folder, expected the name of a file to write"):
        write_text(tmp_path, "")


def test_what_belongs_together_comes_together(tmp_path):
    write_text(tmp_path / "model.toml", "old")
    with pytest.raises(ZeroDivisionError), write_together(tmp_path) as aside:
        write_text(aside / "model.toml", f"new {1 / 0}")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]
    with write_together(tmp_path) as aside:
        write_text(aside / "model.toml", "new")
        write_text(aside / "report.html", "page")
    assert sorted((path.name, path.read_text()) for path in tmp_path.iterdir()) == [
        ("model.toml", "new"),
        ("report.html", "page"),
    ]
    with pytest.raises(InputError, match="is not a folder; make it first"), write_together(tmp_path / "nowhere"):
        pass


TOGETHER = HALF_WAY.replace("write_aside", "write_together").replace(
    "aside.write_text", "(aside / 'model.toml').write_text"
)


def test_a_kill_leaves_no_part_of_what_belongs_together(tmp_path):
    killed_half_way(tmp_path, TOGETHER)
    assert [path.is_dir() for path in tmp_path.iterdir()] == [True]
    with write_together(tmp_path) as aside:
        write_text(aside / "model.toml", "whole")
    assert [path.name for path in tmp_path.iterdir()] == ["model.toml"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_a_folder_that_cannot_be_written(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot write there"):
        write_text(tmp_path / "model.toml", "")
