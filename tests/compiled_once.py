"""Workers on one machine compile a stepper once: the second that wants it waits, and finds it on disk.

The steppers take half a minute to compile: after a change of one, every worker and every process that a test starts
would do so at the same time. They are compiled in a process of their own, for a compiler keeps its memory:
``python -m tests.compiled_once WORKER FOLDER``.
"""

import fcntl
import io
import subprocess
import sys
from contextlib import redirect_stdout
from functools import wraps
from pathlib import Path

import numpy as np
from numba.core.dispatcher import Dispatcher

from emps_design.cli.app import run
from emps_design.machines import machine
from emps_design.simulation import Plant
from tests.costs import COMPILING


def wait_for_each_other(folder: Path) -> None:
    """Let one process at a time compile a function that is kept on disk; ``folder`` holds a lock for each."""
    compile_alone = Dispatcher.compile

    @wraps(compile_alone)
    def compile_once(self, signature):
        if not hasattr(self._cache, "_cache_file"):  # compiled into another function, and kept with that
            return compile_alone(self, signature)
        with (folder / f"{self.py_func.__module__}.{self.py_func.__qualname__}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return compile_alone(self, signature)

    Dispatcher.compile = compile_once


def hand_on_the_carriage() -> None:
    """A co-manipulation of one plant and of several, side by side."""
    with redirect_stdout(io.StringIO()):
        run(["simulate", "--scenario", "comanipulation", "--mass", "50", "--damping", "100", "--plants", "2", "--json"])


def compile_steppers(worker: int) -> None:
    """Have ready what most tests use, before one of them starts a process that would compile it.

    Every ``worker`` begins with another stepper, so that none waits while there is something to compile.
    """
    plant = Plant.of(machine("emps2019"))
    steppers = [
        lambda: plant.closed_loop(np.zeros(4), method="general"),
        hand_on_the_carriage,
        lambda: plant.closed_loop(np.zeros(4), method="plain"),
    ]
    for place in range(len(steppers)):
        steppers[(place + worker) % len(steppers)]()


def compile_apart(worker: int, folder: Path) -> None:
    """:func:`compile_steppers` of a ``worker`` in another process, which locks files in ``folder``."""
    command = [sys.executable, "-m", "tests.compiled_once", str(worker), str(folder)]
    done = subprocess.run(command, cwd=Path(__file__).parents[1], stdout=subprocess.PIPE, text=True, check=True)
    COMPILING.seconds += float(done.stdout)


if __name__ == "__main__":
    wait_for_each_other(Path(sys.argv[2]))
    compile_steppers(int(sys.argv[1]))
    print(COMPILING.seconds)
