"""The page that explains the procedure speaks of numbers that the code has."""

import importlib
import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[3]
PAGE = REPOSITORY / "docs" / "theory" / "diagnosis.md"


def constants(module: str, monkeypatch) -> set[str]:
    """The constants that the page's own directive finds in the one module of ``emps_design.discrepancy`` so called."""
    monkeypatch.syspath_prepend(str(REPOSITORY / "docs" / "_ext"))
    (path,) = (REPOSITORY / "emps_design" / "discrepancy").rglob(f"{module}.py")
    return set(importlib.import_module("assigned").assigned(path))


def test_every_constant_of_the_page_exists_and_is_in_its_table(monkeypatch):
    text = PAGE.read_text(encoding="utf-8")
    used = set(re.findall(r"`(\w+)\.([A-Z][A-Z_0-9]+)`", text))
    lines = [line.split() for line in text.split("```{constants}\n")[1].split("```")[0].split("\n") if line]
    found = {module: constants(module, monkeypatch) for module, *_ in lines}
    listed = {(module, name) for module, *names in lines for name in names or found[module]}
    assert len(used) > 20
    assert used <= listed
    for module, name in listed:
        assert name in found[module], f"{module}.{name}"
