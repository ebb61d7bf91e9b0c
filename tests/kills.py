"""Kill real processes at random moments: all commands that write, as often as asked, and what is left is looked at.

``python -m tests.kills 200`` (``make fuzz``) writes ``benchmarks/kills.json``, which docs/measured.md shows. After each
kill every file is whole, the one of before or the new one; the next run finds nothing in its way and leaves nothing but
its results; a process that can hear the signal ends within two seconds, with 130.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import emps_design
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
COMMANDS = {
    "gains": "gains {axis} --crossover 100 --phase-margin 60 --out {out}/model.toml",
    "force": "force {axis} --k-e1 0.001 --environment 1000 --out {out}/force.toml",
    "simulate": "simulate {axis} --scenario replay --record {record} --out {out}/run.npz",
    "simulate --plot": "simulate {axis} --scenario replay --record {record} --plot {out}/run.svg",
    "identify": "identify {record} --axis {axis} --out {out}/found.toml",
    "observe": "observe {record} --axis {axis} --out {out}/force.csv",
    "report": "report {axis} --record {record} --crossover 100 --out {out}/report.html",
    "demo": "demo --out {out}/demo.html",
    "init": "init {out}/start --force",
    "import": "import {record} --axis {axis} --out {out}/imported.npz",
    "law": "law {record} --out {out}/controller.toml",
    "excite": "excite {axis} --stroke 0.5 --speed 0.05 --to 100Hz --out {out}/program.csv",
    "frf": "frf {record} --axis {axis} --out {out}/response.csv",
    "compensate": "compensate {axis} --stroke 0.1 --out {out}/compensated",
    "export": "export {axis} --to c --out {out}/code",
    "diagnose": "diagnose {record} --axis {axis} --out {out}/found",
}


def _ends_in(end):
    def check(path):
        assert path.read_text(encoding="utf-8").rstrip().endswith(end), path

    return check


def _archive(path):
    with np.load(path, allow_pickle=False) as archive:
        assert all(np.asarray(archive[name]).size for name in archive.files), path


def _table(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[-1].count(",") == lines[0].count(","), path


CHECKS = {
    ".toml": lambda path: tomllib.loads(path.read_text(encoding="utf-8")),
    ".json": lambda path: json.loads(path.read_text(encoding="utf-8")),
    ".npz": _archive,
    ".html": _ends_in("</html>"),
    ".svg": _ends_in("</svg>"),
    ".csv": _table,
    ".md": lambda path: path.read_text(encoding="utf-8"),
}


def kernels() -> set[Path]:
    """The files of machine code that numba keeps."""
    return set(Path(os.environ.get("NUMBA_CACHE_DIR") or emps_design.__path__[0]).rglob("*.nbc"))


@dataclass
class Kills:
    """One command that is killed again and again in a folder of its own."""

    name: str
    folder: Path
    statuses: Counter = field(default_factory=Counter)
    slowest: float = 0.0  # s, from a signal that can be heard to the end
    unfinished: int = 0  # kills that came before the end

    def __post_init__(self):
        for number in SIGNALS:  # a job in the background of a shell ignores SIGINT, and so would what it starts
            if signal.getsignal(number) is signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
        axis = machine("emps2019")
        synthetic_record(axis, laps=1, stroke=0.03, speed=0.15).save(self.folder / "record.npz")
        (self.folder / "axis.toml").write_text(axis.to_toml())
        self.out = self.folder / "out"
        self.out.mkdir()
        names = {"record": self.folder / "record.npz", "axis": self.folder / "axis.toml", "out": self.out}
        self.command = [sys.executable, "-m", "emps_design.cli", *COMMANDS[self.name].format(**names).split()]
        compiled = kernels()
        self.lasts = self.finish()
        if kernels() != compiled:  # which no later run does
            self.lasts = self.finish()
        self.expected = self.files()
        assert self.expected
        self.content = {self.out / path: (self.out / path).read_bytes() for path in self.expected}

    def finish(self) -> float:
        """Run to the end; how long it took [s]."""
        start = time.perf_counter()
        subprocess.run(self.command, check=True, capture_output=True, timeout=600)
        return time.perf_counter() - start

    def files(self) -> list[Path]:
        """Every file of the results but the partial ones of an interrupted diagnosis."""
        found = (path.relative_to(self.out) for path in self.out.rglob("*") if path.is_file() or path.is_symlink())
        return sorted(path for path in found if ".partial" not in str(path))

    def kill(self, number: signal.Signals, moment: float) -> None:
        """Kill one run after ``moment`` [s] and look at what is there."""
        before = set(self.out.rglob("*.part"))  # of a SIGKILL: the next run that writes takes it away
        with subprocess.Popen(self.command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
            try:
                process.wait(moment)
            except subprocess.TimeoutExpired:
                self.unfinished += 1
            sent = time.perf_counter()
            process.send_signal(number)
            _, said = process.communicate(timeout=60)
        took = time.perf_counter() - sent
        self.statuses[process.returncode] += 1
        # In its first moments the interpreter does not listen yet, and is ended by the signal itself.
        early = process.returncode == -number or (number == signal.SIGINT and moment < 0.3 * self.lasts)
        assert early or "Traceback" not in said, said
        assert early or process.returncode in (0, 130), (self.name, number, process.returncode, said)
        if number != signal.SIGKILL:
            self.slowest = max(self.slowest, took)
            assert set(self.out.rglob("*.part")) <= before
        for path in self.out.rglob("*"):
            if path in self.content:
                assert path.read_bytes() == self.content[path], path
            elif path.is_file() and ".part" not in str(path.relative_to(self.out)).replace(".partial", ""):
                CHECKS[path.suffix](path)
        whole = [path for path in self.files() if ".part" not in str(path)]
        assert whole == self.expected  # the results of the run before are all there

    def run(self, times: int) -> None:
        """Kill it ``times`` times, then let it finish: what the kills left is gone, and was in nobody's way."""
        moments = random.Random(self.name)
        for k in range(times):
            # The first tenth is the interpreter's own, which hears no signal yet: of a quick command it is more.
            first = min(0.4, 0.5 * self.lasts)
            self.kill(SIGNALS[k % len(SIGNALS)], max(first, self.lasts * moments.uniform(0.1, 1.0)))
        self.finish()
        assert self.files() == self.expected


def main(kills: int) -> None:
    """Spread ``kills`` over the commands and write what was counted, after each of them."""
    from emps_design.files import write_text

    rows: list[dict] = []
    for place, name in enumerate(COMMANDS):
        times = kills // len(COMMANDS) + (place < kills % len(COMMANDS))
        with tempfile.TemporaryDirectory() as folder:
            killed = Kills(name, Path(folder))
            killed.run(times)
        rows.append(
            {
                "command": name,
                "kills": times,
                "before_the_end": killed.unfinished,
                "interrupted": killed.statuses[130],
                "seconds_to_end": round(killed.slowest, 2),
                "damaged": 0,  # an assertion ends this program otherwise
            }
        )
        print(*rows[-1].values(), flush=True)
        date = datetime.now(UTC).date().isoformat()
        document = {"date": date, "kills": sum(row["kills"] for row in rows), "rows": rows}
        write_text(Path(__file__).parents[1] / "benchmarks" / "kills.json", json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
