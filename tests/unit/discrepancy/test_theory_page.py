"""The page that explains the procedure speaks of numbers that the code has."""

import importlib
import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[3]
PAGE = REPOSITORY / "docs" / "theory" / "diagnosis.md"


def full_name(module: str) -> str:
    """The dotted name of the one module of ``emps_design.discrepancy`` called ``module``."""
    (path,) = (REPOSITORY / "emps_design" / "discrepancy").rglob(f"{module}.py")
    return ".".join(path.relative_to(REPOSITORY).with_suffix("").parts)


def test_every_constant_of_the_page_exists_and_is_in_its_table():
    text = PAGE.read_text(encoding="utf-8")
    said = set(re.findall(r"`(\w+)\.([A-Z][A-Z_0-9]+)`", text))
    lines = text.split("```{constants}\n")[1].split("```")[0].split("\n")
    listed = {(line.split()[0], name) for line in lines if line for name in line.split()[1:]}
    assert len(said) > 20
    assert said <= listed
    for module, name in listed:
        assert hasattr(importlib.import_module(full_name(module)), name), f"{module}.{name}"
