"""The list of modules that the type checker cannot yet check only becomes shorter."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import tomli_w

REPOSITORY = Path(__file__).resolve().parents[2]


def without_exceptions() -> tuple[dict, set[str]]:
    """The configuration of mypy without the list of exceptions, and that list."""
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["mypy"]
    listed = {name for one in settings["overrides"] if one.get("ignore_errors") for name in one["module"]}
    checked = [one for one in settings["overrides"] if not one.get("ignore_errors")]
    return {"tool": {"mypy": {**settings, "overrides": checked}}}, listed


USER = (
    "import emps_design\n"
    "from emps_design.simulation import Plant\n"
    "found = emps_design.design_velocity_loop(emps_design.machine('emps2018'), crossover=100.0)\n"
    "good: float = found.k_v1\n"
    "wrong: str = found.k_v1\n"
    "emps_design.design_velocity_lop\n"
    "Plant.off\n"
)


@pytest.fixture(scope="module")
def checked(tmp_path_factory) -> list[str]:
    """Errors in the package without its exceptions, and in a user's script: one run, on the cache of `make lint`."""
    folder = tmp_path_factory.mktemp("types")
    settings, _ = without_exceptions()
    del settings["tool"]["mypy"]["packages"]
    (folder / "mypy.toml").write_bytes(tomli_w.dumps(settings).encode())
    (folder / "user.py").write_text(USER)
    done = subprocess.run(
        [
            Path(sys.executable).parent / "mypy",
            "--config-file",
            folder / "mypy.toml",
            "emps_design",
            folder / "user.py",
        ],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if ": error: " in line]


@pytest.mark.slow
def test_every_module_on_the_list_has_findings(checked):
    _, listed = without_exceptions()
    files = {line.partition(":")[0] for line in checked if not line.partition(":")[0].endswith("user.py")}
    found = {file.removesuffix(".py").replace("/", ".").removesuffix(".__init__") for file in files}
    assert listed - found == set(), "these have no finding any more: take them off the list in pyproject.toml"
    assert found - listed == set(), checked


def test_the_list_names_modules_one_by_one():
    _, listed = without_exceptions()
    assert [name for name in listed if not REPOSITORY.joinpath(*name.split(".")).with_suffix(".py").is_file()] == []


@pytest.mark.slow
def test_a_type_checker_sees_what_the_package_offers(checked):
    lines = [int(line.split(":")[1]) for line in checked if line.partition(":")[0].endswith("user.py")]
    assert lines == [5, 6, 7], checked
