"""Test a feed-forward in closed loop on the nonlinear axis: each term alone, all together, and with wrong parameters.

The machine does not change. The parameters of the feed-forward are wrong by the ``mismatch``, its phases by the
``phase`` error, all at once and each with the sign that increases the error more. A term that then increases the error
is left out.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.compensation.feedforward import (
    BASELINE,
    LEAD,
    FeedForward,
    feedback_cures,
    named_effects,
    reversal_of,
    terms_of,
)
from emps_design.control.sampled import loop_in_words
from emps_design.control.verdict import worst_loop_of
from emps_design.errors import InputError, SimulationError, UnstableError
from emps_design.laws import Law, law_of
from emps_design.messages import Message, warning
from emps_design.simulation import Plant, trapezoid_laps
from emps_design.view import Line, Table, View, Viewed

MISMATCH, PHASE_DEG = 0.02, 10.0  # errors of parameters and of phases
ON_ERROR = "with feed-forward the law acts on the position error only: reference 0, position minus the reference"
PER_RECORD = "its phase refers to the encoder zero of one record: home the encoder before use"


@dataclass(frozen=True)
class TermResult:
    """One term: tracking error with it ``alone``, without it, with its worst errors, and whether it is ``kept``."""

    name: str
    kept: bool
    alone: float
    left_out: float | None
    worst: float | None
    note: str = ""


@dataclass(frozen=True)
class Compensation(Viewed):
    """A feed-forward, and the rms tracking error with and without it, in the unit of the law's reference."""

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
    warnings: tuple[Message, ...] = ()

    def errors(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Time [s] (n,) and tracking error (n,), ``without`` feed-forward and ``with`` the terms in use."""
        trial = Trial(self.axis, self.q_ref)
        errors = {"without": trial.error(None)[0], "with": trial.error(trial.ahead(self.feedforward))[0]}
        return self.axis.sampling.period * np.arange(self.q_ref.size), errors

    def to_dict(self) -> dict[str, Any]:
        """The keys of the JSON document, with the assumptions."""
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
                "not_varied": "periods and lengths, since the phase error covers them, and exponents",
            },
            "limited_share": self.limited,
            "overshoot": dict(zip(("without", "with"), self.overshoot, strict=True)),
            "worst_loop": worst_loop_of(self.axis).to_dict(),
            "units": {
                "overshoot": self.unit,
                "tracking_rms": self.unit,
                "alone": self.unit,
                "lead": "s",
                "reversal": self.axis.units.unit("m/s"),
            },
            "warnings": list(self.warnings),
        }

    def view(self) -> View:
        """The tracking error of each term and of all together, and advice on the feedback."""
        headings = ("term", "alone", "all others", "all, this wrong", "")
        rows = [
            (term.name.replace("_", " "), term.alone, term.left_out, term.worst, _remark(term)) for term in self.terms
        ]
        title = f"tracking error, rms [{self.unit}], axis {self.axis.name}"
        totals = [
            ("without feed-forward", self.without),
            ("with inertia, friction and constant force", self.baseline),
            ("with all terms in use", self.achieved),
            ("the same, every parameter wrong", self.worst),
        ]
        words = self.axis.units.words
        return (
            Table(headings, rows, title, words=("",), missing=""),
            Table(("all together", "rms", "unit"), [(words(label), rms, self.unit) for label, rms in totals]),
            Line(
                f"wrong: by {100 * self.mismatch:g} %, phases by {self.phase_deg:g} deg, with the less favourable sign"
            ),
            *([Line(f"{ON_ERROR.capitalize()}.")] if self.feedforward.terms else []),
            *(Line(cure["advice"]) for cure in self.feedback),
        )


def _remark(term: TermResult) -> str:
    return term.note if term.kept else f"left out: {term.note}"


def digest_of(axis: Axis) -> str:
    """SHA-256 of the axis file of ``axis`` without its name."""
    return hashlib.sha256(axis.replace(name="axis").to_toml().encode()).hexdigest()


@dataclass(frozen=True)
class Trial:
    """An axis and a reference for testing feed-forwards."""

    axis: Axis
    q_ref: np.ndarray

    @cached_property
    def _plant(self) -> Plant:
        return Plant.of(self.axis)

    @cached_property
    def law(self) -> Law:
        """The law of the axis."""
        return law_of(self.axis, self.axis.sampling.period)

    @cached_property
    def _follows_velocity(self) -> bool:
        if self.law.follows == "rest position":
            raise InputError(
                f"controller.kind: found {self.axis.controller.kind!r}, which has no reference; expected a law that "
                "follows a position or a velocity"
            )
        return self.law.follows == "velocity"

    @property
    def unit(self) -> str:
        """Unit of the tracking error."""
        return self.axis.units.unit("m/s" if self._follows_velocity else "m")

    def error(self, ahead: np.ndarray | None) -> tuple[np.ndarray, float]:
        """Tracking error (n,) with ``ahead`` (n,) added to the law on the error, and the share of samples at the limit.

        With None the law acts alone, unchanged. Raises :class:`SimulationError` if the loop is unstable.
        """
        law = self.law if ahead is None else self.law.on_error()
        run = self._plant.closed_loop(self.q_ref, voltage_noise=ahead, law=law)
        limited = float(np.mean(np.abs(run.u) >= self.axis.drive.command_limit))
        return self.reference - (run.v if self._follows_velocity else run.position), limited

    @property
    def reference(self) -> np.ndarray:
        """The reference of the law (n,) [m or m/s]."""
        return np.gradient(self.q_ref, self.axis.sampling.period) if self._follows_velocity else self.q_ref

    def overshoot(self, ahead: np.ndarray | None) -> float:
        """Overshoot beyond the range of the reference, in its unit; infinite if the loop is unstable."""
        reference = self.reference
        try:
            actual = reference - self.error(ahead)[0]
        except SimulationError:
            return math.inf
        return float(max(actual.max() - reference.max(), reference.min() - actual.min(), 0.0))

    def run(self, ahead: np.ndarray | None) -> tuple[float, float]:
        """Rms of :meth:`error`, infinite if the loop is unstable, and the share of samples at the limit."""
        try:
            error, limited = self.error(ahead)
        except SimulationError:
            return math.inf, 1.0
        return float(np.sqrt(np.mean(error**2))), limited

    def ahead(self, feedforward: FeedForward) -> np.ndarray | None:
        """The command (n,) that ``feedforward`` adds; None without terms."""
        return feedforward.along(self.q_ref) if feedforward.terms else None

    def with_ahead(self, feedforward: FeedForward) -> tuple[float, float]:
        """:meth:`run` with ``feedforward``."""
        return self.run(self.ahead(feedforward))

    def rms(self, feedforward: FeedForward) -> float:
        """Rms of the tracking error with ``feedforward``."""
        return self.with_ahead(feedforward)[0]

    @cached_property
    def with_terms(self) -> Callable[[tuple[str, ...]], tuple[float, float]]:
        """:meth:`with_ahead` for terms with the parameters of the axis, cached by the terms."""
        return cache(lambda terms: self.with_ahead(FeedForward.of(self.axis, terms)))


def compensate(
    axis: Axis,
    q_ref: np.ndarray | None = None,
    mismatch: float = MISMATCH,
    phase_deg: float = PHASE_DEG,
    terms: Sequence[str] | None = None,
) -> Compensation:
    """Find the feed-forward of ``axis`` that reduces the tracking error along ``q_ref`` (n,) [m], and test it.

    ``q_ref`` is by default one lap of trapezoidal velocity; ``mismatch`` is the relative error of the parameters,
    ``phase_deg`` that of phases; ``terms`` are those to choose from, by default all. Raises :class:`InputError` for a
    law without a reference and for an unknown term, :class:`UnstableError` if a loop alone is unstable, in either
    direction.

    >>> from emps_design.machines import machine
    >>> rms = compensate(machine("emps2019")).to_dict()["tracking_rms"]
    >>> rms["with"] < 0.05 * rms["without"]
    True
    """
    for name, value in (("mismatch", mismatch), ("phase_deg", phase_deg)):
        if not (math.isfinite(value) and value >= 0.0):
            raise InputError(f"`{name}`: found {value:g}, expected a number of at least 0")
    if q_ref is None:
        q_ref = trapezoid_laps(axis.sampling.period, laps=1)
    possible, not_compensated = terms_of(axis)
    unknown = [name for name in terms or () if name not in possible]
    if unknown:
        raise InputError(f"compensation: found the term {unknown[0]!r}, expected one of {', '.join(possible)}")
    trial = Trial(axis, q_ref)
    without, _ = trial.with_terms(())
    if not math.isfinite(without):
        raise UnstableError(f"axis {axis.name}: the loop is unstable without feed-forward; stabilise it first")
    loop = worst_loop_of(axis)
    if not loop.margins.stable:  # a short run may end before that shows
        words = loop_in_words(loop, axis.units)
        raise UnstableError(f"axis {axis.name}: the {words} is unstable without feed-forward; stabilise it first")
    possible = tuple(name for name in possible if terms is None or name in terms)
    baseline, _ = trial.with_terms(tuple(BASELINE))
    alone = {name: trial.with_terms((name,))[0] for name in possible}
    kept, notes, trials = _selected(trial, possible, mismatch, phase_deg)
    rigid = tuple(name for name in kept if name in BASELINE)
    if trial.with_terms(kept)[0] > trial.with_terms(rigid)[0]:
        notes |= {name: "increases the error together with the others" for name in kept if name not in BASELINE}
        kept = rigid
    if trial.with_terms(kept)[0] > without:
        notes |= dict.fromkeys(kept, "no feed-forward reduces the error")
        kept = ()
    ahead = replace(FeedForward.of(axis, kept), reversal=reversal_of(q_ref, axis.sampling.period))
    achieved, limited = trial.with_terms(kept)
    worst = _worst(trial, kept, mismatch, phase_deg)
    warnings = [
        warning("not-compensated", f"{name} is not compensated: {reason}", effect=name)
        for name, reason in not_compensated.items()
    ]
    warnings += [warning("term-left-out", f"{name} is left out: {reason}", term=name) for name, reason in notes.items()]
    if kept and axis.controller.parameters.get("anti_windup") == "none":
        text = (
            "anti_windup none: with feed-forward the integral winds up on the whole error at the limit, and may keep "
            "the axis oscillating; use hold"
        )
        warnings.append(warning("winds-up", text))
    overshoot = trial.overshoot(None), trial.overshoot(trial.ahead(ahead))
    if limited > 0.0:
        text = f"the command is at its limit {100 * limited:.2g} % of the time{_farther(*overshoot, trial)}"
        warnings.append(warning("limit-with-feedforward", text, share=limited))
    results = tuple(
        TermResult(name, name in kept, alone[name], *trials[name], notes.get(name, _note_on_phase(axis, name)))
        for name in possible
    )
    return Compensation(
        axis, ahead, q_ref, without, baseline, achieved, worst, results, not_compensated, mismatch, phase_deg, limited,
        overshoot, trial.unit, tuple(feedback_cures(axis)), tuple(warnings),
    )  # fmt: skip


def _farther(without: float, achieved: float, trial: Trial) -> str:
    """Return a clause on a larger overshoot than without feed-forward; "" if there is none."""
    if not achieved > max(1.05 * without, 1e-3 * float(np.ptp(trial.reference))):
        return ""
    base = "mm/s" if trial.law.follows == "velocity" else "mm"
    with_it, without_it = (trial.axis.units.quantity(size, base, ".3g") for size in (achieved, without))
    return (
        f", and the axis overshoots the reference by up to {with_it}, {without_it} without feed-forward, where it lags "
        "behind: at the limit it cannot follow; use less acceleration"
    )


def _selected(
    trial: Trial, possible: Sequence[str], mismatch: float, phase_deg: float
) -> tuple[tuple[str, ...], dict[str, str], dict[str, tuple[float | None, float | None]]]:
    """Return the terms that help even with wrong parameters, notes on the others, and two tracking errors of each.

    These are the error without the term, and that with its parameters wrong.
    """
    kept, notes = list(possible), dict[str, str]()
    trials: dict[str, tuple[float | None, float | None]] = {}
    while True:
        harm: dict[str, float] = {}
        for name in kept:
            others = tuple(term for term in kept if term != name)
            without_it, _ = trial.with_terms(others)
            worst = _worst(trial, tuple(kept), mismatch, phase_deg, only=name)
            trials[name] = (without_it, worst)
            if worst > without_it:
                harm[name] = worst / without_it if without_it > 0.0 else math.inf
        if not harm:
            return tuple(kept), notes, trials
        name = max(harm, key=lambda term: harm[term])
        kept.remove(name)
        notes[name] = f"within its uncertainty the error is {100 * (harm[name] - 1):.2g} % larger than without it"


def _note_on_phase(axis: Axis, name: str) -> str:
    """Return a note if a parameter of the effect ``name`` belongs to one record, else ""."""
    entry = dict(named_effects(axis)).get(name)
    return PER_RECORD if entry is not None and any(p.per_record for p in entry.effect.parameters) else ""


def _worst(trial: Trial, terms: tuple[str, ...], mismatch: float, phase_deg: float, only: str | None = None) -> float:
    """Rms tracking error with all parameters of ``terms`` (of ``only``) wrong, each with the less favourable sign."""
    wrong = ahead = FeedForward.of(trial.axis, terms)
    for change in _changes(ahead, mismatch, phase_deg, only):
        sides = [change(side, ahead) for side in (1.0, -1.0)]
        errors = [trial.rms(side) for side in sides]
        wrong = change(1.0 if errors[0] >= errors[1] else -1.0, wrong)
    return max(trial.rms(wrong), trial.with_terms(terms)[0])


def _changes(ahead: FeedForward, mismatch: float, phase_deg: float, only: str | None) -> list[Any]:
    """Return one function per parameter of ``ahead``: it applies an error of a given sign to a feed-forward."""
    changes: list[Any] = []
    terms = ahead.terms if only is None else (only,)
    phase = math.radians(phase_deg)

    def factor(side: float) -> float:
        return 1.0 + side * mismatch

    for name, at in BASELINE.items():
        if name in terms:
            changes.append(lambda side, nominal, at=at: _with_baseline(nominal, at, factor(side)))
    if ahead.back_emf and "viscous" in terms:
        changes.append(lambda side, nominal: replace(nominal, back_emf=nominal.back_emf * factor(side)))
    for place, (name, entry) in enumerate(named_effects(ahead.axis)):
        for at, parameter in enumerate(entry.effect.parameters if name in terms else ()):
            if parameter.discrete or parameter.name == entry.effect.repeats:
                continue
            if parameter.unit == "rad":
                changes.append(lambda side, nominal, p=place, at=at: _with_parameter(nominal, p, at, 1.0, side * phase))
            else:
                changes.append(lambda side, nominal, p=place, at=at: _with_parameter(nominal, p, at, factor(side)))
    if LEAD in terms:
        changes.append(lambda side, nominal: replace(nominal, late=nominal.late * factor(side)))
    return changes


def _with_baseline(feedforward: FeedForward, at: int, factor: float) -> FeedForward:
    baseline = feedforward.baseline.copy()
    baseline[at] *= factor
    return replace(feedforward, baseline=baseline)


def _with_parameter(feedforward: FeedForward, place: int, at: int, factor: float, shift: float = 0.0) -> FeedForward:
    """Return ``feedforward`` with parameter ``at`` of effect ``place`` scaled by ``factor``, then shifted."""
    parameters = [values.copy() for values in feedforward.parameters]
    parameters[place][at] = factor * parameters[place][at] + shift
    return replace(feedforward, parameters=tuple(parameters))
