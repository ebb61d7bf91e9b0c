"""From a fit to numbers by name with their standard deviations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.identification.controller.estimators import sought
from emps_design.identification.controller.filters import Filter, derivatives, filtered
from emps_design.identification.controller.fit import Fit, estimator_slope
from emps_design.identification.controller.noise import resolution
from emps_design.identification.controller.regressors import Signals, regressors
from emps_design.identification.statistics import hac_covariance
from emps_design.laws.estimators import NUMBERS, Estimator

STEP = 1e-6  # of a sought number


def covariance(signals: Signals, found: Fit, limited: np.ndarray | None) -> np.ndarray:
    """Covariance of the linear coefficients, the integral rate and the numbers of filters and estimator.

    Of least squares behind the whitening filter, so for noise that is correlated as the residual is. Irregular
    samples have none: the residual's own correlation takes its place, and a command in steps may be cut off instead of
    rounded, half a step towards zero.
    """
    raw, period = regressors(signals, found.timing, limited), signals.period
    columns = raw @ found.structure.combination(found.wi)
    if found.structure.form:
        step = STEP * found.wi
        ends = [found.structure.combination(found.wi + sign * step) for sign in (1.0, -1.0)]
        columns = np.column_stack([columns, raw @ ((ends[0] - ends[1]) / (2.0 * step)) @ found.linear])
    columns = filtered(found.filters, columns, period)
    columns = np.column_stack([columns, derivatives(found.filters, raw @ found.beta, period)])
    columns = np.column_stack([columns, *estimator_slope(signals, found, limited)])
    columns = signals.counted(columns)
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    if signals.times is not None:
        left = signals.counted(signals.command - filtered(found.filters, raw @ found.beta, period))
        lag = int(4 * (len(left) / 100) ** (2 / 9))  # Newey and West
        cut = signals.counted(0.5 * resolution(signals.command) * np.sign(signals.command))
        shift = np.linalg.lstsq(columns / scale, cut)[0]
        return (hac_covariance(columns / scale, left, lag) + np.outer(shift, shift)) / np.outer(scale, scale)
    triangle = np.linalg.qr(columns / scale, mode="r")
    inverse = np.linalg.pinv(triangle) / scale[:, None]
    return found.cost / max(found.samples - found.size, 1) * inverse @ inverse.T


def with_deviations(
    found: Fit, spread: np.ndarray, numbers: Callable[[Fit], dict[str, float]]
) -> dict[str, tuple[float, float]]:
    """Each of the ``numbers`` of a fit with its deviation, from the ``spread`` of :func:`covariance`."""
    values = numbers(found)
    centre = _packed(found)
    slopes = []
    for i, at in enumerate(centre):
        step = STEP * max(abs(at), 1e-9 * float(np.max(np.abs(centre))))
        ends = []
        for sign in (1.0, -1.0):
            moved = centre.copy()
            moved[i] += sign * step
            ends.append(numbers(_unpacked(found, moved)))
        slopes.append([(ends[0][name] - ends[1][name]) / (2.0 * step) for name in values])
    table = np.array(slopes).T
    variance = np.einsum("ij,jk,ik->i", table, spread, table)
    deviations = np.sqrt(np.maximum(variance, 0.0)).tolist()
    return {name: (value, std) for (name, value), std in zip(values.items(), deviations, strict=True)}


def _packed(found: Fit) -> np.ndarray:
    rate = [found.wi] if found.structure.form else []
    estimator = found.timing.velocity_estimator
    own = [float(np.log(estimator.number))] if _is_sought(found) and not isinstance(estimator, str) else []
    return np.concatenate([found.linear, rate, *(one.numbers for one in found.filters), own])


def _unpacked(found: Fit, x: np.ndarray) -> Fit:
    linear, rest = x[: found.linear.size], x[found.linear.size :]
    change: dict[str, Any] = {"linear": linear}
    if found.structure.form:
        change["wi"], rest = float(rest[0]), rest[1:]
    filters = []
    for one in found.filters:
        filters.append(Filter(one.kind, tuple(rest[: len(one.numbers)].tolist())))
        rest = rest[len(one.numbers) :]
    estimator = found.timing.velocity_estimator
    if _is_sought(found) and not isinstance(estimator, str):
        own = {"kind": estimator.kind, NUMBERS[estimator.kind]: float(np.exp(rest[0]))}
        change["timing"] = replace(found.timing, velocity_estimator=Estimator.model_validate(own))
    return replace(found, **change, filters=tuple(filters))


def _is_sought(found: Fit) -> bool:
    return found.structure.velocity and sought(found.timing.velocity_estimator)
