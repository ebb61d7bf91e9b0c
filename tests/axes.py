"""An axis of each kind, by its motion and its command: the tests of every room ask them for their words."""

from typing import Any

from emps_design.axis import Axis
from emps_design.machines import machine

KINDS = {
    "linear, V": ("linear", {"command": "voltage"}),
    "rotary, V": ("rotary", {"command": "voltage"}),
    "rotary, A": ("rotary", {"command": "current"}),
    "linear, %": ("linear", {"command": "torque", "command_unit": "%"}),
}
CONTROLLER = {"controller": {"kind": "position_pd", "kp": 160.0, "kv": 240.0}}
PD = {"kind": "position_pd", "kp": 22.0, "kv": 7.6}
JOINT = {
    "name": "joint",
    "motion": "rotary",
    "mechanics": {"mass": 1.15, "viscous": 8.1, "coulomb": 7.2, "offset": 0.4},
    "drive": {"command": "current", "force_gain": 9.2, "command_limit": 10.3, "current_time_constant": 1e-3},
    "sampling": {"period": 1e-3, "encoder_resolution": 3e-6},
    "controller": PD,
}
PERCENT = {"command": "torque", "command_unit": "%", "force_gain": 15.08, "command_limit": 145.0}


def axis_of(kind: str, offset: float = -3.0, **tables: Any) -> Axis:
    """An axis of the kind with the numbers of the paper's machine, the same for a joint; ``tables`` are added."""
    motion, command = KINDS[kind]
    return Axis.from_dict(
        {
            "name": "axis",
            "motion": motion,
            "mechanics": {"mass": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": offset},
            "drive": {**command, "force_gain": 35.0, "command_limit": 10.0},
            "sampling": {"period": 1e-3, "encoder_resolution": 5e-8},
            **tables,
        }
    )


def machine_of(kind: str) -> Axis:
    """A machine of the kind with numbers usual for it: the EMPS, a joint of a robot, or a drive that counts in %."""
    match kind:
        case "linear, V":
            return machine("emps2018").replace(controller=PD)
        case "rotary, V":
            return Axis.from_dict({**JOINT, "drive": JOINT["drive"] | {"command": "voltage"}})
        case "rotary, A":
            return Axis.from_dict(JOINT)
        case "linear, %":
            return machine("emps2018").replace(drive=PERCENT, controller=PD | {"kv": 400.0})
    raise KeyError(kind)
