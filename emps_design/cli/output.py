"""What every command shares: JSON on standard output, progress on standard error, files that are whole or absent."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from emps_design.files import write_aside, write_text

__all__ = ["Progress", "plain", "print_json", "print_warnings", "progress_bar", "write_aside", "write_text"]

Progress = Callable[[str, float], None]


def plain(value: Any) -> Any:
    """Return ``value`` as JSON data: numpy to Python, complex to [re, im], Infinity and NaN to None."""
    if hasattr(value, "to_dict"):
        return plain(value.to_dict())
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def print_json(document: Any) -> None:
    """Print one JSON document on standard output; the same data gives the same bytes."""
    sys.stdout.write(json.dumps(plain(document), indent=1, allow_nan=False, ensure_ascii=False) + "\n")


def print_warnings(warnings: Iterable[str]) -> None:
    """Print each warning as one line on standard error."""
    for warning in warnings:
        print(f"emps-design: warning: {warning}", file=sys.stderr)


@contextmanager
def progress_bar(show: bool = True) -> Iterator[Progress]:
    """Give a ``progress(stage, fraction)`` that draws on standard error: a bar, or a line a stage."""
    if not show:
        yield lambda stage, fraction: None
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
        )
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task("", total=1.0)
            yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)
    else:
        seen: list[str] = []

        def report(stage: str, fraction: float) -> None:
            if not seen or seen[-1] != stage:
                seen.append(stage)
                print(f"emps-design: {stage}", file=sys.stderr)

        yield report
