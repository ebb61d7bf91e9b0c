"""Every example runs, from any folder, without a word of warning, and draws its figure where it has one."""

import ast
import re
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((REPOSITORY / "examples").glob("[0-9]*.py"))
LONG = ("04_impedance_law", "07_identification", "09_paper_section_3", "10_diagnose_hidden_effect")
STUDY = pytest.mark.study("a long example")


@pytest.mark.parametrize(
    "script", [pytest.param(path, id=path.stem, marks=[STUDY] if path.stem in LONG else []) for path in EXAMPLES]
)
def test_example_runs(script, tmp_path, monkeypatch, capsys):
    docstring = ast.get_docstring(ast.parse(script.read_text(encoding="utf-8")))
    figure = re.search(r"\.py\s+\[figures?\.(\w+)\]", docstring)
    drawn = [tmp_path / f"drawn.{figure[1]}"] if figure else []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", [str(script), *map(str, drawn)])
    try:
        runpy.run_path(str(script), run_name="__main__")
    except SystemExit as end:  # for want of a record, which it says
        if end.code:
            raise
    finally:
        plt.close("all")
    assert capsys.readouterr().out.strip()
    assert all(path.stat().st_size > 1000 for path in drawn)


def test_there_are_examples():
    assert EXAMPLES
