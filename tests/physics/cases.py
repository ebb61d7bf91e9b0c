"""One case an effect: parameters that matter over 2 s, and a voltage that reverses, rests and breaks away."""

from __future__ import annotations

import numpy as np

PERIOD = 4e-3
HEIGHTS = {f"height_{i}": h for i, h in enumerate((2.0, -1.0, 4.0, 4.0, 8.0, 0.0), start=1)}
CASES = {
    "none": {},
    "asymmetric_viscous_friction": {"viscous_difference": -40.0},
    "nonlinear_viscous_friction": {"amount": -1.5, "exponent": 2.0},
    "stribeck_friction": {"excess": 8.0, "stribeck_velocity": 0.01, "exponent": 1.0},
    "presliding_friction": {"stiffness": 1e5},
    "maxwell_slip_friction": {"share": 0.3, "travel": 4e-4},
    "load_dependent_friction": {"share": 0.1},
    "position_dependent_friction": {"amplitude": 4.0, "phase": 0.3, "length": 0.1},
    "friction_map": {"start": 0.0, "end": 0.02, **HEIGHTS},
    "friction_drift": {"change": 0.4, "time_constant": 0.8},
    "position_ripple": {"amplitude": 3.0, "phase": 0.5, "period": 2.5e-3},
    "friction_ripple": {"amplitude": 3.0, "phase": 0.5, "period": 2.5e-3},
    "elastic_force": {"stiffness": 300.0, "rest_position": 0.02},
    "force_map": {"start": 0.0, "end": 0.02, **HEIGHTS},
    "gravity": {"torque": 6.0, "angle": 0.7},
    "end_stop": {"stiffness": 2e4, "position": 0.003, "side": 1.0},
    "mass_change": {"change": 0.3, "time": 0.7773},
    "external_force": {"amplitude": -15.0, "start": 0.2013, "duration": 0.1, "every": 0.4},
    "periodic_disturbance": {"amplitude": 6.0, "phase": 0.2, "frequency": 17.0},
    "flexible_coupling": {"frequency": 60.0, "damping": 0.05, "share": 0.4},
    "backlash": {"gap": 1e-4, "frequency": 60.0, "damping": 0.15, "share": 0.4},
    "back_emf_braking": {"braking": 60.0},
    "actuator_delay": {"delay": 1.7e-3},
    "actuator_lag": {"time_constant": 1.5e-3},
    "actuator_saturation": {"limit": 1.2},
    "actuator_deadzone": {"width": 0.2},
    "encoder_error": {"amplitude": 1e-5, "phase": 0.1, "period": 2.5e-3},
    "controller_disturbance": {"amplitude": 0.3, "frequency": 1.3, "duty": 0.4, "start": 0.2},
}
# Not motion of the carriage in open loop: what they add is outside the plant.
OUTSIDE = ("encoder_error", "controller_disturbance")


def voltage(seconds: float = 2.0) -> np.ndarray:
    """Voltage [V] held over 4 ms: two sines that reverse the carriage and let it rest in between."""
    t = np.arange(round(seconds / PERIOD)) * PERIOD
    return 1.6 * np.sin(2 * np.pi * 1.3 * t) * np.abs(np.sin(2 * np.pi * 0.45 * t)) + 0.25 * np.sin(2 * np.pi * 9 * t)


def axis_with(*names: str):
    """The 2019 machine with effects of the cases, sampled slowly, encoder exact."""
    from emps_design.effects import get_effect
    from emps_design.machines import machine

    effects = [{"kind": name, **CASES[name]} for name in names if CASES[name]]
    motion = next(filter(None, (get_effect(one["kind"]).motion for one in effects)), "linear")
    sampling = {"period": PERIOD, "encoder_resolution": 0.0}
    return machine("emps2019").replace(motion=motion, effects=effects, sampling=sampling)
