"""The constants that a file assigns, one in a line, with the words behind them."""

import re
from pathlib import Path

ASSIGNED = re.compile(r"^([A-Z][A-Z_0-9]*) = ([^#]+?)(?:\s+# (.*))?$", re.MULTILINE)


def assigned(path: Path) -> dict[str, tuple[str, str]]:
    """Value and words of every constant of the file ``path``, by name."""
    return {name: (value, words) for name, value, words in ASSIGNED.findall(path.read_text(encoding="utf-8"))}
