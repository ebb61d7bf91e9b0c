"""Every effect is recovered, with the baseline, from its own simulation: closed loop, no noise, output error."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from emps_design.effects import EFFECTS
from emps_design.machines import machine
from emps_design.simulation import Plant

HEIGHTS = {f"height_{i}": h for i, h in enumerate((3.0, 2.0, -2.0, 5.0, 8.0, 1.0), start=1)}
TRUE = {
    "asymmetric_viscous_friction": {"viscous_difference": -40.0},
    "nonlinear_viscous_friction": {"amount": 5.0, "exponent": 2.0},
    "stribeck_friction": {"excess": 8.0, "stribeck_velocity": 0.01, "exponent": 1.4},
    "presliding_friction": {"stiffness": 1e5},
    "maxwell_slip_friction": {"share": 0.3, "travel": 5e-4},
    "load_dependent_friction": {"share": 0.1, "carried_force": 40.0},
    "position_dependent_friction": {"amplitude": 5.0, "phase": 0.4, "length": 0.13},
    "friction_map": {"start": 0.0, "end": 0.15, **HEIGHTS},
    "friction_drift": {"change": -0.4, "time_constant": 2.0},
    "position_ripple": {"amplitude": 4.0, "phase": 0.6, "period": 0.01},
    "friction_ripple": {"amplitude": 4.0, "phase": 0.6, "period": 0.01},
    "elastic_force": {"stiffness": 60.0, "rest_position": 0.0},
    "force_map": {"start": 0.0, "end": 0.15, **HEIGHTS},
    "gravity": {"torque": 30.0, "angle": 0.5},
    "end_stop": {"stiffness": 1500.0, "position": 0.13, "side": 1.0},
    "mass_change": {"change": 0.15, "time": 1.5},
    "external_force": {"amplitude": 20.0, "start": 0.9, "duration": 0.2, "every": 1.7},
    "periodic_disturbance": {"amplitude": 4.0, "phase": 0.3, "frequency": 6.0},
    "flexible_coupling": {"frequency": 35.0, "damping": 0.05, "share": 0.4, "load_friction": 0.3},
    "backlash": {"gap": 1e-4, "frequency": 60.0, "damping": 0.15, "share": 0.4, "load_friction": 0.3},
    "back_emf_braking": {"braking": 30.0},
    "actuator_delay": {"delay": 1.3e-3},
    "actuator_lag": {"time_constant": 1.4e-3},
    "actuator_saturation": {"limit": 3.0},
    "actuator_deadzone": {"width": 0.2},
    "encoder_error": {"amplitude": 1e-5, "phase": 0.4, "period": 0.01},
    "controller_disturbance": {"amplitude": 0.8, "frequency": 1.3, "duty": 0.5, "start": 0.2},
}
# Edges that fall on samples: between two samples nothing changes, so they are searched, not refined.
ON_SAMPLES = {"controller_disturbance": ("frequency", "duty", "start")}
OF_THE_WHOLE_RECORD = ("frequency",)  # started within half a turn over the record, as a spectrum would give it
PERIOD = 1e-3


def program():
    """There and back over 0.15 m at 0.12 and at 0.05 m/s, accelerations of 1 m/s^2 [m]."""
    speed = []
    for top, sign in ((0.12, 1), (0.12, -1), (0.05, 1), (0.05, -1)):
        rise = round(top / 1.0 / PERIOD)
        flat = round(0.15 / top / PERIOD) - rise
        ramp = np.arange(1, rise + 1) / rise
        speed += [sign * top * np.concatenate([ramp, np.ones(flat), ramp[::-1]]), np.zeros(60)]
    return np.cumsum(np.concatenate(speed)) * PERIOD


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_recovered_from_its_own_simulation(effect):
    axis = machine("emps2019").replace(
        motion=effect.motion or "linear",
        effects=[{"kind": effect.name, **TRUE[effect.name]}],
        sampling={"encoder_resolution": 0.0},
    )
    plant, q_ref = Plant.of(axis), program()
    truth, b = effect.values(TRUE[effect.name]), axis.mechanics.array()
    fixed = ON_SAMPLES.get(effect.name, ())
    free = [k for k, p in enumerate(effect.parameters) if not p.discrete and p.name not in fixed]
    scale = np.concatenate([np.maximum(np.abs(b), 3.0), np.abs(truth[free])])
    # A winding that is never open brakes as viscous friction does.
    switched = {"enable": np.where(np.arange(q_ref.size) % 900 < 850, 1.0, 0.0)} if effect.winding else {}
    measured = plant.closed_loop(q_ref, **switched).force

    def residual(x):
        values = truth.copy()
        values[free] = x[4:] * scale[4:]
        return plant.closed_loop(q_ref, baseline=x[:4] * scale[:4], parameters=(values,), **switched).force - measured

    rng = np.random.default_rng(3)
    exact = np.concatenate([b, truth[free]]) / scale
    off = np.where([False] * 4 + [effect.parameters[k].name in OF_THE_WHOLE_RECORD for k in free], 3e-3, 0.03)
    start = exact * (1 + off * rng.choice([-1.0, 1.0], exact.size))
    found = least_squares(residual, start, method="lm", diff_step=1e-4, xtol=1e-10, max_nfev=40 * exact.size)
    np.testing.assert_allclose(found.x, exact, atol=1e-6)
