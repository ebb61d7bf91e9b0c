"""What the general stepper takes of an effect: the compiled kernels of its hooks, and what they let the steps be."""

from __future__ import annotations

import dis
from collections.abc import Iterator, Sequence
from functools import cache

from emps_design.effects import Effect
from emps_design.effects.effect import Kernel
from emps_design.simulation.kernels import motion
from emps_design.simulation.kernels.compile import address

# In the order of the rows of the table of hooks.
HOOKS = ("force", "dry", "inertia", "command", "actuator", "delay", "sensor", "rate", "guard", "jump_time")
# What the stepper takes as one number, where it is the same throughout a run, and where that number stands.
SUMMED = {"dry": motion.LEVEL, "inertia": motion.MASS}
_MOTION, _STATE, _COMMAND = range(5), (0, 1, 3, 4), range(3, 4)  # of a kernel's arguments q, v, t, tau, x, p, b


def summed_of(effect: Effect, touching: bool) -> Iterator[tuple[int, Kernel]]:
    """Yield the place in the settings, and the kernel, of what of ``effect`` is the same throughout a run.

    Those kernels read parameters and baseline alone; the parameters of what is ``touching`` the carriage may change.
    """
    for hook, place in SUMMED.items():
        kernel = getattr(effect, hook)
        if kernel is not None and not touching and not _reads(kernel, _MOTION):
            yield place, kernel


def hooks_of(effect: Effect, touching: bool, held: bool) -> Iterator[tuple[int, int]]:
    """Yield the row of the table, and the address, of every kernel of ``effect`` that is called step by step.

    ``touching``: it is something at the carriage, whose force a sensor there feels; ``held``: that force is the
    sample's for the whole period.
    """
    if held and effect.force is not None:
        yield motion.HELD, address(effect.force)
        return
    summed = [kernel for _, kernel in summed_of(effect, touching)]
    for row, hook in enumerate(HOOKS):
        kernel = getattr(effect, hook)
        if kernel is not None and kernel not in summed:
            yield row, address(kernel, hook if hook in ("actuator", "rate") else "kernel")
    if effect.force is not None and not touching:
        yield motion.SOLVED if effect.affine or effect.slopes else motion.UNSOLVED, address(effect.force)
    if effect.by_travel and effect.force is not None:
        yield motion.MEMORY, address(effect.force)
    if touching:
        for row, kernel in ((motion.TOUCH, effect.force), (motion.TOUCH_MASS, effect.inertia)):
            if kernel is not None:
                yield row, address(kernel)


def touches_motion(effect: Effect) -> bool:
    """Whether ``effect`` acts between motor force and motion, not only on the signals around them."""
    return any((effect.force, effect.dry, effect.inertia, effect.rate, effect.guard, effect.jump_time))


def sees_command(effect: Effect) -> bool:
    """Whether a force of ``effect`` reads the motor force, or a mass that may change, so that it jumps with it."""
    return effect.inertia is not None or reads_command(effect)


def reads_command(effect: Effect) -> bool:
    """Whether a force of ``effect`` reads the motor force."""
    return any(_reads(kernel, _COMMAND) for kernel in (effect.force, effect.dry) if kernel is not None)


def is_smooth(effect: Effect) -> bool:
    """Whether ``effect`` is a force without a kink between two jumps in time, and a mass that is the same there."""
    weighs = effect.inertia is not None and _reads(effect.inertia, _STATE)
    return not (effect.states or effect.guard or weighs)


def how_solved(stepped: Sequence[Effect], lags: int) -> int:
    """How hold periods of an axis with the effects ``stepped`` are solved, behind so many ``lags`` of the motor force.

    0: not at all; 1: all effects are in the solution; 2: smooth ones beside it; 3: of these some that see the command.
    Of effects that are affine in pieces there may be one.
    """
    solved, others = [one for one in stepped if one.affine], [one for one in stepped if not one.affine]
    pieces = sum(1 for effect in solved if effect.guard)
    rubs = any(effect.takes_dry for effect in stepped)
    if not solved or pieces > 1 or lags > 1 or rubs or not all(map(is_smooth, others)):
        return 0
    if any(map(reads_command, others)):
        return 3 if lags == 0 else 0  # behind a lag what they see is no parabola of time
    return 2 if others else 1


@cache
def _reads(kernel: Kernel, which: Sequence[int]) -> bool:
    """Whether ``kernel`` uses one of its arguments ``which``, whatever it calls them."""
    names = [kernel.__code__.co_varnames[i] for i in which]
    read = [step.argval for step in dis.get_instructions(kernel)]
    return any(name in (one if isinstance(one, tuple) else (one,)) for one in read for name in names)
