"""The command line: arguments, exit status, progress. It computes nothing."""

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
        Terminal().tell("standard output is closed, expected somewhere to print; > /dev/null prints nowhere")
        sys.exit(1)
    if "--debug" not in sys.argv and not sys.warnoptions:
        warnings.simplefilter("ignore")  # of libraries, for programmers; our own are printed as such
    gc.set_threshold(20_000, 20, 20)  # imports create many objects and free few: collection took a tenth of the start
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices here are tall and thin: threads would only spin
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # or each start searches every installed package
    interrupts.install_handlers()
    status = run(sys.argv[1:])
    if status == interrupts.STATUS:
        interrupts.end()
    gc.freeze()  # the process ends: a last collection took half a second
    sys.exit(status)


def _open_closed_streams() -> None:
    """Open the null device for every closed standard stream; otherwise the next file would get its descriptor."""
    while (free := os.open(os.devnull, os.O_RDWR)) <= 2:
        continue
    os.close(free)
    sys.stdin, sys.stderr = sys.stdin or open(0), sys.stderr or open(2, "w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # file names may hold what the terminal cannot show: escape it
            stream.reconfigure(errors="backslashreplace")
