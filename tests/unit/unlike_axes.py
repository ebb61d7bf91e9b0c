"""Axes unlike the paper's, for tests of several rooms."""

from emps_design.axis import Axis

JOINT = Axis.from_dict(
    {
        "name": "joint",
        "motion": "rotary",
        "mechanics": {"mass": 0.0021, "viscous": 0.013, "coulomb": 0.08, "offset": 0.01},
        "drive": {"command": "current", "force_gain": 0.45, "command_limit": 12.0, "current_time_constant": 0.4e-3},
        "sampling": {"period": 0.5e-3, "encoder_resolution": 2e-4, "computation_delay": 2},
    }
)
