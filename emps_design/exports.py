"""What a room offers, imported on first use: importing the package must not cost a second of start-up."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from inspect import getsource
from typing import Any


def offered(source: str) -> dict[str, str]:
    """Map each name imported under ``if TYPE_CHECKING:`` in ``source`` to the module it comes from.

    >>> offered("if TYPE_CHECKING:\\n    from math import pi as pi, tau as tau")
    {'pi': 'math', 'tau': 'math'}
    """
    blocks = [node for node in ast.parse(source).body if isinstance(node, ast.If)]
    imports = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def on_first_use(room: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` for the package ``room``.

    The names are those its ``__init__`` imports under ``if TYPE_CHECKING:``, so that type checkers and users see the
    same list. :class:`AttributeError` for any other.
    """
    module = sys.modules[room]
    homes = offered(getsource(module))

    def resolve(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        found = getattr(import_module(homes[name]), name)
        setattr(module, name, found)
        return found

    def names() -> list[str]:
        return sorted({*vars(module), *homes})

    return resolve, names, sorted(homes)
