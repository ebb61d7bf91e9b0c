"""The virtual machine as C: the axis with its effects, by translation of the stepper that its simulations run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.codegen.c import HELPERS
from emps_design.codegen.program import ARRAY, INT, REAL, WHOLES, Function, Program
from emps_design.codegen.reader import read_into
from emps_design.codegen.stepper import EXPONENT, StepperReader, items, read_stepper
from emps_design.codegen.stepper_in_c import Opened, StepperPrinter
from emps_design.errors import InputError
from emps_design.simulation import Plant
from emps_design.simulation.effect_hooks import HOOKS
from emps_design.simulation.kernels import hold_loop
from emps_design.simulation.kernels.compile import address

POINT = (*[REAL] * 4, *[ARRAY] * 3)  # q, v, t, tau, x, p, b
FORMS = {"kernel": POINT, "actuator": (REAL, ARRAY), "rate": (*POINT, REAL, ARRAY)}  # arguments of compiled hooks
INITIAL = (REAL, ARRAY, ARRAY)
LONGEST = 4096  # samples that a command may be on its way
ARRAYS = ("y", "gains", "memory", "reference", "push", "noise", "motor_rows", "signals", "floors", "scratch", "out",
          "events")  # fmt: skip
TYPES = {**dict.fromkeys(ARRAYS, ARRAY), "arrays": f"({ARRAY},{WHOLES},{WHOLES},{ARRAY},{ARRAY})", "law": INT,
         "slots": WHOLES, "found": WHOLES}  # fmt: skip
SAMPLED = {"run": {"reference", "push", "encoder", "position", "velocity", "u", "outside"}, "applied": {"u"}}
HELPER = (
    f"static long long {EXPONENT}(real x)\n{{\n    int found;\n\n    (void)frexp(x, &found);\n    return found;\n}}"
)


@dataclass(frozen=True)
class Machine:
    """An axis as C.

    ``structures``, ``functions`` and the ``opened`` run; for each form of a hook the names of its ``kernels`` by
    number; ``initial`` the function, its type, first state, first parameter and number of states of each effect that
    has some; ``numbers`` the arrays that it begins with; ``ring`` the samples that are kept.
    """

    structures: list[str]
    functions: list[str]
    stepping: list[str]
    opened: Opened
    kernels: dict[str, list[tuple[int, str]]]
    initial: list[tuple[str, str, int, int, int]]
    numbers: dict[str, list[str]]
    ring: int


def machine_of(axis: Axis, name: str) -> Machine:
    """Translate ``axis`` with its effects; raises :class:`InputError` for a kernel that has no translation.

    >>> from emps_design.machines import machine
    >>> machine_of(machine("emps2019"), "emps2019").ring
    3
    """
    plant = Plant.of(axis)
    ready = plant.prepared(*plant.numbers(), 0.0, 0.0, 1, axis.sampling.period, axis.sampling.encoder_resolution)
    ring = _longest_wait(axis, plant) + 3
    stepper = _stepper(ready.y.size, ring)
    printer = StepperPrinter(stepper.functions, name, SAMPLED)
    stepping, opened = (
        list(map(printer.function, stepper.functions[:-1])),
        printer.opened(stepper.kernel, "k", "encoder"),
    )
    functions, kernels, places, initial, calls = _kernels(plant, name, printer.structures)
    calls |= stepper.calls
    helpers = [HELPERS[one] for one in HELPERS if one in calls] + [HELPER]
    hooks = ready.hooks.tolist()
    hooks[: 3 * int(ready.starts[-1]) : 3] = [places[one] for one in hooks[: 3 * int(ready.starts[-1]) : 3]]
    numbers = {"baseline": ready.baseline, "parameters": ready.parameters, "settings": ready.settings, "y": ready.y,
               "floors": ready.floors, "hooks": hooks, "starts": ready.starts}  # fmt: skip
    texts = {key: [repr(one) for one in np.asarray(values).tolist()] or ["0"] for key, values in numbers.items()}
    return Machine(
        printer.definitions(), [*helpers, *functions], stepping, opened, kernels, initial,
        {**texts, "scratch": [str(ready.scratch.size)]}, ring,
    )  # fmt: skip


def _stepper(states: int, ring: int) -> Program:
    """The stepper of an axis with so many ``states``: driven by a command and a force, no law, nothing that varies."""
    sizes = {"y.size": states, "reference.size": ring, "push.size": ring, "noise.size": 0, "slots.size": 0}
    fixed = {"law": 0, **sizes, "motor_rows.shape[0]": 0, "gains.shape[0]": 1}
    return read_stepper(hold_loop.run, TYPES, fixed)


def _longest_wait(axis: Axis, plant: Plant) -> int:
    """Samples that a command is on its way at most."""
    wait = axis.sampling.computation_delay * axis.sampling.period
    for effect, p in zip(plant.effects, plant.parameters, strict=True):
        if effect.delay is not None:
            wait += max(0.0, effect.delay(0.0, 0.0, 0.0, 0.0, np.zeros(0), p, plant.baseline))
    samples = int(wait / axis.sampling.period)
    if samples > LONGEST:
        raise InputError(f"axis {axis.name}: found a command {samples} samples on its way, expected at most {LONGEST}")
    return samples


def _kernels(plant: Plant, name: str, structures: dict[str, str]) -> Any:
    """Functions of the effects' kernels, the kernels by form and number, numbers by address, states at first, calls."""
    functions, forms, places = dict[str, None](), {form: list[tuple[int, str]]() for form in FORMS}, dict[int, int]()
    initial, calls = list[tuple[str, str, int, int, int]](), set[str]()
    for i, effect in enumerate(plant.effects):
        found: dict[str, Function] = {}
        hooks = [(getattr(effect, hook), hook if hook in FORMS else "kernel") for hook in HOOKS]
        hooks = [(kernel, form) for kernel, form in hooks if kernel is not None]
        for kernel, form in hooks:
            read_into(StepperReader, kernel, FORMS[form], found, calls, ())
        if effect.initial is not None:
            read_into(StepperReader, effect.initial, INITIAL, found, calls, ())
        printer = StepperPrinter(found.values(), f"{name}_{effect.name}")
        printer.structures = structures
        functions |= dict.fromkeys(map(printer.function, found.values()))
        for kernel, form in hooks:
            place = address(kernel, form)
            if place not in places:
                places[place] = len(places) + 1
                forms[form].append((places[place], printer.functions[kernel.__name__]))
        if effect.initial is not None and i not in plant.lagging:
            start = effect.initial.__name__
            kind = found[start].result
            places_ = plant.states_at[i], plant.parameters_at[i]
            initial.append((printer.functions[start], printer.declared(kind, "").strip(), *places_, len(items(kind))))
    return list(functions), forms, places, initial, calls
