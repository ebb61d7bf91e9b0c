"""Modules are documented, nothing heavy comes early, nothing dangerous is called, no effect is special."""

import ast
import functools
import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

from emps_design.cli import app
from emps_design.cli.app import COMMANDS, module_of
from emps_design.effects import EFFECTS
from emps_design.laws import LAWS

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "emps_design"
MODULES = sorted(PACKAGE.rglob("*.py"))
HEAVY = ("control", "sympy", "scipy.signal", "matplotlib", "numba", "statsmodels", "arch", "h5py", "pandas", "panel")


def named(module: Path) -> str:
    return str(module.relative_to(REPOSITORY))


@functools.cache
def tree(module: Path) -> ast.Module:
    return ast.parse(module.read_text(encoding="utf-8"))


def undocumented(module: Path) -> list[str]:
    """Public things of ``module`` without a docstring."""
    bare = []
    if module.read_text(encoding="utf-8").strip() and not ast.get_docstring(tree(module)):
        bare.append(named(module))
    # Kernels and checks of an effect are described together, in the module's docstring and in effects/effect.py.
    if module.parent.name == "library" and module.name != "__init__.py":
        return bare
    for scope in (tree(module), *(node for node in tree(module).body if isinstance(node, ast.ClassDef))):
        if isinstance(scope, ast.ClassDef) and scope.name.startswith("_"):
            continue
        for node in scope.body:
            public = isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
            if module.parent.name == "cli" and node is not scope and getattr(node, "name", "") == "command":
                continue  # its help is the module's docstring
            if public and not ast.get_docstring(node):
                bare.append(f"{named(module)}:{node.lineno} {node.name}")
    return bare


def test_public_things_have_a_docstring():
    assert [name for module in MODULES for name in undocumented(module)] == []


def test_no_function_has_more_than_eight_parameters():
    """But what is compiled: kernels, the rates of effects, and the equation of a law."""
    compiled = {"cached()", "cached(contract=True)", "part", "inlined", "fused", "fused_inlined", "intrinsic"}
    many = []
    for module in MODULES:
        for node in ast.walk(tree(module)):
            if isinstance(node, ast.FunctionDef) and not compiled & set(map(ast.unparse, node.decorator_list)):
                arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                if len({entry.arg for entry in arguments} - {"self", "cls"}) > 8:
                    many.append((module.parts[-2], node.name))
    assert set(many) <= {("library", "rate"), ("library", "demanded_force")}


def test_no_two_classes_share_a_name():
    """One concept, one name; the file of a law calls its own parameters ``Table``."""
    classes = defaultdict(list)
    for module in MODULES:
        for node in tree(module).body:
            if isinstance(node, ast.ClassDef) and module.parent.parts[-2:] != ("laws", "library"):
                classes[node.name].append(named(module))
    assert {name: homes for name, homes in classes.items() if len(homes) > 1} == {}


def dangerous(module: Path) -> list[str]:
    """Imports and calls that no module may have, and exceptions that it swallows."""
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
    return found


def test_nothing_dangerous_and_nothing_swallowed():
    assert {named(module): dangerous(module) for module in MODULES if dangerous(module)} == {}


def test_importing_is_light():
    code = "import emps_design, emps_design.cli, emps_design.axis"
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


def test_every_command_of_the_contract_has_its_file():
    for command in COMMANDS:
        module = REPOSITORY / f"{module_of(command).replace('.', '/')}.py"
        assert ast.get_docstring(tree(module)), command
        assert "answer" in [node.name for node in tree(module).body if isinstance(node, ast.FunctionDef)], command


def test_every_slow_test_and_every_study_says_why():
    sources = {path: path.read_text(encoding="utf-8") for path in sorted((REPOSITORY / "tests").rglob("*.py"))}
    marked = {path: ast.parse(source) for path, source in sources.items() if "mark.s" in source}
    bare = [
        f"{path.relative_to(REPOSITORY)}:{node.lineno}"
        for path, parsed in marked.items()
        for node in ast.walk(parsed)
        if isinstance(node, ast.Attribute)
        and ast.unparse(node) in ("pytest.mark.slow", "pytest.mark.study")
        and not any(isinstance(call, ast.Call) and call.func is node and call.args for call in ast.walk(parsed))
    ]
    assert bare == []


def test_every_command_takes_json(capsys):
    for command in COMMANDS:
        assert app.run([command, "--help"]) == 0
        text = capsys.readouterr().out
        # The studio prints its address and serves until it is ended.
        assert "--json" in text or command == "studio", command


def test_one_file_per_effect():
    files = {p.stem for p in (PACKAGE / "effects" / "library").glob("*.py")}
    assert {effect.name for effect in EFFECTS} == files - {"__init__"}


def asking_by_name(parsed: ast.Module, names: set[str]) -> list[int]:
    """Lines of a module that hold one of ``names``, other than to build an axis (``"kind"`` of a table).

    Any string counts, wherever it stands: a comparison with it can hide behind a constant or a function.
    """
    nodes = list(ast.walk(parsed))
    tables = [node for node in nodes if isinstance(node, ast.Dict)]
    building = {
        id(value)
        for table in tables
        for key, value in zip(table.keys, table.values, strict=True)
        if isinstance(key, ast.Constant) and key.value == "kind"
    }
    strings = [node for node in nodes if isinstance(node, ast.Constant) and id(node) not in building]
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    asking = [node.lineno for node in strings if node.value in names]
    return asking + [node.lineno for node in imports if node.module.startswith("emps_design.effects.library.")]


EFFECT_WORDS = {word for effect in EFFECTS for word in (effect.name, effect.label)}


def test_no_room_above_asks_for_an_effect_by_name():
    above = [m for m in MODULES if m.relative_to(PACKAGE).parts[0] not in ("effects", "machines")]
    asking = {named(module): asking_by_name(tree(module), EFFECT_WORDS) for module in above}
    assert {module: lines for module, lines in asking.items() if lines} == {}


# `impedance` and `cascade` are also commands and keys of documents, `p` heads a column: nothing about a law.
NOT_THE_LAW = {"cli/app.py", "discrepancy/view.py", "paper/errata.py", "report/assemble.py"}
# Which law made a record is told as the table of a kind, so somebody has to write that kind down.
TELLS_THE_LAW = {"identification/controller/wording.py"}


def test_no_room_above_asks_for_a_law_by_name():
    names = {law.name for law in LAWS}
    asking = {
        str(module.relative_to(PACKAGE))
        for module in MODULES
        if module.relative_to(PACKAGE).parts[0] not in ("laws", "machines") and asking_by_name(tree(module), names)
    }
    assert asking == NOT_THE_LAW | TELLS_THE_LAW


@pytest.mark.parametrize(
    "source",
    [
        'if effect.name == "backlash": pass',
        'PLAY = "backlash"',
        'play = get_effect("backlash")',
        'match name:\n    case "backlash": pass',
        'REMEDIES = {"backlash": 1.0}',
        "from emps_design.effects.library.backlash import EFFECT",
        'show = label.startswith("Backlash")',
    ],
)
def test_asking_for_an_effect_is_seen(source):
    assert asking_by_name(ast.parse(source), EFFECT_WORDS)
    assert not asking_by_name(ast.parse('EFFECTS = [{"kind": "backlash", "width": 1e-4}]'), EFFECT_WORDS)
