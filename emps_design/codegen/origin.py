"""Where exported code comes from: the axis file with what its head says, and the commit of this package."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

from emps_design.errors import one_line

LONGEST = 10  # s, of asking for the commit


def origin_of(path: str | Path) -> str:
    """The axis file at ``path``: its name, its SHA-256, and the comment that it begins with; nothing without a file.

    ``diagnose`` says there which record its numbers are of.
    """
    if not Path(path).is_file():
        return ""
    content = Path(path).read_bytes()
    first = content.decode("utf-8", "replace").partition("\n")[0]
    said = f": {first.lstrip('# ')}" if first.startswith("#") else ""
    return one_line(f"{Path(path).name}, SHA-256 {hashlib.sha256(content).hexdigest()}{said}")


@lru_cache
def commit() -> str:
    """The commit of this package where it runs from its own repository; nothing elsewhere."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists() or shutil.which("git") is None:
        return ""
    asked = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12", "--match="]
    done = subprocess.run(asked, capture_output=True, text=True, timeout=LONGEST, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""
