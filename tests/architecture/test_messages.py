"""A message has a code of its own and its axis's words; flags are known to the command line alone, in one table."""

import ast
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer

from emps_design.cli.app import COMMANDS, _application, module_of, request_of
from emps_design.cli.output import FLAGS, FLAGS_OF, Terminal
from emps_design.request import options_of
from tests.axes import KINDS, axis_of
from tests.messages import messages
from tests.rewriting import rewritten

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


@pytest.fixture(scope="module")
def made():
    """Every place of the package that makes a message."""
    return messages()


def test_a_code_is_made_in_one_place(made):
    codes = [message.code for message in made]
    assert len(codes) > 100
    assert sorted(codes) == sorted(set(codes))
    assert [code for code in codes if not re.fullmatch(r"[a-z]+(-[a-z]+)*", code)] == []


def test_messages_are_made_by_severity_alone():
    """No module makes a message in another way, such as with a severity of its own."""
    makers = [named(path) for path in sorted(PACKAGE.rglob("*.py")) if re.search(r"\bMessage\(", path.read_text())]
    assert makers == ["emps_design/messages.py"]


@pytest.mark.parametrize("kind", KINDS)
def test_no_message_has_the_words_or_units_of_another_axis(kind, made):
    """What stands between the values of a message; units and words of the axis are values too."""
    units = axis_of(kind).units
    other = []
    for message in made:
        texts = [re.sub(r"{\w*}", "1", text) for text in message.texts]
        other += [message.code for text in texts if rewritten(units, text) != text]
    assert other == ([] if units.command_unit == "V" else ["small-command"])  # which is about volts, and for them alone


def test_every_message_is_made_in_a_test(made):
    """A test names its code, or three words of its text in a row; the text of an error is tested with the error."""
    tests = [path for path in (REPOSITORY / "tests").rglob("*.py") if path != Path(__file__)]
    said = " ".join(" ".join(path.read_text(encoding="utf-8").split()) for path in tests)

    def in_a_test(message):
        parts = [part.split() for text in message.texts for part in text.split("{}")]
        words = [" ".join(part[i : i + 3]) for part in parts for i in range(len(part) - 2)]
        return f'"{message.code}"' in said or any(three in said for three in words)

    assert [message.code for message in made if message.texts and not in_a_test(message)] == []
