"""What every command shares: JSON on standard output, progress on standard error, files that are whole or absent."""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from emps_design.errors import InputError

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


@contextmanager
def write_aside(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside ``path`` to write to, and rename it when the block ends well.

    A failure or an interrupt leaves neither a half-written file nor a changed old one.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: folder {path.parent} does not exist; make it first")
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    except OSError as error:
        raise InputError(f"{path}: cannot write there, {error.strerror}") from error
    os.close(handle)
    aside = Path(name)
    try:
        yield aside
        os.chmod(aside, 0o666 & ~_umask())
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` to ``path`` whole or not at all."""
    with write_aside(path) as aside:
        aside.write_text(text, encoding="utf-8")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


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
