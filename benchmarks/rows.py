"""Rows of the table that ``make bench`` prints, and the clocks they are read from."""

from __future__ import annotations

import resource
import sys


def add(rows: list[dict], work: str, value: float, unit: str, target: float | None = None, least: bool = False) -> None:
    """Add a row; ``target`` is the most that ``value`` may be, or the least."""
    met = None if target is None else bool(value >= target if least else value <= target)
    rows.append({"work": work, "value": float(f"{value:.4g}"), "unit": unit, "target": target, "met": met})


def skip(work: str, why: str) -> None:
    """Say which row is left out, and why."""
    print(f"benchmarks: {work}: left out, {why}", file=sys.stderr)


def children() -> float:
    """Processor time of the processes that have ended [s]: other work on the machine stretches it little."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
