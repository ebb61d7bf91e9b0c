"""The command line: arguments, exit status, progress. It computes nothing."""

from __future__ import annotations

import signal
import sys

from emps_design.cli.app import run


def main() -> None:
    """Entry point of ``emps-design``."""
    # A polite kill unwinds like Ctrl-C, so that files written aside are removed.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(run(sys.argv[1:]))
