"""The records to explain with their noise, and a hypothesis: a candidate model of them, simulated in closed loop.

Residuals are cached, because a search evaluates the same models again with another noise model or other effects.
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
from emps_design.discrepancy.records import RecordSet, Split, drive, in_followed_band
from emps_design.effects.effect import MASS
from emps_design.laws import law_of
from emps_design.records import Record
from emps_design.simulation import Plant, Run
from emps_design.simulation.run import ClosedLoopRun

OPEN_LOOP = ("disturbance", "q0", "supply", "enable")  # drive of a record without the law and its reference


class ResidualCache:
    """Cache of arrays, keyed by the identity of objects and the values of numbers; a copy or a pickle is empty.

    >>> remembered, axis = ResidualCache(), object()
    >>> remembered.get((axis,), [np.ones(1)], lambda: (np.zeros(2),))
    (array([0., 0.]),)
    >>> remembered.get((axis,), [np.ones(1)], lambda: (np.ones(2),))
    (array([0., 0.]),)
    """

    def __init__(self) -> None:
        # The entries hold the objects, so that no other object can get the same id.
        self._entries: OrderedDict[Any, tuple[Sequence[Any], tuple[np.ndarray, ...]]] = OrderedDict()

    def __reduce__(self) -> tuple[type[ResidualCache], tuple[()]]:
        return ResidualCache, ()

    def get(
        self,
        objects: Sequence[Any],
        numbers: Sequence[np.ndarray],
        compute: Callable[[], tuple[np.ndarray, ...]],
    ) -> tuple[np.ndarray, ...]:
        """The arrays of ``compute`` for ``objects`` and ``numbers``, from the cache where possible; read-only."""
        key = (*map(id, objects), *(array.tobytes() for array in numbers))
        entry = self._entries.pop(key, None)  # atomic; a second thread at the same time computes the arrays too
        if entry is None:
            arrays = compute()
            for array in arrays:
                array.flags.writeable = False
            entry = objects, arrays
        self._entries[key] = entry
        most = rules.CACHE // max(1, sum(array.nbytes for array in entry[1]))
        while len(self._entries) > most:
            self._entries.popitem(last=False)
        return entry[1]


@dataclass(frozen=True)
class Problem:
    """Records of one axis and what is needed to judge a model of them.

    ``states`` are functions (n, k) along each record; their span is projected out of every residual on the used
    samples. ``noise_gain`` (n,) along each record is the gain of the loop for noise; innovations are divided by it.
    ``acting`` is a force (n,) [N] on the carriage along each record, in addition to the measured one. ``known`` are
    quantities computed once from the records; ``cache`` has residuals of these records, valid for any noise model.
    """

    axis: Axis
    records: tuple[Record, ...]
    splits: tuple[Split, ...]
    whitening: Whitening
    states: tuple[np.ndarray, ...] = ()
    noise_gain: tuple[np.ndarray, ...] = ()
    acting: tuple[np.ndarray, ...] = ()
    known: RecordSet | None = field(default=None, compare=False, repr=False)
    cache: ResidualCache = field(default_factory=ResidualCache, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.known is None or self.known.records is not self.records or self.known.axis is not self.axis:
            object.__setattr__(self, "known", RecordSet(self.axis, self.records))

    @property
    def record_set(self) -> RecordSet:
        """Quantities of the records that do not depend on the model or the noise."""
        assert self.known is not None
        return self.known

    @property
    def period(self) -> float:
        """Sampling period [s], one for all records."""
        return self.records[0].period

    @property
    def follows(self) -> bool:
        """Whether models follow the recorded motion because the controller is unknown."""
        return self.record_set.follows

    def compared(self, forces: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        """Residual ``forces`` (n,) [N], one per record, low-passed if the model follows the recorded motion."""
        return tuple(map(in_followed_band, forces, self.records, self.record_set.bands)) if self.follows else forces

    def only(self, record: int) -> Problem:
        """The problem of one record, by its number; its models are those of :meth:`Candidate.only`."""
        chosen = slice(record, record + 1)
        alone = ("records", "splits", "states", "noise_gain", "acting")
        return replace(self, **{name: getattr(self, name)[chosen] for name in alone})

    def with_acting(self, forces: Sequence[np.ndarray]) -> Problem:
        """The same records with ``forces`` (n,) [N] on the carriage, one per record, in addition to ``acting``."""
        acting = tuple(a + b for a, b in zip(self.acting, forces, strict=True)) if self.acting else tuple(forces)
        return replace(self, acting=acting, cache=ResidualCache())

    def with_whitening(self, whitening: Whitening) -> Problem:
        """The same records judged with another noise model."""
        return replace(self, whitening=whitening)

    def whiten(self, forces: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
        """Innovations of ``forces`` [N], (n,) or (n, k) per record, in standard deviations, without ``states``."""
        apply = self.whitening.apply
        innovations = tuple(apply(f) if f.ndim == 1 else np.apply_along_axis(apply, 0, f) for f in forces)
        if self.noise_gain:
            innovations = tuple((x.T / gain).T for x, gain in zip(innovations, self.noise_gain, strict=True))
        if not self.states:
            return innovations
        return tuple(x - basis @ (basis.T @ x) for x, basis in zip(innovations, self._states_basis, strict=True))

    def without_states(self, forces: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        """``forces`` (n,) [N], one per record, with ``states`` projected out."""
        return tuple(map(self.whitening.undo, self.whiten(forces))) if self.states else forces

    def noise(self, seed: int) -> tuple[np.ndarray, ...]:
        """Random force [N] with the spectrum of the noise, (n,) per record."""
        generator = np.random.default_rng(seed)
        return tuple(self.whitening.undo(generator.standard_normal(len(record))) for record in self.records)

    @cached_property
    def _states_basis(self) -> tuple[np.ndarray, ...]:
        """Orthonormal basis (n, k) per record of the whitened ``states``, 0 on unused samples."""
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
        """The strokes of all records as slices of the vector of :meth:`gather`."""
        edges, before = {0}, 0
        for split, mask in zip(self.splits, self.masks(part), strict=True):
            counts = np.concatenate(([0], np.cumsum(mask)))
            edges.update(before + int(counts[stop]) for _, stop in split.strokes)
            before += int(counts[-1])
            edges.add(before)
        return [slice(start, stop) for start, stop in itertools.pairwise(sorted(edges))]

    def samples(self, part: str) -> int:
        """Number of samples of ``part``, which is the expected whitened cost of noise alone."""
        return int(sum(mask.sum() for mask in self.masks(part)))


@dataclass(frozen=True)
class Hypothesis:
    """A candidate model of the records of a problem, with its simulations and residuals.

    The simulated encoder is exact, which makes the residual a smooth function of the parameters; the quantisation of
    the real encoder is part of the noise.
    """

    problem: Problem
    model: Candidate

    def with_model(self, model: Candidate) -> Hypothesis:
        """Another model of the same records."""
        return Hypothesis(self.problem, model)

    def with_axis_baseline(self) -> Hypothesis:
        """The same effects with the baseline of the axis file."""
        return self.with_model(replace(self.model, baseline=self.problem.axis.mechanics.array()))

    def only(self, record: int) -> Hypothesis:
        """The same model of one of the records, by its number."""
        return Hypothesis(self.problem.only(record), self.model.only(record))

    def simulate(self, record: int, **drive: Any) -> Run:
        """Closed-loop simulation with the parameters of ``record``; ``drive`` as for :meth:`Plant.closed_loop`.

        Without ``law`` the controller of the axis is used, with the gains of the record.
        """
        axis, measured = self.problem.record_set.simulated, self.problem.records[record]
        parameters = self.model.parameters(record)
        if "law" not in drive:
            drive["law"] = law_of(axis, measured.period, measured.extra)
        plant = Plant(axis, list(zip(self.model.effects, parameters, strict=True)))
        how = {**drive, "baseline": self.model.baseline, "tolerance": self.problem.record_set.tolerance}
        return plant.closed_loop(ClosedLoopRun(**how, quantise=False))

    def driven(self, record: int) -> dict[str, Any]:
        """Keywords of :meth:`simulate`: initial state and inputs of record number ``record``."""
        recorded, mass = self.problem.record_set, self.model.baseline[MASS]
        return drive(recorded.starts[record], recorded.axis, recorded.records[record], mass, recorded.bands[record])

    def run(self, record: int, disturbance: np.ndarray | None = None) -> Run:
        """Simulation of one record from ``q_ref`` alone, or along the recorded motion if the controller is unknown.

        ``disturbance`` (n,) [N] acts on the carriage in addition to the measured force and the problem's ``acting``.
        """
        how = self.driven(record)
        for force in (disturbance, *self.problem.acting[record : record + 1]):
            if force is not None:
                how["disturbance"] = force + (0.0 if how["disturbance"] is None else how["disturbance"])
        return self.simulate(record, **how)

    def runs(self, disturbance: Sequence[np.ndarray | None] | None = None) -> tuple[Run, ...]:
        """Simulations of all records, with ``disturbance`` (n,) [N] per record on the carriage."""
        forces = disturbance or (None,) * len(self.problem.records)
        return tuple(self.run(record, force) for record, force in enumerate(forces))

    def free_run(self, disturbance: Sequence[np.ndarray] = ()) -> np.ndarray:
        """Velocity errors [m/s] of the model driven by the recorded command alone, all records end to end.

        Computed in the band of :meth:`Problem.compared`, with a ``disturbance`` (n,) [N] per record. Raises
        :class:`SimulationError` if the motion is unbounded.
        """
        problem, errors = self.problem, []
        for number, (record, band_hz) in enumerate(zip(problem.records, problem.record_set.bands, strict=True)):
            plant = Plant(problem.axis, list(zip(self.model.effects, self.model.parameters(number), strict=True)))
            how = {key: value for key, value in problem.record_set.starts[number].items() if key in OPEN_LOOP}
            for force in disturbance[number : number + 1]:
                how["disturbance"] = force + (0.0 if how["disturbance"] is None else how["disturbance"])
            run = plant.open_loop(
                record.u,
                period=record.period,
                baseline=self.model.baseline,
                quantise=False,
                tolerance=problem.record_set.tolerance,
                **how,
            )
            errors.append(
                in_followed_band(np.gradient(record.q - run.q, record.period), record, band_hz)[rules.START_UP :]
            )
        return np.concatenate(errors)

    def residuals(self, disturbance: Sequence[np.ndarray | None] | None = None) -> tuple[np.ndarray, ...]:
        """Measured minus simulated motor force [N], one array (n,) per record, with ``disturbance`` as in `runs`.

        While the motor is off there is no force to compare, so the commands of the law along the measured and the
        simulated motion are compared instead. The residual of a model that follows the recorded motion is limited to
        the band of its position law.
        """
        if disturbance is not None:
            return self._residuals(disturbance)
        problem, model = self.problem, self.model
        objects = (problem.axis, *problem.records, *model.effects)
        return problem.cache.get(objects, (model.baseline, *model.values), self._residuals)

    def _residuals(self, disturbance: Sequence[np.ndarray | None] | None = None) -> tuple[np.ndarray, ...]:
        problem, recorded = self.problem, self.problem.record_set
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
        """Measured minus simulated force [N] on the used samples, (n_used,) per record, ``states`` projected out."""
        return self.problem.pick(self.problem.without_states(self.residuals()), "used")


def of_unit_length(columns: np.ndarray) -> np.ndarray:
    """``columns`` (n, k) normalised to unit length, without zero columns."""
    size = np.linalg.norm(columns, axis=0)
    moving = size > 0
    return columns / size if moving.all() else columns[:, moving] / size[moving]


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis (n, r) of ``columns`` (n, k); r is their rank, 0 where all are zero."""
    basis, singular, _ = np.linalg.svd(of_unit_length(columns), full_matrices=False)
    return basis[:, singular > rules.NOTHING * singular.max(initial=0.0)]
