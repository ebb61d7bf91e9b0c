"""``python -m tests.hidden.trial CASE``: the answer of :mod:`emps_design.discrepancy.evidence` to one case, as JSON.

It has what the scorer reads of ``diagnose --json``: the verdict, the findings and their equivalents.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from threadpoolctl import threadpool_limits

from emps_design.axis import Axis
from emps_design.discrepancy.evidence import answered
from emps_design.discrepancy.preparation import prepare
from emps_design.effects import known_effects
from emps_design.importing import import_record


def answer(case: Path) -> dict:
    """Verdict and findings on the records of ``case``; what the controller's law shows is a finding as well."""
    axis = Axis.load(case / "axis.toml")
    train, holdout = (import_record(next(case.glob(f"{part}.[cn][sp][vz]")), axis) for part in ("train", "holdout"))
    library = tuple(known_effects().values())
    preparation = prepare((train,), axis, library, holdout, None, None)
    with threadpool_limits(1):
        found = answered(preparation, say=lambda text: print(text, file=sys.stderr, flush=True))
    added = [law.added for law in preparation.laws if law.added]
    verdict = "named" if added and found.verdict == "nothing-missing" else found.verdict
    findings = [{"effect": name, "equivalents": found.equivalents[name]} for name in found.names]
    return {"verdict": verdict, "findings": findings + [{"effect": name, "equivalents": []} for name in added]}


if __name__ == "__main__":
    print(json.dumps(answer(Path(sys.argv[1]))))
