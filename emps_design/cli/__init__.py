"""The command line: arguments, exit status, progress. It computes nothing."""

from __future__ import annotations

import gc
import os
import sys
import warnings
from io import TextIOWrapper

from emps_design.cli import interrupts
from emps_design.cli.app import run
from emps_design.cli.output import tell


def main() -> None:
    """Entry point of ``emps-design``."""
    _stand_on_three_streams()
    if sys.stdout is None:
        tell("standard output is closed, expected somewhere to print; > /dev/null prints nowhere")
        sys.exit(1)
    if "--debug" not in sys.argv and not sys.warnoptions:
        warnings.simplefilter("ignore")  # of libraries, for programmers; our own are printed as such
    gc.set_threshold(20_000, 20, 20)  # imports make many objects and let few go: looking for those took a tenth
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices here are tall and thin: threads would only spin
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # looked for in every package there is, at each start
    interrupts.listen()
    status = run(sys.argv[1:])
    if status == interrupts.STATUS:
        interrupts.end()
    gc.freeze()  # the process ends: looking once more for what nobody holds took half a second
    sys.exit(status)


def _stand_on_three_streams() -> None:
    """Put the null device where a standard stream is closed, or the next file opened would get its place."""
    while (free := os.open(os.devnull, os.O_RDWR)) <= 2:
        continue
    os.close(free)
    sys.stdin, sys.stderr = sys.stdin or open(0), sys.stderr or open(2, "w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # the name of a file need not be text: show what cannot be encoded
            stream.reconfigure(errors="backslashreplace")
