"""The gallery runs what can run: a script that ends early for want of a file would end the build of the documents."""

import ast
import importlib.util
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((REPOSITORY / "examples").glob("[0-9]*.py"))


@pytest.fixture(scope="module")
def gallery():
    specification = importlib.util.spec_from_file_location(
        "gallery_examples", REPOSITORY / "docs" / "_ext" / "gallery_examples.py"
    )
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: script.stem)
def test_a_script_that_may_exit_is_shown_only(gallery, script):
    exits = any(
        isinstance(node, ast.Call) and ast.unparse(node.func) in ("sys.exit", "exit", "quit")
        for node in ast.walk(ast.parse(script.read_text(encoding="utf-8")))
    )
    run = re.search(gallery.needs_nothing(REPOSITORY / "examples"), f"/{script.name}") is not None
    assert run != exits


def test_every_script_has_its_page(gallery, tmp_path):
    pages = gallery.gallery_sources(REPOSITORY / "examples", tmp_path)
    assert [page.name for page in sorted(pages.glob("[0-9]*.py"))] == [script.name for script in EXAMPLES]
    for page in pages.glob("[0-9]*.py"):
        title, line = gallery.docstring_of(page).splitlines()[:2]
        assert set(line) == {"="}
        assert len(line) == len(title)


def test_a_figure_is_asked_for_where_a_script_takes_one(gallery):
    assert gallery.figure_argument("Run: python examples/01_gains.py [figure.svg]", "01_gains") == ["01_gains.svg"]
    assert gallery.figure_argument("Run: python examples/11.py DATA_EMPS.mat", "11") == []
