"""The records to explain and their noise, and a hypothesis about them: a candidate model simulated in closed loop.

Residuals are cached: a search returns to the same models, with other noise or beside other effects.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.least_squares import Candidate
from emps_design.discrepancy.noise_floor import Whitening
from emps_design.discrepancy.records import Recorded, Split, drive, in_followed_band
from emps_design.effects.effect import MASS
from emps_design.laws import law_of
from emps_design.records import Record
from emps_design.simulation import Plant, Run
from emps_design.simulation.run import ClosedLoopRun

OPEN_LOOP = ("disturbance", "q0", "supply", "enable")  # drive of a record without the law and its reference


class Remembered:
    """Cache of arrays by the identity of objects and the values of numbers; a copy or a pickle of it is empty.

    >>> remembered, axis = Remembered(), object()
    >>> remembered.get((axis,), [np.ones(1)], lambda: (np.zeros(2),))
    (array([0., 0.]),)
    >>> remembered.get((axis,), [np.ones(1)], lambda: (np.ones(2),))
    (array([0., 0.]),)
    """

    def __init__(self) -> None:
        # The objects are kept with the arrays: as long as they are, nothing else has their ids.
        self._kept: OrderedDict[Any, tuple[Sequence[Any], tuple[np.ndarray, ...]]] = OrderedDict()

    def __reduce__(self) -> tuple[type[Remembered], tuple[()]]:
        return Remembered, ()

    def get(
        self,
        objects: Sequence[Any],
        numbers: Sequence[np.ndarray],
        compute: Callable[[], tuple[np.ndarray, ...]],
    ) -> tuple[np.ndarray, ...]:
        """The arrays of ``compute`` for ``objects`` and ``numbers``, from the cache where possible; read-only."""
        key = (*map(id, objects), *(array.tobytes() for array in numbers))
        entry = self._kept.pop(key, None)  # atomic: a second thread at the same time computes it too
        if entry is None:
            arrays = compute()
            for array in arrays:
                array.flags.writeable = False
            entry = objects, arrays
        self._kept[key] = entry
        most = rules.CACHE // max(1, sum(array.nbytes for array in entry[1]))
        while len(self._kept) > most:
            self._kept.popitem(last=False)
        return entry[1]


@dataclass(frozen=True)
class Problem:
    """Records of one axis and what is needed to judge a model of them.

    ``states`` are functions (n, k) along each record whose span is projected out of every residual on the used samples.
    ``loudness`` (n,) along each record is the gain of noise in the innovations, which are divided by it. ``acting`` is
    a force (n,) [N] on the carriage along each record besides the measured one. ``known`` are quantities computed from
    the records once, ``remembered`` residuals of the same records, also for other noise.
    """

    axis: Axis
    records: tuple[Record, ...]
    splits: tuple[Split, ...]
    whitening: Whitening
    states: tuple[np.ndarray, ...] = ()
    loudness: tuple[np.ndarray, ...] = ()
    acting: tuple[np.ndarray, ...] = ()
    known: Recorded | None = field(default=None, compare=False, repr=False)
    remembered: Remembered = field(default_factory=Remembered, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.known is None or self.known.records is not self.records or self.known.axis is not self.axis:
            object.__setattr__(self, "known", Recorded(self.axis, self.records))

    @property
    def recorded(self) -> Recorded:
        """Quantities of the records that depend on no model and no noise."""
        assert self.known is not None
        return self.known

    @property
    def period(self) -> float:
        """Sampling period [s], one for all records."""
        return self.records[0].period

    @property
    def follows(self) -> bool:
        """Whether models follow the recorded motion because the controller is unknown."""
        return self.recorded.follows

    def compared(self, forces: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        """Residual ``forces`` (n,) [N], one per record, low-passed where the model follows the recorded motion."""
        return tuple(map(in_followed_band, forces, self.records, self.recorded.bands)) if self.follows else forces

    def only(self, record: int) -> Problem:
        """The problem of one record, by its number; its models are :meth:`Candidate.only`."""
        chosen = slice(record, record + 1)
        alone = ("records", "splits", "states", "loudness", "acting")
        return replace(self, **{name: getattr(self, name)[chosen] for name in alone})

    def with_acting(self, forces: Sequence[np.ndarray]) -> Problem:
        """The same records with ``forces`` (n,) [N] on the carriage, one per record, besides those acting already."""
        acting = tuple(a + b for a, b in zip(self.acting, forces, strict=True)) if self.acting else tuple(forces)
        return replace(self, acting=acting, remembered=Remembered())

    def with_whitening(self, whitening: Whitening) -> Problem:
        """The same records judged with other noise."""
        return replace(self, whitening=whitening)

    def whiten(self, forces: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
        """Innovations of ``forces`` [N], (n,) or (n, k) per record, in units of noise, ``states`` projected out."""
        apply = self.whitening.apply
        innovations = tuple(apply(f) if f.ndim == 1 else np.apply_along_axis(apply, 0, f) for f in forces)
        if self.loudness:
            innovations = tuple((x.T / loud).T for x, loud in zip(innovations, self.loudness, strict=True))
        if not self.states:
            return innovations
        return tuple(x - basis @ (basis.T @ x) for x, basis in zip(innovations, self._states_basis, strict=True))

    def without_states(self, forces: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        """``forces`` (n,) [N], one per record, with ``states`` projected out."""
        return tuple(map(self.whitening.undo, self.whiten(forces))) if self.states else forces

    def noise(self, seed: int) -> tuple[np.ndarray, ...]:
        """Force [N] drawn from the noise by ``seed``, (n,) per record."""
        generator = np.random.default_rng(seed)
        return tuple(self.whitening.undo(generator.standard_normal(len(record))) for record in self.records)

    @cached_property
    def _states_basis(self) -> tuple[np.ndarray, ...]:
        """An orthonormal basis (n, k) per record of the whitened ``states``, 0 on unused samples."""
        columns = replace(self, states=()).whiten(self.states)
        return tuple(
            orthonormal(innovations * used[:, None])
            for innovations, used in zip(columns, self.masks("used"), strict=True)
        )

    def masks(self, part: str) -> tuple[np.ndarray, ...]:
        """Boolean samples of ``part``: "fit", "select" or "used"."""
        return tuple(getattr(s, part) for s in self.splits)

    def pick(self, signals: tuple[np.ndarray, ...], part: str) -> list[np.ndarray]:
        """The samples of ``part`` of ``signals``, one array per record."""
        return [signal[mask] for signal, mask in zip(signals, self.masks(part), strict=True)]

    def gather(self, signals: tuple[np.ndarray, ...], part: str) -> np.ndarray:
        """The samples of ``part`` of ``signals``, one per record, in one vector."""
        return np.concatenate(self.pick(signals, part))

    def strokes(self, part: str) -> list[slice]:
        """The strokes of all records as slices of the samples of ``part`` in one vector."""
        edges, before = {0}, 0
        for split, mask in zip(self.splits, self.masks(part), strict=True):
            counts = np.concatenate(([0], np.cumsum(mask)))
            edges.update(before + int(counts[stop]) for _, stop in split.strokes)
            before += int(counts[-1])
            edges.add(before)
        return [slice(start, stop) for start, stop in itertools.pairwise(sorted(edges))]

    def samples(self, part: str) -> int:
        """Number of samples of ``part``: the whitened cost of noise alone."""
        return int(sum(mask.sum() for mask in self.masks(part)))


@dataclass(frozen=True)
class Hypothesis:
    """A candidate model of the records of a problem, its simulations and residuals.

    The encoder is taken as exact, so that the residual is a smooth function of the parameters; its quantisation is
    part of the noise.
    """

    problem: Problem
    model: Candidate

    def with_model(self, model: Candidate) -> Hypothesis:
        """Another model of the same records."""
        return Hypothesis(self.problem, model)

    def with_axis_baseline(self) -> Hypothesis:
        """The same effects on the axis file's baseline."""
        return self.with_model(replace(self.model, baseline=self.problem.axis.mechanics.array()))

    def only(self, record: int) -> Hypothesis:
        """The same model of one of the records, by its number."""
        return Hypothesis(self.problem.only(record), self.model.only(record))

    def simulate(self, record: int, **drive: Any) -> Run:
        """Closed-loop simulation with the numbers of ``record``, driven as :meth:`Plant.closed_loop` says.

        The law, where none is given, has the gains of the record.
        """
        axis, measured = self.problem.recorded.simulated, self.problem.records[record]
        parameters = self.model.parameters(record)
        if "law" not in drive:
            drive["law"] = law_of(axis, measured.period, measured.extra)
        plant = Plant(axis, list(zip(self.model.effects, parameters, strict=True)))
        how = {**drive, "baseline": self.model.baseline, "tolerance": self.problem.recorded.tolerance}
        return plant.closed_loop(ClosedLoopRun(**how, quantise=False))

    def driven(self, record: int) -> dict[str, Any]:
        """Keywords of :meth:`simulate` with the initial state and the drive of record number ``record``."""
        recorded, mass = self.problem.recorded, self.model.baseline[MASS]
        return drive(recorded.starts[record], recorded.axis, recorded.records[record], mass, recorded.bands[record])

    def run(self, record: int, disturbance: np.ndarray | None = None) -> Run:
        """Simulation of one record from ``q_ref`` alone; without a controller, following the recorded motion.

        ``disturbance`` (n,) [N] acts on the carriage besides the measured force and ``acting`` of the problem.
        """
        how = self.driven(record)
        for force in (disturbance, *self.problem.acting[record : record + 1]):
            if force is not None:
                how["disturbance"] = force + (0.0 if how["disturbance"] is None else how["disturbance"])
        return self.simulate(record, **how)

    def runs(self, disturbance: Sequence[np.ndarray | None] | None = None) -> tuple[Run, ...]:
        """Simulations of all records, with ``disturbance`` (n,) [N] per record on the carriage."""
        pushes = disturbance or (None,) * len(self.problem.records)
        return tuple(self.run(record, push) for record, push in enumerate(pushes))

    def free_run(self, disturbance: Sequence[np.ndarray] = ()) -> np.ndarray:
        """Velocity errors [m/s] of the model driven by the recorded command alone, all records end to end.

        In the band in which a model that follows its record is compared; under a ``disturbance`` (n,) [N] per record.
        Raises :class:`SimulationError` where the motion is unbounded.
        """
        problem, missed = self.problem, []
        for number, (record, band_hz) in enumerate(zip(problem.records, problem.recorded.bands, strict=True)):
            plant = Plant(problem.axis, list(zip(self.model.effects, self.model.parameters(number), strict=True)))
            how = {key: value for key, value in problem.recorded.starts[number].items() if key in OPEN_LOOP}
            for force in disturbance[number : number + 1]:
                how["disturbance"] = force + (0.0 if how["disturbance"] is None else how["disturbance"])
            run = plant.open_loop(
                record.u,
                period=record.period,
                baseline=self.model.baseline,
                quantise=False,
                tolerance=problem.recorded.tolerance,
                **how,
            )
            missed.append(
                in_followed_band(np.gradient(record.q - run.q, record.period), record, band_hz)[rules.START_UP :]
            )
        return np.concatenate(missed)

    def residuals(self, disturbance: Sequence[np.ndarray | None] | None = None) -> tuple[np.ndarray, ...]:
        """Measured minus simulated motor force [N], one array (n,) per record, under ``disturbance`` as in `runs`.

        While the motor is off there is no force to compare: the commands of the law along the measured and the
        simulated motion are compared instead. A model that follows the recorded motion is compared in the band of its
        position law only.
        """
        if disturbance is not None:
            return self._residuals(disturbance)
        problem, model = self.problem, self.model
        objects = (problem.axis, *problem.records, *model.effects)
        return problem.remembered.get(objects, (model.baseline, *model.values), self._residuals)

    def _residuals(self, disturbance: Sequence[np.ndarray | None] | None = None) -> tuple[np.ndarray, ...]:
        problem, recorded = self.problem, self.problem.recorded
        forces = tuple(
            recorded.forces[number] - run.force + recorded.missing_while_off(number, run.q)
            for number, run in enumerate(self.runs(disturbance))
        )
        return problem.compared(forces)

    def whitened(self) -> tuple[np.ndarray, ...]:
        """Innovations of :meth:`residuals` in units of the noise."""
        return self.problem.whiten(self.residuals())

    def residual(self, part: str) -> np.ndarray:
        """Innovations on the samples of ``part`` of all records, in one vector."""
        return self.problem.gather(self.whitened(), part)

    def excess(self) -> float:
        """Whitened cost of all used samples minus that of noise alone."""
        innovations = self.residual("used")
        return float(innovations @ innovations) - innovations.size

    def remaining_force(self) -> list[np.ndarray]:
        """Measured minus simulated force [N] on the used samples, one array (n_used,) per record.

        With the problem's ``states`` projected out.
        """
        return self.problem.pick(self.problem.without_states(self.residuals()), "used")


def of_unit_length(columns: np.ndarray) -> np.ndarray:
    """``columns`` (n, k) normalised to length 1, without those that are zero."""
    size = np.linalg.norm(columns, axis=0)
    moving = size > 0
    return columns / size if moving.all() else columns[:, moving] / size[moving]


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis (n, r) of ``columns`` (n, k); r is their rank, 0 where all are zero."""
    basis, singular, _ = np.linalg.svd(of_unit_length(columns), full_matrices=False)
    return basis[:, singular > rules.NOTHING * singular.max(initial=0.0)]
