"""CONTRIBUTING says which files a new effect, law, machine, format and command need: its words are followed here."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
RECIPES = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## Add\n")[1]
MACHINE = (REPOSITORY / "emps_design" / "machines" / "emps2019.toml").read_text(encoding="utf-8")


class Newcomer:
    """A copy of the package, edited as a recipe says; the files of the package it may edit are those named there."""

    def __init__(self, folder: Path, recipe: str):
        (text,) = re.findall(rf"- \*\*{recipe}:\*\*((?:.|\n)*?)(?=\n- \*\*|\Z)", RECIPES)
        self.named = {name for name in re.findall(r"`([\w/.-]+)`", text)}
        self.folder, self.package = folder, folder / "emps_design"
        shutil.copytree(REPOSITORY / "emps_design", self.package, ignore=shutil.ignore_patterns("__pycache__"))

    def copy(self, source: str, name: str, **words: str) -> None:
        """The file ``source`` under another ``name`` beside it, with other ``words``."""
        assert source in self.named
        text = (self.package / source).read_text(encoding="utf-8")
        for before, after in words.items():
            assert before in text
            text = text.replace(before, after)
        (self.package / source).with_name(name).write_text(text, encoding="utf-8")

    def new(self, folder: str, name: str, text: str) -> None:
        """A new file in a ``folder`` that is named."""
        assert folder in self.named
        (self.package / folder / name).write_text(text, encoding="utf-8")

    def edit(self, file: str, before: str, after: str) -> None:
        """Replace what a ``file`` that is named says once."""
        assert file in self.named
        text = (self.package / file).read_text(encoding="utf-8")
        assert text.count(before) == 1
        (self.package / file).write_text(text.replace(before, after), encoding="utf-8")

    def says(self, program: str) -> str:
        """What a ``program`` in Python prints that finds this copy."""
        done = subprocess.run(
            [sys.executable, "-c", program], cwd=self.folder, env={"PYTHONPATH": str(self.folder)}, text=True,
            capture_output=True, timeout=120, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout


@pytest.fixture
def newcomer(tmp_path, request):
    return Newcomer(tmp_path, request.param)


def recipe(name: str):
    return pytest.mark.parametrize("newcomer", [name], indirect=True)


@recipe("An effect")
def test_an_effect_is_one_file_and_a_line(newcomer):
    newcomer.copy("effects/library/stribeck_friction.py", "sticky_friction.py", stribeck_friction="sticky_friction")
    newcomer.edit("effects/library/__init__.py", '    "gravity",\n', '    "gravity",\n    "sticky_friction",\n')
    said = newcomer.says(
        "from emps_design.effects import known_effects\n"
        "from emps_design.machines import machine\n"
        "shape = dict(excess=8.0, stribeck_velocity=8e-3, exponent=1.0)\n"
        "axis = machine('emps2019').replace(effects=[{'kind': 'sticky_friction', **shape}])\n"
        "print(list(known_effects())[14], axis.effects[0].effect.dry(0, 8e-3, 0, 0, 0, (8.0, 8e-3, 1.0), 0))"
    )
    assert said.split() == ["sticky_friction", str(8.0 * np.exp(-1.0))]


@recipe("A law")
def test_a_law_is_one_file_and_a_line(newcomer):
    words = {'"position_pd"': '"my_law"'}
    newcomer.copy("laws/library/position_pd.py", "my_law.py", **words)
    newcomer.edit("laws/library/__init__.py", "ip_velocity, p,", "ip_velocity, my_law, p,")
    newcomer.edit("laws/library/__init__.py", "p.LAW)", "p.LAW, my_law.LAW)")
    said = newcomer.says(
        "from emps_design.laws import law_of\n"
        "from emps_design.machines import machine\n"
        "axis = machine('emps2019').replace(controller={'kind': 'my_law', 'kp': 100.0, 'kv': 200.0})\n"
        "print(axis.controller.kind, law_of(axis, 1e-3).gains[:2])"
    )
    assert "my_law" in said
    assert "200" in said


@recipe("A machine")
def test_a_machine_is_one_file(newcomer):
    newcomer.new("machines/", "your-machine.toml", MACHINE.replace('"emps2019"', '"your-machine"'))
    assert newcomer.says("from emps_design.machines import machine\nprint(machine('your-machine').name)") == (
        "your-machine\n"
    )


@recipe("A record format")
def test_a_record_format_is_a_reader_and_its_choice(newcomer):
    newcomer.new(
        "records/", "raw.py",
        "import numpy as np\n\n\ndef read_raw(file):\n    titles = file.readline().decode().split()[1:]\n"
        "    table = np.frombuffer(file.read()).reshape(-1, len(titles))\n"
        "    return dict(zip(titles, table.T.copy(), strict=True))\n",
    )  # fmt: skip
    newcomer.edit("records/readers.py", "_KINDS = {", '_KINDS = {".raw": "raw table", ')
    newcomer.edit(
        "records/readers.py", 'def _kind(head: bytes) -> str:\n',
        'def _kind(head: bytes) -> str:\n    if head[:3] == b"RAW":\n        return ".raw"\n',
    )  # fmt: skip
    newcomer.edit(
        "records/readers.py", '    if kind == ".npz":\n        return _columns',
        '    if kind == ".raw":\n        from emps_design.records.raw import read_raw\n\n'
        '        return read_raw(file)\n    if kind == ".npz":\n        return _columns',
    )  # fmt: skip
    t = np.arange(3000) * 1e-3
    table = np.column_stack([t, 0.1 * np.sin(t), 0.1 * np.sin(t), np.cos(t)])
    (newcomer.folder / "run.raw").write_bytes(b"RAW t q_ref q u\n" + table.tobytes())
    said = newcomer.says("from emps_design.records import read_record\nprint(read_record('run.raw').u[1])")
    assert float(said) == pytest.approx(np.cos(1e-3))


@recipe("A command")
def test_a_command_is_one_file_and_a_line(newcomer):
    newcomer.new(
        "commands/", "mass.py",
        '"""The moving mass of an axis."""\n\nfrom dataclasses import dataclass\n\n'
        "from emps_design.axis import Axis\nfrom emps_design.commands import Reply\n"
        "from emps_design.commands.options import axis_argument\nfrom emps_design.request import Request\n"
        "from emps_design.view import Line\n\n\n"
        '@dataclass(frozen=True)\nclass MassRequest(Request):\n    """An axis."""\n\n'
        '    axis: Axis = axis_argument("emps2019")\n\n\n'
        'def answer(request: MassRequest) -> Reply:\n    """Its mass."""\n'
        "    mass, units = request.axis.mechanics.mass, request.axis.units\n"
        '    return Reply({"mass": mass}, (Line(units.quantity(mass, "kg")),), units)\n',
    )  # fmt: skip
    newcomer.edit(
        "cli/app.py", '    "Show": {\n', '    "Show": {\n        "mass": "Show the moving mass of an axis.",\n'
    )
    program = "from emps_design.cli.app import run\nrun(['--help'])\nrun(['mass', 'emps2019', '--json'])\nrun(['mass'])"
    said = newcomer.says(program)
    assert "95.11 kg" in said
    assert "Show the moving mass of an axis." in said
    assert '"mass": 95.1089' in said
