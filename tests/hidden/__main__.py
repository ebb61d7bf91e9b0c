"""``python -m tests.hidden``: make cases, diagnose them, write the confusion table to docs/hidden_effects*.md."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from datetime import date
from pathlib import Path

from tests.hidden import generate
from tests.hidden.score import TIMEOUT, rows, score_all, summary, table

# Sets and seeds whose results were known when a rule was chosen.
STEERED = {("all", 0), ("quick", 0), ("several", 100), ("beside", 100), ("unknown", 100)}
STEERED |= {("several", 9101), ("beside", 9001), ("beside", 9201), ("beside", 9002)}
STEERED |= {("several", 9302), ("beside", 9302), ("unknown", 9302), ("several", 9402)}
STEERED |= {("beside", 9602), ("beside", 9702), ("several", 10002), ("beside", 10002)}
STEERED |= {("several", 10003), ("several", 10004), ("several", 10005), ("beside", 10006), ("beside", 10007)}
STEERED |= {("all", 10008), ("all", 10009), ("beside", 10010), ("beside", 10011)}
STEERED |= {("beside", 10012), ("unknown", 10013), ("beside", 10015)}
STEERED |= {("beside", 10016), ("beside", 10017), ("beside", 10018), ("beside", 10019), ("several", 10015)}
STEERED |= {("beside", 10021), ("several", 10022), ("several", 10024), ("beside", 10025)}
STEERED |= {("beside", 10027), ("several", 10027)}
REPOSITORY = Path(__file__).resolve().parents[2]
PAGES, TABLES = REPOSITORY / "docs", REPOSITORY / "benchmarks"


def main(arguments: list[str] | None = None) -> int:
    """Score a set of cases; the counts go to standard output as JSON."""
    parser = argparse.ArgumentParser(prog="python -m tests.hidden", description=__doc__)
    parser.add_argument("--cases", choices=generate.SETS, default="all")
    parser.add_argument(
        "--count", type=int, default=8, help="number of cases of the other sets, and of healthy drives in `all`"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--no-laps", action="store_true", help="training programs in which nothing repeats")
    parser.add_argument("--folder", type=Path, help="keep the cases here, and use those that are there")
    parser.add_argument("--page", type=Path, help="default: docs/hidden_effects.md, with _no_laps where they are none")
    parser.add_argument("--table", type=Path, help="default: benchmarks/hidden.json, with _no_laps where they are none")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--timeout", type=float, default=TIMEOUT, help="seconds after which a case counts as wrong")
    options = parser.parse_args(arguments)
    kind = f"_{options.cases}" * (options.cases not in ("quick", "all")) + "_no_laps" * options.no_laps
    page = options.page or PAGES / f"hidden_effects{kind}.md"
    numbers = options.table or TABLES / f"hidden{kind}.json"
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        if not any(folder.glob("*/truth.json")):
            words = [str(folder), "--seed", str(options.seed), "--cases", options.cases, "--only", options.only]
            generate.main([*words, "--count", str(options.count), *["--no-laps"] * options.no_laps])
        scores = []
        for case in score_all(folder, options.only, options.jobs, options.timeout):
            scores.append(case)
            answer = " + ".join(case.named) or case.verdict
            line = f"{case.case:55s} {case.result:9s} {answer:50s} {case.closed:5.2f} {case.seconds:4.0f} s {case.note}"
            print(line, file=sys.stderr, flush=True)
    if not scores:
        print(f"no case whose name contains {options.only!r}", file=sys.stderr)
        return 2
    count = {key: None if value != value else value for key, value in summary(scores).items()}
    steered = (options.cases, options.seed) in STEERED
    text = table(scores, options.seed, options.cases, not options.no_laps, steered)
    page.write_text(text, encoding="utf-8")
    document = {
        "seed": options.seed,
        "date": f"{date.today()}",
        "steered": steered,
        "summary": count,
        "rows": rows(scores),
    }
    numbers.write_text(json.dumps(document, indent=1), encoding="utf-8")
    print(json.dumps(count))
    return 0


if __name__ == "__main__":
    sys.exit(main())
