"""What the package and its rooms offer: every name leads where it says, on first use, for users and type checkers."""

import ast
import importlib
from pathlib import Path

import pytest

import emps_design
from emps_design.exports import offered

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "emps_design"
ROOMS = {
    ".".join(init.parent.relative_to(REPOSITORY).parts): offered(init.read_text(encoding="utf-8"))
    for init in sorted(PACKAGE.rglob("__init__.py"))
}
OFFERED = [(room, name) for room, homes in ROOMS.items() for name in homes]


@pytest.mark.parametrize(("room", "name"), OFFERED, ids=lambda part: part)
def test_every_name_resolves(room, name):
    module = importlib.import_module(room)
    assert getattr(module, name) is not None
    assert name in dir(module)
    assert name in module.__all__


@pytest.mark.parametrize("name", emps_design.__all__)
def test_every_name_at_the_top_is_documented(name):
    assert getattr(emps_design, name).__doc__


@pytest.mark.parametrize("room", [room for room, homes in ROOMS.items() if homes])
def test_no_name_is_also_a_modules(room):
    # The import of a module puts it under its name into its package, in the place of what is offered there.
    folder = REPOSITORY.joinpath(*room.split("."))
    assert {path.stem for path in folder.iterdir()} & set(ROOMS[room]) == set()


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="module 'emps_design' has no attribute 'Axle'"):
        _ = emps_design.Axle


def test_the_package_says_that_it_is_typed():
    assert (PACKAGE / "py.typed").is_file()


def imported(source: str) -> list[str]:
    """Modules of the package that Python ``source`` imports from, at its top or inside its functions."""
    nodes = list(ast.walk(ast.parse(source)))
    found = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    found += [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    return [name for name in found if name.split(".")[0] == "emps_design"]


@pytest.mark.parametrize("script", sorted(REPOSITORY.glob("examples/*.py")), ids=lambda script: script.stem)
def test_examples_import_nothing_deeper_than_a_room(script):
    used = imported(script.read_text(encoding="utf-8"))
    assert used
    assert [name for name in used if name.count(".") > 1] == []


@pytest.mark.parametrize("page", sorted(REPOSITORY.glob("docs/**/*.md")), ids=lambda page: page.stem)
def test_documents_import_nothing_deeper_than_a_room(page):
    lines = [line.strip() for line in page.read_text(encoding="utf-8").splitlines()]
    used = [line.split()[1] for line in lines if line.startswith(("from emps_design", "import emps_design"))]
    assert [name for name in used if name.count(".") > 1] == []
