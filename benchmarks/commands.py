"""Processor time of whole commands, from the start of Python to its end: the fastest of a few runs."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.rows import add, children
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record

GAINS = ("gains", "--crossover", "100", "--phase-margin", "60", "--json")


def commands(rows: list[dict]) -> None:
    """Measure the import of the command line, ``gains``, and ``identify`` on one record and on ten."""
    add(rows, "import of the command line, processor time", _fastest("-c", "import emps_design.cli"), "s", 0.2)
    add(rows, "gains, whole command, processor time", _command(*GAINS), "s", 0.4)
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder) / f"day{seed}.npz") for seed in range(10)]
        for seed, path in enumerate(paths):
            synthetic_record(machine("emps2019"), seed=seed).save(path)
        add(rows, "identify, one record of 55 s, processor time", _command("identify", paths[0], "--json"), "s", 2.0)
        add(rows, "identify, ten of them, processor time", _command("identify", *paths, "--json"), "s", 6.0)


def _command(*words: str) -> float:
    return _fastest("-m", "emps_design.cli", *words)


def _fastest(*words: str) -> float:
    times = []
    for _ in range(4):
        before = children()
        subprocess.run([sys.executable, *words], check=True, capture_output=True)
        times.append(children() - before)
    return min(times)
