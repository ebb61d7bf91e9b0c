"""How often 95 % intervals hold the truth: ``make coverage`` writes benchmarks/coverage*.json, an axis at a time."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.coverage_axes import CASES, FIRST_SEED, QUIET, Case, Records
from emps_design.axis import Axis
from emps_design.cli.output import Terminal
from emps_design.errors import EmpsError
from emps_design.files import write_text
from emps_design.identification import identify
from emps_design.identification.result import Identification
from emps_design.records import Record

RUNS = int(os.environ.get("EMPS_DESIGN_COVERAGE", "1000"))
DRAWS = 100  # of the bootstrap
PARAMETERS = ("mass", "viscous", "coulomb", "constant_force")
# What is counted: the estimator, and which of its intervals.
COUNTED = (
    ("ls", "interval_95"),
    ("bootstrap", "interval_95_bootstrap"),
    ("iv", "interval_95"),
    ("oe", "interval_95"),
    ("auto", "interval_95"),
)
TABLES = {"coverage": CASES, "coverage_quiet": QUIET}


def estimates(record: Record, axis: Axis, seed: int) -> dict[str, Callable[[], Identification]]:
    """Each estimator as it is called by default; the bootstrap is that of least squares."""
    return {
        "ls": partial(identify, record, axis, estimator="ls", bootstrap=DRAWS, seed=seed),
        "iv": partial(identify, record, axis, estimator="iv"),
        "oe": partial(identify, record, axis, estimator="oe"),
        "auto": partial(identify, record, axis),
    }


def main(table: str, cases: tuple[Case, ...]) -> None:
    """Count over ``cases``, and write the file of ``table`` after every axis."""
    rows: list[dict] = []
    for case in cases:
        records = Records(case)
        truth = records.axis.mechanics.array()
        held = {name: np.zeros(len(PARAMETERS)) for name, _ in COUNTED}
        plain = {name: np.zeros(len(PARAMETERS)) for name, _ in COUNTED}
        done = dict.fromkeys(held, 0)
        with Terminal().progress() as progress:
            for run in range(RUNS):
                progress(f"{case.name}, {RUNS} records", run / RUNS)
                record, found = records(FIRST_SEED + run), {}
                for name, estimate in estimates(record, records.axis, run).items():
                    try:
                        found[name] = estimate()
                    except EmpsError as error:
                        print(f"{record.name}, {name}: {error}", flush=True)
                found["bootstrap"] = found.get("ls")
                for name, interval in COUNTED:
                    one = found.get(name)
                    if one is None or not all(p.determined for p in one.parameters.values()):
                        continue
                    ends = np.array([getattr(p, interval) for p in one.parameters.values()])
                    std = np.array([p.std for p in one.parameters.values()])
                    held[name] += (ends[:, 0] <= truth) & (truth <= ends[:, 1])
                    plain[name] += np.abs(one.values() - truth) <= 1.96 * std
                    done[name] += 1
        rows += [
            {
                "axis": case.name,
                "estimator": name,
                "parameter": parameter,
                "runs": done[name],
                "identify_percent": 100.0 * held[name][i] / max(done[name], 1),
                "equation_15_percent": 100.0 * plain[name][i] / max(done[name], 1),
            }
            for name, _ in COUNTED
            for i, parameter in enumerate(PARAMETERS)
        ]
        write(table, rows)


def write(table: str, rows: list[dict]) -> None:
    """Write what was counted so far, each estimator over all axes first, and the least of its shares."""
    pooled = []
    for name, _ in COUNTED:
        own = [row for row in rows if row["estimator"] == name]
        runs = np.array([row["runs"] for row in own])
        shares = {key: np.array([row[key] for row in own]) for key in ("identify_percent", "equation_15_percent")}
        every = {"axis": "all", "estimator": name, "parameter": "all", "runs": int(runs.sum()) // len(PARAMETERS)}
        pooled.append({**every, **{key: float(np.average(share, weights=runs)) for key, share in shares.items()}})
        least = own[int(np.argmin(shares["identify_percent"]))]
        pooled.append({**least, "axis": f"least: {least['axis']}"})
    date = datetime.now(UTC).date().isoformat()
    document = {"date": date, "runs_each": RUNS, "first_seed": FIRST_SEED, "rows": [*pooled, *rows]}
    write_text(Path(__file__).with_name(f"{table}.json"), json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    for table in sys.argv[1:] or TABLES:
        main(table, TABLES[table])
