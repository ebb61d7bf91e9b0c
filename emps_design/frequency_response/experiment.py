"""Design of a frequency-response experiment: a multi-sine or a stepped sine on a carriage that runs to and fro.

While the carriage runs one way, dry friction is constant and the loop is linear. So the reference makes passes at a
steady speed, and the excitation (:mod:`.waves`) is added on each pass once the loop has settled. The amplitude of the
command falls with a power of the frequency. The model of the loop gives the excitation at the controller's output or
the reference that this takes, and all peaks. The amplitude is the largest at which the velocity keeps its sign and
every limit holds. Expected deviations follow from white force noise and the encoder's quantisation.
Source: R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapter 5.

The experiment is then simulated on the nonlinear axis, and the excitation reduced until every limit holds. The linear
loop covers neither the ramps of the passes, nor transients between two steps, nor a controller whose own share of the
command reaches its limit before the sum does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import sample_axis
from emps_design.control.sampled import axis_loop
from emps_design.errors import InputError, SimulationError, UnstableError
from emps_design.files import write_aside
from emps_design.frequency_response.estimate import HIGHEST_SHARE
from emps_design.frequency_response.signals import repeated_share
from emps_design.frequency_response.waves import BLOCKS, GROUP, PLACES, ExcitationRequest, MultiSine, SteppedSine, Wave
from emps_design.laws import law_of
from emps_design.laws.estimators import estimator_response
from emps_design.messages import Message, warning
from emps_design.records.layout import LONGEST
from emps_design.request import takes
from emps_design.simulation import Plant
from emps_design.units import LINEAR, Units
from emps_design.view import Line, Table, View, Viewed

ROOM = 0.9  # share of a limit that is used

TRIES = 12
SHRINKS, STEP = 0.98, 0.5  # factors on an excitation that exceeds a limit: beside the linear estimate, and without one

EXCITED_SPEED = 0.8  # share of the steady speed that the excitation may take
STEEPEST = 10.0  # largest excitation over command: below the crossover the controller opposes the excitation
SLOWER = 0.5  # largest relative reduction of the speed that keeps the encoder's steps from repeating
TRIED = 2000  # speeds
SHOWN = 10  # lines of the table that a reader sees
UNITS = {"speed": "m/s", "velocity": "m/s", "command": "V", "position": "m", "jerk": "m/s^3"}  # of the peaks
PERIODS = (2, 4, 8, 16, 32)  # over which the steps are not to repeat
NOISE_SHARE = 0.02  # of the Coulomb friction, rms of white force noise where none is given


@dataclass(frozen=True)
class Limits:
    """Limits of an experiment: ``stroke`` [m], ``speed`` [m/s], ``force`` [N], ``jerk`` [m/s^3]; None is no limit."""

    stroke: float
    speed: float | None = None
    force: float | None = None
    jerk: float | None = None


def check_request(
    limits: Limits, request: ExcitationRequest, high: float, nyquist: float, units: Units = LINEAR
) -> None:
    """Raise :class:`InputError` for an invalid band up to ``high`` [Hz], resolution, number of steps, speed or limit.

    >>> check_request(Limits(0.5, force=float("nan")), ExcitationRequest(0.05), 100.0, 500.0)
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: force limit: found nan, expected a positive number
    """
    speed, low, resolution, steps = request.speed, request.low, request.resolution, request.steps
    if not 0.0 < low < high:
        raise InputError(f"frequencies: found {low:g} to {high:g} Hz, expected 0 < lowest < highest")
    if high >= nyquist:
        raise InputError(f"frequency: found {high:g} Hz, expected less than the Nyquist frequency, {nyquist:g} Hz")
    if not 0.0 < resolution <= 0.5 * (high - low):
        raise InputError(f"resolution: found {resolution:g} Hz, expected more than 0 and several lines in the band")
    if steps is not None and steps < GROUP:
        raise InputError(f"steps: found {steps}, expected at least {GROUP} lines")
    bounds = {limit.name if limit.name == "stroke" else f"{units.word(limit.name)} limit": getattr(limits, limit.name)
              for limit in fields(limits)}  # fmt: skip
    for name, value in {"speed": speed, **bounds}.items():
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"{name}: found {value:g}, expected a positive number")
    if limits.speed is not None and speed >= ROOM * limits.speed:
        found, limit = (units.quantity(number, "m/s", "g") for number in (speed, limits.speed))
        raise InputError(f"speed: found passes at {found}, expected less than the limit of {limit}")


def check_length(samples: float, period: float) -> None:
    """Raise :class:`InputError` for an experiment of more ``samples`` than a record may have.

    >>> check_length(6e6, 1e-3)
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: stroke: found an experiment of 6e+03 s, expected at most 5e+03 s (5000000 samples): \
use a shorter stroke, a higher speed, or fewer passes
    """
    if samples > LONGEST:
        raise InputError(
            f"stroke: found an experiment of {samples * period:.3g} s, expected at most {LONGEST * period:.3g} s "
            f"({LONGEST} samples): use a shorter stroke, a higher speed, or fewer passes"
        )


@dataclass(frozen=True, eq=False)
class LoopInputs:
    """Inputs of the loop: ``q_ref`` (n,) [m] and ``excitation`` (n,) [V]; ``excited`` (n,) marks the excited samples.

    ``passes`` (n,) [m/s] is the velocity of the passes alone, without an excitation in the reference.
    """

    q_ref: np.ndarray
    excitation: np.ndarray
    excited: np.ndarray
    passes: np.ndarray


@dataclass(frozen=True)
class Bound:
    """A ``limit`` on the quantity that ``reached`` takes from a simulation; ``name`` and ``unit`` are for messages."""

    name: str
    limit: float
    reached: Callable[[Reached], float]
    unit: str


@dataclass(frozen=True)
class Reached:
    """Peaks of a simulated experiment: ``velocity``, ``slowest`` while excited [m/s]; ``command`` [V], ``travel`` [m].

    ``own`` [V] is the controller's share of the command, which a drive limits before the excitation is added.
    """

    velocity: float
    slowest: float
    command: float
    own: float
    travel: float


def rehearse(axis: Axis, bounds: list[Bound], signals: Callable[[float], LoopInputs]) -> tuple[float, Reached, str]:
    """Return the largest share of the excitation, at most 1, whose ``signals(share)`` stay within ``bounds``, its peaks
    in the simulation, and the name of the bound that limits it, "" for none.

    Raises :class:`InputError` where the passes alone exceed a bound.
    """
    alone = _peaks(axis, signals(0.0))
    if alone is None:
        raise InputError("speed: the passes without excitation cannot be simulated; use a lower speed")
    for bound in bounds:
        if bound.reached(alone) > bound.limit:
            raise InputError(
                f"{bound.name}: the passes without excitation reach {bound.reached(alone):.4g} {bound.unit}, expected "
                f"at most {bound.limit:.4g} {bound.unit}: use a lower speed, or a longer stroke for the acceleration"
            )
    share, bound_by = 1.0, ""
    for _ in range(TRIES):
        reached = _peaks(axis, signals(share))
        over = bounds[:1] if reached is None else [bound for bound in bounds if bound.reached(reached) > bound.limit]
        if reached is not None and not over:
            return share, reached, bound_by
        bound_by = over[0].name
        if reached is None or max(reached.command, reached.own) >= axis.drive.command_limit * (1.0 - 1e-9):
            share *= STEP  # a saturated command does not show by how much it is too large
        else:
            share *= SHRINKS * min(_allowed_share(bound, alone, reached) for bound in over)
    raise InputError(f"{bound_by}: no excitation stays within this limit; use a lower speed")


def _allowed_share(bound: Bound, alone: Reached, reached: Reached) -> float:
    """The share of an excitation that ``bound`` allows, by linear interpolation from the passes without it."""
    steady = bound.reached(alone)
    return (bound.limit - steady) / (bound.reached(reached) - steady)


def _peaks(axis: Axis, signals: LoopInputs) -> Reached | None:
    """Peaks of the closed loop in a simulation; None where the simulation fails."""
    try:
        run = Plant.of(axis).closed_loop(signals.q_ref, voltage_noise=signals.excitation)
    except SimulationError:
        return None
    forwards = (run.v * np.sign(signals.passes))[signals.excited]
    return Reached(
        velocity=float(np.abs(run.v).max()),
        slowest=float(forwards.min()) if forwards.size else 0.0,
        command=float(np.abs(run.u).max()),
        own=float(np.abs(run.u - signals.excitation).max()),
        travel=float(np.ptp(run.position)),
    )


@dataclass(frozen=True, eq=False)
class Experiment(Viewed):
    """Reference and excitation at the samples, with the expected deviations and peaks.

    ``q_ref`` (n,) [m]; ``excitation`` (n,) [V], 0 where the reference carries it; ``frequency`` (m,) [Hz] the lines and
    ``std`` (m,) their expected relative deviations; ``peaks`` the largest values. The passes run at ``speed`` [m/s], a
    little below ``requested_speed`` where the encoder's steps would repeat at that. ``signal`` is a multi-sine, with
    ``periods`` of ``samples`` on each pass, or a stepped sine, with blocks of at most ``samples``.
    """

    axis: Axis
    signal: str
    at: str
    q_ref: np.ndarray = field(repr=False)
    excitation: np.ndarray = field(repr=False)
    frequency: np.ndarray
    std: np.ndarray
    requested_speed: float
    speed: float
    passes: int
    periods: int
    samples: int
    noise: float
    peaks: dict[str, float]
    bound_by: str
    warnings: tuple[Message, ...] = ()

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return self.axis.sampling.period

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """Columns of the experiment's table by title, in the units of the axis."""
        unit = self.axis.units.unit
        columns = {"t [s]": np.arange(self.q_ref.size) * self.period, f"q_ref [{unit('m')}]": self.q_ref}
        return columns if self.at == "reference" else {**columns, f"excitation [{unit('V')}]": self.excitation}

    def save(self, path: str | Path) -> None:
        """Write the table to the .csv file ``path``, whole or not at all."""
        with write_aside(Path(path)) as aside:
            table = np.column_stack(list(self.columns.values()))
            formats = ["%.12g", *["%.10g"] * (table.shape[1] - 1)]
            np.savetxt(aside, table, fmt=formats, delimiter=",", header=",".join(self.columns), comments="")

    def view(self) -> View:
        """The signal, its limit and peaks, and the expected deviations at some of the lines."""
        units, lines, peaks = self.axis.units, self.frequency, self.peaks
        what = f"{self.periods} periods"
        if self.signal == SteppedSine.label:
            what = f"steps of at most {self.periods} blocks"
        speed, command, travel = (units.unit(base) for base in ("m/s", "V", "m"))
        shown = sorted({int(np.argmin(np.abs(lines - f))) for f in np.geomspace(lines[0], lines[-1], SHOWN)})
        return (
            Line(
                f"{self.axis.name}: {self.signal} of {lines.size} lines from {lines[0]:.4g} to {lines[-1]:.4g} Hz, "
                f"added to the {self.at}; {self.passes} passes of {what} of {self.samples * self.period:g} s, "
                f"{self.q_ref.size * self.period:.4g} s in all",
                "prose",
            ),
            Line(
                f"passes at {self.speed:.5g} {speed} (requested: {self.requested_speed:.5g}), speed "
                f"{peaks['slowest']:.4g} to {peaks['velocity']:.4g} {speed}, command at most {peaks['command']:.4g} "
                f"{command}, travel {peaks['stroke']:.4g} {travel}; the amplitude is limited by the {self.bound_by}",
                "prose",
            ),
            Table(
                ("frequency [Hz]", "relative std [%]"),
                [(f"{lines[i]:.4g}", f"{100 * self.std[i]:.3g}") for i in shown],
                f"expected for {self.noise:g} {units.unit('N')} rms of white {units.words('force')} noise",
            ),
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data without the signals."""
        return {
            "axis": self.axis.name,
            "signal": self.signal,
            "at": self.at,
            "seconds": self.q_ref.size * self.period,
            "asked_speed": self.requested_speed,
            "speed": self.speed,
            "passes": self.passes,
            "periods": self.periods,
            "period_seconds": self.samples * self.period,
            "lines": self.frequency.size,
            "frequency_hz": self.frequency,
            "expected_std": self.std,
            "assumed_force_noise": self.noise,
            "peaks": self.peaks,
            "bound_by": self.bound_by,
            "units": {name: self.axis.units.unit(base) for name, base in UNITS.items()},
            "warnings": list(self.warnings),
        }


@takes(ExcitationRequest)
def design_experiment(axis: Axis, limits: Limits, request: ExcitationRequest) -> Experiment:
    """Return the experiment for ``axis``: lines from ``low`` to ``high`` [Hz], spaced by ``resolution`` [Hz] at least.

    With ``steps`` it is a stepped sine of that many lines, each measured over 1/``resolution`` [s] and repeated
    ``passes`` times. Raises :class:`InputError` for an experiment that does not fit the limits, :class:`UnstableError`
    for an axis with an unstable loop.

    >>> from emps_design.machines import machine
    >>> experiment = design_experiment(machine("emps2019"), Limits(stroke=0.5), speed=0.05, resolution=1.0)
    >>> experiment.periods, experiment.bound_by, list(experiment.columns)
    (6, 'command limit', ['t [s]', 'q_ref [m]', 'excitation [V]'])
    """
    period = axis.sampling.period
    nyquist = 0.5 / period
    low, high = request.low, HIGHEST_SHARE * nyquist if request.high is None else request.high
    check_request(limits, request, high, nyquist, axis.units)
    samples = round(1.0 / (request.resolution * period))
    settle = round(max(0.2, 2.0 / low) / period)
    wave: Wave
    if request.steps is not None:
        wave = SteppedSine.between(low * period, high * period, request.steps, samples)
    else:
        fade, random = min(settle, samples // 2), np.random.default_rng(request.seed)
        wave = MultiSine.between(low * period, high * period, samples, fade, random)
    speed, at = _speed_without_repeats(request.speed, axis, wave), request.at
    loop = axis_loop(axis, speed)
    if not loop.stable:
        raise UnstableError(
            f"axis {axis.name}: its loop is unstable, largest pole {loop.radius:.4g}; stabilise it before the "
            "experiment"
        )
    steady = _steady_command(axis, speed)
    ramp = _ramp(axis, limits, speed, steady, 0.2 * samples * period)
    flat = int((limits.stroke * ROOM - speed * ramp) / speed / period - settle)
    if flat < wave.shortest:
        needed = (wave.shortest + settle + 2) * period * speed + speed * ramp
        quantity = axis.units.quantity
        raise InputError(
            f"stroke: found {quantity(limits.stroke, 'm', 'g')}: a pass at {quantity(speed, 'm/s')} can be excited for "
            f"{max(flat, 0) * period:.3g} s, expected at least {wave.shortest * period:.4g} s; use "
            f"{quantity(needed / ROOM, 'm', '.3g')}, a lower speed, or a coarser resolution"
        )
    check_length(wave.length(flat, request.passes) * (1.0 + 2.0 * (ramp / period + settle) / flat), period)
    f = wave.cycles / period
    w = 2.0 * np.pi * f
    by = "voltage" if at == PLACES[0] else "reference"
    command = loop.response(w, "voltage", by) + (1.0 if at == PLACES[0] else 0.0)
    added = w**-request.slope / np.maximum(np.abs(command), 1.0 / STEEPEST if by == "voltage" else 1e-12)
    spectrum = wave.phased(added, command)
    velocity = spectrum * loop.response(w, "velocity", by)
    unit = {
        "velocity": wave.peak(velocity),
        "command": wave.peak(spectrum * command),
        "added": wave.peak(spectrum) if at == PLACES[0] else 0.0,
        "own": wave.peak(spectrum * (command - 1.0)) if at == PLACES[0] else 0.0,  # the controller's answer
        "position": wave.peak(velocity / (1j * w)),
        "jerk": wave.peak(velocity * (1j * w) ** 2),
    }
    amplitude, bound_by = _amplitude(axis, limits, speed, steady, unit)
    carried = spectrum
    if by == "reference" and law_of(axis, period).follows == "velocity":
        carried = spectrum * period / (1.0 - np.exp(-1j * w * period))
    trains, each = wave.trains(amplitude * carried, flat, request.passes)

    def signals(share: float) -> LoopInputs:
        return _passes(period, speed, ramp, settle, [share * train for train in trains], at)

    share, reached, cut_by = rehearse(axis, _bounds(axis, limits), signals)
    amplitude, bound_by = share * amplitude, cut_by or bound_by
    final = signals(share)
    q_ref, excitation = final.q_ref, final.excitation
    peaks = {name: amplitude * value for name, value in unit.items()}
    peaks = {
        **{f"excitation_{name}": value for name, value in peaks.items()},
        "velocity": max(speed + peaks["velocity"], reached.velocity),
        "slowest": min(speed - peaks["velocity"], reached.slowest),
        "command": max(steady + peaks["command"], reached.command),
        "stroke": max(float(np.ptp(q_ref)) + 2.0 * peaks["position"], reached.travel),
    }
    noise = NOISE_SHARE * axis.mechanics.coulomb if request.noise is None else request.noise
    std = _expected_std(axis, speed, w, amplitude * np.abs(spectrum * command), each, noise)
    faint = int(np.count_nonzero(std > 0.3))
    text = f"{faint} of {f.size} lines will hardly be above the noise"
    warnings = (warning("faint-lines", text, count=faint),) if faint else ()
    periods = wave.periods(flat) if isinstance(wave, MultiSine) else BLOCKS
    samples = samples if isinstance(wave, MultiSine) else int(np.max(each)) // BLOCKS // request.passes
    return Experiment(
        axis, wave.label, at, q_ref, excitation, f, std, request.speed, speed, len(trains), periods, samples, noise,
        peaks, bound_by, warnings,
    )  # fmt: skip


def _steady_command(axis: Axis, speed: float) -> float:
    """Command [V] of steady motion at ``speed`` in the direction with more friction."""
    m = axis.mechanics
    return (axis.damping * speed + m.coulomb + abs(m.offset)) / axis.drive.gain


def _amplitude(axis: Axis, limits: Limits, speed: float, steady: float, unit: dict[str, float]) -> tuple[float, str]:
    """The largest factor on the peaks ``unit`` within every limit, and the name of the limit that binds."""
    gain = axis.drive.gain
    rooms = {
        "speed of the passes": EXCITED_SPEED * speed / unit["velocity"],
        "command limit": (ROOM * axis.drive.command_limit - steady) / max(unit["command"], unit["own"], unit["added"]),
        "stroke": 0.5 * (1.0 - ROOM) * limits.stroke / unit["position"],
    }
    if limits.speed is not None:
        rooms["speed limit"] = (ROOM * limits.speed - speed) / unit["velocity"]
    if limits.force is not None:
        rooms[f"{axis.units.word('force')} limit"] = (ROOM * limits.force / gain - steady) / unit["command"]
    if limits.jerk is not None:
        rooms["jerk limit"] = ROOM * limits.jerk / unit["jerk"]
    bound_by = min(rooms, key=lambda name: rooms[name])
    if not rooms[bound_by] > 0.0:
        steadily = axis.units.quantity(speed, "m/s")
        raise InputError(
            f"{bound_by}: steady motion at {steadily} leaves no margin for an excitation; use a lower speed"
        )
    return rooms[bound_by], bound_by


def _bounds(axis: Axis, limits: Limits) -> list[Bound]:
    """The bounds of the simulated experiment."""
    unit, gain = axis.units.unit, axis.drive.gain
    bounds = [
        Bound(
            "command limit",
            (1.0 - 1e-9) * axis.drive.command_limit,
            lambda reached: max(reached.command, reached.own),
            unit("V"),
        ),
        Bound("stroke", limits.stroke, lambda reached: reached.travel, unit("m")),
    ]
    if limits.speed is not None:
        bounds.append(Bound("speed limit", limits.speed, lambda reached: reached.velocity, unit("m/s")))
    if limits.force is not None:
        bounds.append(
            Bound(f"{axis.units.word('force')} limit", limits.force, lambda reached: gain * reached.command, unit("N"))
        )
    return bounds


def _speed_without_repeats(speed: float, axis: Axis, wave: Wave) -> float:
    """The nearest speed [m/s] at or below ``speed`` at which the encoder's steps hardly repeat with the excitation.

    The carriage then advances by no whole number of steps in a period. Where no speed suits all lines, it is the one at
    which the steps repeat least on the worst of them.
    """
    step = axis.sampling.encoder_resolution
    if step == 0.0:
        return speed
    blocks = np.unique(wave.blocks) * axis.sampling.period
    tried = speed - min(SLOWER * speed, 2.0 * step / float(blocks[-1])) * np.linspace(0.0, 1.0, TRIED)
    advance = tried[:, None] * blocks / step
    worst = np.max([periods * repeated_share(advance, periods) for periods in PERIODS], axis=(0, 2))  # 1: by chance
    good = np.flatnonzero(worst <= 1.0)
    return float(tried[good[0] if good.size else np.argmin(worst)])


def _ramp(axis: Axis, limits: Limits, speed: float, steady: float, usual: float) -> float:
    """Time [s] in which the passes reach ``speed``: ``usual``, or longer so that half of the spare force suffices."""
    gain = axis.drive.gain
    most = min(gain * axis.drive.command_limit, np.inf if limits.force is None else limits.force)
    room = 0.5 * (ROOM * most - gain * steady)
    return max(0.1, usual, 0.5 * np.pi * axis.mechanics.mass * speed / room) if room > 0.0 else usual


def _passes(period: float, speed: float, ramp: float, settle: int, trains: list[np.ndarray], at: str) -> LoopInputs:
    """All passes with their excitation; the velocity of the passes changes as half a cosine."""
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(round(ramp / period)) + 0.5) / round(ramp / period))
    velocity, added, rest = [np.zeros(settle)], [np.zeros(settle)], np.zeros(settle)
    excited = [rest]
    for i, train in enumerate(trains):
        flat = np.ones(settle + train.size)
        velocity += [(-1) ** i * np.concatenate([rise, flat, rise[::-1]]), rest]
        before, after = np.zeros(rise.size + settle), np.zeros(rise.size)
        added += [before, train, after, rest]
        excited += [before, np.ones(train.size), after, rest]
    velocities, excitation = speed * np.concatenate(velocity), np.concatenate(added)
    plain, excited_at = period * np.cumsum(velocities), np.concatenate(excited) > 0.0
    if at == PLACES[0]:
        return LoopInputs(plain, excitation, excited_at, velocities)
    return LoopInputs(plain + excitation, np.zeros(plain.size), excited_at, velocities)


def _expected_std(
    axis: Axis, speed: float, w: np.ndarray, command: np.ndarray, samples: np.ndarray | int, noise: float
) -> np.ndarray:
    """Relative deviations (m,) of lines whose ``command`` has amplitudes (m,) [V] over ``samples`` (m,)."""
    plant, resolution = sample_axis(axis, speed), axis.sampling.encoder_resolution
    back = np.exp(-1j * w * plant.period)
    estimate = estimator_response(plant.estimator, w, plant.period) * (1.0 - back)
    position = plant.response(w) * plant.period / estimate
    power = (noise / axis.drive.gain) ** 2 + resolution**2 / 12.0 / np.abs(position) ** 2
    return np.sqrt(power / samples) / (0.5 * command)
