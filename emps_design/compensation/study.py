"""Try a feed-forward in closed loop on the nonlinear axis: each term alone, together, and with wrong parameters.

The machine stays as the axis says; the feed-forward gets parameters that are wrong by the ``mismatch``, phases by the
``phase`` error, each in the direction that does more harm, all at once. A term that does more harm than good there is
left out.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.compensation.feedback import feedback_cures
from emps_design.compensation.feedforward import (
    BASELINE,
    LEAD,
    FeedForward,
    names_of_effects,
    reversal_of,
    terms_of,
)
from emps_design.control.nested_loops import nested_loops, worst_loop
from emps_design.errors import InputError, SimulationError, UnstableError
from emps_design.laws import Law, law_of

if TYPE_CHECKING:
    from emps_design.axis import Axis

MISMATCH, PHASE_DEG = 0.02, 10.0  # errors of parameters and of phases
ON_ERROR = "beside a feed-forward the law is given the position error alone: reference 0, position less the reference"
PER_RECORD = "its phase is that of one record's zero: home the encoder before it is used"


@dataclass(frozen=True)
class TermResult:
    """One term: tracking error with it ``alone``, with all the others but it, and what became of it."""

    name: str
    kept: bool
    alone: float
    left_out: float | None
    worst: float | None
    note: str = ""


@dataclass(frozen=True)
class Compensation:
    """A feed-forward and what it does to the tracking error rms, in the unit of what the law follows."""

    axis: Axis
    feedforward: FeedForward
    q_ref: np.ndarray = field(repr=False)
    without: float
    baseline: float
    achieved: float
    worst: float
    terms: tuple[TermResult, ...]
    not_compensated: dict[str, str]
    mismatch: float
    phase_deg: float
    limited: float
    overshoot: tuple[float, float]
    unit: str
    feedback: tuple[dict[str, Any], ...] = ()
    warnings: tuple[str, ...] = ()

    def errors(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Time [s] and tracking error (n,), without feed-forward and with what is kept."""
        trial = Trial(self.axis, self.q_ref)
        found = {"without": trial.error(None)[0], "with": trial.error(trial.ahead(self.feedforward))[0]}
        return self.axis.sampling.period * np.arange(self.q_ref.size), found

    def to_dict(self) -> dict[str, Any]:
        """The contract's keys, and what was assumed."""
        return {
            "axis": self.axis.name,
            "axis_sha256": digest_of(self.axis),
            "tracking_rms": {
                "without": self.without,
                "baseline": self.baseline,
                "with": self.achieved,
                "worst": self.worst,
            },
            "terms": [vars(term) for term in self.terms],
            "not_compensated": self.not_compensated,
            "feedback": list(self.feedback),
            "kept": list(self.feedforward.terms),
            "reversal": self.feedforward.reversal,
            "lead": self.feedforward.wait,
            "law_taken_off": bool(self.feedforward.terms),
            "assumed": {
                "mismatch": self.mismatch,
                "phase_deg": self.phase_deg,
                **({"law": ON_ERROR} if self.feedforward.terms else {}),
                "not_varied": "periods and lengths, whose error is that of the phase, and exponents",
            },
            "limited_share": self.limited,
            "overshoot": dict(zip(("without", "with"), self.overshoot, strict=True)),
            "worst_loop": worst_loop(nested_loops(self.axis)).to_dict(),
            "units": {
                "overshoot": self.unit,
                "tracking_rms": self.unit,
                "alone": self.unit,
                "lead": "s",
                "reversal": self.axis.units.unit("m/s"),
            },
            "warnings": list(self.warnings),
        }


def digest_of(axis: Axis) -> str:
    """SHA-256 of all that ``axis`` says but its name."""
    return hashlib.sha256(axis.replace(name="axis").to_toml().encode()).hexdigest()


@dataclass(frozen=True)
class Trial:
    """An axis and a reference, on which feed-forwards are tried."""

    axis: Axis
    q_ref: np.ndarray

    @cached_property
    def _plant(self) -> Any:
        from emps_design.simulation import Plant

        return Plant.of(self.axis)

    @cached_property
    def law(self) -> Law:
        """The law of the axis."""
        return law_of(self.axis, self.axis.sampling.period)

    @cached_property
    def _follows_velocity(self) -> bool:
        if self.law.follows == "rest position":
            raise InputError(
                f"controller.kind: found {self.axis.controller.kind!r}, which follows no reference; expected a law "
                "that follows a position or a velocity"
            )
        return self.law.follows == "velocity"

    @property
    def unit(self) -> str:
        """Unit of the tracking error."""
        return self.axis.units.unit("m/s" if self._follows_velocity else "m")

    def error(self, ahead: np.ndarray | None) -> tuple[np.ndarray, float]:
        """Tracking error (n,) with ``ahead`` (n,) beside the law on its error, and the share of samples at the limit.

        None for ``ahead``: the law alone, as it is. Raises :class:`SimulationError` where the loop is unstable.
        """
        law = self.law if ahead is None else self.law.on_error()
        run = self._plant.closed_loop(self.q_ref, voltage_noise=ahead, law=law)
        limited = float(np.mean(np.abs(run.u) >= self.axis.drive.command_limit))
        return self.wanted - (run.v if self._follows_velocity else run.position), limited

    @property
    def wanted(self) -> np.ndarray:
        """What the law is to follow (n,) [m or m/s]."""
        return np.gradient(self.q_ref, self.axis.sampling.period) if self._follows_velocity else self.q_ref

    def overshoot(self, ahead: np.ndarray | None) -> float:
        """How far beyond all that is wanted the axis goes, in the unit of the tracking error; infinite if unstable."""
        wanted = self.wanted
        try:
            came = wanted - self.error(ahead)[0]
        except SimulationError:
            return math.inf
        return float(max(came.max() - wanted.max(), wanted.min() - came.min(), 0.0))

    def run(self, ahead: np.ndarray | None) -> tuple[float, float]:
        """Rms of :meth:`error`, infinite where the loop is unstable, and the share of samples at the limit."""
        try:
            error, limited = self.error(ahead)
        except SimulationError:
            return math.inf, 1.0
        return float(np.sqrt(np.mean(error**2))), limited

    def ahead(self, feedforward: FeedForward) -> np.ndarray | None:
        """What ``feedforward`` adds to the command (n,); None for nothing."""
        return feedforward.along(self.q_ref) if feedforward.terms else None

    def with_ahead(self, feedforward: FeedForward) -> tuple[float, float]:
        """:meth:`run` with ``feedforward``."""
        return self.run(self.ahead(feedforward))

    def rms(self, feedforward: FeedForward) -> float:
        """Rms of the tracking error with ``feedforward``."""
        return self.with_ahead(feedforward)[0]

    @cached_property
    def with_terms(self) -> Callable[[tuple[str, ...]], tuple[float, float]]:
        """:meth:`with_ahead` of terms with the axis's own numbers; each set of terms is run once."""
        return cache(lambda terms: self.with_ahead(FeedForward.of(self.axis, terms)))


def compensate(
    axis: Axis,
    q_ref: np.ndarray | None = None,
    mismatch: float = MISMATCH,
    phase_deg: float = PHASE_DEG,
    terms: Sequence[str] | None = None,
) -> Compensation:
    """Find the feed-forward of ``axis`` that lowers the tracking error along ``q_ref`` (n,) [m], and try it.

    ``q_ref`` by default one lap of trapezoids of velocity; ``mismatch`` is the relative error of the parameters,
    ``phase_deg`` that of phases; ``terms`` the only ones to take, by default all. Raises :class:`InputError` for a law
    that follows nothing and for another term, :class:`UnstableError` where the loop is unstable without feed-forward.

    >>> from emps_design.machines import machine
    >>> found = compensate(machine("emps2019")).to_dict()["tracking_rms"]
    >>> found["with"] < 0.05 * found["without"]
    True
    """
    for name, value in (("mismatch", mismatch), ("phase_deg", phase_deg)):
        if not (math.isfinite(value) and value >= 0.0):
            raise InputError(f"`{name}`: found {value:g}, expected a number of at least 0")
    if q_ref is None:
        from emps_design.simulation import trapezoid_laps

        q_ref = trapezoid_laps(axis.sampling.period, laps=1)
    possible, left = terms_of(axis)
    unknown = [name for name in terms or () if name not in possible]
    if unknown:
        raise InputError(f"compensation: found the term {unknown[0]!r}, expected one of {', '.join(possible)}")
    trial = Trial(axis, q_ref)
    without, _ = trial.with_terms(())
    if not math.isfinite(without):
        raise UnstableError(f"axis {axis.name}: the loop is unstable without any feed-forward; design it first")
    possible = tuple(name for name in possible if terms is None or name in terms)
    baseline, _ = trial.with_terms(tuple(BASELINE))
    alone = {name: trial.with_terms((name,))[0] for name in possible}
    kept, notes, trials = _selected(trial, possible, mismatch, phase_deg)
    rigid = tuple(name for name in kept if name in BASELINE)
    if trial.with_terms(kept)[0] > trial.with_terms(rigid)[0]:
        notes |= {name: "together with the others it does harm" for name in kept if name not in BASELINE}
        kept = rigid
    if trial.with_terms(kept)[0] > without:
        notes |= dict.fromkeys(kept, "no feed-forward lowers the error")
        kept = ()
    ahead = replace(FeedForward.of(axis, kept), reversal=reversal_of(q_ref, axis.sampling.period))
    achieved, limited = trial.with_terms(kept)
    worst = _worst(trial, kept, mismatch, phase_deg)
    warnings = [f"{name} is not compensated: {reason}" for name, reason in left.items()]
    warnings += [f"{name} is left out: {note}" for name, note in notes.items()]
    if kept and axis.controller.parameters.get("anti_windup") == "none":
        warnings.append(
            "anti_windup none: beside a feed-forward the integral has all of an error that the limit leaves, and may "
            "keep the axis swinging; take hold"
        )
    overshoot = trial.overshoot(None), trial.overshoot(trial.ahead(ahead))
    if limited > 0.0:
        warnings.append(f"the command is at its limit {100 * limited:.2g} % of the time{_farther(*overshoot, trial)}")
    tried = tuple(
        TermResult(name, name in kept, alone[name], *trials[name], notes.get(name, _home(axis, name)))
        for name in possible
    )
    return Compensation(
        axis, ahead, q_ref, without, baseline, achieved, worst, tried, left, mismatch, phase_deg, limited,
        overshoot, trial.unit, tuple(feedback_cures(axis)), tuple(warnings),
    )  # fmt: skip


def _farther(without: float, achieved: float, trial: Trial) -> str:
    """In words that the feed-forward takes the axis farther beyond its reference than the law alone does."""
    if not achieved > max(1.05 * without, 1e-3 * float(np.ptp(trial.wanted))):
        return ""
    unit = "mm/s" if trial.law.follows == "velocity" else "mm"
    return (
        f", and the axis goes up to {1e3 * achieved:.3g} {unit} beyond the reference, {1e3 * without:.3g} {unit} "
        "without feed-forward, which lags behind instead: the limit does not let it follow; ask for less acceleration"
    )


def _selected(
    trial: Trial, possible: Sequence[str], mismatch: float, phase_deg: float
) -> tuple[tuple[str, ...], dict[str, str], dict[str, tuple[float | None, float | None]]]:
    """Terms that are worth it at their worst; notes on those that are not; errors without each, and at its worst."""
    kept, notes = list(possible), dict[str, str]()
    trials: dict[str, tuple[float | None, float | None]] = {}
    while True:
        harm: dict[str, float] = {}
        for name in kept:
            others = tuple(one for one in kept if one != name)
            lacking, _ = trial.with_terms(others)
            worst = _worst(trial, tuple(kept), mismatch, phase_deg, only=name)
            trials[name] = (lacking, worst)
            if worst > lacking:
                harm[name] = worst / lacking if lacking > 0.0 else math.inf
        if not harm:
            return tuple(kept), notes, trials
        name = max(harm, key=lambda one: harm[one])
        kept.remove(name)
        notes[name] = f"within its uncertainty it does harm, {100 * (harm[name] - 1):.2g} % more error than without it"


def _home(axis: Axis, name: str) -> str:
    for own, one in zip(names_of_effects(axis), axis.effects, strict=True):
        if own == name and any(p.per_record for p in one.effect.parameters):
            return PER_RECORD
    return ""


def _worst(trial: Trial, terms: tuple[str, ...], mismatch: float, phase_deg: float, only: str | None = None) -> float:
    """Tracking error with every parameter of ``terms`` (of ``only``) wrong, each the way that alone does more harm."""
    wrong = ahead = FeedForward.of(trial.axis, terms)
    for change in _changes(ahead, mismatch, phase_deg, only):
        sides = [change(side, ahead) for side in (1.0, -1.0)]
        errors = [trial.rms(side) for side in sides]
        wrong = change(1.0 if errors[0] >= errors[1] else -1.0, wrong)
    return max(trial.rms(wrong), trial.with_terms(terms)[0])


def _changes(ahead: FeedForward, mismatch: float, phase_deg: float, only: str | None) -> list[Any]:
    """What can be wrong about ``ahead``: functions of a side, +1 or -1, and a feed-forward to make wrong."""
    found: list[Any] = []
    wanted = ahead.terms if only is None else (only,)
    for name, at in BASELINE.items():
        if name in wanted:
            found.append(lambda side, given, at=at: _with_baseline(given, at, 1.0 + side * mismatch))
    if ahead.back_emf and "viscous" in wanted:
        found.append(lambda side, given: replace(given, back_emf=given.back_emf * (1.0 + side * mismatch)))
    for place, (name, one) in enumerate(zip(names_of_effects(ahead.axis), ahead.axis.effects, strict=True)):
        for at, parameter in enumerate(one.effect.parameters if name in wanted else ()):
            if parameter.discrete or parameter.name == one.effect.repeats:
                continue
            if parameter.unit == "rad":
                found.append(lambda side, given, p=place, at=at: _moved(given, p, at, side * math.radians(phase_deg)))
            else:
                found.append(lambda side, given, p=place, at=at: _scaled(given, p, at, 1.0 + side * mismatch))
    if LEAD in wanted:
        found.append(lambda side, given: replace(given, late=given.late * (1.0 + side * mismatch)))
    return found


def _with_baseline(given: FeedForward, at: int, factor: float) -> FeedForward:
    baseline = given.baseline.copy()
    baseline[at] *= factor
    return replace(given, baseline=baseline)


def _scaled(given: FeedForward, place: int, at: int, factor: float) -> FeedForward:
    return _changed(given, place, at, given.parameters[place][at] * factor)


def _moved(given: FeedForward, place: int, at: int, by: float) -> FeedForward:
    return _changed(given, place, at, given.parameters[place][at] + by)


def _changed(given: FeedForward, place: int, at: int, value: float) -> FeedForward:
    parameters = [values.copy() for values in given.parameters]
    parameters[place][at] = value
    return replace(given, parameters=tuple(parameters))
