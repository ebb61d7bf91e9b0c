"""A diagnosis as one evidence: what effects explain, what no effect explains, and noise, in one probabilistic model.

The residual force of a model with a set of effects is ``B b + n``. ``B`` are the responses of the loop to smooth forces
of the state, in groups whose variances are read from the data (Kennedy and O'Hagan, 2001), and ``n`` is autoregressive
noise with Student's tails; both are estimated for every set. Where play or a limit makes the loop amplify noise, the
simulation says when, and the noise of these samples is as much larger.

The evidence of a set is the likelihood with ``b`` integrated, Laplace's integral over the parameters with their priors,
and the prior odds of its effects. A search makes the move that raises it most: an effect added, exchanged, or dropped,
or two added at once. An unknown force acts in the loop where the records ask for one, and is linearised there.

On trial: ``docs/decisions/one_evidence.md`` says how it is judged. :func:`diagnose` does not use it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from emps_design.discrepancy import unknown_force
from emps_design.discrepancy.beam_search import exchanges, shapes
from emps_design.discrepancy.calibration import first_noise
from emps_design.discrepancy.extension import converged, extended
from emps_design.discrepancy.fit import Fit, admissible, evaluate, fit
from emps_design.discrepancy.gap import adapt
from emps_design.discrepancy.least_squares import Candidate, Slot
from emps_design.discrepancy.noise_floor import ORDER, Floor, Whitening, usual_rms
from emps_design.discrepancy.parallel import side_by_side
from emps_design.discrepancy.preparation import HeldOut, Preparation
from emps_design.discrepancy.problem import Hypothesis, Problem
from emps_design.discrepancy.starts import either_baseline
from emps_design.discrepancy.unknown_force import COARSE, SLOWEST, Kind, along, damping, inertia, memory
from emps_design.effects import Motion, Parameter
from emps_design.errors import RecordError, SimulationError
from emps_design.identification.statistics import autocovariance

# Priors
TAILS = 5.0  # degrees of freedom of the noise
WIDTH = 3.0  # typical sizes: deviation of the prior of an amplitude
SPREAD = 1.0  # deviation of the logarithm of a positive parameter
BASELINE_WIDTH = 0.5  # of a baseline number, deviation around the axis file's
ODDS = 12.0  # nats that an effect must gain beyond its parameters: the size of the library, and chance
WORTH = 0.002  # nats for each sample that it must gain besides: no noise is known better
FLOOR = (0.95, 0.5)  # of the deviation of the first noise: least deviation, of laps and of other strokes
# Decisions
ALIKE = 3.0  # nats within which another set is as good
KNOWN = 3.0  # nats that the confirming data must gain by an effect, and all data by an unknown force
STRUCTURE = 1.5  # times the noise, in force: noise and unknown force beyond it are more than noise
MOST = 7  # effects
# Tolerances
VARIANCES, SCALES = 12, 3  # iterations of the variances of the groups, and of noise and weights
CONVERGED = 2  # times that the noise is read from a fit and the fit converges under it
IN_TURN = 2  # times that an unknown force in the loop is linearised
JUDGED = 6  # fits of a move whose evidence is computed
NEAR = 300.0  # nats: a set this far behind may lead once it has converged
LEADING = 2  # sets of a move that converge
PASSES = 8
DEGREE = 8  # of polynomials along the travel
OVER_SPEED = 5  # of polynomials over speed
NEGLIGIBLE = 1e-12  # variance of a group that has none


def _position(measured: Motion, simulated: np.ndarray) -> np.ndarray:
    return along(measured.q, DEGREE)[:, 1:]


def _each_way(measured: Motion, simulated: np.ndarray) -> np.ndarray:
    return along(measured.q, DEGREE) * np.tanh(measured.v / SLOWEST)[:, None]


def _over_speed(measured: Motion, simulated: np.ndarray) -> np.ndarray:
    from numpy.polynomial.chebyshev import chebvander

    speed = np.abs(measured.v) / np.abs(measured.v).max()
    powers = chebvander(2 * speed - 1, OVER_SPEED)[:, 1:]
    return np.column_stack([powers, powers * np.tanh(measured.v / SLOWEST)[:, None]])


GROUPS = (
    Kind("a force along the travel", _position),
    Kind("friction along the travel", _each_way),
    Kind("friction over speed", _over_speed),
    Kind("viscous friction that varies along the travel", partial(damping, degree=COARSE)),
    Kind("friction that remembers the motion before", memory),
    Kind("an inertia that varies along the travel", partial(inertia, degree=COARSE)),
)


@dataclass(frozen=True)
class Unknown:
    """Smooth forces of the state in the loop of a model, linearised.

    ``problem`` has the mean force acting. ``forces`` and ``responses`` (n, m) [N] per record are columns on the
    carriage and in the residual, ``group`` (m,) is that of each, and ``mean`` (m,) per record are the coefficients
    that act already.
    """

    problem: Problem
    forces: tuple[np.ndarray, ...]
    responses: tuple[np.ndarray, ...]
    group: np.ndarray
    mean: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, hypothesis: Hypothesis, acting: tuple[np.ndarray, ...] = ()) -> Unknown:
        """Linearise around ``hypothesis``, in whose problem the forces ``acting`` (n,) [N] act.

        A group of forces with which the model cannot be simulated has no columns.
        """
        by_record: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in hypothesis.problem.records]
        group: list[int] = []
        for number, kind in enumerate(GROUPS):
            with suppress(SimulationError):
                some = unknown_force.columns_of(hypothesis, kind)
                pairs = zip(some, unknown_force.responses_to(hypothesis, some), strict=True)
                group += [number] * some[0].shape[1]
                for columns, pair in zip(by_record, pairs, strict=True):
                    columns.append(pair)
        empty = [(np.zeros((len(record), 0)), np.zeros((len(record), 0))) for record in hypothesis.problem.records]
        stacked = [
            [np.column_stack(side) for side in zip(none, *columns, strict=True)]
            for columns, none in zip(by_record, empty, strict=True)
        ]
        forces, responses = tuple(pair[0] for pair in stacked), tuple(pair[1] for pair in stacked)
        pushes = acting or tuple(np.zeros(len(record)) for record in hypothesis.problem.records)
        mean = [np.linalg.lstsq(f, push, rcond=1e-9)[0] for f, push in zip(forces, pushes, strict=True)]
        return cls(hypothesis.problem, forces, responses, np.array(group, dtype=int), tuple(mean))

    def whole(self, residuals: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        """``residuals`` (n,) [N] per record as they would be without the force that acts, to first order."""
        return tuple(r + b @ mean for r, b, mean in zip(residuals, self.responses, self.mean, strict=True))


@dataclass(frozen=True)
class Noise:
    """What of a residual no effect explains: an unknown force and noise.

    ``variances`` are those of the groups, ``coefficients`` (m,) per record the posterior mean of ``b``, ``quieted`` a
    basis per record along which a residual may be an unknown force, and the share of it that is taken off.
    ``likelihood`` [nats] has ``b`` integrated; without any unknown force it would be less by ``gain``. ``loudness``
    (n,) per record is how much larger than usual the noise of a sample is, ``noise_rms`` and ``force_rms`` [N] are
    those of the noise, without events, and of the unknown force, both where the loop does not amplify them.
    """

    whitening: Whitening
    variances: np.ndarray
    coefficients: tuple[np.ndarray, ...]
    quieted: tuple[tuple[np.ndarray, np.ndarray], ...]
    likelihood: float
    gain: float
    loudness: tuple[np.ndarray, ...]
    noise_rms: float
    force_rms: float

    @property
    def rms(self) -> float:
        """Rms [N] of both together."""
        return math.hypot(self.noise_rms, self.force_rms)


@dataclass(frozen=True)
class _Whitened:
    """The residual (n,) and columns (n, m) of one record in units of noise, and the weights (n,), 0 where unused."""

    residual: np.ndarray
    columns: np.ndarray
    size: np.ndarray  # (m,) of the columns before they had unit rms
    weights: np.ndarray

    @cached_property
    def normal(self) -> np.ndarray:
        return (self.columns * self.weights[:, None]).T @ self.columns

    @cached_property
    def pull(self) -> np.ndarray:
        return np.asarray(self.columns.T @ (self.weights * self.residual))


def noise_of(
    unknown: Unknown,
    residuals: tuple[np.ndarray, ...],
    first: Whitening,
    least: float,
    odds: float,
    loud: tuple[np.ndarray, ...] = (),
) -> Noise:
    """The noise and the unknown force of ``residuals`` (n,) [N] per record.

    ``first`` is the noise to begin with, ``least`` [N] the smallest deviation of an innovation, ``odds`` [nats] what a
    group of the unknown force costs, ``loud`` (n,) per record the gain of noise.
    """
    used = unknown.problem.masks("used")
    samples = unknown.problem.samples("used")
    loud = loud or tuple(np.ones(r.size) for r in residuals)
    amplified = sum(float(np.sum(np.log(gain[mask]))) for gain, mask in zip(loud, used, strict=True))
    innovations = [first.apply(r) / gain for r, gain in zip(residuals, loud, strict=True)]
    variances = np.ones(len(GROUPS))
    explained = tuple(np.zeros_like(r) for r in residuals)
    for turn in range(SCALES):
        weights = _weights(innovations, used)
        spread = tuple(gain / np.sqrt(w) for gain, w in zip(loud, weights, strict=True))
        rest = [(r - e) / s for r, e, s in zip(residuals, explained, spread, strict=True)]
        whitening = _autoregressive(rest, used, least) if turn else first
        whitened = [
            _whitened(r, b, whitening, gain, w * mask)
            for r, b, gain, w, mask in zip(residuals, unknown.responses, loud, weights, used, strict=True)
        ]
        variances = _paying(whitened, unknown.group, _variances(whitened, unknown.group, variances), odds)
        posterior = [_posterior(part, variances[unknown.group]) for part in whitened]
        explained = tuple(b @ p.coefficients for b, p in zip(unknown.responses, posterior, strict=True))
        innovations = [
            part.residual - part.columns @ (p.coefficients * part.size)
            for part, p in zip(whitened, posterior, strict=True)
        ]
        picked = np.concatenate([x[mask] for x, mask in zip(innovations, used, strict=True)])
        scale = max(_scale(picked), least / whitening.std)
        offset = -samples * math.log(whitening.std) - amplified
        cost = sum(p.penalty for p in posterior) + odds * np.count_nonzero(variances)
        likelihood = _student(picked, scale) + offset - cost
    plain = np.concatenate([part.residual[mask] for part, mask in zip(whitened, used, strict=True)])
    quiet = [(r - e) / gain for r, e, gain in zip(residuals, explained, loud, strict=True)]
    known = [e / gain for e, gain in zip(explained, loud, strict=True)]
    return Noise(
        whitening,
        variances,
        tuple(p.coefficients for p in posterior),
        tuple((p.basis, p.share) for p in posterior),
        likelihood,
        likelihood - offset - _student(plain, max(_scale(plain), least / whitening.std)),
        tuple(gain / np.sqrt(w) for gain, w in zip(loud, _weights(innovations, used), strict=True)),
        usual_rms([x[mask] for x, mask in zip(quiet, used, strict=True)]),
        float(np.std(np.concatenate([x[mask] for x, mask in zip(known, used, strict=True)]))),
    )


def _weights(innovations: list[np.ndarray], used: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """The precision (n,) of every sample under the scale that fits all of them."""
    scale = _scale(np.concatenate([x[mask] for x, mask in zip(innovations, used, strict=True)]))
    return tuple(_precision(x, scale) for x in innovations)


def _precision(x: np.ndarray, scale: float) -> np.ndarray:
    """The expected precision of every sample of ``x`` (n,), relative to 1/``scale``^2, by Student's tails."""
    return np.asarray((TAILS + 1) / (TAILS + (x / scale) ** 2))


def _whitened(
    residual: np.ndarray, columns: np.ndarray, whitening: Whitening, gain: np.ndarray, weights: np.ndarray
) -> _Whitened:
    from scipy.signal import lfilter

    filtered = lfilter(whitening.coefficients / whitening.std, (1.0,), columns, axis=0) / gain[:, None]
    size = np.maximum(np.sqrt(np.mean(filtered[weights > 0] ** 2, axis=0)), 1e-300)
    return _Whitened(whitening.apply(residual) / gain, filtered / size, size, weights)


@dataclass(frozen=True)
class _Posterior:
    """The ``coefficients`` (m,) of the unknown force; ``basis`` and ``share`` as in :class:`Noise`; the ``penalty``."""

    coefficients: np.ndarray
    basis: np.ndarray
    share: np.ndarray
    penalty: float


def _posterior(part: _Whitened, variances: np.ndarray) -> _Posterior:
    """The posterior of ``b`` (m,) with prior ``variances`` (m,): its mean, and what integrating it costs [nats]."""
    kept = variances > NEGLIGIBLE
    root = np.sqrt(variances[kept])
    inner = part.normal[np.ix_(kept, kept)] * np.outer(root, root)
    eigenvalues, vectors = np.linalg.eigh(inner)
    sound = eigenvalues > 1e-8 * eigenvalues.max(initial=1e-300)
    eigenvalues, vectors = eigenvalues[sound], vectors[:, sound]
    along_them = vectors.T @ (root * part.pull[kept]) / (1.0 + eigenvalues)
    coefficients = np.zeros(variances.size)
    coefficients[kept] = root * (vectors @ along_them)
    penalty = 0.5 * float(np.sum(np.log1p(eigenvalues))) + 0.5 * float(along_them @ along_them)
    weighted = part.columns[:, kept] * root * np.sqrt(part.weights)[:, None]
    basis = weighted @ (vectors / np.sqrt(eigenvalues))
    return _Posterior(coefficients / part.size, basis, 1.0 - 1.0 / np.sqrt(1.0 + eigenvalues), penalty)


def _paying(parts: list[_Whitened], group: np.ndarray, variances: np.ndarray, odds: float) -> np.ndarray:
    """``variances`` (groups,) without the groups that raise the likelihood by less than their ``odds`` [nats]."""
    whole = _gain(parts, variances[group])
    while variances.any():
        active = np.flatnonzero(variances)
        fewer = []
        for number in active:
            rest = np.where(np.arange(variances.size) == number, 0.0, variances)
            rest = np.where(rest > 0, _variances(parts, group, rest, rest > 0), 0.0)
            fewer.append((_gain(parts, rest[group]), rest))
        gain, rest = max(fewer, key=lambda pair: pair[0])
        if whole - gain > odds:
            break
        whole, variances = gain, rest
    return variances


def _gain(parts: list[_Whitened], variances: np.ndarray) -> float:
    """What an unknown force of ``variances`` (m,) gains in the likelihood of Gaussian innovations [nats]."""
    root, total = np.sqrt(variances), 0.0
    for part in parts:
        inner = part.normal * np.outer(root, root) + np.eye(root.size)
        along_it = root * part.pull
        total += 0.5 * float(along_it @ np.linalg.solve(inner, along_it)) - 0.5 * float(np.linalg.slogdet(inner)[1])
    return total


def _variances(
    parts: list[_Whitened], group: np.ndarray, start: np.ndarray, active: np.ndarray | None = None
) -> np.ndarray:
    """Variances of the ``active`` groups of most likelihood, of Gaussian innovations (MacKay's fixed point, 1992)."""
    active = np.ones(len(GROUPS), bool) if active is None else active
    variances = np.where(active, np.maximum(start, 0.01), 0.0)
    for _ in range(VARIANCES):
        squares, free = np.zeros(len(GROUPS)), np.zeros(len(GROUPS))
        root = np.sqrt(np.maximum(variances[group], 1e-14))
        for part in parts:
            inverse = np.linalg.inv(part.normal * np.outer(root, root) + np.eye(root.size))
            mean = root * (inverse @ (root * part.pull))
            squares += np.bincount(group, mean * mean, len(GROUPS))
            free += np.bincount(group, 1.0 - np.diag(inverse), len(GROUPS))
        variances = np.where(active & (free > 0.2), squares / np.maximum(free, 0.2), 0.0)
    return variances


def _autoregressive(rest: list[np.ndarray], used: tuple[np.ndarray, ...], least: float) -> Whitening:
    """The autoregressive noise of ``rest`` (n,) [N] per record in the samples ``used``."""
    lags, samples = np.zeros(ORDER + 1), sum(int(mask.sum()) for mask in used)
    for x, mask in zip(rest, used, strict=True):
        lags += autocovariance(np.where(mask, x, 0.0), samples, ORDER + 1)
    whitening = Whitening.of_autocovariance(lags)
    return Whitening(whitening.coefficients, max(whitening.std, least))


def _scale(x: np.ndarray) -> float:
    """The scale of Student's t that fits ``x`` (n,)."""
    scale = max(float(np.median(np.abs(x))) / 0.67, 1e-9)
    for _ in range(10):
        scale = max(float(np.sqrt(np.mean(_precision(x, scale) * x * x))), 1e-9)
    return scale


def _student(x: np.ndarray, scale: float) -> float:
    """Log-likelihood of ``x`` (n,) under Student's t."""
    constant = math.lgamma((TAILS + 1) / 2) - math.lgamma(TAILS / 2) - 0.5 * math.log(TAILS * math.pi)
    tails = float(np.sum(np.log1p((x / scale) ** 2 / TAILS)))
    return x.size * (constant - math.log(scale)) - 0.5 * (TAILS + 1) * tails


@dataclass(frozen=True)
class Judged:
    """A fitted set of effects, the unknown force beside it, its noise, and its evidence [nats]."""

    fit: Fit
    unknown: Unknown
    noise: Noise
    evidence: float

    @property
    def model(self) -> Candidate:
        """The fitted model."""
        return self.fit.model

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return self.fit.model.names

    @property
    def bounces(self) -> bool:
        """Whether an effect has play."""
        return any(effect.play for effect in self.fit.model.effects)

    def under(self, quiet: bool = True, weighed: bool = False) -> Hypothesis:
        """The model judged by its own noise, beside the unknown force, with the weights of its samples."""
        problem = replace(
            self.unknown.problem,
            whitening=self.noise.whitening,
            quieted=self.noise.quieted if quiet else (),
            loudness=self.noise.loudness if weighed else (),
        )
        return Hypothesis(problem, self.fit.model)


Say = Callable[[str], None]


@dataclass(frozen=True)
class Moves:
    """The records of a ``preparation``, all used samples fitted, and the ``floor`` that their noise cannot go below."""

    preparation: Preparation
    problem: Problem
    floor: Floor
    say: Say

    @property
    def known(self) -> tuple[str, ...]:
        """Effects known from the controller's law."""
        return self.preparation.start.model.names

    @property
    def least(self) -> float:
        """The smallest deviation [N] of an innovation."""
        return FLOOR[0 if self.floor.from_laps else 1] * self.floor.whitening.std

    @property
    def odds(self) -> float:
        """What an effect, or a group of unknown forces, must gain [nats]."""
        return ODDS + WORTH * self.problem.samples("used")

    def judged(self, fitted: Fit, unknown: Unknown) -> Judged | None:
        """``fitted`` with its noise and evidence; None where it cannot be simulated."""
        if not fitted.innovations:
            return None
        unweighed = Hypothesis(replace(fitted.problem, loudness=(), quieted=()), fitted.model)
        loud = evaluate(unweighed).loudness if fitted.model.effects else ()
        noise = noise_of(unknown, unknown.whole(fitted.residuals()), self.floor.whitening, self.least, self.odds, loud)
        count = len(fitted.model.effects) - len(self.known)
        return Judged(fitted, unknown, noise, noise.likelihood + self._occam(fitted) - self.odds * count)

    def _occam(self, fitted: Fit) -> float:
        """Laplace's integral over the parameters, relative to the likelihood at their best values [nats]."""
        slots = fitted.slots or fitted.model.slots()
        values, axis = fitted.model.vector(slots), self.problem.axis.mechanics.array()
        width = np.array([self._width(slot, value) for slot, value in zip(slots, values, strict=True)])
        centre = np.array([axis[slot.place] if slot.effect < 0 else 0.0 for slot in slots])
        drawn = np.array([slot.effect < 0 or _of(slot).linear for slot in slots])
        apart = np.where(drawn, np.minimum(((values - centre) / width) ** 2, 25.0), 0.0)
        volume = 0.0
        if fitted.covariance.shape == (len(slots),) * 2 and fitted.covariance.any():
            eigenvalues = np.linalg.eigvalsh(fitted.covariance / np.outer(width, width))
            eigenvalues = np.maximum(eigenvalues, 1e-14)
            volume = 0.5 * float(np.sum(np.log(eigenvalues / (1.0 + eigenvalues))))
        return volume - 0.5 * float(apart.sum())

    def _width(self, slot: Slot, value: float) -> float:
        """The deviation of the prior of a parameter."""
        if slot.effect < 0:
            return BASELINE_WIDTH * slot.magnitude
        parameter = _of(slot)
        if parameter.linear:
            typical = parameter.scale or max((abs(start) for start in parameter.starts), default=0.0) or abs(value)
            return WIDTH * max(typical, 1e-12)
        if np.isfinite(parameter.lower) and np.isfinite(parameter.upper):
            return (parameter.upper - parameter.lower) / math.sqrt(12.0)
        if parameter.unit == "s" and parameter.per_record:
            return self.problem.records[0].duration / math.sqrt(12.0)
        return SPREAD * max(abs(value), slot.magnitude)

    def settled(self, judged: Judged) -> Judged:
        """A set fitted to convergence under its own noise, beside its own unknown force where it needs one."""
        judged = self.linearised(judged)
        for _ in range(1 if judged.bounces else CONVERGED):
            again = fit(judged.under(weighed=True))
            again = converged(again) if again.model.effects else again
            better = self.judged(again, judged.unknown) if admissible(again) else None
            if better is None or better.evidence <= judged.evidence:
                return judged
            gain, judged = better.evidence - judged.evidence, self.linearised(better)
            if gain < ALIKE:
                return judged
        return judged

    def linearised(self, judged: Judged) -> Judged:
        """The set with its unknown force linearised around its own motion, and in the loop where it is needed."""
        start = judged.fit
        with suppress(SimulationError):
            plain = Hypothesis(self.problem.with_whitening(judged.noise.whitening), judged.model)
            best = self.judged(evaluate(plain, start.slots, start.covariance), Unknown.of(plain)) or judged
            for _ in range(IN_TURN):
                if best.noise.gain < NEAR:
                    break
                force = tuple(f @ b for f, b in zip(best.unknown.forces, best.noise.coefficients, strict=True))
                problem = self.problem.with_whitening(best.noise.whitening).with_acting(force)
                acted = Hypothesis(problem, judged.model)
                again = self.judged(evaluate(acted, start.slots, start.covariance), Unknown.of(acted, force))
                if again is None or again.evidence <= best.evidence:
                    break
                best = again
            return best
        return judged

    def best(self, fits: list[Fit], unknown: Unknown) -> list[Judged]:
        """The best few admissible fits, judged, best first."""
        sound = sorted(filter(admissible, fits), key=lambda fitted: fitted.cost)[:JUDGED]
        judged = side_by_side(self.judged, [(fitted, unknown) for fitted in sound])
        return sorted((j for j in judged if j is not None), key=lambda j: -j.evidence)

    def added(self, current: Judged, general: bool = False) -> list[Judged]:
        """Sets with one effect more, instead of the unknown force and beside it, best first."""
        sets, library = list[Judged](), shapes(self.preparation.library, general=general)
        acts = any(map(np.any, current.unknown.mean))
        instead = Unknown.of(Hypothesis(self.problem, current.model)) if acts else current.unknown
        for unknown, quiet in ((instead, False), (current.unknown, True)):
            if quiet and current.noise.gain < KNOWN:
                continue
            noise = current.noise if quiet else self.coloured(current)
            problem = replace(unknown.problem, whitening=noise.whitening, quieted=noise.quieted if quiet else ())
            begins = [evaluate(Hypothesis(problem, current.model))]
            if not current.model.effects:
                begins += [evaluate(other) for other in either_baseline(begins[0])[1:]]
            fits = [f for begin in begins if begin.innovations for f in extended(begin, library)[0]]
            sets += self.best(fits, unknown)
        return sorted(sets, key=lambda j: -j.evidence)

    def coloured(self, current: Judged) -> Noise:
        """The noise of a set where all that it leaves is noise, without an unknown force."""
        residuals = current.unknown.whole(current.fit.residuals())
        rest = [r / loud for r, loud in zip(residuals, current.noise.loudness, strict=True)]
        return replace(current.noise, whitening=_autoregressive(rest, self.problem.masks("used"), self.least))

    def dropped(self, current: Judged) -> list[Judged]:
        """Sets with one effect less, best first."""
        start = current.under()
        models = [current.model.without(i) for i, name in enumerate(current.names) if name not in self.known]
        return self.best(side_by_side(fit, [(start.with_model(m),) for m in models]), current.unknown)

    def exchanged(self, current: Judged) -> list[Judged]:
        """Sets with one effect exchanged for one it is confused with, or started anew, best first."""
        begin = evaluate(current.under())
        return self.best(exchanges(begin, self.known, self.preparation.library), current.unknown)

    def better(self, current: Judged, moves: list[Judged], what: str) -> Judged | None:
        """The best of ``moves`` that has more evidence than ``current`` once it has converged."""
        for move in moves[:3]:
            self.say(f"   {what} {'+'.join(move.names)} {move.evidence - current.evidence:+.0f}")
        first = moves[: 1 if moves and moves[0].bounces else LEADING]
        leading = [self.settled(move) for move in first if move.evidence > current.evidence - NEAR]
        best = max(leading, key=lambda j: j.evidence, default=None)
        return best if best is not None and best.evidence > current.evidence + ALIKE else None

    def next(self, current: Judged) -> Judged | None:
        """The set that one move reaches, in the order of the effort; None where no move raises the evidence."""
        moves = self.added(current) if len(current.names) < MOST else []
        better = self.better(current, moves, "add")
        if better is None and len(current.names) > len(self.known):
            better = self.better(current, self.exchanged(current), "exchange")
            better = better or self.better(current, self.dropped(current), "drop")
        if better is None:
            pairs = [pair for first in moves[:LEADING] for pair in self.added(self.settled(first))[:LEADING]]
            better = self.better(current, sorted(pairs, key=lambda j: -j.evidence), "pair")
        if better is None and len(current.names) < MOST:
            better = self.better(current, self.added(current, general=True), "curve")
        return better


def _of(slot: Slot) -> Parameter:
    """The parameter of an effect in ``slot``."""
    assert isinstance(slot.quantity, Parameter)
    return slot.quantity


def most_evident(preparation: Preparation, say: Say = lambda text: None) -> tuple[Moves, Judged]:
    """The set of effects with the most evidence that the moves reach."""
    rough, floor = first_noise(preparation)
    splits = tuple(replace(s, fit=s.used, select=np.zeros_like(s.fit)) for s in rough.problem.splits)
    problem = replace(rough.problem, splits=splits)
    search = Moves(preparation, problem, floor, say)
    baseline = fit(Hypothesis(problem.with_whitening(floor.whitening), rough.model), steps=20)
    current = search.judged(baseline, Unknown.of(baseline))
    if current is None:
        raise RecordError("the baseline cannot be simulated along the records")
    current = search.settled(current)
    for _ in range(PASSES):
        noise = current.noise
        say(f"{'+'.join(current.names)} {current.evidence:.0f}: unknown {noise.gain:.0f}, {noise.rms:.3g} N")
        better = search.next(current)
        if better is None:
            break
        current = better
    return search, current


@dataclass(frozen=True)
class Conclusion:
    """The verdict, the effects named, others as good as each, and the evidence and confirmation [nats] of each."""

    verdict: str
    names: tuple[str, ...]
    equivalents: dict[str, list[str]]
    evidence: dict[str, tuple[float, float]]
    withdrawn: tuple[str, ...]
    best: Judged
    remaining: float


def answered(preparation: Preparation, say: Say = lambda text: None) -> Conclusion:
    """The answer on a ``preparation``: the most evident set, confirmed effect by effect on the data held out."""
    search, best = most_evident(preparation, say)
    names = [name for name in best.names if name not in search.known]
    equivalents: dict[str, list[str]] = {name: [] for name in names}
    for other in search.exchanged(best) if names else []:
        gone, new = set(best.names) - set(other.names), set(other.names) - set(best.names)
        if len(gone) == len(new) == 1 and other.evidence > best.evidence - ALIKE:
            equivalents[gone.pop()].append(new.pop())
    data, remaining = preparation.held_out, best.noise.rms
    evidence: dict[str, tuple[float, float]] = {}
    whole = None if data is None else _on(search, data, best, best)
    if whole is not None:
        remaining = min(remaining, whole.rms)
    for name in names:
        rest = fit(best.under().with_model(best.model.without(best.names.index(name))))
        without = search.judged(rest, best.unknown)
        if without is None:
            evidence[name] = math.inf, math.inf
            continue
        there = None if data is None else _on(search, data, without, best)
        gain = math.inf if whole is None or there is None else whole.likelihood - there.likelihood
        evidence[name] = best.evidence - without.evidence, gain
    stands = tuple(name for name in names if min(evidence[name]) > KNOWN)
    structure = remaining > STRUCTURE * search.floor.force or best.noise.variances.any()
    if not stands:
        verdict = "unnamed" if structure else "nothing-missing"
    elif structure:
        verdict = "partly-named"
    else:
        verdict = "ambiguous" if any(equivalents[name] for name in stands) else "named"
    withdrawn = tuple(name for name in names if name not in stands)
    return Conclusion(verdict, stands, equivalents, evidence, withdrawn, best, remaining)


def _on(search: Moves, data: HeldOut, judged: Judged, best: Judged) -> Noise | None:
    """The noise of a set on the confirming ``data``; None where it cannot be simulated there."""
    data = data.with_whitening(judged.noise.whitening)
    there = replace(search, problem=data.problem)
    with suppress(SimulationError):
        model = adapt(data, judged.model, best.model)
        fitted = evaluate(Hypothesis(data.problem, model))
        if fitted.innovations:
            first = there.judged(fitted, Unknown.of(fitted))
            return None if first is None else there.linearised(first).noise
    return None
