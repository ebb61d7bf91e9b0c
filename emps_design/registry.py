"""Registry of the package's effects and laws, and of those that a user adds from a file.

A user's file is imported, so its code runs. Files named in an environment variable are loaded in every process.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from emps_design.errors import AxisError, nearest_name

Entry = TypeVar("Entry")


@dataclass(eq=False)
class Registry(Generic[Entry]):
    """The entries of one ``kind`` ("effect"), each with a ``name``: the package's ``own``, then those of the user.

    ``entry`` is their class. A user's file defines one under the name of ``kind`` in capitals. ``variable`` is the
    environment variable with the paths of such files, and ``key`` is the key of the name in an axis file.
    """

    kind: str
    entry: type[Entry]
    own: tuple[Entry, ...]
    variable: str
    key: str
    added: dict[str, Entry] = field(default_factory=dict)

    def known(self) -> dict[str, Entry]:
        """Every entry by name, those of the package first."""
        return {**{_name(entry): entry for entry in self.own}, **self.added}

    def get(self, name: str) -> Entry:
        """Return the entry called ``name``; raises :class:`AxisError` with the nearest name if unknown."""
        known = self.known()
        if name not in known:
            raise AxisError(
                f"{self.key}: found kind {name!r}, expected one of {', '.join(known)}{nearest_name(name, list(known))}"
            )
        return known[name]

    def register(self, entry: Entry) -> Entry:
        """Add a user's ``entry`` and return it; raises :class:`AxisError` if the package has one of that name."""
        if _name(entry) in map(_name, self.own):
            raise AxisError(f"{self.kind} {_name(entry)}: the package already has that name; choose another")
        self.added[_name(entry)] = entry
        return entry

    def load_file(self, path: str | Path) -> Entry:
        """Run the Python file at ``path``, register the entry it defines and return it; raises :class:`AxisError`."""
        path, title = Path(path), self.kind.upper()
        expected = f"expected a Python file with {'an' if title[0] in 'AEIOU' else 'a'} {title}"
        if not path.is_file():
            raise AxisError(f"{path}: no such file; {expected}")
        spec = importlib.util.spec_from_file_location(f"emps_design_{self.kind}_{path.stem}", path)
        if spec is None or spec.loader is None:
            raise AxisError(f"{path}: found a name that does not end in .py, {expected}")
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module  # compiled kernels are cached by the name of their module
        try:
            spec.loader.exec_module(module)
        except Exception as error:  # a user's file may raise anything
            raise AxisError(f"{path}: {type(error).__name__}: {error}") from error
        definition = getattr(module, title, None)
        if not isinstance(definition, self.entry):
            place = self.entry.__module__.rpartition(".")[0]
            raise AxisError(f"{path}: found {title} = {definition!r}, expected an {place}.{self.entry.__name__}")
        return self.register(definition)

    def load_environment(self) -> None:
        """Load every file in the environment variable, separated like a search path."""
        for path in filter(None, os.environ.get(self.variable, "").split(os.pathsep)):
            self.load_file(path)


def _name(entry: Any) -> str:
    return str(entry.name)
