"""Where exported code comes from: the axis file with what its head says, and the commit of this package."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

from emps_design.errors import one_line

LONGEST, DIGITS = 10, 12  # s of asking for the commit, and of what is said of it


def origin_of(name: str, content: bytes) -> str:
    """What a page says of the axis file ``name``: its SHA-256, and the comment that it begins with.

    ``diagnose`` says there which record its numbers are of.

    >>> origin_of("model.toml", b"# of a record\\nname = 'x'")[-13:]
    ': of a record'
    """
    first = content.decode("utf-8", "replace").partition("\n")[0]
    said = f": {first.lstrip('# ')}" if first.startswith("#") else ""
    return one_line(f"{name}, SHA-256 {hashlib.sha256(content).hexdigest()}{said}")


@lru_cache
def commit() -> str:
    """The commit of this package where it runs from its own repository, and whether it was changed since."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists() or shutil.which("git") is None:
        return ""
    found, changed = (_answer(root, *asked) for asked in (("rev-parse", "HEAD"), ("status", "-s", "-uno")))
    return found[:DIGITS] + (", changed since" if changed else "")


def _answer(root: Path, *asked: str) -> str:
    """What git says; nothing where it fails."""
    done = subprocess.run(["git", *asked], cwd=root, capture_output=True, text=True, timeout=LONGEST, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""
