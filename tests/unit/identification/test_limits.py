"""What identify may take: time and memory of whole processes."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from emps_design.machines import machine
from emps_design.simulation import Plant
from emps_design.simulation.synthetic_record import practice_record, trapezoid_laps

HOUR = 3_600_000  # samples at 1 kHz

# Processor time counts little of what else the machine does; the peak is the process's own, not that of its parent.
PROGRAM = """
import os, sys
from pathlib import Path
from emps_design.cli.app import run
status = run(["identify", *sys.argv[1:], "--json"])
peak = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
print(os.times().user + os.times().system, int(peak.split()[1]) / 1024, file=sys.stderr)
sys.exit(status)
"""
pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc to see the peak of memory")


def spent(*paths: Path) -> tuple[float, float]:
    """Processor time [s] and peak memory [MB] of identify on ``paths``."""
    done = subprocess.run([sys.executable, "-c", PROGRAM, *map(str, paths)], check=True, capture_output=True, text=True)
    seconds, megabytes = done.stderr.splitlines()[-1].split()
    return float(seconds), float(megabytes)


def test_one_record_in_two_seconds_and_ten_in_six(tmp_path):
    paths = [tmp_path / f"day{seed}.npz" for seed in range(10)]
    for seed, path in enumerate(paths):
        practice_record(machine("emps2019"), seed=seed).save(path)
    assert min(spent(paths[0])[0] for _ in range(2)) < 2.0
    assert min(spent(*paths)[0] for _ in range(2)) < 6.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["npz", "mat", "csv"])
def test_an_hour_in_500_megabytes(tmp_path, kind):
    laps = trapezoid_laps(1e-3, laps=4)
    q_ref = np.tile(laps, HOUR // len(laps) + 1)[:HOUR]
    noise = 4e-3 * np.random.default_rng(0).standard_normal(HOUR)
    run = Plant.of(machine("emps2019")).closed_loop(q_ref, voltage_noise=noise)
    columns = {"t": run.t, "q_ref": q_ref, "q": run.q, "u": run.u}
    path = tmp_path / f"hour.{kind}"
    if kind == "npz":
        np.savez(path, **columns)
    elif kind == "mat":
        savemat(path, columns)
    else:
        with path.open("w") as file:
            file.write("t,q_ref,q,u\n")
            rows = zip(*(column.tolist() for column in columns.values()), strict=True)
            file.writelines(f"{t:.3f},{r:.9f},{q:.8f},{u:.6f}\n" for t, r, q, u in rows)
    assert spent(path)[1] < 500.0
