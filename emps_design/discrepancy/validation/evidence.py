"""How much of each effect a record asks for, while something may act on it that no effect explains.

Every effect's own evidence: what it changes in the residual, regressed onto that residual beside all others. What the
model leaves is part of the noise, once by its spectrum and once as a smooth function of the state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import STEP
from emps_design.discrepancy.model.parallel import side_by_side
from emps_design.discrepancy.model.problem import Hypothesis, Problem, orthonormal
from emps_design.discrepancy.model.state import states_of
from emps_design.discrepancy.search.noise_floor import LEFT, floor_of_residual
from emps_design.effects.two_mass import has_play
from emps_design.errors import SimulationError

Forces = tuple[np.ndarray, ...]  # one array (n,) [N] per record


@dataclass(frozen=True)
class Asked:
    """How much of an effect a record asks for: ``share`` 1 is all of it, 0 none; ``std`` its standard deviation.

    ``repeats`` is the share that the effect asks of itself when the carriage is disturbed by noise: below 1 where play
    bounces, and no two laps are alike. ``exercised`` False: the record does not bring the effect out, and says nothing
    of it. ``weighed`` are the shares where what the model leaves is itself noise, once by its spectrum and once as a
    smooth function of the state, each with its deviation. ``bounces``: the effect is such play itself.
    """

    name: str
    share: float
    std: float
    repeats: float
    exercised: bool
    weighed: tuple[tuple[float, float], ...] = ()
    bounces: bool = False

    @property
    def refuted(self) -> bool:
        """Whether the record clearly wants another amount of it than the effect itself, or all of it."""
        return self.exercised and self._apart(self.share) - rules.SURE * self.std > rules.ASKED_APART

    @property
    def hardly_wanted(self) -> bool:
        """Whether the record wants less than half of it, all weighings taken together: rather none than all."""
        told = self.confirmed
        return told is not None and told["share"] < rules.HALF

    @property
    def wanted(self) -> bool:
        """Whether the record wants about all of it, however what the model leaves is weighed."""
        return self.exercised and self.astray <= rules.ASKED_APART

    @property
    def stands(self) -> bool:
        """Whether the record clearly wants about all of it.

        What stands in for something unknown shares its force with it, and is wanted in another amount as soon as the
        unknown may be a function of the state too. What play makes of another effect by bouncing is luck: no evidence.
        """
        if self.repeats < rules.ASKED_APART:  # of play that hardly ever bounces alike no more can be asked
            return self.wanted and self.bounces
        return self.wanted and max(std for _, std in self._all()) <= rules.SHARE_KNOWN * self.repeats

    @property
    def astray(self) -> float:
        """How far from all of it the record's share is, in the least favourable weighing."""
        return max(self._apart(share) for share, _ in self._all())

    @property
    def confirmed(self) -> dict[str, float] | None:
        """The contract's share, of what the effect asks of itself, and its deviation; None where nothing is told."""
        if not self.exercised or self.repeats < rules.ASKED_APART:
            return None
        shares = np.array(self._all()) / self.repeats
        return {"share": float(shares[:, 0].mean()), "std": float(max(shares[:, 1].max(), np.ptp(shares[:, 0]) / 2))}

    def _all(self) -> list[tuple[float, float]]:
        return [(self.share, self.std), *self.weighed]

    def _apart(self, share: float) -> float:
        return max(self.repeats - share, share - 1.0)


def asked_for(hypothesis: Hypothesis) -> tuple[Asked, ...]:
    """How much of each effect of a model its records ask for, all of them at once.

    What every effect changes in the whitened residual, and what the four baseline numbers do, are regressed onto that
    residual. A stand-in for unknown physics fits one motion; on another one it is wanted in another amount. The
    regression is done again with what the model leaves as noise: whitened by its own spectrum, and as a sum of smooth
    functions of the simulated state, with random coefficients of a size read from it (empirical Bayes); where these
    explain nothing to begin with, by its spectrum only.
    """
    problem, model = hypothesis.problem, hypothesis.model
    if not model.effects:
        return ()
    noise = problem.noise(0)
    rests = [hypothesis.with_model(model.without(index)) for index in range(len(model.effects))]
    models = [hypothesis, *rests]
    runs = [*((one, None) for one in (*models, *_beside_baseline(hypothesis))), *((one, noise) for one in models)]
    left = side_by_side(_left, runs)
    (whole, *lefts), (disturbed, *lefts_disturbed) = left[: -len(models)], left[-len(models) :]
    if whole is None:  # what cannot run tells nothing
        return tuple(Asked(name, 0.0, 0.0, 1.0, exercised=False) for name in model.names)
    columns = [_change(one, whole) for one in lefts]  # of the effects, then of the baseline's numbers
    again = [_change(one, disturbed) for one in lefts_disturbed]
    spectrum = floor_of_residual(problem.pick(problem.unfollowed(whole), "used"), problem.period, LEFT).whitening
    states = () if problem.states else states_of(hypothesis)
    noises = (problem, problem.with_whitening(spectrum))
    unknown = ((), states) if states else ((),)
    shares: list[list[tuple[float, float]]] = side_by_side(
        _shares_of, [(one, whole, columns, other) for one in noises for other in unknown]
    )
    found = []
    for i, (change, other) in enumerate(zip(columns[: len(again)], again, strict=True)):
        here, there = _gathered(problem, change), _gathered(problem, other)
        repeats = min(1.0, float(here @ there) / max(float(there @ there), 1e-30))
        exercised = float(np.linalg.norm(here)) > rules.EXERCISED * np.sqrt(here.size)
        weighed = tuple(rows[i] for rows in shares[1:])
        found.append(
            Asked(model.names[i], *shares[0][i], repeats, exercised, weighed, bounces=has_play(model.effects[i]))
        )
    return tuple(found)


def _shares_of(weighed: Problem, whole: Forces, columns: list[Forces], states: Forces) -> list[tuple[float, float]]:
    """Shares of the changes ``columns`` that ``whole`` asks for, where it may be a function of ``states`` as well."""
    design = np.column_stack([_gathered(weighed, column) for column in columns])
    return _shares(design, _gathered(weighed, whole), orthonormal(_gathered(weighed, states)) if states else None)


def _shares(design: np.ndarray, left: np.ndarray, unknown: np.ndarray | None = None) -> list[tuple[float, float]]:
    """Share of each column of ``design`` (n, k) that ``left`` (n,) asks for, and its deviation, in whitened numbers.

    Along ``unknown`` (n, m), orthonormal, what is left may be structure and counts as noise of its own variance.
    """
    size = np.linalg.norm(design, axis=0)
    size[size == 0] = np.inf  # what changes nothing is not asked for
    unit = design / size
    noise, structure, basis = max(1.0, float(left @ left) / left.size), 0.0, np.zeros((left.size, 0))
    if unknown is not None:
        basis = unknown
        both = np.column_stack([unit, basis])
        rest = left - both @ np.linalg.lstsq(both, left, rcond=1e-10)[0]
        noise = max(1.0, float(rest @ rest) / (left.size - both.shape[1]))
        beside = left - unit @ np.linalg.lstsq(unit, left, rcond=1e-10)[0]
        structure = max(0.0, float(np.mean((basis.T @ beside) ** 2)) - noise)
    quietened = structure / (noise + structure)

    def weighed(x: np.ndarray) -> np.ndarray:
        return (x - quietened * basis @ (basis.T @ x)) / noise

    inverse = np.linalg.pinv(unit.T @ weighed(unit), hermitian=True)
    shares = 1.0 + inverse @ (unit.T @ weighed(left)) / size
    stds = np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size
    return [(float(share), float(std)) for share, std in zip(shares, stds, strict=True)]


def _gathered(problem: Problem, signals: Forces) -> np.ndarray:
    """Whitened ``signals``, (n,) or (n, k) per record, on the used samples of all records."""
    return problem.gather(problem.whiten(signals), "used")


def _left(hypothesis: Hypothesis, disturbance: Forces | None = None) -> Forces | None:
    """Measured minus simulated force with ``disturbance`` on the carriage; None where the model cannot run."""
    try:
        return hypothesis.residuals(disturbance)
    except SimulationError:
        return None


def _change(left: Forces | None, whole: Forces | None) -> Forces:
    """What ``left`` has more than ``whole``; a model that cannot run tells nothing."""
    if left is None or whole is None:
        return tuple(np.zeros_like(force) for force in left or whole or ())
    return tuple(one - other for one, other in zip(left, whole, strict=True))


def _beside_baseline(hypothesis: Hypothesis) -> list[Hypothesis]:
    """The model with a small step of each baseline number."""
    model = hypothesis.model
    slots = tuple(slot for slot in model.slots() if slot.effect < 0)
    steps = np.diag([STEP * slot.magnitude for slot in slots])
    return [hypothesis.with_model(model.with_vector(slots, moved)) for moved in model.vector(slots) + steps]
