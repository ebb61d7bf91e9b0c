"""The README shows what its commands really print, and its two commands are there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from emps_design.effects import EFFECTS

REPOSITORY = Path(__file__).resolve().parents[2]
README = (REPOSITORY / "README.md").read_text(encoding="utf-8")


@pytest.mark.study("five commands as a reader types them")
def test_the_output_shown_is_the_output_given():
    check = [sys.executable, str(REPOSITORY / "docs" / "fill_readme.py"), "--check"]
    done = subprocess.run(check, cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, f"run 'python docs/fill_readme.py' and look at the difference\n{done.stderr}"


def test_every_command_shown_has_its_output():
    commands = re.findall(r"<!-- run: (.*) -->", README)
    assert len(commands) == 5
    assert all(f"```text\n$ {command}\n" in README for command in commands)


def test_links_lead_somewhere():
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", README):
        assert (REPOSITORY / target).exists(), target


@pytest.mark.parametrize("name", ["README.md", "CHANGELOG.md"])
def test_the_number_of_effects_is_counted(name):
    text = " ".join((REPOSITORY / name).read_text(encoding="utf-8").split())
    assert re.findall(r"(\d+) (?:physical )?effects", text) == [str(len(EFFECTS))]


def test_the_two_commands_come_first():
    start = README[:400]
    makefile = (REPOSITORY / "Makefile").read_text()
    for target in ("demo", "test"):
        assert f"make {target}" in start
        assert re.search(rf"^{target}:", makefile, re.MULTILINE)


@pytest.mark.study("what a reader types")
def test_the_python_shown_runs(tmp_path):
    code = "\n".join(re.findall(r"```python\n(.*?)```", README, re.DOTALL))
    assert "identify(" in code
    prepare = [sys.executable, "-m", "emps_design.cli", "init", str(tmp_path)]
    subprocess.run(prepare, capture_output=True, check=True, timeout=300)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "TransferFunction" in done.stdout or "s^2" in done.stdout
