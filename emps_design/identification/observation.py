"""Observe the external force of a record by every method, and judge it where the force was measured."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import RecordError
from emps_design.identification.filters import held_force, motion
from emps_design.identification.identify import identify
from emps_design.identification.result import Identification
from emps_design.notebook import table
from emps_design.observer import (
    DEFAULT_CUTOFF_HZ,
    ForceObserver,
    KalmanForceObserver,
    SmallestForce,
    acting_voltage,
    left_out,
    model_force,
    observe_offline,
    observe_online,
    smallest_observable_force,
)
from emps_design.records import Record

OFFLINE_CUTOFF_HZ = 60.0
PARAMETER_UNCERTAINTY = 0.02  # of each parameter where no deviation is known, as in section IV-B
NEAR_AN_EDGE = 0.1  # s, on both sides
NOISE_STEP = 0.05  # s apart: what an error changes by over that time counts as noise
KALMAN_BANDWIDTH = 2.0  # times the cut-off of the first-order low-pass: about the same delay
SETTLED = 0.25  # s of the record's start and of its end that no judgement counts


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


@dataclass(frozen=True)
class MethodResult:
    """One method on one record: ``force`` (n,) [N], its ``delay`` [s] as designed, and how it did.

    ``rms_error`` [N] is against the force at the same moment, ``rms_error_aligned`` [N] against that of ``delay`` ago.
    """

    force: np.ndarray = field(repr=False)
    delay: float
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
    cutoff_hz: float = DEFAULT_CUTOFF_HZ,
    offline_cutoff_hz: float = OFFLINE_CUTOFF_HZ,
    parameter_std: np.ndarray | None = None,
) -> Observation:
    """Observe the external force of ``record`` with the parameters of ``axis``.

    ``cutoff_hz`` [Hz] of the on-line observer (the Kalman one has twice that bandwidth), ``offline_cutoff_hz``
    [Hz] of the zero-phase filter off-line; ``parameter_std`` standard deviations of mass, viscous, coulomb, offset for
    the parameter bound (2 % of each where not given). Raises :class:`RecordError` for a record shorter than 1 s.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.practice import practice_record
    >>> axis = machine("emps2019")
    >>> found = observe(practice_record(axis, laps=1), axis)
    >>> sorted(found.methods), found.methods["online"].smallest.bound
    (['kalman', 'offline', 'online'], 'break_away')
    """
    if record.duration < 4 * SETTLED:
        raise RecordError(f"{record.name}: {record.duration:g} s long, expected at least {4 * SETTLED:g} s to observe")
    voltage, axis = acting_voltage(axis.replace(sampling={"period": record.period}), record.u)
    record = replace(record, u=voltage)
    seen = motion(record, offline_cutoff_hz)
    offline = observe_offline(seen, held_force(record, axis.drive.force_gain, offline_cutoff_hz), axis)
    parameter = _parameter_bound(seen, axis, parameter_std)
    methods = {"offline": _judge(record, axis, offline, 0.0, parameter, {"cutoff_hz": offline_cutoff_hz})}
    online = ForceObserver(axis, cutoff_hz)
    force = observe_online(online, record.q, record.u)
    methods["online"] = _judge(record, axis, force, online.delay, parameter, {"cutoff_hz": cutoff_hz})
    warnings = list(record.warnings)
    for method, kinds in left_out(axis).items():
        if kinds:
            warnings.append(f"{method}: left out, their force is not in the motion: {', '.join(kinds)}")
    if axis.sampling.encoder_resolution > 0:
        kalman = KalmanForceObserver(axis, bandwidth_hz=KALMAN_BANDWIDTH * cutoff_hz)
        settings = {
            "bandwidth_hz": kalman.bandwidth_hz,
            "force_rate": kalman.force_rate,
            "encoder_noise_std": kalman.noise_std,
        }
        force = observe_online(kalman, record.q, record.u)
        methods["kalman"] = _judge(record, axis, force, kalman.delay, parameter, settings)
    else:
        warnings.append("no Kalman observer: the axis gives no encoder_resolution")
    return Observation(
        record=record.name,
        sha256=record.sha256,
        axis=axis.name,
        t=record.t,
        f_ext=record.f_ext,
        methods=methods,
        warnings=tuple(warnings),
    )


def direct_validation(record: Record, axis: Axis, model: str = "asymmetric", **options: Any) -> Identification:
    """Identify and observe on the same record with its measured force, (21)-(23); its ``rms_error`` is that of tau_e.

    With Y = tau_m + tau_e = W X + e, the observed force W X - tau_m differs from the measured one by e.
    """
    if record.f_ext is None or not np.any(record.f_ext):
        raise RecordError(f"{record.name}: no measured external force; direct validation (21) needs a column f_ext")
    return identify(record, axis, model=model, external_force_known=True, **options)


def with_known_push(record: Record, voltage: np.ndarray, force_gain: float) -> Record:
    """The record as if ``voltage`` (n,) [V], known to be in ``u``, had been an external force of G_tau times it.

    What is left in ``u`` is what the controller asked for; ``f_ext`` is the force that was added behind its back.
    """
    push = np.ravel(np.asarray(voltage, dtype=float))
    return replace(record, u=record.u - push, f_ext=force_gain * push, name=f"{record.name}, push unknown")


def _parameter_bound(seen, axis: Axis, std: np.ndarray | None) -> float:
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


def _judge(record: Record, axis: Axis, force: np.ndarray, delay: float, parameter: float, settings) -> MethodResult:
    start = int(SETTLED / record.period)
    inner = slice(start, len(record) - start)
    truth, rms, aligned, steps, error = record.f_ext, None, None, None, force
    if truth is not None:
        error = force - truth
        rms = float(np.sqrt(np.mean(error[inner] ** 2)))
        late = np.interp(record.t - delay, record.t, truth)
        aligned = float(np.sqrt(np.mean((force - late)[inner] ** 2)))
        steps = _step_answer(force, truth, record.period)
    # Noise is what is quick in the error: a median keeps reversals and edges, which are few, out of it.
    quick = np.diff(error[inner][:: max(1, int(NOISE_STEP / record.period))])
    noise = 1.96 * 1.4826 * float(np.median(np.abs(quick))) / np.sqrt(2.0)
    return MethodResult(force, delay, rms, aligned, steps, smallest_observable_force(axis, noise, parameter), settings)


def _step_answer(force: np.ndarray, truth: np.ndarray, period: float) -> Steps | None:
    """Answer to the steps of a square wave; None where the known force has no steps."""
    change = np.diff(truth)
    height = float(np.ptp(truth))
    edges = np.flatnonzero(np.abs(change) > 0.5 * height) + 1 if height > 0 else np.zeros(0, int)
    reach = int(NEAR_AN_EDGE / period)
    edges = edges[(edges > reach) & (edges < len(truth) - reach)]
    if edges.size < 2 or np.mean(np.abs(change) > 1e-9 * height) > 0.01:
        return None
    near = np.zeros(len(truth), dtype=bool)
    near[: int(SETTLED / period)] = near[-int(SETTLED / period) :] = True
    for edge in edges:
        near[edge - reach : edge + reach] = True
    high = truth > truth.min() + 0.5 * height
    plateau = float(force[high & ~near].mean() - force[~high & ~near].mean())
    mean = np.mean([np.sign(change[e - 1]) * (force[e - reach : e + reach] - force[e - reach]) for e in edges], axis=0)
    share = mean / float(np.mean(mean[-reach // 4 :]))
    crossing = {level: _first_crossing(share, level) for level in (0.1, 0.5, 0.9)}
    complete = all(value is not None for value in crossing.values())
    return Steps(
        edges=int(edges.size),
        delay=period * (crossing[0.5] - reach) if complete else None,
        rise_time=period * (crossing[0.9] - crossing[0.1]) if complete else None,
        plateau=plateau,
        plateau_error_percent=100.0 * (plateau / height - 1.0),
        rms_error_away_from_edges=float(np.sqrt(np.mean((force - truth)[~near] ** 2))),
    )


def _first_crossing(share: np.ndarray, level: float) -> float | None:
    """Index, between samples, at which ``share`` last comes from below ``level`` to above it for good."""
    below = np.flatnonzero(share < level)
    if not below.size or below[-1] + 1 >= len(share):
        return None
    i = int(below[-1])
    return i + (level - share[i]) / (share[i + 1] - share[i])
