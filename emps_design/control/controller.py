"""Crossover, margins, bandwidth and damping of each loop of the controller in an axis file, and of the whole loop.

They are given for the sampled loop, as the drive runs it, and for its continuous limit with all lags of the axis. The
velocity loop is broken at the plant input with the position loop open, the position loop at the position error with the
velocity loop closed, the whole loop at the plant input, where a delay or a current loop acts. Natural frequency ``|s|``
and damping ``-Re s / |s|`` are those of the least damped pole of the closed loop (``s = ln(z) / T`` if sampled) that is
not far above crossover and bandwidth; a real pole has a damping of 1.

:class:`ContinuousLoop` is the limit of a loop for fast sampling: the law without hold and estimator, the plant with all
its lags. The kernel of the law is evaluated for periods far below that of the axis and extrapolated to zero
(Richardson), so every law has this limit, also a user's, without a second formula. The lags of the axis remain: current
loop, computation delay, lags and delays of the effects. With ``u = F(s) r + H(s) q`` for the law and ``q = P(s) u`` for
the plant the loop is

    -H P                          broken at the plant input
    F P / (1 - (F + H) P)         broken at the position error
    F s P / (1 - (F s + H) P)     broken at the velocity error, where the reference is a velocity

and its poles are the roots of ``1 - H P``, delays included.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.advice import where_in_words
from emps_design.axis import Axis
from emps_design.control.discretisation import (
    SampledPlant,
    frequencies_around,
    law_peaks,
    oscillations,
    sample_axis,
    sample_plant,
)
from emps_design.control.linear_plant import LinearPlant
from emps_design.control.margins import (
    HERTZ,
    MOST_GAIN,
    Margins,
    Row,
    further_down,
    loop_margins,
    periodic_response,
    transfer,
)
from emps_design.control.sampled import (
    MARGINAL,
    PLANT_INPUT,
    POSITION_ERROR,
    NestedLoop,
    SampledLoop,
    at_plant_input,
    at_position_error,
    close,
    loop_in_words,
    worst_loop,
)
from emps_design.control.velocity.gains import MINUS_3_DB
from emps_design.control.velocity.load_range import LoadRange, relative_mismatch
from emps_design.control.verdict import cases_of
from emps_design.control.view import number, worst_in_words
from emps_design.laws import LawTable, get_law, law_of, table_of
from emps_design.laws.linear import LinearLaw, linear_law
from emps_design.messages import Message
from emps_design.request import typed
from emps_design.view import Line, Table, View, Viewed

LOOPS = ("velocity", "position", "whole")
ROWS: tuple[Row, ...] = (
    ("crossover", "crossover", "rad/s", 1.0),
    ("", "crossover", "Hz", 1.0 / HERTZ),
    ("phase margin", "phase_margin_deg", "deg", 1.0),
    ("gain margin", "gain_margin", "ratio", 1.0),
    ("delay margin", "delay_margin", "ms", 1e3),
    ("", "delay_margin_samples", "samples", 1.0),
    ("disk margin", "disk_margin", "", 1.0),
    ("bandwidth, -3 dB", "bandwidth", "rad/s", 1.0),
    ("natural frequency", "natural_frequency", "rad/s", 1.0),
    ("damping", "damping", "", 1.0),
)
FOLLOWED = ("position", "velocity", "")  # references with a bandwidth; "": a velocity loop without its own reference
FAR = 5.0  # poles faster than this factor on crossover and bandwidth do not count for natural frequency and damping
_REFERENCE, _POSITION = 0, 1  # indices of the inputs of a law

SHORTER = (1e-3, 5e-4, 2.5e-4)  # periods for the extrapolation, as shares of the axis's period
WEIGHTS = (1.0 / 3.0, -2.0, 8.0 / 3.0)  # of these three in the limit: errors of order h and h^2 cancel
HIGHEST = 30.0  # upper end of the frequency grid, in Nyquist frequencies
STARTS, MOST_DELAY = 16, 100  # samples per period, and largest delay in samples, of the loop for the initial poles
SLOWEST = 8  # number of poles that are refined

LawAt = Callable[[float], LinearLaw]  # the linear form of a law at a period [s]


@dataclass(frozen=True)
class LoopMargins:
    """One loop: where it is ``broken``, its ``margins`` there, closed-loop ``bandwidth`` [rad/s], least damped pole.

    ``bandwidth`` is None if the loop has no reference or its response never falls by 3 dB. ``velocity_error`` has the
    margins with the loop broken there, if they differ from those at the plant input, as for a law with its proportional
    part on the velocity only; ``continuous`` is the limit of the same loop for fast sampling.
    """

    broken: str
    margins: Margins
    bandwidth: float | None
    natural_frequency: float | None
    damping: float | None
    velocity_error: Margins | None = None
    continuous: LoopMargins | None = None

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable, by its poles."""
        return self.margins.stable

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI units, angles in degrees."""
        margins = self.margins
        document = {
            "stable": margins.stable,
            "broken": self.broken,
            "crossover": margins.crossover,
            "phase_margin_deg": margins.phase_margin_deg,
            "gain_margin": margins.gain_margin,
            "gain_reduction_margin": margins.gain_reduction_margin,
            "delay_margin": margins.delay_margin,
            "disk_margin": margins.disk_margin,
            "bandwidth": self.bandwidth,
            "natural_frequency": self.natural_frequency,
            "damping": self.damping,
        }
        if self.velocity_error is not None:
            document["velocity_error"] = self.velocity_error.to_dict()
        if self.continuous is not None:
            document["continuous"] = self.continuous.to_dict()
        return document


Loops = dict[str, LoopMargins | None]


@dataclass(frozen=True)
class ControllerMargins(Viewed):
    """The ``loops`` of the controller of ``axis`` by name, None for loops that it does not have.

    ``others`` are the loops on the other plants of a load range or mismatch, each with its differences from the axis;
    the effects are linearised at ``velocity`` [m/s].
    """

    axis: Axis
    loops: Loops
    others: tuple[tuple[Mapping[str, Any], Loops], ...] = ()
    velocity: float = 0.1
    warnings: tuple[Message, ...] = field(default=(), repr=False)

    @cached_property
    def worst(self) -> NestedLoop:
        """The loop with the smallest margins, over all plants."""
        return worst_loop(
            NestedLoop(f"{name} loop", loop.broken, loop.margins, where)
            for where, loops in (({}, self.loops), *self.others)
            for name, loop in loops.items()
            if loop is not None
        )

    @property
    def stable(self) -> bool:
        """Whether every loop is stable on every plant."""
        return self.worst.margins.stable

    @property
    def reason(self) -> str:
        """The reason why the controller must not run, in one line; empty if every loop is stable."""
        return (
            ""
            if self.stable
            else f"the {loop_in_words(self.worst, self.axis.units)} of the axis file's controller is unstable"
        )

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of the command ``margins``."""
        document: dict[str, Any] = {
            "axis": self.axis.name,
            "controller": self.axis.controller.kind,
            "velocity": self.velocity,
            "stable": self.stable,
            "worst_loop": self.worst.to_dict(),
            "loops": _plain(self.loops),
        }
        if self.others:
            document["range"] = [{"where": dict(where), "loops": _plain(loops)} for where, loops in self.others]
        if not self.stable:
            document["reason"] = self.reason
        return {**document, "warnings": list(self.warnings)}

    def view(self) -> View:
        """The verdict, the margins of each loop, sampled and continuous, and on the other plants."""
        verdict, style = ("stable", "good") if self.stable else ("UNSTABLE", "bad")
        loops = {f"{name} loop": loop for name, loop in self.loops.items() if loop is not None}
        continuous = {name: loop.continuous for name, loop in loops.items() if loop.continuous is not None}
        units = self.axis.units
        return (
            Line(f"{self.axis.name}: the loops of the {self.axis.controller.kind} controller are {verdict}", style),
            Line(worst_in_words(self.worst.to_dict(), units)),
            _side_by_side(loops, "Sampled, as the drive runs it"),
            _side_by_side(continuous, "Continuous, with all lags of the axis"),
            *([self._on_every_machine(list(loops))] if self.others else []),
            *(Line(warning, "note") for warning in self.warnings),
        )

    def _on_every_machine(self, names: list[str]) -> Table:
        """Phase and gain margin of the loops ``names`` on the other plants."""
        rows = [
            (where_in_words(where, self.axis.units), *(_in_short(loop) for loop in loops.values() if loop))
            for where, loops in self.others
        ]
        return Table(("", *names), rows, "On the other plants: phase margin, gain margin")


def _side_by_side(loops: Mapping[str, LoopMargins], title: str) -> Table:
    """The margins of ``loops``, one column each; the delay margin in samples exists for sampled loops only."""
    columns = [{**loop.margins.to_dict(), **loop.to_dict()} for loop in loops.values()]
    rows = [("broken at the", *(loop["broken"] for loop in columns), "")]
    for label, key, unit, scale in ROWS:
        if not all(key in loop for loop in columns):
            continue
        cells = [
            number(None if loop[key] is None else scale * loop[key], 4, "-") if loop["stable"] else "undefined"
            for loop in columns
        ]
        rows.append((label, *cells, unit))
    return Table(("", *loops, "unit"), rows, title)


def _in_short(loop: LoopMargins) -> str:
    margins = loop.margins
    if not loop.stable:
        return "unstable"
    return f"{number(margins.phase_margin_deg, 3)} deg, {number(margins.gain_margin, 3)}"


def _plain(loops: Loops) -> dict[str, Any]:
    return {name: None if loop is None else loop.to_dict() for name, loop in loops.items()}


@typed
def controller_margins(
    axis: Axis, mismatch: float | None = None, load: LoadRange | None = None, velocity: float = 0.1
) -> ControllerMargins:
    """Return crossover, margins, bandwidth and damping of each loop of the controller of ``axis`` and of the whole.

    ``mismatch`` adds every corner of that relative error of mass, viscous friction and force gain, ``load`` the plants
    of a :class:`~emps_design.control.velocity.load_range.LoadRange`. The effects of the axis are linearised at
    ``velocity`` [m/s], and in the other direction too. Raises :class:`~emps_design.errors.AxisError` if the axis has no
    controller.

    >>> from emps_design.axis import Axis
    >>> servo = Axis(mechanics={"mass": 0.74944, "viscous": 10.556, "coulomb": 0.0}, drive={"force_gain": 1.0},
    ...              sampling={"period": 1e-3}, controller={"kind": "p", "kp": 250.0})
    >>> loops = controller_margins(servo).loops
    >>> loops["velocity"], round(loops["whole"].margins.phase_margin_deg, 1)
    (None, 41.3)
    >>> round(loops["whole"].continuous.natural_frequency, 2), round(loops["whole"].continuous.damping, 3)
    (18.26, 0.386)
    """
    errors = None if mismatch is None else relative_mismatch(mismatch)
    here, *others = cases_of(axis, velocity, load, errors)
    plant = sample_axis(here.axis, here.velocity)
    return ControllerMargins(
        axis,
        loops_around(axis, plant, velocity, continuous=True),
        tuple(
            (case.where, loops_around(axis, sample_axis(case.axis, case.velocity, delay=case.delay), case.velocity))
            for case in others
        ),
        velocity,
        plant.linear.warnings,
    )


def loops_around(axis: Axis, plant: SampledPlant, velocity: float = 0.1, continuous: bool = False) -> Loops:
    """Return the loops of the controller of ``axis`` around any sampled ``plant``, by the names :data:`LOOPS`."""
    margins: Loops = dict.fromkeys(LOOPS)
    for name, (follows, law) in _laws(axis, float(np.sign(velocity))).items():
        loop = _sampled(law(plant.period), plant, name, follows)
        limit = _continuous(ContinuousLoop.of(law, axis, plant), plant, name, follows) if continuous else None
        margins[name] = replace(loop, continuous=limit)
    return margins


def _laws(axis: Axis, direction: float) -> dict[str, tuple[str, LawAt]]:
    """Return for each loop its kind of reference, and its law as a function of the period [s].

    A position loop is a law that reads the position error only.
    """
    period = axis.sampling.period
    law, kind = law_of(axis, period), get_law(axis.controller.kind)
    loops: dict[str, tuple[str, LawAt]] = {}

    def whole(h: float) -> LinearLaw:
        return linear_law(law_of(axis, h), h, direction)

    if kind.loops is not None:
        for _, table in kind.loops(table_of(axis)):

            def inner(h: float, table: LawTable = table) -> LinearLaw:
                return linear_law(kind.law(table, axis, h), h, direction)

            follows = kind.law(table, axis, period).follows
            loops[follows] = follows, inner
    elif law.follows == "velocity":
        loops["velocity"] = law.follows, whole
    elif law.follows == "position":
        error_only = not _reads_position(_velocity_feedback(whole(period)))
        if kind.state_feedback and not error_only:
            loops["velocity"] = "", lambda h: _velocity_feedback(whole(h))
        if kind.state_feedback or error_only:
            loops["position"] = law.follows, whole
    return {**loops, "whole": (law.follows, whole)}


def _velocity_feedback(form: LinearLaw) -> LinearLaw:
    """The velocity feedback of a law of position error and velocity: ``form`` with the position error held at zero."""
    B, D = form.B.copy(), form.D.copy()
    for columns in (B, D):
        columns[..., _POSITION] += columns[..., _REFERENCE]
        columns[..., _REFERENCE] = 0.0
    size = np.abs(form.D[..., _POSITION])
    D[..., _POSITION] = np.where(np.abs(D[..., _POSITION]) < 1e-12 * size, 0.0, D[..., _POSITION])
    return replace(form, B=B, D=D)


def _reads_position(form: LinearLaw) -> bool:
    """Whether the command of a law depends on the position."""
    return bool(np.any(form.D[..., _POSITION]) or np.any(form.used()))


def _sampled(form: LinearLaw, plant: SampledPlant, name: str, follows: str) -> LoopMargins:
    loop = close(plant, form, plant_input=True)
    margins = at_position_error(plant, form) if name == "position" else at_plant_input(plant, form)
    grid = plant.frequencies(peaks=law_peaks(form, plant.period))
    poles = loop.poles[np.abs(loop.poles) > 1e-9]
    return _loop_margins(
        name,
        follows,
        margins,
        grid,
        np.log(poles.astype(complex)) / (loop.cycle * plant.period),
        _closed(loop, plant, follows),
        lambda: loop_margins(_velocity_error(loop, form, plant), grid, True, plant.period),
    )


def _continuous(loop: ContinuousLoop, plant: SampledPlant, name: str, follows: str) -> LoopMargins:
    grid, poles = loop.frequencies(plant), loop.poles
    stable = bool(np.all(poles.real <= MARGINAL * np.abs(poles)))
    broken = loop.at_position_error if name == "position" else loop.at_plant_input

    def closed(w: np.ndarray) -> np.ndarray:
        s = 1j * np.asarray(w)
        if not follows:
            return loop.at_plant_input(s) / (1.0 + loop.at_plant_input(s))
        return loop.followed(s) * (s if follows == "velocity" else 1.0)

    return _loop_margins(
        name,
        follows,
        _bounded(loop_margins(lambda w: broken(1j * w), grid, stable)),
        grid,
        poles,
        closed,
        lambda: _bounded(loop_margins(lambda w: loop.at_velocity_error(1j * w), grid, True)),
    )


def _loop_margins(
    name: str,
    follows: str,
    margins: Margins,
    grid: np.ndarray,
    poles: np.ndarray,
    closed: Callable[[np.ndarray], np.ndarray],
    at_velocity_error: Callable[[], Margins],
) -> LoopMargins:
    """The loop ``name`` of a law: its ``margins``, its bandwidth, and the least damped of its ``poles`` [1/s].

    ``grid`` [rad/s] brackets the -3 dB frequency of the ``closed`` loop's response to the reference that the law
    ``follows``. The margins ``at_velocity_error`` are included if they differ.
    """
    bandwidth = _minus_3_db(closed, grid) if margins.stable and follows in FOLLOWED else None
    error = None
    if name == follows == "velocity" and margins.stable:
        error = _if_different(margins, at_velocity_error())
    return LoopMargins(
        POSITION_ERROR if name == "position" else PLANT_INPUT,
        margins,
        bandwidth,
        *_least_damped(poles, margins.crossover, bandwidth),
        error,
    )


def _closed(loop: SampledLoop, plant: SampledPlant, follows: str) -> Callable[[np.ndarray], np.ndarray]:
    """Response of the closed loop to its reference: of the position, or of the velocity as the law estimates it."""

    def velocity(w: np.ndarray) -> np.ndarray:
        return loop.response(w, "voltage", "reference") * plant.response(w)

    def alone(w: np.ndarray) -> np.ndarray:
        gain = loop.loop_gain(w)
        return gain / (1.0 + gain)

    return {"velocity": velocity, "position": lambda w: loop.position_response(w, "reference")}.get(follows, alone)


def _velocity_error(loop: SampledLoop, form: LinearLaw, plant: SampledPlant) -> Callable[[np.ndarray], np.ndarray]:
    """The sampled loop of a law that follows a velocity, broken at the velocity error."""

    def response(w: np.ndarray) -> np.ndarray:
        z = np.exp(1j * np.asarray(w) * plant.period)
        ahead = transfer(form.A, form.B[:, _REFERENCE], form.C, form.D[_REFERENCE], z) * plant.response(w)
        return ahead / (1.0 + loop.loop_gain(w) - ahead)

    return response


@dataclass(frozen=True)
class ContinuousLoop:
    """The loop of a law, given as ``law`` at any period [s], around ``plant`` with an additional ``delay`` [s].

    ``period`` [s] is that of the axis and scales the frequency grid.
    """

    law: LawAt
    plant: LinearPlant
    delay: float
    period: float

    @classmethod
    def of(cls, law: LawAt, axis: Axis, sampled: SampledPlant) -> ContinuousLoop:
        """The loop of ``law`` on the plant of ``axis``, of which ``sampled`` is the sampled one."""
        sampling = axis.sampling
        late = sampled.linear.delay + sampling.computation_delay * sampling.period
        return cls(law, sampled.linear, late, sampling.period)

    @cached_property
    def _forms(self) -> list[tuple[float, float, LinearLaw]]:
        periods = [share * self.period for share in SHORTER]
        return [(weight, h, self.law(h)) for weight, h in zip(WEIGHTS, periods, strict=True)]

    def by_reference(self, s: np.ndarray) -> np.ndarray:
        """F: command over reference at ``s`` [1/s] of any shape."""
        return self._limit(s, 0)

    def by_position(self, s: np.ndarray) -> np.ndarray:
        """H: command over position at ``s`` [1/s]."""
        return self._limit(s, 1)

    def _limit(self, s: np.ndarray, place: int) -> np.ndarray:
        return np.asarray(sum(weight * _response(form, h, s, place) for weight, h, form in self._forms))

    def position(self, s: np.ndarray) -> np.ndarray:
        """P: encoder's position over command at ``s`` [1/s], delays included."""
        s = np.asarray(s, dtype=complex)
        return transfer(self.plant.A, self.plant.B, self.plant.C, 0.0, s) * np.exp(-s * self.delay)

    def at_plant_input(self, s: np.ndarray) -> np.ndarray:
        """The loop broken at the plant input at ``s`` [1/s]."""
        return -self.by_position(s) * self.position(s)

    def at_position_error(self, s: np.ndarray) -> np.ndarray:
        """The loop broken at the position error at ``s`` [1/s]."""
        ahead, plant = self.by_reference(s), self.position(s)
        return ahead * plant / (1.0 - (ahead + self.by_position(s)) * plant)

    def at_velocity_error(self, s: np.ndarray) -> np.ndarray:
        """The loop of a law that follows a velocity, broken at the velocity error, at ``s`` [1/s]."""
        ahead, plant = self.by_reference(s) * s, self.position(s)
        return ahead * plant / (1.0 - (ahead + self.by_position(s)) * plant)

    def followed(self, s: np.ndarray) -> np.ndarray:
        """Position over reference in the closed loop at ``s`` [1/s]."""
        return self.by_reference(s) * self.position(s) / (1.0 + self.at_plant_input(s))

    def frequencies(self, sampled: SampledPlant) -> np.ndarray:
        """Return a frequency grid [rad/s]: that of the plant ``sampled``, extended upwards, fine at resonances."""
        nyquist = np.pi / self.period
        beyond = np.geomspace(nyquist, HIGHEST * nyquist, 150)
        grid = np.concatenate([sampled.frequencies(), beyond, frequencies_around(oscillations(self.plant.A))])
        return np.unique(grid[(grid > 0.0) & (grid <= HIGHEST * nyquist)])

    @cached_property
    def poles(self) -> np.ndarray:
        """The slowest poles [1/s], slowest first, one of each conjugate pair, refined on the response."""
        h = max(self.period / STARTS, self.delay / MOST_DELAY)
        plant = sample_plant(replace(self.plant, delay=self.delay), h)
        loop = close(plant, self.law(h))
        z = loop.poles[np.abs(loop.poles) > 1e-6]
        s = np.log(z) / (loop.cycle * h)
        s = s[s.imag >= 0.0]
        slow = [self._refined(pole) for pole in s[np.argsort(-s.real)][:SLOWEST]]
        return np.array(sorted((pole for pole in slow if pole is not None), key=lambda pole: -pole.real), dtype=complex)

    def _refined(self, pole: complex) -> complex | None:
        """The root of 1 - H P near ``pole`` by Newton's method; None if there is none, as for an estimator's pole."""
        s = complex(pole)
        for _ in range(30):
            step = 1e-6 * max(abs(s), 1e-9 / self.period)
            try:
                here, beside = 1.0 + self.at_plant_input(np.array([s, s + step]))
            except np.linalg.LinAlgError:  # a pole of the law or the plant, not of the loop
                return None
            change = here * step / (here - beside) if here != beside else 0.0
            s += change
            if not np.isfinite(s) or abs(s - pole) > 0.5 * abs(pole):
                return None
            if abs(change) <= 1e-8 * abs(s):
                return s
        return None


def _response(form: LinearLaw, period: float, s: np.ndarray, place: int) -> np.ndarray:
    """Command over the input ``place`` of a law at ``s`` [1/s]; with several rates the mean over a cycle."""
    s = np.asarray(s, dtype=complex)
    matrices = form.A, form.B[..., place], form.C, form.D[..., place]
    if form.cycle == 1:
        return transfer(*matrices, np.exp(s * period))
    return periodic_response(*matrices, -1j * s.ravel() * period).reshape(s.shape)


def _bounded(margins: Margins) -> Margins:
    """``margins`` without a gain margin above :data:`MOST_GAIN`, which is rounding."""
    far = margins.gain_margin is not None and margins.gain_margin > MOST_GAIN
    return replace(margins, gain_margin=None, gain_margin_frequency=None) if far else margins


def _if_different(margins: Margins, error: Margins) -> Margins | None:
    """Return ``error`` if it differs from ``margins``, otherwise None."""
    both = [(getattr(margins, name), getattr(error, name)) for name in ("phase_margin_deg", "crossover")]
    alike = all(a is None or b is None or math.isclose(a, b, rel_tol=1e-6) for a, b in both)
    return None if alike else error


def _least_damped(poles: np.ndarray, *frequencies: float | None) -> tuple[float | None, float | None]:
    """Return natural frequency [rad/s] and damping of the least damped of ``poles`` (n,) [1/s].

    Poles far above the known ``frequencies`` [rad/s] of the loop do not count; of real poles the slowest does.

    >>> pole = _least_damped(np.array([-20.0, -3.0 + 4.0j, -3.0 - 4.0j, -90.0 + 500.0j]), 6.0)
    >>> [round(x, 6) for x in pole], _least_damped(np.array([-4.0, -1.0]), None)
    ([5.0, 0.6], (1.0, 1.0))
    """
    known = [w for w in frequencies if w is not None]
    near = [pole for pole in poles if pole and (not known or abs(pole) <= FAR * max(known))]
    pole = complex(min(near or poles, key=lambda pole: (round(-pole.real / abs(pole), 9), abs(pole)), default=0.0))
    return (abs(pole), -pole.real / abs(pole)) if pole else (None, None)


def _minus_3_db(response: Callable[[np.ndarray], np.ndarray], grid: np.ndarray) -> float | None:
    """First frequency [rad/s] at which a closed-loop ``response`` has fallen by 3 dB; None: never."""
    grid = further_down(grid)
    size = np.abs(response(grid))
    level = MINUS_3_DB * size[0]
    below = np.flatnonzero(size < level)
    if not below.size or not level:
        return None
    from scipy.optimize import brentq

    low, high = np.log(grid[below[0] - 1 : below[0] + 1])
    return float(np.exp(brentq(lambda x: abs(response(np.exp(np.array([x])))[0]) - level, low, high, xtol=1e-14)))
