"""The library's messages name arguments; the command line alone knows of flags, in one table."""

import ast
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer

from emps_design.cli.app import COMMANDS, _application
from emps_design.cli.command import module_of, request_of
from emps_design.cli.output import FLAGS, FLAGS_OF, Terminal
from emps_design.request import options_of

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "emps_design"
ABOVE = ("cli", "commands", "studio")  # the help of an option names flags
LIBRARY = [p for p in sorted(PACKAGE.rglob("*.py")) if p.relative_to(PACKAGE).parts[0] not in ABOVE]
FLAG = re.compile(r"(?<![\w-])--[a-z]")
COMMAND = re.compile(r"emps-design [a-z]+( [^\"'<]*)?")  # a whole command, to be typed as it stands
ARGUMENT = re.compile(r"`([^`]+)`")


def texts(source: str) -> list[str]:
    """Every string of Python ``source`` but its docstrings and the flags of an option."""
    nodes = list(ast.walk(ast.parse(source)))
    flags = [n.value for n in nodes if isinstance(n, ast.keyword) and n.arg == "flags"]
    declared = {id(node) for value in flags for node in ast.walk(value)}
    documented = [
        n for n in nodes if isinstance(n, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(n)
    ]
    docstrings = {id(node.body[0].value) for node in documented}
    found = [node for node in nodes if isinstance(node, ast.Constant) and id(node) not in docstrings | declared]
    return [node.value for node in found if isinstance(node.value, str)]


def requests() -> dict[str, list[str]]:
    """The names of the options of every command that has a request."""
    modules = {name: module_of(name) for name in COMMANDS if find_spec(module_of(name))}
    kinds = {name: request_of(import_module(module)) for name, module in modules.items()}
    return {name: [entry.name for entry in options_of(kind)] for name, kind in kinds.items()}


def named(module: Path) -> str:
    return str(module.relative_to(REPOSITORY))


@pytest.fixture(scope="module")
def library_texts():
    """What every module of the library may print, with the module's name."""
    return [(named(module), text) for module in LIBRARY for text in texts(module.read_text(encoding="utf-8"))]


def test_the_library_names_no_flag(library_texts):
    assert [(module, text) for module, text in library_texts if FLAG.search(COMMAND.sub("", text))] == []


def test_every_argument_that_a_message_names_has_its_flag(library_texts):
    options = {name for request in requests().values() for name in request}
    arguments = [(module, name) for module, text in library_texts for name in ARGUMENT.findall(text)]
    known = options | FLAGS.keys() | {name for flags in FLAGS_OF.values() for name in flags}
    assert [(module, name) for module, name in arguments if not {name, name.partition("=")[0]} & known] == []


def test_every_flag_of_the_table_is_one():
    group = typer.main.get_command(_application([], Terminal()))
    known = {
        command: {name for option in group.commands[command].params for name in option.opts} for command in COMMANDS
    }
    assert {flag.split()[0] for flag in FLAGS.values()} <= set().union(*known.values())
    for command, flags in FLAGS_OF.items():
        for flag in flags.values():
            name, _, of = flag.partition(" of ")
            assert name.split()[0] in known[of.strip("'") or command]


def test_a_flag_in_a_message_is_seen():
    found = texts('"""Docstring --here."""\nraise InputError(f"{name}: too slow; give --cutoff")')
    assert [text for text in found if FLAG.search(COMMAND.sub("", text))] == [": too slow; give --cutoff"]
    assert not FLAG.search(COMMAND.sub("", "emps-design simulate model.toml --reference next.csv"))
