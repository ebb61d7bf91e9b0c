"""Exit statuses, one line an error, one JSON document, files whole or absent."""

import ast
import importlib
import json
import os
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from emps_design import __version__
from emps_design.cli import app
from emps_design.cli.output import Terminal
from emps_design.errors import InputError, SpecificationError, UnstableError
from emps_design.files import write_aside, write_text
from emps_design.request import Request, flags_of, options_of

REPOSITORY = Path(__file__).resolve().parents[3]
PACKAGE = REPOSITORY / "emps_design"


def texts_that_name_arguments():
    """Every text of the package, but docstrings, that names an identifier between backquotes: file and argument."""
    for path in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(path.read_text())
        alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone:
                for argument in re.findall(r"`(\w+)(?:=[^`]*)?`", node.value):
                    yield path, argument


def requests(kind=Request):
    """Every kind of request, and so every option of the program."""
    for own in kind.__subclasses__():
        yield own
        yield from requests(own)


def test_every_argument_that_a_message_names_becomes_a_flag_that_there_is():
    """A message of the library may be shown by any command, also by one without that option."""
    for path in (PACKAGE / "commands").glob("[a-z]*.py"):
        importlib.import_module(f"emps_design.commands.{path.stem}")
    options = [entry for kind in requests() for entry in options_of(kind)]
    flags = {flag for entry in options for flag in flags_of(entry)} | {"--force"}
    named = [
        (path, argument)
        for path, argument in texts_that_name_arguments()
        if path.parent.name not in ("commands", "studio")
    ]
    assert {"window", "external_force", "cutoff"} <= {argument for _, argument in named}
    for path, argument in named:
        flag = Terminal(("identify",)).with_flags(f"`{argument}`").split()[0]
        assert flag in flags, f"{path}: {argument}"


def run_raising(monkeypatch, error, *arguments):
    def application(_, terminal):
        def call(**_):
            raise error

        return call

    monkeypatch.setattr(app, "_application", application)
    return app.run(list(arguments))


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (InputError("mass: found -1 kg"), 2),
        (SpecificationError("too fast", {"crossover": 50.0}), 3),
        (UnstableError("diverges", {"k_e1": 0.1}), 4),
        (RuntimeError("what nobody foresaw"), 1),
        (KeyboardInterrupt(), 130),
    ],
)
def test_status_and_one_line(monkeypatch, capsys, error, status):
    assert run_raising(monkeypatch, error, "gains") == status
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert err.startswith("emps-design: ")


@pytest.mark.parametrize("error", [SpecificationError("too fast", {"w": 50.0}), UnstableError("diverges", {"w": 50.0})])
def test_a_refused_design_still_prints_json(monkeypatch, capsys, error):
    run_raising(monkeypatch, error, "gains", "--json")
    document = json.loads(capsys.readouterr().out)
    assert document["reason"] == str(error)
    assert document["nearest"] == {"w": 50.0}
    assert document["warnings"] == [str(error)]


@pytest.mark.parametrize("error", [InputError("found -1"), RuntimeError("unforeseen")])
def test_debug_gives_the_traceback(monkeypatch, error):
    with pytest.raises(type(error)):
        run_raising(monkeypatch, error, "gains", "--debug")


def test_usage_errors_are_one_line(capsys):
    assert app.run(["excite"]) == 2
    assert "see 'emps-design --help'" in capsys.readouterr().err
    assert app.run(["init", "--nonsense"]) == 2
    assert "--nonsense" in capsys.readouterr().err
    assert app.run(["initt"]) == 2
    assert "initt" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["--help"]])
def test_help_lists_every_command(capsys, arguments):
    assert app.run(arguments) == 0
    text = capsys.readouterr().out
    assert all(command in text for command in app.COMMANDS)


def test_help_says_a_whole_sentence_of_every_command_within_80_columns(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert app.run(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    for group in app.GROUPS.values():
        for name, sentence in group.items():
            assert any(line.split() == [name, *sentence.split()] for line in lines), name
            assert sentence.endswith(".")


def test_the_version(capsys):
    assert app.run(["--version"]) == 0
    assert capsys.readouterr().out == f"emps-design {__version__}\n"
    assert tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["version"] == __version__


def test_plain_data():
    class Result:
        def to_dict(self):
            return {"poles": np.array([1 + 2j]), "margin": np.inf, "n": np.int64(3), "pair": (np.nan, True, None)}

    assert Terminal().json_data(Result()) == {"poles": [[1.0, 2.0]], "margin": None, "n": 3, "pair": [None, True, None]}


def test_a_failed_write_leaves_the_old_file(tmp_path):
    write_text(tmp_path / "a.txt", "old")
    with pytest.raises(RuntimeError, match="half way"), write_aside(tmp_path / "a.txt") as aside:  # noqa: PT012
        aside.write_text("new and incomp")
        raise RuntimeError("half way")
    assert (tmp_path / "a.txt").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_write_refuses_folders_and_missing_folders(tmp_path):
    with pytest.raises(InputError, match="is a folder, expected the name of a file"):
        write_text(tmp_path, "text")
    with pytest.raises(InputError, match=r"folder .*/none does not exist; make it first"):
        write_text(tmp_path / "none" / "a.txt", "text")


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs a folder in which nobody may write")
def test_write_refuses_what_it_may_not_write():
    with pytest.raises(InputError, match="cannot write there, "):
        write_text("/proc/self/a.txt", "text")


def test_written_files_have_ordinary_rights(tmp_path):
    write_text(tmp_path / "a.txt", "text")
    (tmp_path / "b.txt").touch()
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "b.txt").stat().st_mode


def test_progress_goes_to_standard_error_once_a_stage(capsys):
    with Terminal().progress() as progress:
        progress("filtering", 0.1)
        progress("filtering", 0.2)
        progress("fitting", 0.5)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == ["emps-design: filtering", "emps-design: fitting"]


def test_warnings_are_a_line_each(capsys):
    Terminal().print_warnings(["q: converted from mm to m"])
    assert capsys.readouterr().err == "emps-design: warning: q: converted from mm to m\n"


def test_a_reader_that_leaves_is_no_traceback():
    code = "from emps_design.cli import main; import sys; sys.argv = ['emps-design', '--help']; main()"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""


def test_a_polite_kill_removes_what_was_written_aside(tmp_path):
    code = (
        "import signal, sys, time\n"
        "from emps_design.files import write_aside\n"
        "signal.signal(signal.SIGTERM, signal.default_int_handler)\n"
        "with write_aside(sys.argv[1]) as aside:\n"
        "    aside.write_text('half'); print('ready', flush=True); time.sleep(60)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "a.txt")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGTERM)
        process.wait(timeout=10)
    assert list(tmp_path.iterdir()) == []
