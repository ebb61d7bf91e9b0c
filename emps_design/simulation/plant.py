"""The plant: an axis with its effects, prepared once and simulated any number of times.

It prepares the inputs of the steppers: the compiled kernels of the effects' hooks, the solution method that these
permit, checked signals, and the settings of a run.
"""

from __future__ import annotations

import dis
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects import Effect
from emps_design.effects.effect import Kernel
from emps_design.errors import InputError, SimulationError
from emps_design.laws import Law, law_of
from emps_design.request import takes
from emps_design.simulation.environment import Hand, Wall
from emps_design.simulation.kernels import baseline as core, hold_loop as stepper, motion
from emps_design.simulation.kernels.compile import address
from emps_design.simulation.run import ClosedLoopRun, OpenLoopRun, Run, intention_columns, motor_rows, positive, signal

# In the order of the rows of the table of hooks.
HOOKS = ("force", "dry", "inertia", "command", "actuator", "delay", "sensor", "rate", "guard", "jump_time")
# Hooks that are one number for the stepper if they are constant during a run, and the place of that setting.
SUMMED = {"dry": motion.LEVEL, "inertia": motion.MASS}
_MOTION, _STATE, _COMMAND = range(5), (0, 1, 3, 4), range(3, 4)  # of a kernel's arguments q, v, t, tau, x, p, b

# Absolute tolerance of the states of the effects by unit, for states close to zero.
FLOORS = {"m": 1e-6, "m/s": 1e-4, "N": 1e-2}
METHODS = ("general", "linear", "plain", "folded")  # of stepping; those before the fastest exact one are exact too
_LEAST_DIFFERENCE = 1e-7  # least relative difference of two lags
_EMPTY = np.zeros(0)
_NO_SIGNALS, _NO_MOTOR, _NO_SLOTS = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros(0, np.int64)


def summed_of(effect: Effect, touching: bool) -> Iterator[tuple[int, Kernel]]:
    """Yield the place in the settings and the kernel of each hook of ``effect`` that is constant during a run.

    Such a kernel depends only on parameters and baseline; the parameters of an effect ``touching`` the carriage may
    change during a run.
    """
    for hook, place in SUMMED.items():
        kernel = getattr(effect, hook)
        if kernel is not None and not touching and not _reads(kernel, _MOTION):
            yield place, kernel


def hooks_of(effect: Effect, touching: bool, held: bool) -> Iterator[tuple[int, int]]:
    """Yield the row of the table and the address of every kernel of ``effect`` that is called step by step.

    ``touching``: the effect is in contact with the carriage and a force sensor there measures its force; ``held``: that
    force is constant over each sampling period.
    """
    if held and effect.force is not None:
        yield motion.HELD, address(effect.force)
        return
    summed = [kernel for _, kernel in summed_of(effect, touching)]
    for row, hook in enumerate(HOOKS):
        kernel = effect.hook(hook)
        if kernel is not None and kernel not in summed:
            yield row, address(kernel, hook if hook in ("actuator", "rate") else "kernel")
    if effect.force is not None and not touching:
        yield motion.SOLVED if effect.solver.affine or effect.solver.slopes else motion.UNSOLVED, address(effect.force)
    if effect.solver.by_travel and effect.force is not None:
        yield motion.MEMORY, address(effect.force)
    if touching:
        for row, kernel in ((motion.TOUCH, effect.force), (motion.TOUCH_MASS, effect.inertia)):
            if kernel is not None:
                yield row, address(kernel)


def touches_motion(effect: Effect) -> bool:
    """Whether ``effect`` acts between motor force and motion, not only on the signals."""
    return any((effect.force, effect.dry, effect.inertia, effect.rate, effect.solver.guard, effect.solver.jump_time))


def sees_command(effect: Effect) -> bool:
    """Whether a force of ``effect`` depends on the motor force, or it changes the mass, so that it jumps with it."""
    return effect.inertia is not None or reads_command(effect)


def reads_command(effect: Effect) -> bool:
    """Whether a force of ``effect`` depends on the motor force."""
    return any(_reads(kernel, _COMMAND) for kernel in (effect.force, effect.dry) if kernel is not None)


def is_smooth(effect: Effect) -> bool:
    """Whether ``effect`` is smooth between jumps in time: no states, no guards, a mass independent of the motion."""
    mass_varies = effect.inertia is not None and _reads(effect.inertia, _STATE)
    return not (effect.states or effect.solver.guard or mass_varies)


def how_solved(stepped: Sequence[Effect], lags: int) -> int:
    """Return how hold periods with the effects ``stepped`` are solved, with ``lags`` lags of the motor force.

    0: not in closed form; 1: in closed form with all effects; 2: smooth effects are added to the closed form; 3: some
    of these depend on the command. At most one effect may be piecewise affine.
    """
    solved, others = (
        [effect for effect in stepped if effect.solver.affine],
        [effect for effect in stepped if not effect.solver.affine],
    )
    pieces = sum(1 for effect in solved if effect.solver.guard)
    presliding = any(effect.takes_dry for effect in stepped)
    if not solved or pieces > 1 or lags > 1 or presliding or not all(map(is_smooth, others)):
        return 0
    if any(map(reads_command, others)):
        return 3 if lags == 0 else 0  # after a lag the motor force is not a parabola of time
    return 2 if others else 1


@cache
def _reads(kernel: Kernel, which: Sequence[int]) -> bool:
    """Whether ``kernel`` reads one of its arguments at the positions ``which``, regardless of their names."""
    names = [kernel.__code__.co_varnames[i] for i in which]
    read = [step.argval for step in dis.get_instructions(kernel)]
    return any(name in (arg if isinstance(arg, tuple) else (arg,)) for arg in read for name in names)


@dataclass(frozen=True)
class Prepared:
    """Arguments of the general stepper, except the law, the signals and the output arrays.

    ``baseline`` (4,), ``parameters``, ``settings``, ``y`` the initial state, the table of hooks with its ``starts``,
    ``columns`` that are written to ``slots`` of the parameters at every sample, ``floors`` and ``scratch``.
    """

    baseline: np.ndarray
    parameters: np.ndarray
    settings: np.ndarray
    y: np.ndarray
    hooks: np.ndarray
    starts: np.ndarray
    columns: np.ndarray
    slots: np.ndarray
    floors: np.ndarray
    scratch: np.ndarray


@dataclass(frozen=True)
class Inputs:
    """The checked inputs of a run: parameters of the plant, initial state, signals, and settings.

    ``baseline`` (4,); ``parameters`` in one vector; ``resolution`` [m] of the encoder; without a ``law``, ``reference``
    (n,) are the commands; ``motor`` as returned by :func:`motor_rows`. Empty signals are zero.
    """

    baseline: np.ndarray
    parameters: np.ndarray
    samples: int
    period: float
    resolution: float
    q0: float = 0.0
    v0: float = 0.0
    intention: np.ndarray | None = None
    energy: bool = False
    tolerance: float = 1.0
    law: Law | None = None
    reference: np.ndarray = field(default_factory=lambda: _EMPTY)
    push: np.ndarray = field(default_factory=lambda: _EMPTY)
    noise: np.ndarray = field(default_factory=lambda: _EMPTY)
    motor: np.ndarray = field(default_factory=lambda: _NO_MOTOR)


class Plant:
    """An axis ready to be simulated.

    >>> import numpy as np
    >>> from emps_design.machines import machine
    >>> run = Plant.of(machine("emps2019")).closed_loop(np.linspace(0.0, 0.01, 200))
    >>> round(float(run.q[-1]), 4)
    0.0097
    """

    def __init__(
        self, axis: Axis, effects: Sequence[tuple[Effect, np.ndarray]], environment: tuple[Hand | Wall, ...] = ()
    ):
        """``effects`` with their parameters; ``environment``: hands and walls in contact with the carriage."""
        self.axis = axis
        self.baseline = axis.mechanics.array()
        self.environment = environment
        entries = [*effects, *(contact.effect() for contact in environment)]
        self.effects = tuple(effect for effect, _ in entries)
        self.parameters = tuple(values for _, values in entries)
        count = len(effects)
        self._outside = range(count, len(entries))
        hands = {count + i: contact for i, contact in enumerate(environment) if isinstance(contact, Hand)}
        self._hands, self._held = list(hands), [i for i, hand in hands.items() if hand.held]
        self._lag = axis.drive.current_time_constant
        # A lag of the motor force needs no state: up to two lags, the current loop included, have a closed form.
        lags = [i for i, effect in enumerate(self.effects) if effect.solver.lag]
        self.lagging = lags[: 1 if self._lag > 0 else 2]
        twice = len(self.lagging) + (self._lag > 0) > 1
        self._free = any(effect.takes_dry for effect in self.effects)
        self._p = np.concatenate([_EMPTY, *self.parameters])
        self.parameters_at = list(accumulate(map(len, self.parameters), initial=0))
        states = [0 if i in self.lagging else len(effect.states) for i, effect in enumerate(self.effects)]
        self.states_at = list(accumulate(states, initial=2))
        self._states = self.states_at[-1]
        self._floors = [
            FLOORS.get(state.unit, 1e-6)
            for i, effect in enumerate(self.effects)
            for state in effect.states
            if i not in self.lagging
        ]
        self._hooks, self._starts = self._table()
        moving = [effect for i, effect in enumerate(self.effects) if i not in (*self.lagging, *self._held)]
        dynamic = any((e.states and not e.solver.by_travel) or e.solver.guard for e in moving)
        stepped = [effect for effect in moving if effect.solver.slopes is None and touches_motion(effect)]
        self._exact = not stepped and not twice
        reads_force = any(sees_command(effect) for i, effect in enumerate(self.effects) if i not in self.lagging)
        self._solved = 0 if environment else how_solved(stepped, len(self.lagging) + (self._lag > 0))
        dynamic |= twice and (reads_force or any(effect.states for effect in moving))  # slides are solved for one lag
        # Presliding friction that jumps with every command deflects immediately: it needs the stepper.
        self._slides = 0 if dynamic or (reads_force and self._free) else 1 if reads_force else 2

    @classmethod
    def of(cls, axis: Axis) -> Plant:
        """The plant of ``axis`` with its effects; kernels are compiled once."""
        return cls(axis, [(entry.effect, entry.effect.values(entry.parameters)) for entry in axis.effects])

    def touched_by(self, *things: Hand | Wall) -> Plant:
        """Return this plant with a hand, walls, or both at the carriage."""
        count = len(self.effects) - len(self.environment)
        effects = list(zip(self.effects[:count], self.parameters[:count], strict=True))
        return Plant(self.axis, effects, (*self.environment, *things))

    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        rows: list[list[tuple[int, int, int]]] = [[] for _ in range(motion.UNSOLVED + 1)]
        for i, effect in enumerate(self.effects):
            if i not in self.lagging and not effect.winding:
                for row, kernel in hooks_of(effect, i in self._outside, i in self._held):
                    rows[row].append((kernel, self.states_at[i], self.parameters_at[i]))
        table = np.array([number for row in rows for entry in row for number in entry] or [0], np.int64)
        return table, np.array(list(accumulate(map(len, rows), initial=0)), np.int64)

    @takes(ClosedLoopRun)
    def closed_loop(self, request: ClosedLoopRun) -> Run:
        """Simulate the axis under its controller (or ``law``) and return the :class:`Run`.

        Raises :class:`SimulationError` with time, state and effect if the simulation cannot continue.
        """
        period = self._period(request)
        unit = self.axis.units.unit
        q_ref = signal(request.q_ref, "q_ref", unit("m"))
        law = request.law or law_of(self.axis, period)
        if request.reference is None:
            reference = law.reference(q_ref, period)
        else:
            reference = signal(request.reference, "reference", f"{unit('m')} or {unit('m/s')}", q_ref.size)
        noise = request.voltage_noise
        noise = _EMPTY if noise is None else signal(noise, "voltage_noise", unit("V"), q_ref.size)
        q0 = float(q_ref[0]) if request.q0 is None else float(request.q0)
        return self._simulate(self._inputs(request, law, reference, q0, noise), request.method, q_ref)

    @takes(OpenLoopRun)
    def open_loop(self, request: OpenLoopRun) -> Run:
        """Simulate the axis under the voltage ``u`` and return the :class:`Run`, whose ``q_ref`` is nan.

        The voltage limit applies; ``command`` effects add to ``u``.
        """
        u = signal(request.u, "u", self.axis.units.unit("V"))
        inputs = self._inputs(request, None, u, request.q0, _EMPTY)
        return self._simulate(inputs, request.method, np.full(u.size, np.nan))

    def _period(self, request: ClosedLoopRun | OpenLoopRun) -> float:
        return self.axis.sampling.period if request.period is None else positive(request.period)

    def _inputs(
        self, request: ClosedLoopRun | OpenLoopRun, law: Law | None, reference: np.ndarray, q0: float, noise: np.ndarray
    ) -> Inputs:
        """The checked inputs of the run of ``request``."""
        b, p = self.numbers(request.baseline, request.parameters)
        hands, n, push, units = len(self._hands), reference.size, request.disturbance, self.axis.units
        if hands > 1 or (request.intention is not None and not hands):
            raise InputError(
                f"intention: found {hands} hands at the {units.word('carriage')}, expected one; see Plant.touched_by"
            )
        if not (np.isfinite(q0) and np.isfinite(request.v0)):
            place, speed = units.quantity(q0, "m", "g"), units.quantity(request.v0, "m/s", "g")
            raise InputError(f"q0, v0: found {place}, {speed}, expected finite numbers")
        return Inputs(
            baseline=b,
            parameters=p,
            samples=n,
            period=self._period(request),
            resolution=self.axis.sampling.encoder_resolution if request.quantise else 0.0,
            q0=q0,
            v0=request.v0,
            intention=request.intention,
            energy=request.energy,
            tolerance=request.tolerance,
            law=law,
            reference=reference,
            push=_EMPTY if push is None else signal(push, "disturbance", units.unit("N"), n),
            noise=noise,
            motor=motor_rows(self.axis.drive, request.supply, request.enable, n),
        )

    def _simulate(self, inputs: Inputs, method: str, q_ref: np.ndarray) -> Run:
        n, motor = inputs.samples, inputs.motor
        fastest = "general" if inputs.energy or motor.size else self._method(inputs)
        possible = ("auto", *METHODS[: METHODS.index(fastest) + 1])
        if method not in possible:
            raise InputError(f"method: found {method!r}, expected one of {', '.join(possible)} for this axis")
        method = fastest if method == "auto" else method
        events, tally = np.empty((n + 1000, 3)), np.array([0, n + 1000])
        balance = None
        if inputs.law is None or method in ("general", "linear"):
            rows, balance = self._general(inputs, method, events, tally)
        else:
            rows = self._core(inputs, method, events, tally)
        encoder, position, velocity, u, outside = rows
        count = min(int(tally[0]), n + 1000)
        return Run(
            q_ref=q_ref,
            q=encoder,
            position=position,
            v=velocity,
            u=u,
            f_ext=outside,
            events=events[:count].copy(),
            force_gain=motor[:, 0] if motor.size else self.axis.drive.gain,
            period=inputs.period,
            lost_events=int(tally[0]) - count,
            energy=balance,
            name=self.axis.name,
            units=self.axis.units,
        )

    def numbers(self, baseline: Any = None, parameters: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """Return ``baseline`` (4,) and ``parameters`` in one vector, checked; by default those of the axis."""
        b = self.baseline if baseline is None else np.array(baseline, dtype=float)
        p = self._p.copy() if parameters is None else np.concatenate([_EMPTY, *parameters])
        if b.shape != (4,) or not np.isfinite(b).all() or b[0] <= 0 or b[1] < 0 or b[2] < 0:
            raise InputError(
                f"baseline: found {b.tolist()}, expected [{self.axis.units.word('mass')} > 0, viscous >= 0, "
                "coulomb >= 0, offset], finite"
            )
        if p.size != self._p.size or not np.isfinite(p).all():
            raise InputError(f"parameters: found {p.tolist()}, expected {self._p.size} finite numbers")
        return b, p

    def _method(self, inputs: Inputs) -> str:
        """The fastest stepping method that is exact for this axis."""
        delay, law = self.axis.sampling.computation_delay, inputs.law
        if self.effects or self._lag > 0 or law is None or not law.state_feedback:
            return "linear" if self._solved == 1 and self._pieces(inputs.parameters) else "general"
        return "plain" if delay or inputs.noise.size or inputs.resolution > 0 else "folded"

    def _pieces(self, p: np.ndarray) -> list[tuple[int, float, float]]:
        """State index and range of every affine effect with the parameters ``p``; empty if one is not affine."""
        pieces = []
        for i, effect in enumerate(self.effects if self._solved else ()):
            if effect.solver.affine:
                ends = effect.solver.affine(p[self.parameters_at[i] : self.parameters_at[i + 1]])
                if ends is None:
                    return []
                pieces.append((self.states_at[i], *ends))
        return pieces

    def _core(self, inputs: Inputs, method: str, events: np.ndarray, tally: np.ndarray) -> Iterable[np.ndarray]:
        """Run the exact core, which is without effects."""
        assert inputs.law is not None
        n, drive, delay = inputs.samples, self.axis.drive, self.axis.sampling.computation_delay
        reference, push, period, start = inputs.reference, inputs.push, inputs.period, (inputs.q0, inputs.v0)
        b = inputs.baseline + np.array([0.0, drive.braking, 0.0, 0.0])
        position, velocity, u, encoder = np.empty((4, n))
        numbers = core.numbers_of(self.axis, period, inputs.resolution, inputs.law.gains)
        if method == "plain":
            good = core.run_plain(
                b, numbers, delay, start, reference, push, inputs.noise, position, encoder, velocity, u, events, tally
            )
        else:
            good = core.run_folded(b, numbers, start, reference, push, position, velocity, u, events, tally)
            encoder = position
        farthest = self.axis.units.farthest
        if good == n and not abs(position[-1]) < farthest:
            good = int(np.argmin(np.abs(position) < farthest))
        if good < n:
            at, reason = (good, stepper.DIVERGED) if good >= 0 else (-good - 1, stepper.RUNAWAY)
            why = stepper.reason_of(reason, self.axis.units)
            raise SimulationError(why, at * period, (float(position[at]), float(velocity[at])))
        return encoder, position, velocity, u, push if push.size else np.broadcast_to(0.0, n)

    def prepared(self, inputs: Inputs) -> Prepared:
        """Return the arguments of the general stepper for a run with these ``inputs``."""
        b, p, q0, v0 = inputs.baseline, inputs.parameters, inputs.q0, inputs.v0
        columns, slots = self._intended(inputs.intention, inputs.samples, inputs.period)
        drive, settings = self.axis.drive, np.zeros(motion.SETTINGS)
        settings[motion.PERIOD], settings[motion.GAIN] = inputs.period, drive.gain
        settings[motion.LIMIT], settings[motion.RESOLUTION] = drive.command_limit, inputs.resolution
        settings[motion.DELAYED] = self.axis.sampling.computation_delay
        settings[motion.LAG], settings[motion.BEHIND] = self._lags(b, p, q0, v0)
        settings[motion.BRAKING], settings[motion.FARTHEST] = drive.braking, self.axis.units.farthest
        settings[motion.VISCOUS_P] = settings[motion.VISCOUS_N] = b[1] + drive.braking
        settings[motion.LEVEL], settings[motion.MASS] = b[2], b[0]
        for i, effect in enumerate(self.effects):
            values = p[self.parameters_at[i] : self.parameters_at[i + 1]]
            for place, kernel in summed_of(effect, i in self._outside):
                settings[place] += kernel(q0, v0, 0.0, 0.0, _EMPTY, values, b)
            if effect.solver.slopes is not None:
                settings[[motion.VISCOUS_P, motion.VISCOUS_N]] += effect.solver.slopes(values)
                settings[motion.BRAKING] += effect.solver.slopes(values)[0] if effect.winding else 0.0
        mass = settings[motion.MASS]
        settings[motion.MOBILITY] = 1.0 / mass if mass != 0.0 else np.inf
        states = self._states + (4 if inputs.energy else 0)
        settings[motion.FREE], settings[motion.STATES] = self._free, states
        settings[motion.TOLERANCE], settings[motion.ENERGY] = inputs.tolerance, self._states if inputs.energy else 0
        if not inputs.energy:
            settings[motion.SLIDES], settings[motion.EXACT] = self._slides, self._exact
            for at, lower, upper in self._pieces(p):
                settings[motion.LINEAR] = self._solved
                if np.isfinite(upper - lower):
                    settings[[motion.TWIST, motion.LOWER, motion.UPPER]] = at, lower, upper
        y, floors = np.zeros(states), np.zeros(states)
        y[0], y[1] = q0, v0
        for i, effect in enumerate(self.effects):
            if effect.initial is not None and i not in self.lagging:
                values = p[self.parameters_at[i] : self.parameters_at[i + 1]]
                y[self.states_at[i] : self.states_at[i + 1]] = effect.initial(q0, values, b)
        floors[2 : self._states] = self._floors
        guards = int(self._starts[motion.GUARD + 1] - self._starts[motion.GUARD])
        scratch = np.zeros(stepper.room(states, guards))
        return Prepared(b, p, settings, y, self._hooks, self._starts, columns, slots, floors, scratch)

    def _lags(self, b: np.ndarray, p: np.ndarray, q0: float, v0: float) -> tuple[float, float]:
        """Time constants [s] of the lags that are known functions of time, 0: none."""
        ends = [(self.effects[i], self.parameters_at[i], self.parameters_at[i + 1]) for i in self.lagging]
        lags = [
            self._lag,
            *(
                effect.solver.lag(q0, v0, 0.0, 0.0, _EMPTY, p[start:end], b)
                for effect, start, end in ends
                if effect.solver.lag
            ),
        ]
        first, second, *_ = *(lag for lag in lags if lag != 0.0), 0.0, 0.0
        # Equal time constants have no partial fractions; a relative difference of 1e-7 has no visible effect.
        return first, first * (1.0 + _LEAST_DIFFERENCE) if abs(second - first) < _LEAST_DIFFERENCE * first else second

    def _general(
        self, inputs: Inputs, method: str, events: np.ndarray, tally: np.ndarray
    ) -> tuple[Iterable[np.ndarray], dict[str, float] | None]:
        """Run the general stepper; returns the rows of the run, and its energy balance if requested."""
        ready, motor, law, n = self.prepared(inputs), inputs.motor, inputs.law, inputs.samples
        if self._solved == 1:
            ready.settings[motion.LINEAR] *= method == "linear"
        y, braking = ready.y, ready.settings[motion.BRAKING]
        motor[:, 1] += np.where(motor[:, 0] != 0.0, braking - self.axis.drive.braking, 0.0)
        if np.any(motor[:, 1] != braking):  # closed forms are for one constant braking
            ready.settings[[motion.SLIDES, motion.EXACT, motion.LINEAR]] = 0.0
        out = np.empty((5, n))
        place, gains, memory = 0, _NO_SIGNALS, _EMPTY
        if law is not None:
            place, gains, memory = address(law.kernel, "law"), np.atleast_2d(law.gains), np.zeros(law.memory)
            ready.settings[motion.ERROR_ALONE] = law.error_alone
            if law.error_alone and law.integral is not None:
                ready.settings[motion.WAITS] = law.integral + 1
            if len(gains) not in (1, n):
                raise InputError(f"law: found gains for {len(gains)} samples, expected {n}: those of its own record")
        plant = (ready.baseline, ready.hooks, ready.starts, ready.parameters, ready.settings)
        status, k, within = stepper.run(
            plant, y, place, gains, memory, inputs.reference, inputs.push, inputs.noise, motor, ready.columns,
            ready.slots, ready.floors, ready.scratch, out, events, tally,
        )  # fmt: skip
        if status != stepper.DONE:
            names = ", ".join(effect.name for effect in self.effects) or "none"
            why = stepper.reason_of(status, self.axis.units)
            raise SimulationError(why, k * inputs.period + within, tuple(y.tolist()), names)
        return out, self._energy(ready, inputs.q0, inputs.v0, n * inputs.period) if inputs.energy else None

    def _energy(self, ready: Prepared, q0: float, v0: float, end: float) -> dict[str, float]:
        """Energy balance [J]; ``residual`` is the error of the integration, or the energy of a jump of the mass."""
        y, b = ready.y, ready.baseline

        def kinetic(q: float, v: float, t: float) -> float:
            mass = b[0]
            for i, effect in enumerate(self.effects):
                if effect.inertia is not None:
                    values = ready.parameters[self.parameters_at[i] : self.parameters_at[i + 1]]
                    mass += effect.inertia(q, v, t, 0.0, y[self.states_at[i] : self.states_at[i + 1]], values, b)
            return 0.5 * mass * v * v

        motor, push, friction, effects = (float(work) for work in y[self._states :])
        parts = {
            "motor": motor,
            "external": push,
            "offset": float(-b[3] * (y[0] - q0)),
            "friction": -friction,
            "effects": -effects,
            "kinetic": float(kinetic(y[0], y[1], end) - kinetic(q0, v0, 0.0)),
        }
        return {**parts, "residual": sum(parts.values()) - 2.0 * parts["kinetic"]}

    def _intended(self, intention: np.ndarray | None, n: int, period: float) -> tuple[np.ndarray, np.ndarray]:
        """Parameters (n, 6) of the hand at every sample for its ``intention``, and their places."""
        if intention is None:  # the hand holds position 0, the default of its parameters
            return _NO_SIGNALS, _NO_SLOTS
        hand, positions = self._hands[0], np.asarray(intention, dtype=float)
        columns = intention_columns(positions, self.parameters[hand], hand in self._held, n, period)
        return columns, self.parameters_at[hand] + np.arange(6)
