"""The plant as a linear system about steady motion: carriage, current loop and every effect's slope.

Each effect enters by its hooks, differentiated at one operating point: forces, dry friction, inertia, own states,
actuator maps, sensor errors and delays. So whatever ``diagnose`` adds to an axis takes part in a design; what a slope
cannot show (play, steps in time, injected signals) is named in ``warnings``.

The operating point is where the loop works: in steady motion at a velocity, from position 0 on. What repeats along the
travel (a ripple) counts with its mean over one repeat, so it is no spring; at a corner (a stop that is just touched)
the flatter side counts; an actuator counts at the command that the motion takes, and one that cannot give it just
inside its limit.

States: carriage position and velocity, the states of the effects in their order, and the motor force behind the
current loop where that has a time constant. Inputs: voltage, and an external force on the carriage (+ pushes to +q).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.plant.actuator import ActuatorMap
from emps_design.control.plant.operating_point import Member
from emps_design.effects.effect import COULOMB, MASS, OFFSET, VISCOUS
from emps_design.errors import InputError
from emps_design.quantities import check_magnitude

if TYPE_CHECKING:
    import control

POSITION, VELOCITY = 0, 1


@dataclass(frozen=True)
class LinearPlant:
    """dx/dt = A x + B u(t - delay) + E f_ext, encoder reading C x; SI units.

    ``state`` names the states, ``mass`` [kg] and ``viscous`` [N/(m/s)] are the carriage's own inertia and slope of
    friction at the operating point, ``steepest`` [N/m] the largest slope over position of what averages out along the
    travel, ``warnings`` names what the slopes leave out. Arrays may have leading axes, for many plants at once.
    """

    A: np.ndarray
    B: np.ndarray
    E: np.ndarray
    C: np.ndarray
    delay: float
    mass: Any
    viscous: Any
    state: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    steepest: float = 0.0

    @property
    def in_slow_motion(self) -> tuple[float, float]:
        """Mass [kg] and slope of friction [N/(m/s)] of all that moves, a load behind a coupling too; of a single plant.

        From the force over the velocity of the carriage in powers of s: its constant, and what multiplies s. What
        depends on position is left out.

        >>> mass, slope = rigid_plant(2.0, 6.0).in_slow_motion
        >>> round(mass, 9), round(slope, 9)
        (2.0, 6.0)
        """
        A, E = self.A[VELOCITY:, VELOCITY:].copy(), self.E[VELOCITY:]
        more = float(self.mass)  # N/(m/s) of friction on top, for a plant that has none
        A[0, 0] -= E[0] * more
        moves = np.linalg.lstsq(A, E, rcond=None)[0]  # a load within its play does not move
        speed, slower = -moves[0], -np.linalg.lstsq(A, moves, rcond=None)[0][0]
        return float(-slower / speed**2), float(1.0 / speed - more)

    def to_ss(self) -> control.StateSpace:
        """The plant as a continuous ``control.StateSpace`` from voltage and force to encoder and velocity.

        Its pure ``delay`` is not in it; that of :class:`~emps_design.control.plant.discretisation.SampledPlant` has it.
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
    """The plant without effects: ``mass`` [kg] and ``viscous`` friction [N/(m/s)], arrays (m,) for m plants.

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

    Away from zero velocity Coulomb friction is a constant and drops out. Raises :class:`InputError` at velocity 0.

    >>> from emps_design.machines import machine
    >>> plant = linear_plant(machine("emps2019"))
    >>> plant.A.tolist()[1] == [0.0, -203.5034 / 95.1089]
    True
    """
    if not np.isfinite(velocity) or velocity == 0.0:
        raise InputError(
            f"velocity: found {velocity:g} m/s, expected a number other than 0: friction has no slope there"
        )
    check_magnitude("velocity", velocity, "m/s")
    b, braking, members = axis.mechanics.array(), axis.drive.braking, list[Member]()
    for entry in axis.effects:
        p = entry.effect.values(entry.parameters)
        if entry.effect.winding and entry.effect.slopes is not None:
            braking += entry.effect.slopes(p)[0]
        else:
            members.append(Member(entry.effect, p, b))
    gain, lag = axis.drive.gain, axis.drive.current_time_constant
    warnings: list[str] = []

    # Without what a back-EMF brakes: the effects see the force that the winding's current makes.
    tau = b[VISCOUS] * velocity + np.sign(velocity) * b[COULOMB] + b[OFFSET]
    for _ in range(20):  # the effects' forces need the motor force, which needs their forces
        for member in members:
            member.settle(velocity, tau)
        previous, tau = tau, _steady_force(members, b, velocity, tau)
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
        raise InputError(f"effects: with {' and '.join(actuator.names)} no voltage acts, expected one within the limit")
    if abs(actuator.reach(needed)) < abs(needed):
        where = (
            "linearised just inside that, where the loop can work" if actuator.maps else "the loop works when slower"
        )
        warnings.append(
            f"{' and '.join(actuator.names) or 'limit of the command'}: steady motion at {velocity:g} m/s takes "
            f"{needed:.3g} V and only {actuator.reach(needed):.3g} V act; {where}"
        )
    firsts = [2 + sum(sizes[:i]) for i in range(len(sizes))]  # of each member's states
    lags = [(-1, lag)] * (lag > 0.0)
    lags += [(first, one.lag(velocity, tau)) for first, one in zip(firsts, members, strict=True) if one.effect.lag]
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
        if member.effect.lag:
            continue
        own = slice(first, first + size)
        mass += member.inertia(velocity, tau)
        d_q, d_v, d_tau, d_x = member.slopes(member.force, velocity, tau)
        drag[POSITION] += d_q
        drag[VELOCITY] += d_v - d_tau * braking
        drag[own] += d_x
        drag_tau += d_tau
        if size:
            r_q, r_v, r_tau, r_x = member.rate_slopes(velocity, tau)
            A[own, POSITION], A[own, VELOCITY] = r_q, r_v - r_tau * braking
            A[own, own] += r_x
            A[own, :] += np.outer(r_tau, force_row)
            B[own] += r_tau * force_in
        s_q, s_v, _, s_x = member.slopes(member.sensor, velocity, tau)
        C[POSITION] += s_q
        C[VELOCITY] += s_v
        C[own] += s_x
        warnings += member.left_out(velocity, tau)
    if not mass > 0.0:
        kinds = " and ".join(entry.kind for entry in axis.effects)
        raise InputError(
            f"effects: {mass:.4g} kg are left on the encoder's side of {kinds}, expected shares that leave some"
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


def _steady_force(members: list[Member], b: np.ndarray, v: float, tau: float) -> float:
    """Motor force that keeps the carriage at ``v`` [N]."""
    forces = sum(member.force(0.0, v, tau, member.x) for member in members)
    return float(b[VISCOUS] * v + np.sign(v) * b[COULOMB] + b[OFFSET] + forces)
