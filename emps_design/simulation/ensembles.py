"""Simulate many plants in parallel, on every core, or on a cluster.

The plants are corners of a spread, a Monte Carlo sample of it, or the sweep of one parameter. Joblib distributes the
work: in threads by default and, inside ``joblib.parallel_config(backend="dask")``, on a ``dask.distributed`` cluster
with the same call. Plants are split into equal parts and are independent, so the results do not depend on the number of
workers. A plant that cannot be simulated is flagged and does not affect the others; after an interrupt the finished
ones are returned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from emps_design.axis import Axis, Mechanics
from emps_design.errors import InputError, SimulationError, nearest_name
from emps_design.laws import law_of
from emps_design.progress import Progress
from emps_design.records import Record
from emps_design.simulation.kernels import baseline as core
from emps_design.simulation.kernels.lanes import LANES, room
from emps_design.simulation.plant import Plant
from emps_design.simulation.scenarios import DROPPED

MECHANICS = tuple(Mechanics.model_fields)

DONE, FAILED, UNFINISHED = 0, 1, 2
STATUS = ("done", "failed", "unfinished")
METRICS = {  # name: unit
    "tracking_rms": "m",
    "position_rms": "m",
    "force_rms": "N",
    "peak_voltage": "V",
    "rest_share": "",
}
_PART = {"lanes": 8 * LANES, "single": 8}  # plants per task


@dataclass(frozen=True, eq=False)
class Plants:
    """Parameters of many plants: ``baseline`` (m, 4) and, per effect, ``parameters`` (m, n_parameters).

    ``names`` are the varied parameters, ``values`` (m, len(names)) their values.
    """

    baseline: np.ndarray
    parameters: tuple[np.ndarray, ...]
    names: tuple[str, ...]
    values: np.ndarray

    def __len__(self) -> int:
        return self.baseline.shape[0]

    def part(self, start: int, stop: int) -> Plants:
        """The plants from ``start`` to ``stop``."""
        parameters = tuple(values[start:stop] for values in self.parameters)
        return Plants(self.baseline[start:stop], parameters, self.names, self.values[start:stop])


def monte_carlo(axis: Axis, spread: float | Mapping[str, float], plants: int, seed: int = 0) -> Plants:
    """Draw ``plants`` plants uniformly within the relative +- ``spread`` of each named parameter, or of the baseline.

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
    return _varied(axis, tuple(spreads), 1.0 + factors * np.array(list(spreads.values())), relative=True)


def corners(axis: Axis, spread: float | Mapping[str, float]) -> Plants:
    """Return the axis itself and every combination of the ends of +- ``spread`` (relative), lower ends first.

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
    return _varied(axis, tuple(spreads), 1.0 + signs * np.array(list(spreads.values())), relative=True)


def sweep(axis: Axis, name: str, values: Sequence[float]) -> Plants:
    """Return one plant for each of ``values`` of the parameter ``name``, in the unit of the axis file.

    >>> from emps_design.machines import machine
    >>> sweep(machine("emps2019"), "mass", [90.0, 100.0]).baseline[:, 0]
    array([ 90., 100.])
    """
    row = np.asarray(values, dtype=float)
    if row.ndim != 1 or row.size == 0 or not np.isfinite(row).all():
        raise InputError(f"sweep of {name}: found {row.tolist()}, expected a row of finite numbers")
    return _varied(axis, (name,), row[:, None])


def _parameter_places(axis: Axis) -> dict[str, tuple[int, int]]:
    """Parameters that can be varied: name -> index of the effect (-1: baseline), index of the parameter."""
    names = {name: (-1, i) for i, name in enumerate(MECHANICS)}
    for place, entry in enumerate(axis.effects):
        for i, parameter in enumerate(entry.effect.parameters):
            names[f"{entry.kind}.{parameter.name}"] = (place, i)
    return names


def _spreads(axis: Axis, spread: float | Mapping[str, float]) -> dict[str, float]:
    spreads = dict(spread) if isinstance(spread, Mapping) else {name: float(spread) for name in MECHANICS}
    for name, value in spreads.items():
        if not (np.isfinite(value) and 0 <= value < 1):
            raise InputError(f"spread of {name}: found {value:g}, expected a relative number in [0, 1)")
    return spreads


def _varied(axis: Axis, names: tuple[str, ...], values: np.ndarray, relative: bool = False) -> Plants:
    """Plants with ``values`` (m, len(names)) of the parameters ``names``; ``relative``: times those of ``axis``."""
    known, plant, m = _parameter_places(axis), Plant.of(axis), len(values)
    baseline = np.tile(plant.baseline, (m, 1))
    parameters = tuple(np.tile(p, (m, 1)) for p in plant.parameters)
    values = values.copy()
    for column, name in enumerate(names):
        if name not in known:
            raise InputError(
                f"parameter: found {name!r}, expected one of {', '.join(known)}{nearest_name(name, list(known))}"
            )
        place, i = known[name]
        table = baseline if place < 0 else parameters[place]
        values[:, column] *= table[:, i] if relative else 1.0
        table[:, i] = values[:, column]
    return Plants(baseline, parameters, names, values)


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Metrics of many plants: ``metrics`` (m,) by name, NaN for plants that did not finish, and ``status`` (m,).

    ``tracking_rms`` [m] of reference minus position; ``position_rms`` [m] and ``force_rms`` [N] of record minus
    simulation, if there is a record; ``peak_voltage`` [V]; ``rest_share`` of the samples at rest.
    """

    plants: Plants
    metrics: dict[str, np.ndarray]
    status: np.ndarray
    reasons: dict[int, str] = field(default_factory=dict)
    interrupted: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Counts, quantiles of every metric, and reasons of failures."""
        done = self.status == DONE
        quantiles = {}
        for name, values in self.metrics.items():
            good = values[done & np.isfinite(values)]
            low, middle, high = np.quantile(good, (0.05, 0.5, 0.95)) if good.size else (np.nan,) * 3
            quantiles[name] = {
                "unit": METRICS[name],
                "q05": float(low),
                "median": float(middle),
                "q95": float(high),
                "worst": float(good.max()) if good.size else float("nan"),
            }
        return {
            "plants": len(self.plants),
            "varied": list(self.plants.names),
            "status": {name: int((self.status == code).sum()) for code, name in enumerate(STATUS)},
            "interrupted": self.interrupted,
            "metrics": quantiles,
            "failures": {str(index): reason for index, reason in sorted(self.reasons.items())[:20]},
        }


def simulate_ensemble(
    axis: Axis,
    plants: Plants,
    q_ref: np.ndarray | None = None,
    record: Record | None = None,
    disturbance: np.ndarray | None = None,
    workers: int = -1,
    quantise: bool = True,
    progress: Progress | None = None,
) -> Ensemble:
    """Simulate every plant in closed loop along ``q_ref`` (n,) [m], or along ``record`` and compare with it.

    ``workers`` is the number of threads (-1: every core), or of the cluster's concurrent tasks. ``progress`` is called
    with a stage and a fraction. Ctrl-C returns the finished plants, the rest flagged ``unfinished``. Raises
    :class:`InputError` without a reference and a record, or if the axis has no controller.
    """
    from joblib import Parallel, delayed

    if q_ref is None and record is not None:
        q_ref = record.q_ref
    if q_ref is None:
        raise InputError("ensemble: found neither q_ref nor record, expected one of them")
    reference = np.ascontiguousarray(q_ref, dtype=float)
    if record is not None and len(record) != reference.size:
        raise InputError(f"ensemble: q_ref has {reference.size} samples, the record {len(record)}; expected the same")
    law_of(axis, axis.sampling.period)  # raises for an axis without a controller before any task starts
    course = Course(
        axis,
        reference,
        None if record is None else (np.ascontiguousarray(record.q), np.ascontiguousarray(record.u)),
        None if disturbance is None else np.ascontiguousarray(disturbance, dtype=float),
        quantise,
    )
    table, status = np.full((len(plants), len(METRICS)), np.nan), np.full(len(plants), UNFINISHED)
    reasons: dict[int, str] = {}
    interrupted = False
    size = _PART["lanes" if course.fits_lanes else "single"]
    starts = range(0, len(plants), size)
    calls = (delayed(course.part)(start, plants.part(start, start + size)) for start in starts)
    results = Parallel(n_jobs=workers, prefer="threads", return_as="generator_unordered", batch_size=1)(calls)
    try:
        for finished, (start, rows, failures) in enumerate(results, 1):
            part = slice(start, start + len(rows))
            table[part], status[part] = rows, DONE
            for index, reason in failures.items():
                status[index], reasons[index] = FAILED, reason
            if progress is not None:
                progress("plants", finished / len(starts))
    except KeyboardInterrupt:
        results.close()
        interrupted = True
    metrics = {name: table[:, i] for i, name in enumerate(METRICS)}
    if record is None:
        metrics = {name: values for name, values in metrics.items() if name not in ("position_rms", "force_rms")}
    return Ensemble(plants, metrics, status, reasons, interrupted)


@dataclass(frozen=True)
class Course:
    """The inputs of all plants of an ensemble: ``q_ref`` (n,) [m] on ``axis``, and ``disturbance`` (n,) [N] or None.

    ``measured`` are position [m] and voltage [V], (n,) each, to compare with; ``quantise``: the encoder has steps.
    """

    axis: Axis
    q_ref: np.ndarray
    measured: tuple[np.ndarray, np.ndarray] | None
    disturbance: np.ndarray | None
    quantise: bool

    @property
    def q0(self) -> float:
        """Initial position [m]."""
        return float(self.q_ref[0] if self.measured is None else self.measured[0][0])

    @property
    def first(self) -> int:
        """First sample of the metrics."""
        return min(DROPPED, self.q_ref.size - 1)

    @property
    def fits_lanes(self) -> bool:
        """Whether lanes can run it: the friction plant without lag or delay, under a state feedback."""
        axis = self.axis
        ideal = not axis.effects and axis.drive.current_time_constant == 0 and axis.sampling.computation_delay == 0
        return ideal and law_of(axis, axis.sampling.period).state_feedback

    def part(self, start: int, plants: Plants) -> tuple[int, np.ndarray, dict[int, str]]:
        """``start``, metrics (m, k) of ``plants``, and reasons of failures by number; the first plant is ``start``."""
        mass, baselines = self.axis.units.word("mass"), plants.baseline
        rows = np.full((len(plants), len(METRICS)), np.nan)
        reasons: dict[int, str] = {}
        good = []
        for i, b in enumerate(baselines):
            if not np.isfinite(b).all() or b[0] <= 0 or b[1] < 0 or b[2] < 0:
                reasons[start + i] = f"baseline {b.tolist()} is not a {mass} > 0 with friction >= 0, finite"
            else:
                good.append(i)
        if good and self.fits_lanes:
            rows[good] = self.side_by_side(baselines[good])
            good = [i for i in good if not np.isfinite(rows[i]).all()]  # those that the lanes could not finish
        plant = Plant.of(self.axis)
        for i in good:
            try:
                rows[i] = self.alone(plant, baselines[i], [values[i] for values in plants.parameters])
            except (SimulationError, InputError) as error:
                rows[i], reasons[start + i] = np.nan, str(error)
        return start, rows, reasons

    def side_by_side(self, baselines: np.ndarray) -> np.ndarray:
        """Metrics of plants with ``baselines`` (m, 4) computed in lanes; nan for those that need :meth:`alone`."""
        m, axis, nothing = len(baselines), self.axis, np.zeros(0)
        padded = np.concatenate([baselines, np.repeat(baselines[:1], -m % LANES, axis=0)])
        period, drive = axis.sampling.period, axis.drive
        resolution = axis.sampling.encoder_resolution if self.quantise else 0.0
        gains = law_of(axis, period).gains
        numbers = core.numbers_of(axis, period, resolution, gains)
        push = nothing if self.disturbance is None else self.disturbance
        result = np.empty((len(padded), len(METRICS)))
        core.run_lanes(
            padded, numbers, (self.q0, 0.0), self.q_ref, push, *(self.measured or (nothing, nothing)), self.first,
            room(core.ROWS), np.zeros(2, np.int64), result,
        )  # fmt: skip
        n = self.q_ref.size - self.first
        result[:, :3] = np.sqrt(result[:, :3] / n)
        result[:, 2] *= drive.gain
        result[:, 4] /= n
        return result[:m]

    def alone(self, plant: Plant, baseline: np.ndarray, parameters: list[np.ndarray]) -> np.ndarray:
        """Metrics of one plant; raises :class:`SimulationError` if its simulation cannot continue."""
        run = plant.closed_loop(
            self.q_ref,
            baseline=baseline,
            parameters=parameters,
            disturbance=self.disturbance,
            q0=self.q0,
            quantise=self.quantise,
        )
        compared = slice(self.first, None)

        def rms(difference: np.ndarray) -> float:
            return float(np.sqrt(np.mean(difference[compared] ** 2)))

        gain = plant.axis.drive.gain
        position = rms(self.measured[0] - run.q) if self.measured else 0.0
        force = gain * rms(self.measured[1] - run.u) if self.measured else 0.0
        rest = float(np.mean(run.v[compared] == 0.0))
        return np.array([rms(self.q_ref - run.position), position, force, float(np.abs(run.u).max()), rest])
