"""What the package and its rooms offer: every name leads where it says, on first use, for users and type checkers."""

import ast
import importlib
from importlib.util import find_spec
from pathlib import Path

import pytest

import emps_design

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "emps_design"


def offered(stub: str) -> list[str]:
    """The names that the stub of a room imports."""
    nodes = [node for node in ast.parse(stub).body if isinstance(node, ast.ImportFrom)]
    return [alias.name for node in nodes for alias in node.names]


ROOMS = {
    ".".join(stub.parent.relative_to(REPOSITORY).parts): offered(stub.read_text(encoding="utf-8"))
    for stub in sorted(PACKAGE.rglob("__init__.pyi"))
}


def test_every_name_resolves():
    for room, homes in ROOMS.items():
        module = importlib.import_module(room)
        for name in homes:
            assert getattr(module, name) is not None, (room, name)
            assert name in dir(module), (room, name)
            assert name in module.__all__, (room, name)


def test_every_name_at_the_top_is_documented():
    assert [name for name in emps_design.__all__ if not getattr(emps_design, name).__doc__] == []


def test_no_name_is_also_a_modules():
    # The import of a module puts it under its name into its package, in the place of what is offered there.
    for room, homes in ROOMS.items():
        folder = REPOSITORY.joinpath(*room.split("."))
        at_once = set(offered((folder / "__init__.py").read_text(encoding="utf-8")))
        assert {path.stem for path in folder.iterdir()} & set(homes) <= at_once, room


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="No emps_design attribute Axle"):
        _ = emps_design.Axle


def test_the_package_says_that_it_is_typed():
    assert (PACKAGE / "py.typed").is_file()


def imported(source: str) -> list[str]:
    """Modules of the package that Python ``source`` imports from, at its top or inside its functions."""
    nodes = list(ast.walk(ast.parse(source)))
    found = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    found += [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    return [name for name in found if name.split(".")[0] == "emps_design"]


def test_examples_import_nothing_deeper_than_a_room():
    for script in sorted(REPOSITORY.glob("examples/*.py")):
        used = imported(script.read_text(encoding="utf-8"))
        assert used, script.name
        assert [name for name in used if name.count(".") > 1] == [], script.name


def test_documents_import_nothing_deeper_than_a_room():
    for page in sorted(REPOSITORY.glob("docs/**/*.md")):
        lines = [line.strip() for line in page.read_text(encoding="utf-8").splitlines()]
        used = [line.split()[1] for line in lines if line.startswith(("from emps_design", "import emps_design"))]
        assert [name for name in used if name.count(".") > 1] == [], page.name


def test_benchmarks_import_what_is_there():
    """They run seldom, and no other test loads all of them."""
    needed = set()
    for script in sorted(REPOSITORY.glob("benchmarks/*.py")):
        nodes = ast.walk(ast.parse(script.read_text(encoding="utf-8")))
        froms = [node for node in nodes if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("emps")]
        needed |= {(script.name, node.module, alias.name) for node in froms for alias in node.names}
    assert len(needed) > 50
    missing = [
        (script, module, name)
        for script, module, name in sorted(needed)
        if not hasattr(importlib.import_module(module), name) and not find_spec(f"{module}.{name}")
    ]
    assert missing == []


def test_every_room_of_the_reference_is_there(monkeypatch):
    monkeypatch.syspath_prepend(str(REPOSITORY / "docs" / "_ext"))
    for room in importlib.import_module("reference_pages").ROOMS:
        assert find_spec(f"emps_design.{room}"), room
