"""The physical effects of this package, one file each, in the order in which they are listed and tried."""

from __future__ import annotations

from importlib import import_module

from emps_design.effects.effect import Effect

ORDER = (
    "asymmetric_viscous_friction",
    "nonlinear_viscous_friction",
    "stribeck_friction",
    "presliding_friction",
    "maxwell_slip_friction",
    "load_dependent_friction",
    "position_dependent_friction",
    "friction_map",
    "friction_drift",
    "position_ripple",
    "friction_ripple",
    "elastic_force",
    "force_map",
    "gravity",
    "end_stop",
    "mass_change",
    "external_force",
    "periodic_disturbance",
    "flexible_coupling",
    "backlash",
    "back_emf_braking",
    "actuator_delay",
    "actuator_lag",
    "actuator_saturation",
    "actuator_deadzone",
    "encoder_error",
    "controller_disturbance",
)
EFFECTS: tuple[Effect, ...] = tuple(import_module(f"{__name__}.{name}").EFFECT for name in ORDER)
