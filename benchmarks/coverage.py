"""How often 95 % intervals hold the truth: writes benchmarks/coverage.json, with ``python -m benchmarks.coverage``."""

from __future__ import annotations

import json
from pathlib import Path

from emps_design.cli.output import progress_bar
from emps_design.files import write_text
from emps_design.identification.coverage import coverage
from emps_design.machines import machine

NOISE_TIMES = (0.03, 0.1, 0.3)  # s
RUNS = 200


def main() -> None:
    """Count, and write the file."""
    rows = []
    for noise_time in NOISE_TIMES:
        with progress_bar() as progress:
            rows += coverage(machine("emps2019"), RUNS, noise_time, progress).to_dict()["rows"]
    write_text(Path(__file__).with_name("coverage.json"), json.dumps({"runs": RUNS, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
