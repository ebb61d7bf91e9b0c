"""The plant linearised about steady motion: carriage, current loop and every effect.

Each effect enters by its hooks, differentiated at one operating point: forces, dry friction, inertia, states, actuator
maps, sensor errors and delays. So every effect that ``diagnose`` adds to an axis is part of a design. Properties that a
slope cannot describe (play, steps in time, injected signals) are named in ``warnings``.

The operating point is steady motion at a velocity, from position 0 on. An effect that repeats along the travel (a
ripple) counts with its mean over one period, so it is not a spring; at a corner (the contact point of a stop) the
flatter side counts. An actuator map is linearised at the command of the motion, or just below its limit if it
saturates; the command follows from the acting voltage through the inverse of the maps.

States: carriage position and velocity, the states of the effects in their order, and the motor force if the current
loop has a time constant. Inputs: voltage, and an external force on the carriage (+ pushes to +q). An
:class:`Environment` attaches mass, damping and stiffness to the carriage, with a force sensor in between.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.axis import Axis
from emps_design.effects.effect import COULOMB, MASS, OFFSET, VISCOUS, Effect, Kernel
from emps_design.errors import InputError
from emps_design.messages import Message, grave, warning
from emps_design.units import Units

if TYPE_CHECKING:
    import control

EDGE = 0.99  # share of the largest acting voltage at which a saturated map is linearised

PLACES = 64  # positions along one period of an effect
SETTLED = 2.0  # s of integration for states whose equilibrium Newton's method does not reach
CORNER = 1e-3  # relative difference of the slopes on both sides above which a position is a corner

POSITION, VELOCITY = 0, 1


@dataclass(frozen=True)
class ActuatorMap:
    """The static maps of the actuator: a command [V] up to ``limit`` [V] goes through ``maps``, in this order.

    >>> from emps_design.machines import machine
    >>> deadzone = {"kind": "actuator_deadzone", "width": 0.2}
    >>> actuator = ActuatorMap.of(machine("emps2018").replace(effects=[deadzone]))
    >>> round(actuator.acting(10.0), 6), round(actuator.command(0.5), 6), round(actuator.slope(0.0), 6)
    (9.8, 0.7, 1.0)
    """

    limit: float
    maps: tuple[Callable[[float], float], ...] = ()
    names: tuple[str, ...] = field(default=(), repr=False)

    @classmethod
    def of(cls, axis: Axis) -> ActuatorMap:
        """The maps of the effects of ``axis``, in their order."""
        static = [(entry.effect, entry.effect.values(entry.parameters)) for entry in axis.effects]
        static = [(effect, p) for effect, p in static if effect.actuator is not None]
        maps = tuple(lambda u, effect=effect, p=p: float(effect.actuator(u, p)) for effect, p in static)
        return cls(axis.drive.command_limit, maps, tuple(effect.name for effect, _ in static))

    def acting(self, command: float) -> float:
        """The acting voltage [V] for a ``command`` [V]."""
        for step in self.maps:
            command = step(command)
        return command

    def reach(self, acting: float) -> float:
        """``acting`` [V], limited to the largest acting voltage of its sign."""
        side = -1.0 if acting < 0.0 else 1.0
        return side * min(abs(acting), abs(self.acting(side * self.limit)))

    def command(self, acting: float) -> float:
        """The smallest command [V] that gives the ``acting`` voltage [V], up to the limit."""
        if not self.maps:
            return acting
        target, side = abs(self.reach(acting)), -1.0 if acting < 0.0 else 1.0
        low, high = 0.0, self.limit
        for _ in range(100):
            middle = 0.5 * (low + high)
            if abs(self.acting(side * middle)) < target:
                low = middle
            else:
                high = middle
        return side * high

    def slope(self, acting: float) -> float:
        """Change of the acting voltage with the command [V/V] at ``acting`` [V], or just below the largest."""
        if not self.maps:
            return 1.0
        side = -1.0 if acting < 0.0 else 1.0
        inside = min(abs(acting), EDGE * abs(self.acting(side * self.limit)))
        step = 1e-3 * (self.acting(side * self.limit) * side - inside)
        if step <= 0.0:
            return 0.0
        # On the side away from zero, outside a dead zone.
        near, far = (self.command(side * (inside + count * step)) for count in (1, 2))
        return step / abs(far - near)


class Member:
    """One effect at the operating point: its hooks called as plain functions, differentiated by central differences."""

    def __init__(self, effect: Effect, p: np.ndarray, b: np.ndarray):
        self.effect, self.p, self.b = effect, p, b
        self.x = effect.at_rest(0.0, p, b)
        self.settled = True
        self.repeat = float(p[effect.place(effect.repeats)]) if effect.repeats else 0.0
        self.places = np.arange(PLACES) / PLACES * self.repeat if effect.repeats else np.zeros(1)

    def settle(self, v: float, tau: float) -> None:
        """Set the states to their equilibrium at the operating point; they do not change if there is none."""
        if self.effect.rate is None:
            return
        for begin in (
            lambda: self.x,
            lambda: self._after(SETTLED, v, tau),
        ):  # a load within its play must move to contact first
            x = self._at_rest(begin(), v, tau)
            scale = np.abs(self._rate_jacobian(v, tau, x)) @ np.abs(x) + abs(v) + 1e-12
            self.settled = bool(np.all(np.isfinite(x)) and np.all(np.abs(self._rate(0.0, v, tau, x)) <= 1e-6 * scale))
            if self.settled:
                self.x = x
                return

    def _at_rest(self, x: np.ndarray, v: float, tau: float) -> np.ndarray:
        """Equilibrium of the states by Newton's method from ``x``."""
        for _ in range(50):
            step = np.linalg.lstsq(self._rate_jacobian(v, tau, x), -self._rate(0.0, v, tau, x), rcond=None)[0]
            x = x + step
            if np.all(np.abs(step) <= 1e-12 + 1e-9 * np.abs(x)):
                break
        return x

    def _after(self, seconds: float, v: float, tau: float) -> np.ndarray:
        """States after ``seconds`` at the operating point."""
        from scipy.integrate import solve_ivp

        return solve_ivp(lambda t, x: self._rate(0.0, v, tau, x), (0.0, seconds), self.x, "LSODA", rtol=1e-6).y[:, -1]

    def force(self, q: float, v: float, tau: float, x: np.ndarray) -> float:
        """Resisting force [N] of the effect in motion, its mean over one period."""
        return float(np.mean([self.force_at(q + place, v, tau, x) for place in self.places]))

    def force_at(self, q: float, v: float, tau: float, x: np.ndarray) -> float:
        """Resisting force [N] of the effect in motion at ``q`` [m]."""
        arguments = (q, v, 0.0, tau, x, self.p, self.b)
        total = self.effect.force(*arguments) if self.effect.force else 0.0
        if self.effect.dry:
            total += np.sign(v) * self.effect.dry(*arguments)
        if self.effect.takes_dry:
            total -= np.sign(v) * self.b[COULOMB]
        return float(total)

    def sensor(self, q: float, v: float, tau: float, x: np.ndarray) -> float:
        """Error that the effect adds to the encoder's reading [m]."""
        return self._hook(self.effect.sensor, q, v, tau, x)

    def inertia(self, v: float, tau: float) -> float:
        """Mass that the effect adds [kg]."""
        return self._hook(self.effect.inertia, 0.0, v, tau, self.x)

    def delay(self, v: float, tau: float) -> float:
        """Delay of the voltage by the effect [s]."""
        return self._hook(self.effect.delay, 0.0, v, tau, self.x)

    def lag(self, v: float, tau: float) -> float:
        """Time constant [s] of the motor force behind the voltage by the effect."""
        return self._hook(self.effect.solver.lag, 0.0, v, tau, self.x)

    def _hook(self, hook: Kernel | None, q: float, v: float, tau: float, x: np.ndarray) -> float:
        return 0.0 if hook is None else float(hook(q, v, 0.0, tau, x, self.p, self.b))

    def slopes(self, function: Callable[..., float], v: float, tau: float) -> tuple[float, float, float, np.ndarray]:
        """Partial derivatives of ``function(q, v, tau, x)`` with respect to each argument."""
        return (
            self._over_position(lambda q: function(q, v, tau, self.x)),
            _slope(lambda value: function(0.0, value, tau, self.x), v, 1e-4 * abs(v)),
            _slope(lambda value: function(0.0, v, value, self.x), tau, 1e-3),
            np.array([_slope(lambda value: function(0.0, v, tau, value), *at) for at in self._each_state()]),
        )

    def rate_slopes(self, v: float, tau: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Partial derivatives of the rates of the states by position, velocity, motor force and the states."""
        return (
            _slope(lambda q: self._rate(q, v, tau, self.x), 0.0, 1e-6),
            _slope(lambda value: self._rate(0.0, value, tau, self.x), v, 1e-4 * abs(v)),
            _slope(lambda value: self._rate(0.0, v, value, self.x), tau, 1e-3),
            self._rate_jacobian(v, tau, self.x),
        )

    def _over_position(self, function: Callable[[float], float]) -> float:
        """Slope of ``function(q)`` [../m]: 0 if it repeats along the travel, at a corner that of the flatter side."""
        if self.repeat:
            return 0.0
        here, step = function(0.0), 1e-6
        before, after = (here - function(-step)) / step, (function(step) - here) / step
        if abs(after - before) > CORNER * max(abs(before), abs(after)):
            return min(before, after, key=abs)
        return 0.5 * (before + after)

    def steepest(self, v: float, tau: float) -> float:
        """Largest slope over position [N/m] of a force that repeats along the travel; 0 for any other."""
        if not self.repeat or not (self.effect.force or self.effect.dry):
            return 0.0
        step = 1e-4 * self.repeat
        slopes = [_slope(lambda q: self.force_at(q, v, tau, self.x), place, step) for place in self.places]
        return float(np.max(np.abs(slopes)))

    def left_out(self, v: float, tau: float, units: Units) -> list[Message]:
        """Messages on properties of this effect that its linearisation neglects."""
        effect, messages, speed = self.effect, [], units.quantity(v, "m/s", "g")
        name = effect.name
        if effect.solver.guard is not None or effect.solver.jump_time is not None:
            text = f"{name}: not smooth; the linear design uses its slope in steady motion at {speed}"
            messages.append(warning("not-smooth", text, effect=name, velocity=v))
        if effect.command is not None:
            text = f"{name}: adds a signal to the {units.word('voltage')}, which the linear design neglects"
            messages.append(warning("signal-left-out", text, effect=name))
        if not self.settled:
            text = f"{name}: has no steady state at {speed}; linearised at its initial state"
            messages.append(warning("no-steady-state", text, effect=name, velocity=v))
        if self.repeat:
            period = units.quantity(self.repeat, "m")
            where = f"{name}: repeats every {period}, {abs(v) / self.repeat:.4g} Hz at {speed}"
            at_place, unit, what = self.force_at, "N", "a disturbance of +-{}, not a spring"
            if effect.sensor is not None:
                at_place, unit, what = self.sensor, "m", "a measurement error of +-{}, not a gain"
            size = 0.5 * float(np.ptp([at_place(q, v, tau, self.x) for q in self.places]))
            what = what.format(units.quantity(size, unit, ".3g"))
            text = f"{where}; its slope averages out: in the linear design it is {what}"
            messages.append(warning("slope-averages-out", text, effect=name, velocity=v, size=size))
        return messages

    def _rate(self, q: float, v: float, tau: float, x: np.ndarray) -> np.ndarray:
        dx = np.zeros(self.x.size)
        if self.effect.rate is not None:
            self.effect.rate(q, v, 0.0, tau, x, self.p, self.b, self.b[COULOMB], dx)
        return dx

    def _rate_jacobian(self, v: float, tau: float, x: np.ndarray) -> np.ndarray:
        columns = [_slope(lambda value: self._rate(0.0, v, tau, value), *at) for at in self._each_state(x)]
        return np.array(columns).T.reshape(self.x.size, self.x.size)

    def _each_state(self, x: np.ndarray | None = None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (x, step vector) for a central difference in each own state."""
        x = self.x if x is None else x
        for place in range(x.size):
            step = np.zeros(x.size)
            step[place] = max(1e-9, 1e-4 * abs(x[place]))
            yield x, step


def _slope(function: Callable[[Any], Any], at: Any, step: Any) -> Any:
    """Central difference of ``function`` at ``at``; ``step`` is a number, or a vector with one nonzero entry."""
    return (function(at + step) - function(at - step)) / (2.0 * np.max(step))


@dataclass(frozen=True)
class LinearPlant:
    """dx/dt = A x + B u(t - delay) + E f_ext, encoder reading C x; SI units.

    ``state`` has the names of the states. ``mass`` [kg] and ``viscous`` [N/(m/s)] are inertia and slope of friction of
    the carriage at the operating point, ``steepest`` [N/m] is the largest slope over position of forces that average
    out along the travel, and ``warnings`` names the neglected properties. Arrays may have leading axes for many plants.
    """

    A: np.ndarray
    B: np.ndarray
    E: np.ndarray
    C: np.ndarray
    delay: float
    mass: Any
    viscous: Any
    state: tuple[str, ...]
    warnings: tuple[Message, ...] = ()
    steepest: float = 0.0

    @property
    def in_slow_motion(self) -> tuple[float, float]:
        """Total moving mass [kg] and slope of friction [N/(m/s)], with a load behind a coupling; for a single plant.

        They are the coefficients of s and 1 in the power series of force over velocity of the carriage. Forces that
        depend on position are not included.

        >>> mass, slope = rigid_plant(2.0, 6.0).in_slow_motion
        >>> round(mass, 9), round(slope, 9)
        (2.0, 6.0)
        """
        A, E = self.A[VELOCITY:, VELOCITY:].copy(), self.E[VELOCITY:]
        more = float(self.mass)  # N/(m/s) of additional friction, for a plant without any
        A[0, 0] -= E[0] * more
        constant = np.linalg.lstsq(A, E, rcond=None)[0]  # a load within its play does not move
        speed, linear = -constant[0], -np.linalg.lstsq(A, constant, rcond=None)[0][0]
        return float(-linear / speed**2), float(1.0 / speed - more)

    def to_ss(self) -> control.StateSpace:
        """The plant as a continuous ``control.StateSpace`` from voltage and force to encoder and velocity.

        It does not contain the ``delay``; that of :class:`~emps_design.control.discretisation.SampledPlant` does.
        """
        import control

        C = np.array([self.C, np.eye(self.C.size)[VELOCITY]])
        B = np.column_stack([self.B, self.E])
        names = {"inputs": ["voltage", "force"], "outputs": ["encoder", "velocity"], "states": list(self.state)}
        return control.ss(self.A, B, C, np.zeros((2, 2)), **names, name="plant")


def rigid_plant(
    mass: float | np.ndarray,
    viscous: float | np.ndarray,
    force_gain: float = 1.0,
    current_time_constant: float = 0.0,
) -> LinearPlant:
    """Return the plant without effects: ``mass`` [kg] and ``viscous`` friction [N/(m/s)], arrays (m,) for m plants.

    ``force_gain`` G_tau [N/V]; ``current_time_constant`` [s] of the current loop, 0: ideal.

    >>> rigid_plant(2.0, 6.0, 10.0).B.tolist()
    [0.0, 5.0]
    """
    mass, viscous = np.broadcast_arrays(np.asarray(mass, dtype=float), np.asarray(viscous, dtype=float))
    lag = current_time_constant
    size = 3 if lag > 0.0 else 2
    A, B, E = np.zeros((*mass.shape, size, size)), np.zeros((*mass.shape, size)), np.zeros((*mass.shape, size))
    A[..., POSITION, VELOCITY] = 1.0
    A[..., VELOCITY, VELOCITY] = -viscous / mass
    E[..., VELOCITY] = 1.0 / mass
    if lag > 0.0:
        A[..., VELOCITY, -1] = 1.0 / mass
        A[..., -1, -1], B[..., -1] = -1.0 / lag, force_gain / lag
    else:
        B[..., VELOCITY] = force_gain / mass
    names = ("position", "velocity", "motor_force")[:size]
    return LinearPlant(A, B, E, np.eye(size)[POSITION], 0.0, mass, viscous, names)


def linear_plant(axis: Axis, velocity: float = 0.1) -> LinearPlant:
    """Return the plant of ``axis`` linearised in steady motion at ``velocity`` [m/s], from position 0 on.

    In motion Coulomb friction is constant and drops out. Raises :class:`InputError` at velocity 0.

    >>> from emps_design.machines import machine
    >>> plant = linear_plant(machine("emps2019"))
    >>> plant.A.tolist()[1] == [0.0, -203.5034 / 95.1089]
    True
    """
    if not np.isfinite(velocity) or velocity == 0.0:
        raise InputError(
            f"velocity: found {axis.units.quantity(velocity, 'm/s', 'g')}, expected a number other than 0: friction "
            "has no slope at standstill"
        )
    axis.units.check("velocity", velocity, "m/s")
    b, braking, members = axis.mechanics.array(), axis.drive.braking, list[Member]()
    for entry in axis.effects:
        p = entry.effect.values(entry.parameters)
        if entry.effect.winding and entry.effect.solver.slopes is not None:
            braking += entry.effect.solver.slopes(p)[0]
        else:
            members.append(Member(entry.effect, p, b))
    gain, lag, shown = axis.drive.gain, axis.drive.current_time_constant, axis.units.quantity
    warnings: list[Message] = []

    # Without the braking of a back-EMF, since the effects read the force of the winding current.
    tau = b[VISCOUS] * velocity + np.sign(velocity) * b[COULOMB] + b[OFFSET]
    for _ in range(20):  # the effects' forces need the motor force, which needs their forces
        for member in members:
            member.settle(velocity, tau)
        forces = sum(member.force(0.0, velocity, tau, member.x) for member in members)
        previous, tau = tau, float(b[VISCOUS] * velocity + np.sign(velocity) * b[COULOMB] + b[OFFSET] + forces)
        if abs(tau - previous) <= 1e-9 * max(1.0, abs(tau)):
            break

    sizes = [member.x.size for member in members]
    count = 2 + sum(sizes) + (lag > 0.0)
    A, B, E = np.zeros((count, count)), np.zeros(count), np.zeros(count)
    C = np.zeros(count)
    A[POSITION, VELOCITY] = C[POSITION] = 1.0

    actuator = ActuatorMap.of(axis)
    needed = (tau + braking * velocity) / gain
    slope = gain * actuator.slope(needed)
    if slope == 0.0:
        kinds, command = " and ".join(actuator.names), axis.units.word("voltage")
        raise InputError(f"effects: with {kinds} the {command} has no effect within its limit, expected an effect")
    if abs(actuator.reach(needed)) < abs(needed):
        where = (
            "linearised just below that, where the loop can work" if actuator.maps else "the loop works at lower speed"
        )
        text = (
            f"{' and '.join(actuator.names) or 'limit of the command'}: steady motion at "
            f"{shown(velocity, 'm/s', 'g')} needs {shown(needed, 'V', '.3g')}, but at most "
            f"{shown(actuator.reach(needed), 'V', '.3g')} act; {where}"
        )
        warnings.append(grave("motion-beyond-limit", text, velocity=velocity, command=needed))
    firsts = [2 + sum(sizes[:i]) for i in range(len(sizes))]  # of each member's states
    lags = [(-1, lag)] * (lag > 0.0)
    lags += [
        (first, member.lag(velocity, tau))
        for first, member in zip(firsts, members, strict=True)
        if member.effect.solver.lag
    ]
    force_row, force_in = np.zeros(count), slope  # d(motor force behind the lags)/d(state) and /d(voltage)
    for place, constant in lags:
        A[place], B[place] = force_row / constant, force_in / constant
        A[place, place] -= 1.0 / constant
        force_row, force_in = np.eye(count)[place], 0.0

    mass = b[MASS]
    drag = np.zeros(count)  # d(resisting forces)/d(state)
    drag[VELOCITY] = b[VISCOUS] + braking
    drag_tau = 0.0
    for member, first, size in zip(members, firsts, sizes, strict=True):
        if member.effect.solver.lag:
            continue
        states = slice(first, first + size)
        mass += member.inertia(velocity, tau)
        d_q, d_v, d_tau, d_x = member.slopes(member.force, velocity, tau)
        drag[POSITION] += d_q
        drag[VELOCITY] += d_v - d_tau * braking
        drag[states] += d_x
        drag_tau += d_tau
        if size:
            r_q, r_v, r_tau, r_x = member.rate_slopes(velocity, tau)
            A[states, POSITION], A[states, VELOCITY] = r_q, r_v - r_tau * braking
            A[states, states] += r_x
            A[states, :] += np.outer(r_tau, force_row)
            B[states] += r_tau * force_in
        s_q, s_v, _, s_x = member.slopes(member.sensor, velocity, tau)
        C[POSITION] += s_q
        C[VELOCITY] += s_v
        C[states] += s_x
        warnings += member.left_out(velocity, tau, axis.units)
    if not mass > 0.0:
        kinds = " and ".join(entry.kind for entry in axis.effects)
        raise InputError(
            f"effects: {kinds} leave {shown(mass, 'kg')} on the encoder side, expected shares that leave more than 0"
        )
    A[VELOCITY] = ((1.0 - drag_tau) * force_row - drag) / mass
    B[VELOCITY] = (1.0 - drag_tau) * force_in / mass
    E[VELOCITY] = 1.0 / mass
    names = ["position", "velocity"]
    names += [f"{member.effect.name}.{state.name}" for member in members for state in member.effect.states]
    names += ["motor_force"] if lag > 0.0 else []
    delay = sum(member.delay(velocity, tau) for member in members)
    steepest = sum(member.steepest(velocity, tau) for member in members)
    return LinearPlant(A, B, E, C, delay, float(mass), float(drag[VELOCITY]), tuple(names), tuple(warnings), steepest)


@dataclass(frozen=True)
class Environment:
    """An environment of the carriage: added mass [kg], damping [N/(m/s)] and stiffness to ground [N/m].

    A passive hand is ``tau_e = -(mass qdd + damping qd + stiffness q)``; a wall has stiffness only.
    """

    mass: float | np.ndarray = 0.0
    damping: float | np.ndarray = 0.0
    stiffness: float | np.ndarray = 0.0


FREE = Environment()


@dataclass(frozen=True)
class Felt:
    """Reading [N] of the force sensor at a sample: ``state`` (..., n) x + ``voltage`` u + ``force`` f_ext.

    u is the voltage before the sample, f_ext the external force, constant from the sample on.
    """

    state: np.ndarray
    voltage: np.ndarray | float = 0.0
    force: np.ndarray | float = 1.0


def attached(plant: LinearPlant, environment: Environment) -> LinearPlant:
    """Return ``plant`` with the ``environment`` on its carriage; arrays (m,) in it give m plants.

    >>> from emps_design.control.linear_plant import rigid_plant
    >>> attached(rigid_plant(2.0, 6.0), Environment(mass=1.0, stiffness=30.0)).A.tolist()
    [[0.0, 1.0], [-10.0, -2.0]]
    """
    share = np.asarray(plant.E[..., VELOCITY] / (plant.E[..., VELOCITY] * environment.mass + 1.0))
    share = share / plant.E[..., VELOCITY]  # of the force that accelerates the carriage's own mass
    shape = np.broadcast_shapes(share.shape, np.shape(environment.damping), np.shape(environment.stiffness))
    A = np.broadcast_to(plant.A, (*shape, *plant.A.shape[-2:])).copy()
    B, E = (np.broadcast_to(x, (*shape, x.shape[-1])).copy() for x in (plant.B, plant.E))
    A[..., VELOCITY, :] *= share[..., None]
    B[..., VELOCITY] *= share
    E[..., VELOCITY] *= share
    A[..., VELOCITY, POSITION] -= E[..., VELOCITY] * environment.stiffness
    A[..., VELOCITY, VELOCITY] -= E[..., VELOCITY] * environment.damping
    return replace(plant, A=A, B=B, E=E)


def felt(plant: LinearPlant, environment: Environment) -> Felt:
    """Return the reading of a force sensor between the carriage of an :func:`attached` ``plant`` and ``environment``.

    The reading is the force of the environment, including its inertia, plus the external force.
    """
    mass = np.asarray(environment.mass)
    state = -mass[..., None] * plant.A[..., VELOCITY, :]
    state = np.broadcast_to(state, np.broadcast_shapes(state.shape, plant.A.shape[:-1])).copy()
    state[..., POSITION] -= environment.stiffness
    state[..., VELOCITY] -= environment.damping
    return Felt(state, -mass * plant.B[..., VELOCITY], 1.0 - mass * plant.E[..., VELOCITY])
