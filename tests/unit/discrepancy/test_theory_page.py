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
    used = set(re.findall(r"`(\w+)\.([A-Z][A-Z_0-9]+)`", text))
    lines = [line.split() for line in text.split("```{constants}\n")[1].split("```")[0].split("\n") if line]
    modules = {module: importlib.import_module(full_name(module)) for module, *_ in lines}
    listed = {(module, name) for module, *names in lines for name in names or vars(modules[module])}
    assert len(used) > 20
    assert used <= listed
    for module, name in listed:
        assert hasattr(modules[module], name), f"{module}.{name}"
