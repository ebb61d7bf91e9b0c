"""Run ``emps-design diagnose`` on a folder of hidden-effect cases and compare its answers with the truth."""

from __future__ import annotations

import json
import math
import resource
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.hidden.generate import SKIP

MOST_EQUIVALENTS = 3  # a finding with more of them counts as unnamed
TIMEOUT = 600.0  # s
TITLES = {
    "quick": "a quick share",
    "all": "what was hidden, what was named",
    "several": "three and four at once",
    "beside": "a known one beside unknown physics",
    "unknown": "physics that no library has",
    "small": "small ones",
    "healthy": "nothing hidden",
}


@dataclass(frozen=True)
class Score:
    """Result of one case: the hidden effects, those named, and the share of the gap closed on the hold-out."""

    case: str
    truth: tuple[str, ...]
    named: tuple[str, ...]
    verdict: str
    result: str  # right, abstained, wrong, too small
    exact: bool
    false: tuple[str, ...]
    closed: float
    seconds: float  # processor time, which other load on the machine changes little
    note: str = ""
    seen: tuple[str, ...] = ()  # hidden effects whose share of the gap exceeds the noise
    share: float = 1.0  # size of the hidden effect over its ordinary size
    claimed: tuple[str, ...] = ()  # hidden effects that a finding claims, by name or as an equivalent

    @property
    def known(self) -> tuple[str, ...]:
        """The hidden effects that the library has."""
        return tuple(name for name in self.truth if name not in ("none", "unknown"))


def judge(answer: dict, truth: dict) -> tuple[str, bool, tuple[str, ...]]:
    """Result, whether every first name is exact, and the false names.

    Right: a separate finding claims each hidden effect, by name or among at most three equivalents, and every finding
    claims one; nothing is found on a healthy drive; ``unnamed`` and nothing found for unknown physics;
    ``partly-named`` where a known effect has unknown physics beside it, and only there.

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
        right = truth["effects"] == ["none"] or answer["verdict"] == "unnamed"
        return ("right" if right else "abstained"), right, ()
    unclaimed, false = list(hidden), []
    for name, claim in sorted(claims, key=lambda pair: len(pair[1])):
        match = next((effect for effect in unclaimed if effect in claim), None)
        if match is not None:
            unclaimed.remove(match)
        elif not claim & set(hidden):
            false.append(name)
    if false:
        return "wrong", False, tuple(false)
    if unclaimed:
        return ("abstained" if truth.get("detectable", True) else "too small"), False, ()
    if (answer["verdict"] == "partly-named") != ("unknown" in truth["effects"]):
        return "abstained", False, ()  # the unknown part was not reported, or was reported where there is none
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


def score(case: Path, timeout: float = TIMEOUT) -> Score:
    """Diagnose one case in a separate process; a crash or a timeout counts as wrong."""
    truth = json.loads((case / "truth.json").read_text(encoding="utf-8"))
    hidden, started = tuple(truth["effects"]), _processor_time()
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
            seconds, answer = _processor_time() - started, json.loads(done.stdout)
            result, exact, false = judge(answer, truth)
            closed = gap_closed(case, Path(folder), truth)
        except (subprocess.SubprocessError, ValueError, OSError) as error:
            seconds = _processor_time() - started
            failed = Score(case.name, hidden, (), "", "wrong", False, (), math.nan, seconds, _reason(error, timeout))
            return _with_truth(failed, truth)
    named = tuple(f["effect"] for f in answer["findings"])
    scored = Score(case.name, hidden, named, answer["verdict"], result, exact, false, closed, seconds)
    claims = {name for f in answer["findings"] for name in (f["effect"], *f["equivalents"][:MOST_EQUIVALENTS])}
    return _with_truth(replace(scored, claimed=tuple(name for name in scored.known if name in claims)), truth)


def _with_truth(score: Score, truth: dict[str, Any]) -> Score:
    """``score`` with the effects that can be seen in the case, and their share of the ordinary size."""
    return replace(score, seen=tuple(truth.get("seen", score.known)), share=truth.get("share", 1.0))


def _reason(error: Exception, timeout: float) -> str:
    """One line: why there is no answer. The command is left out, as it holds local paths."""
    if isinstance(error, subprocess.TimeoutExpired):
        return f"no answer within {timeout:g} s"
    output = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
    return next(iter((output or f"ended with {getattr(error, 'returncode', error)}").strip().splitlines()[-1:]), "")


def _processor_time() -> float:
    """Processor time [s] of all child processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def score_all(folder: Path, only: str = "", jobs: int = 1, timeout: float = TIMEOUT) -> Iterator[Score]:
    """Yield the scores of the cases below ``folder`` in order, from ``jobs`` processes."""
    chosen = sorted(path.parent for path in folder.glob("*/truth.json") if only in path.parent.name)
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(partial(score, timeout=timeout), chosen)


def summary(scores: list[Score]) -> dict[str, Any]:
    """Counts over cases with effects, healthy drives and unknown physics, over effects, and the median gap closed.

    ``asked_for`` counts the effects that are ``seen``. A correct name of an effect that is not seen is only a name.
    """
    healthy = [s for s in scores if s.truth == ("none",)]
    unknown = [s for s in scores if s.truth == ("unknown",)]
    real = [s for s in scores if s.known]
    closed = [s.closed for s in real if math.isfinite(s.closed)]
    named, false = sum(len(s.named) for s in scores), sum(len(s.false) for s in scores)
    found = [(name in s.claimed) for s in real for name in s.seen]
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
        "asked_for": {"count": sum(found), "of": len(found), "interval": wilson(sum(found), len(found))},
        "false_names": {"count": false, "of": named, "interval": wilson(false, named)},
        "median_gap_closed": float(np.median(closed)) if closed else math.nan,
        "median_processor_seconds": float(np.median([s.seconds for s in scores])) if scores else math.nan,
    }


def wilson(count: int, of: int) -> list[float]:
    """95 % interval of a share of which ``count`` in ``of`` were observed (Wilson, 1927).

    >>> [round(end, 3) for end in wilson(9, 10)]
    [0.596, 0.982]
    >>> wilson(0, 15)[0]
    0.0
    """
    if not of:
        return [0.0, 1.0]
    z, share = 1.96, count / of
    middle, half = share + z**2 / (2 * of), z * math.sqrt(share * (1 - share) / of + z**2 / (4 * of**2))
    return [max(middle - half, 0.0) / (1 + z**2 / of), min((middle + half) / (1 + z**2 / of), 1.0)]


def share_found(scores: list[Score]) -> list[tuple[float, int, int]]:
    """For each share of the ordinary size: the share, how many hidden effects were named, and of how many."""
    sizes = sorted({s.share for s in scores if s.known})
    claims = [(size, [name in s.claimed for s in scores if s.share == size for name in s.known]) for size in sizes]
    return [(size, sum(found), len(found)) for size, found in claims]


def table(scores: list[Score], seed: int, which: str = "all", repeats: bool = True, steered: bool = False) -> str:
    """Markdown page of the set ``which``; ``repeats``: the training records have laps.

    ``steered``: rules were chosen on these cases, so that the page is no evidence for them.
    """
    count = summary(scores)
    laps = "Each training record repeats its laps." if repeats else "No training record repeats anything."
    seen, false = count["asked_for"], count["false_names"]
    lines = [
        *("---", "orphan: true", "---", ""),
        f"# Hidden effects: {TITLES[which]}{'' if repeats else ', where nothing repeats'}",
        "",
        f"Written by `make hidden` (seed {seed}): cases of `tests/hidden`, made by a simulator of their own, each",
        "diagnosed by `emps-design diagnose`. A name counts as right where the finding or one of its equivalents",
        f"(three at most) is what was hidden and no finding is false. {laps}",
        "Rules were chosen with these cases in sight." if steered else "No rule was chosen with these cases in sight.",
        "",
        *_in_words(count),
        "",
    ]
    if seen["of"] or false["of"]:
        named = f"Effects that stand out of the noise: {_count_of(seen)} named. Names: {_count_of(false)} false"
        lines += [f"{named} (in brackets 95 %, Wilson).", ""]
    sizes = share_found(scores)
    if len(sizes) > 1:
        lines += ["| share of the ordinary size | named | of | 95 % |", "|---|---|---|---|"]
        for size, found, of in sizes:
            low, high = wilson(found, of)
            lines.append(f"| {size:g} | {found} | {of} | {100 * low:.0f} to {100 * high:.0f} % |")
        lines.append("")
    lines += [
        "| hidden | cases | right | abstained | wrong | said |",
        "|---|---|---|---|---|---|",
    ]
    for truth in sorted({s.truth for s in scores}):
        alike = [s for s in scores if s.truth == truth]
        words = Counter(" + ".join(s.named) or s.verdict or s.note for s in alike)
        answers = "; ".join(f"{word} ({times} times)" if times > 1 else word for word, times in words.items())
        results = [
            sum(s.result in kind for s in alike) for kind in (("right",), ("abstained", "too small"), ("wrong",))
        ]
        lines.append(f"| {' + '.join(truth)} | {len(alike)} | {results[0]} | {results[1]} | {results[2]} | {answers} |")
    return "\n".join(lines) + "\n"


def _in_words(count: dict[str, Any]) -> list[str]:
    """Sentences with the counts of each kind of case, and the median time."""
    sentences = []
    if count["effects"]:
        sentences = [
            f"Cases: {count['right']} right ({count['exact']} by the first name), {count['wrong']} wrong, "
            f"{count['abstained']} abstained, {count['too_small']} too small, of {count['effects']}; "
            f"{count['median_gap_closed']:.2f} of the gap closed in the median."
        ]
    if count["healthy"]:
        sentences.append(f"Healthy: {count['false_alarms']} false alarms of {count['healthy']}.")
    if count["unknown"]:
        sentences.append(f"Unknown physics alone: {count['unknown_right']} of {count['unknown']} called unnamed.")
    return [*sentences, f"{count['median_processor_seconds']:.0f} s of processor time in the median."]


def _count_of(part: dict[str, Any]) -> str:
    """``9 of 10 (60 to 98 %)``."""
    low, high = part["interval"]
    return f"{part['count']} of {part['of']} ({100 * low:.0f} to {100 * high:.0f} %)"


def rows(scores: list[Score]) -> list[dict[str, object]]:
    """One row per case, for the measured tables of the documentation."""
    return [
        {
            "case": s.case,
            "truth": " + ".join(s.truth),
            "found": " + ".join(s.named),
            "verdict": s.verdict or s.note,
            "right": s.result == "right",
            "result": s.result,
            "seen": list(s.seen),
            "claimed": list(s.claimed),
            "false": list(s.false),
            "share": s.share,
            "gap_closed": s.closed if math.isfinite(s.closed) else None,
            "seconds": round(s.seconds, 1),
        }
        for s in scores
    ]
