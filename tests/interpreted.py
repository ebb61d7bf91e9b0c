"""Compiled kernels as the plain Python that their source is."""

from types import FunctionType, ModuleType
from typing import Any


def interpreted(module: ModuleType) -> dict[str, Any]:
    """The names of ``module``, its compiled functions as Python ones that call one another as such."""
    names = dict(vars(module))
    for name, value in vars(module).items():
        source = getattr(value, "py_func", None)
        if source is not None:
            names[name] = FunctionType(source.__code__, names, name, source.__defaults__)
    return names
