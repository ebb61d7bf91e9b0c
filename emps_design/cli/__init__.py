"""The command line: arguments, exit status, progress. It computes nothing."""

from __future__ import annotations

import sys

from emps_design.cli.app import run


def main() -> None:
    """Entry point of ``emps-design``."""
    sys.exit(run(sys.argv[1:]))
