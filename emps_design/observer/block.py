"""The on-line force observer as a difference equation in plain Python of numbers, as a drive computes it."""

from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any

# What stands where in the kernel's gains, and in its memory.
PERIOD, FORCE_GAIN, ALPHA, MASS, VISCOUS, COULOMB, OFFSET, REST = range(8)
Q, V, COMMAND, FORCE = range(4)


def added_force(q: float, v: float, tau: float) -> float:
    """What effects add to the force [N] at position, velocity and motor force: nothing but by :func:`with_effects`."""
    return 0.0


def added_dry(q: float, v: float, tau: float) -> float:
    """What they add to the level of dry friction [N]."""
    return 0.0


def added_inertia(q: float, v: float, tau: float) -> float:
    """What they add to the mass [kg]."""
    return 0.0


def position_before(k: int, q: float, memory: Any) -> float:
    """Position [m] of the sample before, where the two periods meet."""
    return memory[Q] if k > 0 else q


def force_observer(k: int, command: float, q: float, f_ext: float, limit: float, gains: Any, memory: Any) -> float:
    """External force [N] as of the observer's delay ago; ``command`` is that of the period which ends at sample k."""
    period = gains[PERIOD]
    before = position_before(k, q, memory)
    v = (q - before) / period
    a = (v - memory[V]) / period
    # Velocity and motor force in the middle of the two periods.
    middle = 0.5 * (v + memory[V])
    motor = gains[FORCE_GAIN] * 0.5 * (command + (memory[COMMAND] if k > 1 else command))
    level = max(gains[COULOMB] + added_dry(before, middle, motor), 0.0)
    dry = 0.0
    if middle > gains[REST]:
        dry = level
    elif middle < -gains[REST]:
        dry = -level
    constant = gains[OFFSET] + added_force(before, middle, motor)
    mass = gains[MASS] + added_inertia(before, middle, motor)
    now = gains[VISCOUS] * middle + constant + dry + mass * a - motor
    if k > 0:
        now = memory[FORCE] + gains[ALPHA] * (now - memory[FORCE])
    memory[Q] = q
    memory[V] = v
    memory[COMMAND] = command
    memory[FORCE] = now
    return now


def with_effects(kernel: Any, added: Mapping[str, Callable[..., Any]]) -> Any:
    """The observer's ``kernel`` with other functions of q, v and tau in place of those that add nothing, by name."""
    return FunctionType(kernel.__code__, {**kernel.__globals__, **added}, kernel.__name__)
