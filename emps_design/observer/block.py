"""The on-line force observer as a difference equation in plain Python of numbers, as a drive computes it."""

from typing import Any

# What stands where in the kernel's gains, and in its memory.
PERIOD, FORCE_GAIN, ALPHA, MASS, VISCOUS, COULOMB, OFFSET, REST = range(8)
Q, V, COMMAND, FORCE = range(4)


def middle_velocity(k: int, q: float, period: float, memory: Any) -> float:
    """Velocity [m/s] in the middle of the two periods that meet at the sample before."""
    return 0.5 * ((q - memory[Q]) / period + memory[V]) if k > 0 else 0.0


def middle_force(k: int, command: float, gain: float, memory: Any) -> float:
    """Motor force [N] there: the mean of both periods."""
    return gain * 0.5 * (command + (memory[COMMAND] if k > 1 else command))


def force_observer(k: int, command: float, q: float, f_ext: float, limit: float, gains: Any, memory: Any) -> float:
    """External force [N] as of the observer's delay ago; ``command`` is that of the period which ends at sample k."""
    period = gains[PERIOD]
    middle = middle_velocity(k, q, period, memory)
    motor = middle_force(k, command, gains[FORCE_GAIN], memory)
    v = (q - memory[Q]) / period if k > 0 else 0.0
    a = (v - memory[V]) / period if k > 0 else 0.0
    level = max(gains[COULOMB], 0.0)
    dry = 0.0
    if middle > gains[REST]:
        dry = level
    elif middle < -gains[REST]:
        dry = -level
    now = gains[VISCOUS] * middle + gains[OFFSET] + dry + gains[MASS] * a - motor
    if k > 0:
        now = memory[FORCE] + gains[ALPHA] * (now - memory[FORCE])
    memory[Q] = q
    memory[V] = v
    memory[COMMAND] = command
    memory[FORCE] = now
    return now
