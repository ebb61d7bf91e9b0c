"""No circle between modules, those inside functions included, and rooms that look down only."""

import subprocess
import sys
import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = REPOSITORY / "emps_design"


def order(package: str) -> list[str]:
    """The modules of ``package``, each after those it imports; ``CycleError`` names a circle."""
    graph = grimp.build_graph(package, cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    return list(TopologicalSorter(imports).static_order())


def test_no_circle_between_modules():
    assert "emps_design.cli.app" in order("emps_design")


def test_a_circle_inside_a_function_is_seen(tmp_path, monkeypatch):
    (tmp_path / "round_house").mkdir()
    for name, line in (
        ("__init__", ""),
        ("ground", "def up():\n    from round_house import roof"),
        ("roof", "from round_house.ground import up"),
    ):
        (tmp_path / "round_house" / f"{name}.py").write_text(line)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(CycleError, match="round_house.roof"):
        order("round_house")


def test_the_import_contract_holds():
    lint = Path(sys.executable).parent / "lint-imports"
    done = subprocess.run(
        [lint, "--no-cache"], cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout
    assert "1 kept, 0 broken" in done.stdout


def test_every_room_is_in_the_contract():
    contract = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]
    drawn = {room.strip() for layer in contract["layers"] for room in layer.split("|")}
    built = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert built - {"__init__"} == drawn
