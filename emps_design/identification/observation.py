"""Observe the external force of a record by every method, and judge it where the force was measured.

How an observer answers the steps of a force that is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects import Motion
from emps_design.errors import InputError, RecordError
from emps_design.identification.excitation import KNOWN
from emps_design.identification.filters import SLOW, held_force, motion, share_of_nyquist
from emps_design.identification.identify import identify
from emps_design.identification.result import Identification
from emps_design.notebook import table
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
from emps_design.progress import Progress, of_part, untold
from emps_design.records import Record

NEAR_AN_EDGE = 0.1  # s, on both sides

OFFLINE_CUTOFF_HZ = 60.0
ONLINE_SHARE, OFFLINE_SHARE = 0.08, 0.25  # of the sampling rate, up to which a cut-off is by default
PARAMETER_UNCERTAINTY = 0.02  # of each parameter where no deviation is known, as in section IV-B
NOISE_STEP = 0.05  # s apart: what an error changes by over that time counts as noise
KALMAN_BANDWIDTH = 2.0  # times the cut-off of the first-order low-pass: about the same delay
SETTLED = 0.25  # s of the record's start and of its end, at least, that no judgement counts
FILTER_ENDS = 2.0  # periods of the zero-phase filter's cut-off in which it makes up what lies outside the record
FORGOTTEN = 7.0  # delays of an on-line observer after which it has forgotten that it started from rest


@dataclass(frozen=True)
class Steps:
    """How a method answers the steps of a known force.

    ``delay`` [s] to half of the step and ``rise_time`` [s] from 10 to 90 %, of the mean answer to all edges;
    ``plateau`` [N] the mean observed height away from edges, ``plateau_error_percent`` against the true one.
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
    """Answer of ``force`` (n,) [N] to the steps of a square wave ``truth`` (n,) [N]; None where that has no steps.

    ``inner`` are the samples that count: away from edges some must be at either height.

    >>> truth = 10.0 * (np.arange(4000) // 500 % 2)
    >>> found = step_answer(np.roll(truth, 3), truth, 1e-3, slice(250, 3750))
    >>> found.edges, round(found.delay, 4), round(found.plateau, 1)
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
    """Index, between samples, at which ``share`` last comes from below ``level`` to above it for good; NaN: never."""
    below = np.flatnonzero(share < level)
    if not below.size or below[-1] + 1 >= len(share):
        return float("nan")
    i = int(below[-1])
    return i + (level - share[i]) / (share[i + 1] - share[i])


@dataclass(frozen=True)
class MethodResult:
    """One method on one record: ``force`` (n,) [N], its ``delay`` [s] as designed, and how it did.

    ``force`` is NaN outside ``reliable``, from and to [s]: a zero-phase filter makes up what lies beyond both ends, and
    an on-line observer starts as if at rest. So it is at the ends of each piece of a record with gaps. Errors count
    from and to ``judged`` [s]: ``rms_error`` [N] is against the force at the same moment, ``rms_error_aligned`` [N]
    against that of ``delay`` ago.
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
        """The contract's keys, and what stands beside them."""
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
class Observation:
    """External force of a record: ``offline`` (19), ``online`` (first-order low-pass) and ``kalman``."""

    record: str
    sha256: str
    axis: str
    t: np.ndarray = field(repr=False)
    f_ext: np.ndarray | None = field(repr=False)
    methods: dict[str, MethodResult] = field(repr=False)
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The contract's ``observe --json``."""
        return {
            "record": self.record,
            "sha256": self.sha256,
            "axis": self.axis,
            **{name: result.to_dict() for name, result in self.methods.items()},
            "warnings": list(self.warnings),
        }

    def _repr_html_(self) -> str:
        rows = [
            (name, one.delay, one.rms_error, one.smallest.value, one.smallest.bound.replace("_", " "))
            for name, one in self.methods.items()
        ]
        heads = ("method", "delay [s]", "rms error [N]", "smallest observable force [N]", "set by")
        return table(f"{self.record}: external force observed with {self.axis}", rows, heads)


def observe(
    record: Record,
    axis: Axis,
    cutoff_hz: float | None = None,
    offline_cutoff_hz: float | None = None,
    parameter_std: np.ndarray | None = None,
    progress: Progress | None = None,
) -> Observation:
    """Observe the external force of ``record`` with the parameters of ``axis``.

    ``cutoff_hz`` [Hz] of the on-line observer (the Kalman one has twice that bandwidth), by default 20 or what the
    sampling allows; ``offline_cutoff_hz`` [Hz] of the zero-phase filter off-line, 60 likewise; ``parameter_std``
    standard deviations of mass, viscous, coulomb, offset for the parameter bound (2 % of each where not given). Raises
    :class:`RecordError` for a record too short for its ends to settle, at least 1 s, and :class:`InputError` for a
    cut-off that the sampling does not allow.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> found = observe(synthetic_record(axis, laps=1), axis)
    >>> sorted(found.methods), found.methods["online"].smallest.bound
    (['kalman', 'offline', 'online'], 'break_away')
    """
    record, axis = as_driven(axis.supplied_by(record), record)
    warnings = list(record.warnings)
    for method, kinds in left_out(axis).items():
        if kinds:
            warnings.append(f"{method}: left out, their force is not in the motion: {', '.join(kinds)}")

    cutoff_hz = min(DEFAULT_CUTOFF_HZ, ONLINE_SHARE / record.period) if cutoff_hz is None else cutoff_hz
    if offline_cutoff_hz is None:
        offline_cutoff_hz = min(OFFLINE_CUTOFF_HZ, OFFLINE_SHARE / record.period)
    share_of_nyquist(offline_cutoff_hz, record.period)  # refused here, before it divides
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
        warnings.append("no Kalman observer: the axis gives no encoder_resolution")
    made_up = FILTER_ENDS * 2.0 * record.period / share_of_nyquist(offline_cutoff_hz, record.period)
    ends = {"offline": (made_up, made_up), **{name: (FORGOTTEN * one.delay, 0.0) for name, one in online.items()}}
    shortest = 4 * max(SETTLED, *(end for pair in ends.values() for end in pair))
    if record.duration < shortest:
        raise RecordError(
            f"{record.name}: {record.duration:g} s long, expected at least {shortest:.3g} s to observe with these "
            "cut-offs"
        )

    tell = progress or untold
    tell("off-line observer", 0.0)
    seen = motion(record, offline_cutoff_hz)
    parameter = _parameter_bound(seen, axis, parameter_std)
    offline = observe_offline(seen, held_force(record, axis.drive.gain, offline_cutoff_hz), axis, rest)
    methods = {"offline": _judge(record, axis, offline, 0.0, ends["offline"], parameter, settings["offline"])}
    del seen, offline
    share = 1 / (1 + len(online))
    for index, (name, one) in enumerate(online.items(), 1):
        force = observe_online(
            one, record.q, record.u, partial(of_part(tell, index * share, share), f"{name} observer")
        )
        methods[name] = _judge(record, axis, force, one.delay, ends[name], parameter, settings[name])
    return Observation(
        record=record.name,
        sha256=record.sha256,
        axis=axis.name,
        t=record.t,
        f_ext=record.f_ext,
        methods=methods,
        warnings=tuple(warnings),
    )


def rest_velocity_of(record: Record, axis: Axis, cutoff_hz: float) -> float:
    """The speed [m/s] below which ``record`` tells no sign of the velocity: 1 mm/s, or less where all of it is slow.

    Then 1 % of the largest, but no less than one step of the encoder in the time that the cut-off [Hz] resolves.
    """
    span = max(1, round(0.5 / (cutoff_hz * record.period)))
    time = span * record.period
    fastest = float(np.abs(record.q[span:] - record.q[:-span]).max(initial=0.0)) / time
    return min(REST_VELOCITY, max(SLOW * fastest, axis.sampling.encoder_resolution / time, np.finfo(float).tiny))


def direct_validation(record: Record, axis: Axis, model: str = "asymmetric", **options: Any) -> Identification:
    """Identify and observe on the same record with its measured force, (21)-(23); its ``rms_error`` is that of tau_e.

    With Y = tau_m + tau_e = W X + e, the observed force W X - tau_m differs from the measured one by e.
    """
    if record.f_ext is None or not np.any(record.f_ext):
        raise RecordError(f"{record.name}: no measured external force; direct validation (21) needs a column f_ext")
    return identify(record, axis, model=model, external_force=KNOWN, **options)


def with_known_push(record: Record, voltage: np.ndarray, force_gain: float) -> Record:
    """The record as if ``voltage`` (n,) [V], known to be in ``u``, had been an external force of G_tau times it.

    What is left in ``u`` is what the controller asked for; ``f_ext`` is the force that was added behind its back.
    """
    push = np.ravel(np.asarray(voltage, dtype=float))
    return replace(record, u=record.u - push, f_ext=force_gain * push, name=f"{record.name}, push unknown")


def _parameter_bound(seen: Motion, axis: Axis, std: np.ndarray | None) -> float:
    mechanics = axis.mechanics.array()
    std = PARAMETER_UNCERTAINTY * np.abs(mechanics) if std is None else np.asarray(std, dtype=float)
    bare = axis.replace(effects=[])
    total = np.zeros_like(seen.v)
    keys = ("mass", "viscous", "coulomb", "offset")
    without = model_force(seen, bare)
    for key, value, spread in zip(keys, mechanics, std, strict=True):
        more = bare.replace(mechanics={key: float(value + spread)})
        total += (model_force(seen, more) - without) ** 2
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
    """Judge ``force`` (n,) [N], which is not reliable for ``ends`` [s] of the start and end of each piece."""
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
    # Noise is what is quick in the error: a median keeps reversals and edges, which are few, out of it.
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
