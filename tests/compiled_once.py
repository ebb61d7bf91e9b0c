"""Workers on one machine compile a stepper once: the second that wants it waits, and finds it on disk.

The steppers take half a minute to compile: after a change of one, every worker and every process that a test starts
would do so at the same time.
"""

import fcntl
from functools import wraps
from pathlib import Path

import numpy as np
from numba.core.dispatcher import Dispatcher

from emps_design.machines import machine
from emps_design.simulation import Plant


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


def compile_steppers() -> None:
    """Have ready what most tests use, before one of them starts a process that would compile it."""
    plant = Plant.of(machine("emps2019"))
    for method in ("general", "plain"):
        plant.closed_loop(np.zeros(4), method=method)
