"""No requirement, nor what it requires, is under the GPL; every direct one has its reason in docs/dependencies.md."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]


def name_of(requirement: str) -> str:
    return re.match(r"[\w.-]+", requirement).group().lower().replace("_", "-")


def installed(names: list[str]) -> dict[str, str]:
    """What licence every installed requirement, however deep, states."""
    stated, left = {}, list(names)
    while left:
        name = left.pop()
        if name in stated:
            continue
        try:
            found = distribution(name)
        except PackageNotFoundError:  # required on other systems only
            continue
        classifiers = [c for c in found.metadata.get_all("Classifier", []) if c.startswith("License")]
        licence = found.metadata.get("License-Expression") or found.metadata.get("License") or ""
        # A licence given in full may mention others (matplotlib's does); its classifiers then say which it is.
        stated[name] = " ".join(classifiers) if classifiers else licence.splitlines()[0] if licence else ""
        left += [name_of(r) for r in found.requires or [] if "extra ==" not in r]
    return stated


def test_nothing_under_the_gpl():
    stated = installed([name_of(requirement) for requirement in PROJECT["dependencies"]])
    assert {"numpy", "scipy", "pydantic-core"} <= set(stated)
    bound = {name: licence for name, licence in stated.items() if re.search(r"\bA?GPL|General Public", licence)}
    assert bound == {}


def test_every_dependency_has_its_reason():
    reasons = (REPOSITORY / "docs" / "dependencies.md").read_text()
    extras = [r for group in PROJECT["optional-dependencies"].values() for r in group]
    names = {name_of(requirement) for requirement in [*PROJECT["dependencies"], *extras]}
    assert {name for name in names if not re.search(rf"\b{re.escape(name)}\b", reasons)} == set()


def test_every_dependency_is_imported():
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (REPOSITORY / "emps_design").rglob("*.py"))
    unused = [
        name
        for name in map(name_of, PROJECT["dependencies"])
        if not re.search(rf"^\s*(?:import|from) {name.replace('-', '_')}\b", sources, re.MULTILINE)
    ]
    assert unused == []
