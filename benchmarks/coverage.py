"""How often 95 % intervals hold the truth: writes benchmarks/coverage.json, with ``python -m benchmarks.coverage``."""

from __future__ import annotations

import json
from pathlib import Path

from emps_design.cli.output import progress_bar
from emps_design.files import write_text
from emps_design.identification.coverage import coverage
from emps_design.machines import machine

WORK = (("ls", 0.03), ("ls", 0.1), ("ls", 0.3), ("iv", 0.1), ("oe", 0.1))  # estimator, correlation of the noise [s]
RUNS = 200


def main() -> None:
    """Count, and write the file."""
    rows = []
    for estimator, noise_time in WORK:
        with progress_bar() as progress:
            rows += coverage(machine("emps2019"), RUNS, noise_time, estimator, progress).to_dict()["rows"]
    write_text(Path(__file__).with_name("coverage.json"), json.dumps({"runs": RUNS, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
