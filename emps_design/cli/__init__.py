"""The command line: arguments, exit status and progress, without any computation."""

from __future__ import annotations

import gc
import os
import sys
import warnings
from io import TextIOWrapper

from emps_design import interrupts
from emps_design.cli.app import run
from emps_design.cli.output import Terminal


def main() -> None:
    """Entry point of ``emps-design``."""
    _open_closed_streams()
    if sys.stdout is None:
        Terminal().tell("standard output is closed, expected an open one; redirect it, such as with > /dev/null")
        sys.exit(1)
    if "--debug" not in sys.argv and not sys.warnoptions:
        warnings.simplefilter("ignore")  # Python's warnings of libraries; the messages of a result are printed anyway
    gc.set_threshold(20_000, 20, 20)  # garbage collection took a tenth of the start-up, which frees little
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads do not speed up the tall, thin matrices here
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # the search of all installed packages is slow
    interrupts.install_handlers()
    status = run(sys.argv[1:])
    if status == interrupts.STATUS:
        interrupts.end()
    gc.freeze()  # skips the final collection, which took half a second
    sys.exit(status)


def _open_closed_streams() -> None:
    """Open the null device for every closed standard stream; otherwise the next file would get its descriptor."""
    while (free := os.open(os.devnull, os.O_RDWR)) <= 2:
        continue
    os.close(free)
    sys.stdin, sys.stderr = sys.stdin or open(0), sys.stderr or open(2, "w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # escape characters of file names that the terminal cannot show
            stream.reconfigure(errors="backslashreplace")
