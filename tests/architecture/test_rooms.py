"""The house as built is the house as drawn: rooms look down, nothing heavy comes early, nothing dangerous is called."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from emps_design.cli import app
from emps_design.cli.app import COMMANDS
from emps_design.effects import EFFECTS

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "emps_design"
MODULES = sorted(PACKAGE.rglob("*.py"))
LONGEST = 400  # lines of a module; look twice past 300
HEAVY = ("control", "sympy", "scipy.signal", "matplotlib", "numba", "statsmodels", "arch", "h5py", "pandas", "panel")


def named(module: Path) -> str:
    return str(module.relative_to(REPOSITORY))


def tree(module: Path) -> ast.Module:
    return ast.parse(module.read_text(encoding="utf-8"))


def test_the_import_contract_holds():
    lint = Path(sys.executable).parent / "lint-imports"
    done = subprocess.run(
        [lint, "--no-cache"], cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout
    assert "1 kept, 0 broken" in done.stdout


def test_every_room_is_in_the_contract():
    import tomllib

    contract = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]
    drawn = {room.strip() for layer in contract["layers"] for room in layer.split("|")}
    built = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert built - {"__init__"} == drawn


@pytest.mark.parametrize("module", MODULES, ids=named)
def test_no_module_is_long(module):
    assert len(module.read_text(encoding="utf-8").splitlines()) <= LONGEST


@pytest.mark.parametrize("module", MODULES, ids=named)
def test_public_things_have_a_docstring(module):
    # Kernels and checks of an effect are described together, in the module's docstring and in effects/effect.py.
    if module.parent.name == "library" and module.name != "__init__.py":
        assert ast.get_docstring(tree(module))
        return
    bare = []
    if module.read_text(encoding="utf-8").strip() and not ast.get_docstring(tree(module)):
        bare.append(named(module))
    for scope in (tree(module), *(node for node in tree(module).body if isinstance(node, ast.ClassDef))):
        if isinstance(scope, ast.ClassDef) and scope.name.startswith("_"):
            continue
        for node in scope.body:
            public = isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
            if module.parent.name == "cli" and node is not scope and getattr(node, "name", "") == "command":
                continue  # its help is the module's docstring
            if public and not ast.get_docstring(node):
                bare.append(f"{named(module)}:{node.lineno} {node.name}")
    assert not bare


@pytest.mark.parametrize("module", MODULES, ids=named)
def test_nothing_dangerous_and_nothing_swallowed(module):
    found = []
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            found += [
                n for n in names if n.split(".")[0] in ("pickle", "shelve", "marshal", "requests", "urllib", "httpx")
            ]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("eval", "exec"):
            found.append(f"{node.func.id} in line {node.lineno}")
        elif isinstance(node, ast.ExceptHandler):
            silent = all(isinstance(step, ast.Pass) for step in node.body)
            if silent or node.type is None:
                found.append(f"except in line {node.lineno}")
        elif isinstance(node, ast.keyword) and node.arg in ("allow_pickle", "shell"):
            off = isinstance(node.value, ast.Constant) and node.value.value is False
            found += [] if off else [f"{node.arg} in line {node.value.lineno}"]
    assert not found


@pytest.mark.parametrize(
    "code", ["import emps_design", "import emps_design.cli", "import emps_design, emps_design.axis"]
)
def test_importing_is_light(code):
    probe = f"{code}; import sys, json; print(json.dumps([m for m in {HEAVY!r} if m in sys.modules]))"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True, timeout=60)
    assert json.loads(done.stdout) == []


def test_gains_with_numbers_given_imports_nothing_heavy():
    probe = (
        "import sys, emps_design.cli.app as app; "
        "status = app.run(['gains', '--crossover', '100', '--phase-margin', '60', '--json']); "
        f"heavy = [m for m in {HEAVY!r} if m in sys.modules]; print(status, heavy, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True, timeout=60)
    assert done.stderr.splitlines()[-1] == "0 []"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_contract_has_its_file(command):
    module = PACKAGE / "cli" / f"{command}.py"
    assert ast.get_docstring(tree(module))
    assert "command" in [node.name for node in tree(module).body if isinstance(node, ast.FunctionDef)]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_takes_json(command, capsys):
    assert app.run([command, "--help"]) == 0
    text = capsys.readouterr().out
    assert "--json" in text or command == "studio"  # the studio prints its address and serves until it is ended


def test_one_file_an_effect():
    files = {p.stem for p in (PACKAGE / "effects" / "library").glob("*.py")}
    assert {effect.name for effect in EFFECTS} == files - {"__init__"}


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_no_room_above_branches_on_an_effect_by_name(effect):
    naming = []
    for module in MODULES:
        if module.relative_to(PACKAGE).parts[0] in ("effects", "machines"):
            continue
        for node in ast.walk(tree(module)):
            operands = [node.left, *node.comparators] if isinstance(node, ast.Compare) else []
            if isinstance(node, ast.match_case):
                operands = [value.value for value in ast.walk(node.pattern) if isinstance(value, ast.MatchValue)]
            if any(isinstance(o, ast.Constant) and o.value == effect.name for o in operands):
                naming.append(f"{named(module)}:{node.lineno if hasattr(node, 'lineno') else ''}")
    assert not naming
