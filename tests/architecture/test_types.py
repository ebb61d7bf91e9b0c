"""What a type checker sees of the package in a user's script."""

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
USER = (
    "import emps_design\n"
    "from emps_design.simulation import Plant\n"
    "found = emps_design.design_velocity_loop(emps_design.machine('emps2018'), crossover=100.0)\n"
    "good: float = found.k_v1\n"
    "wrong: str = found.k_v1\n"
    "emps_design.design_velocity_lop\n"
    "Plant.off\n"
)


@pytest.mark.slow
def test_a_type_checker_sees_what_the_package_offers(tmp_path):
    user = tmp_path / "user.py"
    user.write_text(USER)
    # With the settings of `make lint`, and in its folder: what that has checked is in its cache.
    done = subprocess.run(
        [Path(sys.executable).parent / "mypy", "emps_design", user],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        timeout=280,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    places = [line.partition(": error: ")[0] for line in done.stdout.splitlines() if ": error: " in line]
    # By their names: the cache has the folder in which the script was first checked.
    assert [Path(place).name for place in places] == ["user.py:5", "user.py:6", "user.py:7"], done.stdout
