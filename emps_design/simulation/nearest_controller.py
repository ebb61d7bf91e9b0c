"""What to change in a controller whose loop diverges: the one number nearest to what it has with which it runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from emps_design.axis import Axis
from emps_design.errors import AxisError, SimulationError, UnstableError
from emps_design.laws import leaves

STEP = math.sqrt(2.0)  # between the numbers that are tried
STEPS = 12  # down and up, as many: further away a loop runs because it hardly moves


def unstable(axis: Axis, error: SimulationError, simulate: Callable[[Axis], Any]) -> UnstableError:
    """Return the error for a closed loop of ``axis`` that did not run, with the reason and the nearest that does.

    ``simulate(axis)`` runs the same loop on another axis and raises :class:`SimulationError` where it diverges.
    """
    nearest = nearest_controller(axis, simulate)
    if not nearest:
        return UnstableError(f"{error}; no other number of the controller alone makes it run")
    name, value = next(iter(nearest.items()))
    own = dict(_numbers(axis))[name]
    return UnstableError(f"{error}; nearest that works: {name} = {value:g} instead of {own:g}", nearest)


def nearest_controller(axis: Axis, simulate: Callable[[Axis], Any]) -> dict[str, float]:
    """Return the number of the controller of ``axis``, as {name: value}, with which ``simulate(axis)`` runs; or {}.

    Each number is tried alone, in steps of a factor sqrt(2) either way; the one proposed has another such step to
    spare, and is the one whose factor is nearest to 1.
    """
    found: list[tuple[int, str, float]] = []
    for name, own in _numbers(axis):
        for side in (-1, 1):
            before = False
            for count in range(1, STEPS + 1):
                if found and count >= min(found)[0]:
                    break
                value = float(f"{own * STEP ** (side * count):.3g}")
                runs = _runs(axis, name, value, simulate)
                if runs and before:
                    found.append((count, name, value))
                    break
                before = runs
    if not found:
        return {}
    _, name, value = min(found)
    return {name: value}


def _numbers(axis: Axis) -> list[tuple[str, float]]:
    """The numbers of the controller of ``axis`` by name, ``velocity.kp`` of an inner table; zeros and counts aside."""
    values = leaves(axis.to_dict()["controller"])
    return [(".".join(path), value) for path, value in values if isinstance(value, float) and value != 0.0]


def _runs(axis: Axis, name: str, value: float, simulate: Callable[[Axis], Any]) -> bool:
    controller = axis.to_dict()["controller"]
    *tables, key = name.split(".")
    inner = controller
    for table in tables:
        inner = inner[int(table) if isinstance(inner, list | tuple) else table]
    inner[key] = value
    try:
        simulate(axis.replace(controller=controller))
    except (SimulationError, AxisError):
        return False
    return True
