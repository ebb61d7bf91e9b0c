"""Which plants to simulate: corners of a spread, a Monte-Carlo over it, the sweep of one number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import InputError, nearest_name
from emps_design.simulation.plant import Plant

BASELINE = ("mass", "viscous", "coulomb", "offset")


@dataclass(frozen=True, eq=False)
class Plants:
    """Parameters of many plants: ``baseline`` (m, 4) and, per effect, ``parameters`` (m, n_parameters).

    ``names`` says what was varied, ``values`` (m, len(names)) how.
    """

    baseline: np.ndarray
    parameters: tuple[np.ndarray, ...]
    names: tuple[str, ...]
    values: np.ndarray

    def __len__(self) -> int:
        return self.baseline.shape[0]


def monte_carlo(axis: Axis, spread: float | Mapping[str, float], plants: int, seed: int = 0) -> Plants:
    """Draw ``plants`` plants evenly within +- ``spread`` (relative, of every name given, or of the whole baseline).

    Names are ``mass``, ``viscous``, ``coulomb``, ``offset`` and ``effect.parameter``.

    >>> from emps_design.machines import machine
    >>> drawn = monte_carlo(machine("emps2019"), 0.02, 100)
    >>> len(drawn), bool(np.abs(drawn.baseline[:, 0] / 95.1089 - 1).max() <= 0.02)
    (100, True)
    """
    spreads = _spreads(axis, spread)
    if plants < 1:
        raise InputError(f"plants: found {plants}, expected at least 1")
    factors = np.random.default_rng(seed).uniform(-1.0, 1.0, (plants, len(spreads)))
    return _scaled(axis, tuple(spreads), 1.0 + factors * np.array(list(spreads.values())))


def corners(axis: Axis, spread: float | Mapping[str, float]) -> Plants:
    """Every combination of the ends of +- ``spread`` (relative), lower ends first, after the axis itself.

    >>> from emps_design.machines import machine
    >>> axis = machine("emps2019")
    >>> plants = corners(axis, {"mass": 0.02, "coulomb": 0.1})
    >>> (plants.baseline[:, 0] / axis.mechanics.mass).round(3).tolist()
    [1.0, 0.98, 0.98, 1.02, 1.02]
    """
    spreads = _spreads(axis, spread)
    if len(spreads) > 16:
        raise InputError(f"corners: found {len(spreads)} parameters, expected at most 16 (2^16 plants)")
    signs = np.array([(0.0,) * len(spreads), *product((-1.0, 1.0), repeat=len(spreads))])
    return _scaled(axis, tuple(spreads), 1.0 + signs * np.array(list(spreads.values())))


def sweep(axis: Axis, name: str, values: Sequence[float]) -> Plants:
    """One plant for each of ``values`` of the parameter called ``name`` (its unit is the axis file's).

    >>> from emps_design.machines import machine
    >>> sweep(machine("emps2019"), "mass", [90.0, 100.0]).baseline[:, 0]
    array([ 90., 100.])
    """
    row = np.asarray(values, dtype=float)
    if row.ndim != 1 or row.size == 0 or not np.isfinite(row).all():
        raise InputError(f"sweep of {name}: found {row.tolist()}, expected a row of finite numbers")
    return _placed(axis, (name,), row[:, None])


def _known(axis: Axis) -> dict[str, tuple[int, int]]:
    """Names that can be varied: place of the effect (-1: baseline), place in its parameters."""
    names = {name: (-1, i) for i, name in enumerate(BASELINE)}
    for place, one in enumerate(axis.effects):
        for i, parameter in enumerate(one.effect.parameters):
            names[f"{one.kind}.{parameter.name}"] = (place, i)
    return names


def _spreads(axis: Axis, spread: float | Mapping[str, float]) -> dict[str, float]:
    spreads = dict(spread) if isinstance(spread, Mapping) else {name: float(spread) for name in BASELINE}
    for name, value in spreads.items():
        if not (np.isfinite(value) and 0 <= value < 1):
            raise InputError(f"spread of {name}: found {value:g}, expected a relative number in [0, 1)")
    return spreads


def _nominal(axis: Axis, names: tuple[str, ...]) -> np.ndarray:
    known, plant = _known(axis), Plant.of(axis)
    for name in names:
        if name not in known:
            raise InputError(
                f"parameter: found {name!r}, expected one of {', '.join(known)}{nearest_name(name, list(known))}"
            )
    places = [known[name] for name in names]
    return np.array([(plant.baseline if place < 0 else plant.parameters[place])[i] for place, i in places])


def _scaled(axis: Axis, names: tuple[str, ...], factors: np.ndarray) -> Plants:
    return _placed(axis, names, _nominal(axis, names) * factors)


def _placed(axis: Axis, names: tuple[str, ...], values: np.ndarray) -> Plants:
    _nominal(axis, names)
    known, plant, m = _known(axis), Plant.of(axis), len(values)
    baseline = np.tile(plant.baseline, (m, 1))
    parameters = tuple(np.tile(p, (m, 1)) for p in plant.parameters)
    for column, name in enumerate(names):
        place, i = known[name]
        (baseline if place < 0 else parameters[place])[:, i] = values[:, column]
    return Plants(baseline, parameters, names, values)
