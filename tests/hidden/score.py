"""Run ``emps-design diagnose`` on a folder of hidden-effect cases and compare its answers with the truth."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.hidden.generate import SKIP

MOST_EQUIVALENTS = 3  # more is no name


@dataclass(frozen=True)
class Score:
    """One case: what was hidden, what was said, and how much of the gap is closed on the hold-out."""

    case: str
    truth: tuple[str, ...]
    named: tuple[str, ...]
    verdict: str
    result: str  # right, abstained, wrong, too small
    exact: bool
    false: tuple[str, ...]
    closed: float
    seconds: float
    note: str = ""


def judge(answer: dict, truth: dict) -> tuple[str, bool, tuple[str, ...]]:
    """Result, exact, and the names that are false.

    Right: every hidden effect has a finding of its own that claims it, by name or among at most three equivalents,
    and no finding claims none; nothing found on a healthy drive; ``unnamed`` and nothing found for unknown physics.

    >>> found = [{"effect": "actuator_lag", "equivalents": ["actuator_delay"]}]
    >>> judge({"verdict": "named", "findings": found}, {"effects": ["actuator_delay"]})
    ('right', False, ())
    >>> judge({"verdict": "named", "findings": found}, {"effects": ["none"]})
    ('wrong', False, ('actuator_lag',))
    """
    claims = [(f["effect"], {f["effect"], *f.get("equivalents", ())}) for f in answer["findings"]]
    claims = [(name, claim) for name, claim in claims if len(claim) <= MOST_EQUIVALENTS + 1]
    hidden = [name for name in truth["effects"] if name not in ("none", "unknown")]
    if not hidden:
        if claims:
            return "wrong", False, tuple(name for name, _ in claims)
        silent = truth["effects"] == ["none"] or answer["verdict"] == "unnamed"
        return ("right" if silent else "abstained"), silent, ()
    left, false = list(hidden), []
    for name, claim in sorted(claims, key=lambda pair: len(pair[1])):
        mine = next((effect for effect in left if effect in claim), None)
        if mine is not None:
            left.remove(mine)
        elif not claim & set(hidden):
            false.append(name)
    if false:
        return "wrong", False, tuple(false)
    if left:
        return ("abstained" if truth.get("detectable", True) else "too small"), False, ()
    return "right", sorted(name for name, _ in claims) == sorted(hidden), ()


def gap_closed(case: Path, out: Path, truth: dict) -> float:
    """Share of the squared gap between a refitted baseline and the floor that the extended model closes."""
    before, floor = truth["baseline_closed_loop"], truth["floor_closed_loop"]
    if before <= 1.05 * floor:
        return math.nan
    gain = tomllib.loads((case / "axis.toml").read_text(encoding="utf-8"))["drive"]["force_gain"]
    table = np.genfromtxt(out / "holdout_prediction.csv", delimiter=",", names=True)
    with np.load(case / "holdout.npz") as record:
        after = float(np.std((gain * record["u"] - table["force_extended"])[SKIP:]))
    return 1 - (after**2 - floor**2) / (before**2 - floor**2)


def score(case: Path, timeout: float = 600.0) -> Score:
    """Diagnose one case in a process of its own; a crash or a late answer is wrong."""
    truth = json.loads((case / "truth.json").read_text(encoding="utf-8"))
    hidden, started = tuple(truth["effects"]), time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "emps_design.cli", "diagnose", str(case / "train.npz")]
        command += [
            "--holdout",
            str(case / "holdout.npz"),
            "--axis",
            str(case / "axis.toml"),
            "--out",
            folder,
            "--json",
        ]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=True)
            seconds, answer = time.monotonic() - started, json.loads(done.stdout)
            result, exact, false = judge(answer, truth)
            closed = gap_closed(case, Path(folder), truth)
        except (subprocess.SubprocessError, ValueError, OSError) as error:
            said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()[-1:]
            return Score(case.name, hidden, (), "", "wrong", False, (), math.nan, time.monotonic() - started, *said)
    named = tuple(f["effect"] for f in answer["findings"])
    return Score(case.name, hidden, named, answer["verdict"], result, exact, false, closed, seconds)


def score_all(folder: Path, only: str = "", jobs: int = 1) -> Iterator[Score]:
    """Scores of the cases below ``folder``, as they are done, in order."""
    chosen = sorted(path.parent for path in folder.glob("*/truth.json") if only in path.parent.name)
    with ThreadPoolExecutor(jobs) as pool:
        yield from pool.map(score, chosen)


def summary(scores: list[Score]) -> dict[str, float]:
    """Counts over effects, healthy drives and unknown physics, and the median gap closed."""
    healthy = [s for s in scores if s.truth == ("none",)]
    unknown = [s for s in scores if s.truth == ("unknown",)]
    real = [s for s in scores if s.truth not in (("none",), ("unknown",))]
    closed = [s.closed for s in real if math.isfinite(s.closed)]
    return {
        "effects": len(real),
        "right": sum(s.result == "right" for s in real),
        "exact": sum(s.exact for s in real),
        "wrong": sum(s.result == "wrong" for s in real),
        "abstained": sum(s.result == "abstained" for s in real),
        "too_small": sum(s.result == "too small" for s in real),
        "healthy": len(healthy),
        "false_alarms": sum(s.result == "wrong" for s in healthy),
        "unknown": len(unknown),
        "unknown_right": sum(s.result == "right" for s in unknown),
        "median_gap_closed": float(np.median(closed)) if closed else math.nan,
        "median_seconds": float(np.median([s.seconds for s in scores])) if scores else math.nan,
    }


def table(scores: list[Score], seed: int, repeats: bool = True) -> str:
    """The confusion table as a Markdown page; ``repeats``: the training records have laps."""
    count = summary(scores)
    title = "what was hidden, what was named" if repeats else "where nothing repeats"
    records = "Each training record repeats its laps." if repeats else "No training record repeats anything."
    lines = [
        *("---", "orphan: true", "---", ""),
        f"# Hidden effects: {title}",
        "",
        f"Written by `make hidden` (seed {seed}): cases of `tests/hidden`, made by a simulator of their own, each",
        "diagnosed by `emps-design diagnose`. A name counts as right where the finding or one of its equivalents",
        f"(three at most) is what was hidden and no finding is false. {records}",
        "",
        f"Effects: {count['right']} right ({count['exact']} by the first name), {count['wrong']} wrong, "
        f"{count['abstained']} abstained, {count['too_small']} too small, of {count['effects']}. "
        f"Healthy: {count['false_alarms']} false alarms of {count['healthy']}. "
        f"Unknown physics: {count['unknown_right']} of {count['unknown']} called unnamed. "
        f"Median gap closed {count['median_gap_closed']:.2f}, median time {count['median_seconds']:.0f} s.",
        "",
        "| hidden | cases | right | abstained | wrong | said |",
        "|---|---|---|---|---|---|",
    ]
    for truth in sorted({s.truth for s in scores}):
        own = [s for s in scores if s.truth == truth]
        said = "; ".join(" + ".join(s.named) or s.verdict or s.note for s in own)
        results = [sum(s.result in kind for s in own) for kind in (("right",), ("abstained", "too small"), ("wrong",))]
        lines.append(f"| {' + '.join(truth)} | {len(own)} | {results[0]} | {results[1]} | {results[2]} | {said} |")
    return "\n".join(lines) + "\n"


def rows(scores: list[Score]) -> list[dict[str, object]]:
    """One row a case, as the measured tables of the documentation read them."""
    return [
        {
            "case": s.case,
            "truth": " + ".join(s.truth),
            "found": " + ".join(s.named),
            "verdict": s.verdict or s.note,
            "right": s.result == "right",
            "result": s.result,
            "gap_closed": s.closed if math.isfinite(s.closed) else None,
            "seconds": round(s.seconds, 1),
        }
        for s in scores
    ]
