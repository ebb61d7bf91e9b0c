"""What ``make fuzz`` tried, kind by kind, as docs/measured.md shows it; written where EMPS_DESIGN_FUZZ is set."""

import json
import os
from datetime import UTC, datetime
from pathlib import Path

from tests.property.fuzzing import EXAMPLES

PAGE = Path(__file__).parents[2] / "benchmarks" / "fuzz.json"
_rows: list[dict] = []


def pytest_runtest_logreport(report):
    """Keep what became of one kind of input."""
    if report.when == "call" and "tests/property/" in report.nodeid and "hypothesis" in report.keywords:
        kind = report.nodeid.rpartition("::")[2].removeprefix("test_").replace("_", " ")
        file = Path(report.nodeid.partition("::")[0]).stem.removeprefix("test_fuzz_")
        inputs = EXAMPLES if report.outcome == "passed" else 0
        _rows.append({"of": file, "kind": kind, "inputs": inputs, "outcome": report.outcome})


def pytest_sessionfinish():
    """Write the table."""
    if _rows and os.environ.get("EMPS_DESIGN_FUZZ"):
        date = datetime.now(UTC).date().isoformat()
        document = {"date": date, "inputs": sum(row["inputs"] for row in _rows), "rows": _rows}
        PAGE.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
