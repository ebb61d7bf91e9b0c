"""What the tests cost: processor time of each and of each room, compilation apart; printed after a run.

After ``make studies`` it is a table of the studies: what each costs and the figures it gave to ``record_property``.
``EMPS_DESIGN_STUDY_SECONDS`` bounds the time in which studies start; one that comes later is skipped and named.

A test that costs more than ``LIMIT`` carries ``@pytest.mark.slow("why")``. What it costs is the processor time of its
worker and of the processes it started, without the time in which kernels were compiled, which falls on whichever test
needs one first. Fixtures count where they are set up. ``EMPS_DESIGN_TEST_COSTS=FILE.csv`` keeps the figures of every
test.
"""

from __future__ import annotations

import csv
import os
import threading
import time
from collections import defaultdict
from pathlib import Path, PurePosixPath

import pytest
from numba.core import event

LIMIT = 5.0  # s of processor time
SHOWN = 10
START = pytest.StashKey[tuple[float, float]]()


class Compiling(event.Listener):
    """Processor time of the thread that holds the compiler, from taking it to giving it back."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._own = threading.local()

    def on_start(self, event: event.Event) -> None:
        self._own.depth = getattr(self._own, "depth", 0) + 1
        if self._own.depth == 1:
            self._own.start = time.thread_time()

    def on_end(self, event: event.Event) -> None:
        self._own.depth -= 1
        if not self._own.depth:
            self.seconds += time.thread_time() - self._own.start


COMPILING = Compiling()
event.register("numba:compiler_lock", COMPILING)


def room(nodeid: str) -> str:
    """The folder of a test, the module's where it lies beside the rooms."""
    path = PurePosixPath(nodeid.partition("::")[0])
    return str(path.parent if len(path.parts) > 2 else path)


class Costs:
    """Pytest's hooks; one instance in each worker measures, that of the main process gathers and prints."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, bool, float, float]] = []  # test, slow or not, processor time, compilation [s]
        self.studies: list[tuple[str, str, float, str]] = []  # test, outcome, processor time [s], figures
        self.outcomes: dict[str, str] = {}  # of the studies that are under way
        self.began = time.monotonic()

    def pytest_runtest_setup(self, item):
        most = float(os.environ.get("EMPS_DESIGN_STUDY_SECONDS", "inf"))
        if item.get_closest_marker("study") and time.monotonic() - self.began > most:
            pytest.skip(f"not run: {most:g} s were over")

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item):
        item.stash[START] = (sum(os.times()[:4]), COMPILING.seconds)
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item, call):
        report = yield
        if call.when == "teardown":
            start, compiled = item.stash[START]
            compilation = COMPILING.seconds - compiled
            slow = any(item.get_closest_marker(name) for name in ("slow", "study"))
            report.user_properties.append(("cost", (slow, sum(os.times()[:4]) - start - compilation, compilation)))
        return report

    def pytest_runtest_logreport(self, report):
        if report.when == "call" or report.outcome != "passed":
            self.outcomes[report.nodeid] = report.outcome
        if report.when != "teardown":
            return
        properties = dict(report.user_properties)
        slow, processor, compilation = properties.pop("cost")
        self.rows.append((report.nodeid, slow, processor, compilation))
        figures = ", ".join(f"{name} {value}" for name, value in properties.items())
        outcome = self.outcomes.pop(report.nodeid, report.outcome)
        if "study" in report.keywords:
            self.studies.append((report.nodeid, outcome, processor, figures))

    def pytest_terminal_summary(self, terminalreporter, config):
        write = terminalreporter.write_line
        if self.studies:
            terminalreporter.section("studies")
            for nodeid, outcome, processor, figures in sorted(self.studies):
                write(f"{outcome:<8}{processor:7.1f} s  {nodeid}{': ' * bool(figures)}{figures}")
            return
        if len(self.rows) < 2 * SHOWN:
            return
        rooms: dict[str, list[float]] = defaultdict(lambda: [0, 0.0, 0.0])
        for nodeid, _, processor, compilation in self.rows:
            sums = rooms[room(nodeid)]
            sums[0] += 1
            sums[1] += processor
            sums[2] += compilation
        terminalreporter.section("processor time by room, compilation apart")
        write(f"{'room':<42}{'tests':>6}{'s':>9}{'compiling s':>13}")
        for name, (count, processor, compilation) in sorted(rooms.items(), key=lambda entry: -entry[1][1]):
            write(f"{name:<42}{count:6d}{processor:9.1f}{compilation:13.1f}")
        total = [sum(sums[k] for sums in rooms.values()) for k in range(3)]
        write(f"{'all':<42}{total[0]:6d}{total[1]:9.1f}{total[2]:13.1f}")
        slowest = sorted(self.rows, key=lambda row: -row[2])
        terminalreporter.section(f"the {SHOWN} slowest")
        for nodeid, slow, processor, _ in slowest[:SHOWN]:
            write(f"{processor:7.1f} s{' slow' if slow else '':<6}{nodeid}")
        beyond = [row for row in slowest if row[2] > LIMIT and not row[1]]
        if beyond:
            terminalreporter.section(f"more than {LIMIT:g} s without the mark slow, see CONTRIBUTING.md")
            for nodeid, _, processor, _ in beyond:
                write(f"{processor:7.1f} s      {nodeid}")
        if kept := os.environ.get("EMPS_DESIGN_TEST_COSTS"):
            with Path(kept).open("w", newline="") as file:
                csv.writer(file).writerows([("test", "slow", "processor_s", "compiling_s"), *self.rows])


def pytest_configure(config):
    config.pluginmanager.register(Costs(), "costs")
