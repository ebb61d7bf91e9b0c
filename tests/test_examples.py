"""Every example runs, from any folder, without a word of warning, and draws its figure where it has one."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((REPOSITORY / "examples").glob("[0-9]*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: script.stem)
def test_example_runs(script, tmp_path):
    docstring = ast.get_docstring(ast.parse(script.read_text(encoding="utf-8")))
    figure = re.search(r"\.py\s+\[figures?\.(\w+)\]", docstring)
    drawn = [tmp_path / f"drawn.{figure[1]}"] if figure else []
    done = subprocess.run(
        [sys.executable, "-W", "error", script, *drawn],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert all(path.stat().st_size > 1000 for path in drawn)


def test_there_are_examples():
    assert EXAMPLES
