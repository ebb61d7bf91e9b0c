"""Sweep the assumptions behind Table II of the paper: ``make paper`` or ``python -m benchmarks.paper``.

Writes benchmarks/table_2.json: the date, a row for each assumption, and what the paper printed as the first row.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.table_2 import sweep
from emps_design.cli.output import Terminal
from emps_design.files import write_text
from emps_design.paper.virtual_bench import PRINTED

EXPERIMENTS = 10


def main() -> None:
    """Sweep, print, and write the file."""
    with Terminal().progress() as progress:
        outcomes = sweep(experiments=EXPERIMENTS, progress=progress)
    table = PRINTED["table_2"]
    printed = {
        "assumption": "printed",
        **{name: row[0] for name, row in table.items()},
        **{f"two_sigma_{name}": row[1] for name, row in table.items()},
    }
    rows = [printed, *(one.to_row() for one in outcomes)]
    document = {"measured": datetime.now(UTC).date().isoformat(), "experiments": EXPERIMENTS, "rows": rows}
    write_text(Path(__file__).with_name("table_2.json"), json.dumps(document, indent=1) + "\n")
    for row in rows:
        values = " ".join(f"{row[name]:8.1f}" for name in table)
        deviations = " ".join(f"{row[f'two_sigma_{name}']:6.2f}" for name in table)
        print(f"{row['assumption'][:52]:52} {values}  2s {deviations}  rms {row.get('rms', '')}")


if __name__ == "__main__":
    main()
