"""Slides after one another on random sets of effects, against small steps from event to event.

With the energy balance asked for nothing is slid through and nothing solved, so the reference shares neither.
"""

import numpy as np
import pytest

from emps_design.machines import machine
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import trapezoid_laps

BRAKING = "back_emf_braking"
KINDS = {
    BRAKING: {"braking": 40.0},
    "stribeck_friction": {"excess": 4.0, "stribeck_velocity": 0.02, "exponent": 1.0},
    "nonlinear_viscous_friction": {"amount": -1.5, "exponent": 2.0},
    "asymmetric_viscous_friction": {"viscous_difference": -30.0},
    "position_ripple": {"amplitude": 2.0, "phase": 0.5, "period": 2.5e-3},
    "friction_ripple": {"amplitude": 1.0, "phase": 0.2, "period": 4e-3},
    "position_dependent_friction": {"amplitude": 2.0, "phase": 0.3, "length": 0.2},
    "periodic_disturbance": {"amplitude": 1.5, "phase": 0.0, "frequency": 3.0},
    "maxwell_slip_friction": {"share": 0.3, "travel": 1e-3},
    "presliding_friction": {"stiffness": 1e5},
    "actuator_lag": {"time_constant": 5e-4},
}


def draw(seed):
    """Two to four effects; in every other set the back-EMF brakes."""
    r = np.random.default_rng(seed)
    others = [kind for kind in KINDS if kind != BRAKING]
    kinds = [str(kind) for kind in r.permutation(others)[: r.integers(2, 5)]]
    kinds += [BRAKING] if seed % 2 else []
    changed = ("amplitude", "braking", "excess", "share", "stiffness")
    return [
        {"kind": k, **{n: x * (r.uniform(0.5, 1.5) if n in changed else 1.0) for n, x in KINDS[k].items()}}
        for k in kinds
    ]


@pytest.mark.parametrize("period", [0.25e-3, 1e-3])
@pytest.mark.parametrize("seed", range(12))
def test_random_sets_of_effects_agree_with_small_steps(seed, period):
    axis = machine("emps2019").replace(effects=draw(seed), sampling={"period": period, "encoder_resolution": 0.0})
    q_ref = trapezoid_laps(period, stroke=0.05, speed=0.15, laps=1)
    noise = 4e-3 * np.random.default_rng(100 + seed).standard_normal(q_ref.size)
    plant = Plant.of(axis)
    fast = plant.closed_loop(q_ref, voltage_noise=noise, quantise=False)
    small = plant.closed_loop(q_ref, voltage_noise=noise, quantise=False, energy=True, tolerance=1e-2)
    assert np.abs(fast.position - small.position).max() < 1e-9
