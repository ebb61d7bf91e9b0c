"""Killed at any moment, a command leaves whole files or none; the next run cleans up after it."""

import subprocess
import sys

import pytest

from tests.kills import COMMANDS, SIGNALS, Kills

QUICK = ("gains", "import")  # the others kill whole programs of seconds


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.study("kills")) for name in COMMANDS]
)
def test_killed_at_any_moment(name, tmp_path):
    killed = Kills(name, tmp_path)
    killed.run(len(SIGNALS))
    assert killed.statuses.total() == len(SIGNALS)


def test_an_error_that_an_interrupt_ends_in_is_that_interrupt(monkeypatch, capsys):
    """Compiled code that is interrupted raises an error of its own: matplotlib's path transforms a TypeError."""
    from emps_design import interrupts
    from emps_design.cli import app

    def interrupted(arguments):
        interrupts.interrupted.set()
        raise TypeError("incompatible function arguments")

    monkeypatch.setattr(interrupts, "interrupted", type(interrupts.interrupted)())
    monkeypatch.setattr(app, "_application", lambda arguments, terminal: lambda **given: interrupted(given))
    assert app.run(["gains"]) == 130
    assert capsys.readouterr().err.strip() == "emps-design: interrupted"


DEAF = """
import os, signal, time
from ctypes import CFUNCTYPE
from emps_design import interrupts
from emps_design.cli import app
interrupts.GRACE = 0.1
interrupts.install_handlers()
CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGTERM))()
time.sleep(60)
"""


def test_an_interrupt_in_a_callback_of_compiled_code_is_heard_and_shows_no_traceback():
    """An exception ends at such a callback (as at those of numba's cache): the waiting thread ends the process."""
    done = subprocess.run([sys.executable, "-c", DEAF], capture_output=True, text=True, timeout=50)
    assert (done.returncode, done.stderr) == (130, "emps-design: interrupted\n")


INTO_AN_IMPORT = """
import signal, sys
import numpy
from emps_design import interrupts
interrupts.install_handlers()

class Kills:
    def find_spec(self, name, path=None, target=None):
        if name.endswith("_multiarray_umath"):
            signal.raise_signal(signal.SIGTERM)

sys.meta_path.insert(0, Kills())
for name in [name for name in sys.modules if name.endswith("_multiarray_umath")]:
    del sys.modules[name]
try:
    import numpy.fft
except ImportError as error:
    print(error)
"""


def test_an_interrupt_in_an_import_that_compiled_code_makes_shows_no_traceback():
    """Modules that use numpy from C print what its import raised, and raise an error of their own."""
    done = subprocess.run([sys.executable, "-c", INTO_AN_IMPORT], capture_output=True, text=True, timeout=50)
    assert "failed to import" in done.stdout
    assert (done.returncode, done.stderr) == (0, "")
