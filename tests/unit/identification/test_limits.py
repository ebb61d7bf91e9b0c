"""What identify may take of memory; its times are rows of the benchmarks."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from emps_design.machines import machine
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import trapezoid_laps

HOUR = 3_600_000  # samples at 1 kHz

# The peak is the process's own, not that of its parent.
PROGRAM = """
import sys
from pathlib import Path
from emps_design.cli.app import run
status = run(["identify", *sys.argv[1:], "--json"])
peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
print(int(peak.split()[1]) / 1024, file=sys.stderr)
sys.exit(status)
"""
pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc to see the peak of memory")


def peak_memory(path: Path) -> float:
    """Peak memory of identify on ``path`` [MB]."""
    done = subprocess.run([sys.executable, "-c", PROGRAM, str(path)], check=True, capture_output=True, text=True)
    return float(done.stderr.splitlines()[-1])


@pytest.fixture(scope="module")
def columns():
    """An hour of the embedded machine."""
    laps = trapezoid_laps(1e-3, laps=4)
    q_ref = np.tile(laps, HOUR // len(laps) + 1)[:HOUR]
    noise = 4e-3 * np.random.default_rng(0).standard_normal(HOUR)
    run = Plant.of(machine("emps2019")).closed_loop(q_ref, voltage_noise=noise)
    return {"t": run.t, "q_ref": q_ref, "q": run.q, "u": run.u}


@pytest.mark.study("an hour of samples")
@pytest.mark.parametrize("kind", ["npz", "mat", "csv"])
def test_an_hour_in_500_megabytes(tmp_path, columns, kind):
    path = tmp_path / f"hour.{kind}"
    if kind == "npz":
        np.savez(path, **columns)
    elif kind == "mat":
        savemat(path, columns)
    else:
        with path.open("w") as file:
            file.write("t,q_ref,q,u\n")
            for second in np.column_stack(list(columns.values())).reshape(-1, 1000, 4):
                file.write("%.3f,%.9f,%.8f,%.6f\n" * 1000 % tuple(second.ravel().tolist()))
    assert peak_memory(path) < 500.0
