"""Observe the external force of a record by every method, and compare it with a measured force.

Of a force with known steps it also gives delay, rise time and plateau of each method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from emps_design.advice import advised
from emps_design.axis import Axis, Mechanics
from emps_design.effects import Motion
from emps_design.errors import InputError, RecordError
from emps_design.identification.excitation import KNOWN
from emps_design.identification.filters import SLOW, held_force, motion, share_of_nyquist
from emps_design.identification.identify import identify
from emps_design.identification.result import Identification
from emps_design.messages import Message, note, warning
from emps_design.observer import (
    DEFAULT_CUTOFF_HZ,
    REST_VELOCITY,
    ForceObserver,
    KalmanForceObserver,
    OnlineObserver,
    SmallestForce,
    as_driven,
    left_out,
    model_force,
    observe_offline,
    observe_online,
    smallest_observable_force,
)
from emps_design.progress import Progress, no_progress, of_part
from emps_design.quantities import rounded
from emps_design.records import Record
from emps_design.request import typed
from emps_design.units import Units
from emps_design.view import Line, Table, View, Viewed

NEAR_AN_EDGE = 0.1  # s, on both sides

OFFLINE_CUTOFF_HZ = 60.0
ONLINE_SHARE, OFFLINE_SHARE = 0.08, 0.25  # of the sampling rate: largest default cut-offs
PARAMETER_UNCERTAINTY = 0.02  # of each parameter where no deviation is known, as in section IV-B
NOISE_STEP = 0.05  # s: changes of the error over this time count as noise
KALMAN_BANDWIDTH = 2.0  # times the cut-off of the first-order low-pass: about the same delay
SETTLED = 0.25  # s at the start and at the end of a record, at least, that do not count in the errors
FILTER_ENDS = 2.0  # periods of the zero-phase filter's cut-off in which it extrapolates beyond the record
FORGOTTEN = 7.0  # delays of an on-line observer after which its initial state no longer matters


@dataclass(frozen=True)
class Steps:
    """Step response of a method to a known force.

    ``delay`` [s] to half of the step and ``rise_time`` [s] from 10 to 90 % of the mean response to all edges;
    ``plateau`` [N] is the mean observed height away from edges, ``plateau_error_percent`` its relative error.
    """

    edges: int
    delay: float | None
    rise_time: float | None
    plateau: float
    plateau_error_percent: float
    rms_error_away_from_edges: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        return dict(self.__dict__)


def step_answer(force: np.ndarray, truth: np.ndarray, period: float, inner: slice | np.ndarray) -> Steps | None:
    """Response of ``force`` (n,) [N] to the steps of a square wave ``truth`` (n,) [N]; None where that has no steps.

    ``inner`` selects the samples that count; away from edges some must be at either height.

    >>> truth = 10.0 * (np.arange(4000) // 500 % 2)
    >>> observation = step_answer(np.roll(truth, 3), truth, 1e-3, slice(250, 3750))
    >>> observation.edges, round(observation.delay, 4), round(observation.plateau, 1)
    (7, 0.0025, 10.0)
    """
    change = np.diff(truth)
    height = float(np.ptp(truth))
    edges = np.flatnonzero(np.abs(change) > 0.5 * height) + 1 if height > 0 else np.zeros(0, int)
    reach = int(NEAR_AN_EDGE / period)
    if edges.size < 2 or np.mean(np.abs(change) > 1e-9 * height) > 0.01:
        return None
    near = np.ones(len(truth), dtype=bool)
    near[inner] = False
    for edge in edges:
        near[max(0, edge - reach) : edge + reach] = True
    high = truth > truth.min() + 0.5 * height
    above, below = force[high & ~near], force[~high & ~near]
    if not above.size or not below.size:
        return None
    plateau = float(above.mean() - below.mean())
    edges = edges[(edges > reach) & (edges < len(truth) - reach)]
    answers = [np.sign(change[e - 1]) * (force[e - reach : e + reach] - force[e - reach]) for e in edges]
    answers = [answer for answer in answers if np.all(np.isfinite(answer))]
    crossing = dict.fromkeys((0.1, 0.5, 0.9), float("nan"))
    if answers:
        mean = np.mean(answers, axis=0)
        share = mean / float(np.mean(mean[-reach // 4 :]))
        crossing = {level: _first_crossing(share, level) for level in crossing}
    complete = bool(np.all(np.isfinite(list(crossing.values()))))
    return Steps(
        edges=int(edges.size),
        delay=float(period * (crossing[0.5] - reach)) if complete else None,
        rise_time=float(period * (crossing[0.9] - crossing[0.1])) if complete else None,
        plateau=plateau,
        plateau_error_percent=100.0 * (plateau / height - 1.0),
        rms_error_away_from_edges=float(np.sqrt(np.mean((force - truth)[~near] ** 2))),
    )


def _first_crossing(share: np.ndarray, level: float) -> float:
    """Fractional index from which on ``share`` stays above ``level``; NaN: nowhere."""
    below = np.flatnonzero(share < level)
    if not below.size or below[-1] + 1 >= len(share):
        return float("nan")
    i = int(below[-1])
    return i + (level - share[i]) / (share[i + 1] - share[i])


@dataclass(frozen=True)
class MethodResult:
    """One method on one record: ``force`` (n,) [N], its design ``delay`` [s], and its errors.

    ``force`` is NaN outside the interval ``reliable`` [s], for a zero-phase filter extrapolates at both ends and an
    on-line observer starts from rest; in a record with gaps this holds for each piece. Errors count within the interval
    ``judged`` [s]: ``rms_error`` [N] against the force at the same time, ``rms_error_aligned`` [N] against the force
    ``delay`` earlier.
    """

    force: np.ndarray = field(repr=False)
    delay: float
    reliable: tuple[float, float]
    judged: tuple[float, float]
    rms_error: float | None
    rms_error_aligned: float | None
    steps: Steps | None
    smallest: SmallestForce
    settings: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """The contract's keys, and some more."""
        return {
            "rms_error": self.rms_error,
            "rms_error_aligned": self.rms_error_aligned,
            "delay": self.delay,
            "reliable_from": self.reliable[0],
            "reliable_to": self.reliable[1],
            "judged_from": self.judged[0],
            "judged_to": self.judged[1],
            "smallest_observable_force": self.smallest.to_dict(),
            "steps": None if self.steps is None else self.steps.to_dict(),
            **self.settings,
        }


@dataclass(frozen=True)
class Observation(Viewed):
    """External force of a record: ``offline`` (19), ``online`` (first-order low-pass) and ``kalman``."""

    record: str
    sha256: str
    axis: str
    t: np.ndarray = field(repr=False)
    f_ext: np.ndarray | None = field(repr=False)
    methods: dict[str, MethodResult] = field(repr=False)
    warnings: tuple[Message, ...] = ()
    units: Units = field(default=Units(), repr=False)

    def to_dict(self) -> dict[str, Any]:
        """The contract's ``observe --json``."""
        document = {
            "record": self.record,
            "sha256": self.sha256,
            "axis": self.axis,
            **{name: result.to_dict() for name, result in self.methods.items()},
            "warnings": list(self.warnings),
        }
        return advised("observe", document, self.units)

    def view(self) -> View:
        """Delay of each method, its errors against a known force, and the smallest force that it shows."""
        methods, force, unit = self.methods, self.units.words("force"), self.units.unit("N")
        first = next(iter(methods.values()))
        known, least = first.rms_error is not None, first.smallest.to_dict()
        judged = (f"rms error [{unit}]", f"away from edges [{unit}]", "rise [ms]", "plateau") if known else ()
        rows = [
            (name, f"{1e3 * result.delay:.2f}", *(_errors(result) if known else ())) for name, result in methods.items()
        ]
        spans = (f"{name} {r.reliable[0]:.3f} to {r.reliable[1]:.3f} s" for name, r in methods.items())
        against = f"errors: from {first.judged[0]:.2f} to {first.judged[1]:.2f} s, against the {force} at that time"
        return (
            Table(
                ("method", "delay [ms]", *judged),
                rows,
                f"External {force} of {self.record}, axis {self.axis}",
            ),
            Line(f"valid from and to; before and after, the filters settle: {', '.join(spans)}"),
            *([Line(against)] if known else []),
            Table(
                ("method", force, "set by", *map(_word, least["bounds"])),
                [(name, *_smallest(result.smallest)) for name, result in methods.items()],
                f"Smallest observable {force} [{unit}], and what limits it",
                words=("set by",),
            ),
            *(Line(f"{_word(bound)}: {reason}") for bound, reason in least["reasons"].items()),
        )


@typed
def observe(
    record: Record,
    axis: Axis,
    cutoff_hz: float | None = None,
    offline_cutoff_hz: float | None = None,
    parameter_std: np.ndarray | None = None,
    progress: Progress | None = None,
) -> Observation:
    """Observe the external force of ``record`` with the parameters of ``axis``.

    ``cutoff_hz`` [Hz] is the cut-off of the on-line observer, 20 by default or what the sampling allows; the Kalman
    observer has twice that bandwidth. ``offline_cutoff_hz`` [Hz], 60 likewise, belongs to the zero-phase filter
    off-line. ``parameter_std`` (4,) holds the standard deviations of mass, viscous, coulomb, offset for the parameter
    bound (default 2 % of each). Raises :class:`RecordError` for a record that is too short for the observers to settle,
    at least 1 s, and :class:`InputError` for a cut-off that the sampling does not allow.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> observation = observe(synthetic_record(axis, laps=1), axis)
    >>> sorted(observation.methods), observation.methods["online"].smallest.bound
    (['kalman', 'offline', 'online'], 'break_away')
    """
    record, axis = as_driven(axis.supplied_by(record), record)
    warnings = list(record.warnings)
    for method, kinds in left_out(axis).items():
        if kinds:
            word = axis.units.word("force")
            text = f"{method}: not included, since their {word} does not follow from the motion: {', '.join(kinds)}"
            warnings.append(warning("effects-not-observed", text, effects=kinds))

    cutoff_hz = min(DEFAULT_CUTOFF_HZ, ONLINE_SHARE / record.period) if cutoff_hz is None else cutoff_hz
    if offline_cutoff_hz is None:
        offline_cutoff_hz = min(OFFLINE_CUTOFF_HZ, OFFLINE_SHARE / record.period)
    share_of_nyquist(offline_cutoff_hz, record.period)  # raises for a bad cut-off before it is a divisor
    rest = rest_velocity_of(record, axis, offline_cutoff_hz)
    online: dict[str, OnlineObserver] = {"online": ForceObserver(axis, cutoff_hz, rest)}
    settings = {"offline": {"cutoff_hz": offline_cutoff_hz}, "online": {"cutoff_hz": cutoff_hz}}
    if axis.sampling.encoder_resolution > 0:
        highest = 0.2 / KALMAN_BANDWIDTH / record.period
        if not cutoff_hz < highest:
            raise InputError(
                f"`cutoff_hz`: found {cutoff_hz:g} Hz, expected less than {highest:g} Hz, a tenth of the sampling rate"
            )
        kalman = KalmanForceObserver(axis, bandwidth_hz=KALMAN_BANDWIDTH * cutoff_hz, rest_velocity=rest)
        online["kalman"] = kalman
        settings["kalman"] = {
            "bandwidth_hz": kalman.bandwidth_hz,
            "force_rate": kalman.force_rate,
            "encoder_noise_std": kalman.noise_std,
        }
    else:
        warnings.append(note("no-kalman-observer", "no Kalman observer: the axis gives no encoder_resolution"))
    made_up = FILTER_ENDS * 2.0 * record.period / share_of_nyquist(offline_cutoff_hz, record.period)
    ends = {
        "offline": (made_up, made_up),
        **{name: (FORGOTTEN * observer.delay, 0.0) for name, observer in online.items()},
    }
    shortest = 4 * max(SETTLED, *(end for pair in ends.values() for end in pair))
    if record.duration < shortest:
        raise RecordError(
            f"{record.name}: {record.duration:g} s long, expected at least {shortest:.3g} s to observe with these "
            "cut-offs"
        )

    report_progress = progress or no_progress
    report_progress("off-line observer", 0.0)
    filtered_motion = motion(record, offline_cutoff_hz)
    parameter = _parameter_bound(filtered_motion, axis, parameter_std)
    offline = observe_offline(filtered_motion, held_force(record, axis.drive.gain, offline_cutoff_hz), axis, rest)
    methods = {"offline": _judge(record, axis, offline, 0.0, ends["offline"], parameter, settings["offline"])}
    del filtered_motion, offline
    share = 1 / (1 + len(online))
    for index, (name, observer) in enumerate(online.items(), 1):
        force = observe_online(
            observer, record.q, record.u, partial(of_part(report_progress, index * share, share), f"{name} observer")
        )
        methods[name] = _judge(record, axis, force, observer.delay, ends[name], parameter, settings[name])
    return Observation(
        record=record.name,
        sha256=record.sha256,
        axis=axis.name,
        t=record.t,
        f_ext=record.f_ext,
        methods=methods,
        warnings=tuple(warnings),
        units=axis.units,
    )


def rest_velocity_of(record: Record, axis: Axis, cutoff_hz: float) -> float:
    """The speed [m/s] below which the sign of the velocity is uncertain: 1 mm/s, or less where all motion is slow.

    Then it is 1 % of the largest speed, but at least one encoder step in the time that the cut-off [Hz] resolves.
    """
    span = max(1, round(0.5 / (cutoff_hz * record.period)))
    time = span * record.period
    fastest = float(np.abs(record.q[span:] - record.q[:-span]).max(initial=0.0)) / time
    return min(REST_VELOCITY, max(SLOW * fastest, axis.sampling.encoder_resolution / time, np.finfo(float).tiny))


def direct_validation(record: Record, axis: Axis, model: str = "asymmetric", **options: Any) -> Identification:
    """Identify from a record with a measured force, (21)-(23); ``rms_error`` is that of the observed force tau_e.

    With Y = tau_m + tau_e = W X + e, the observed force W X - tau_m differs from the measured one by e.
    """
    if record.f_ext is None or not np.any(record.f_ext):
        force = axis.units.word("force")
        raise RecordError(f"{record.name}: no measured external {force}; direct validation (21) needs a column f_ext")
    return identify(record, axis, model=model, external_force=KNOWN, **options)


def with_known_push(record: Record, voltage: np.ndarray, force_gain: float) -> Record:
    """The record with the known part ``voltage`` (n,) [V] of ``u`` turned into an external force, G_tau times it.

    ``u`` keeps the controller's output; ``f_ext`` is the force that was added to it.
    """
    push = np.ravel(np.asarray(voltage, dtype=float))
    return replace(record, u=record.u - push, f_ext=force_gain * push, name=f"{record.name}, push unknown")


def _parameter_bound(filtered_motion: Motion, axis: Axis, std: np.ndarray | None) -> float:
    mechanics = axis.mechanics.array()
    std = PARAMETER_UNCERTAINTY * np.abs(mechanics) if std is None else np.asarray(std, dtype=float)
    bare = axis.replace(effects=[])
    total = np.zeros_like(filtered_motion.v)
    without = model_force(filtered_motion, bare)
    for more in mechanics + np.diag(std):
        total += (model_force(filtered_motion, bare.replace(mechanics=Mechanics.table(more))) - without) ** 2
    return 1.96 * float(np.sqrt(np.mean(total)))


def _judge(
    record: Record,
    axis: Axis,
    force: np.ndarray,
    delay: float,
    ends: tuple[float, float],
    parameter: float,
    settings: dict[str, float],
) -> MethodResult:
    """Errors of ``force`` (n,) [N], which is not reliable within ``ends`` [s] of the start and end of each piece."""
    n, period = len(record), record.period
    first, last = (math.ceil(end / period) for end in ends)
    start = max(int(SETTLED / period), first, last)
    known, inner = np.zeros((2, n), bool)
    for begin, end in record.pieces:
        known[begin + first : max(begin, end - last)] = inner[begin + start : max(begin, end - start)] = True
    if not inner.any():
        raise RecordError(
            f"{record.name}: no piece between its gaps is {2 * start * period:.3g} s long, expected one to observe in"
        )
    force[~known] = np.nan
    truth, rms, aligned, steps, error = record.f_ext, None, None, None, np.where(inner, force, np.nan)
    if truth is not None:
        error = error - truth
        rms = float(np.sqrt(np.mean(error[inner] ** 2)))
        late = np.interp(record.t - delay, record.t, truth)
        aligned = float(np.sqrt(np.mean((force - late)[inner] ** 2)))
        steps = step_answer(force, truth, period, inner)
    # Noise is the fast part of the error; the median excludes the few reversals and edges.
    quick = np.diff(error[start :: max(1, int(NOISE_STEP / period))])
    quick = quick[np.isfinite(quick)]
    noise = 1.96 * 1.4826 * float(np.median(np.abs(quick))) / np.sqrt(2.0)
    return MethodResult(
        force=force,
        delay=delay,
        reliable=(first * period, (n - last) * period),
        judged=(start * period, (n - start) * period),
        rms_error=rms,
        rms_error_aligned=aligned,
        steps=steps,
        smallest=smallest_observable_force(axis, noise, parameter),
        settings=settings,
    )


def _errors(result: MethodResult) -> tuple[str, str, str, str]:
    """The errors of a method against a known force; "" where there are none."""
    steps = result.steps
    return (
        "" if result.rms_error is None else rounded(result.rms_error),
        "" if steps is None else rounded(steps.rms_error_away_from_edges),
        "" if steps is None or steps.rise_time is None else f"{1e3 * steps.rise_time:.1f}",
        "" if steps is None else f"{steps.plateau_error_percent:+.2f} %",
    )


def _smallest(least: SmallestForce) -> tuple[str, ...]:
    """The smallest force, the name of what sets it, and every bound."""
    return (rounded(least.value), _word(least.bound), *map(rounded, least.bounds.values()))


def _word(bound: str) -> str:
    return bound.replace("_", "-")
