"""The effects reproduce records that another simulator made with them, down to the noise of those records.

The records are looked for by the fixture ``hidden_data``. Only what they say themselves is used: sizes from
``truth.json``, mechanics from a fit to a healthy record of the same drive.
"""

import json
import math
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from emps_design.axis import Axis
from emps_design.simulation import Plant

SKIP = 50  # samples that the floors leave out


def translate(kind, given, b):
    """Parameters of ``truth.json`` in the words of the effects; phases that it does not tell are fitted."""
    p = dict(given)
    coupling = {}
    if "flex_wn" in p:
        coupling = {"frequency": p["flex_wn"] / (2 * math.pi), "damping": p["flex_zeta"], "share": p["flex_ratio"]}
    return {
        "actuator_deadzone": lambda: {"width": p["dead_v"]},
        "actuator_delay": lambda: {"delay": 1e-3 * p["delay_ms"]},
        "actuator_lag": lambda: {"time_constant": p["lag_tau"]},
        "actuator_saturation": lambda: {"limit": p["sat_v"]},
        "asymmetric_viscous_friction": lambda: {"viscous_difference": p["asym_fv"] * b[1]},
        "backlash": lambda: {"gap": p["backlash"], **coupling},
        "flexible_coupling": lambda: coupling,
        "elastic_force": lambda: {"stiffness": p["spring_k"], "rest_position": p["spring_q0"]},
        "encoder_error": lambda: {"amplitude": p["enc_amp"], "phase": None, "period": p["enc_per"]},
        "end_stop": lambda: {"stiffness": p["stop_k"], "position": p["stop_q"], "side": 1.0},
        "external_force": lambda: {
            "amplitude": p["pulse_amp"],
            "start": p["pulse_t0"],
            "duration": p["pulse_dt"],
            "every": p["pulse_every"],
        },
        "friction_drift": lambda: {"change": p["drift_frac"], "time_constant": p["drift_tau"]},
        "load_dependent_friction": lambda: {"share": p["load_mu"]},
        "mass_change": lambda: {"change": p["mass_step"], "time": p["mass_t"]},
        "nonlinear_viscous_friction": lambda: {"amount": 0.01 * p["quad"], "exponent": 2.0},
        "periodic_disturbance": lambda: {"amplitude": p["hum_amp"], "phase": None, "frequency": p["hum_hz"]},
        "position_dependent_friction": lambda: {
            "amplitude": p["posfric_amp"] * b[2],
            "phase": None,
            "length": p["posfric_len"],
        },
        "position_ripple": lambda: {
            "amplitude": p["ripple_amp"],
            "phase": p["ripple_phase"],
            "period": p["ripple_per"],
        },
        "presliding_friction": lambda: {"stiffness": p["dahl_sigma"]},
        "stribeck_friction": lambda: {
            "excess": p["fs_extra"],
            "stribeck_velocity": p["v_stribeck"],
            "exponent": 1.0,
        },
    }[kind]()


def error(axis, record):
    """Rms force [N] that a closed-loop simulation of the record's reference leaves."""
    run = Plant.of(axis).closed_loop(record["q_ref"])
    return axis.drive.force_gain * float(np.std((record["u"] - run.u)[SKIP:]))


@cache
def healthy_axis(folder, drive):
    """The drive's mechanics, fitted to its healthy training record."""
    axis = Axis.load(folder / f"{drive}-none-0" / "axis.toml")
    record = np.load(folder / f"{drive}-none-0" / "train.npz")
    plant, b = Plant.of(axis), axis.mechanics.array()
    step = np.array([b[0], b[1], b[2], b[2]])

    def residual(x):  # from 1, so that the relative steps of the differences suit the offset too
        return plant.closed_loop(record["q_ref"], baseline=b + (x - 1) * step).u - record["u"]

    x = np.ones(4)
    for difference in (2e-2, 5e-3):
        x = least_squares(residual, x, method="lm", diff_step=difference, max_nfev=40).x
    names = ("mass", "viscous", "coulomb", "offset")
    return axis.replace(mechanics=dict(zip(names, map(float, b + (x - 1) * step), strict=True)))


CASES = [
    *("emps-actuator_deadzone-1", "emps-actuator_delay-1", "emps-actuator_lag-1", "emps-actuator_saturation-1"),
    *("emps-backlash-1", "emps-elastic_force-1", "emps-encoder_error-1", "emps-end_stop-1", "emps-external_force-1"),
    *("emps-flexible_coupling-1", "emps-friction_drift-1", "emps-load_dependent_friction-1", "emps-mass_change-1"),
    *("emps-nonlinear_viscous_friction-1", "emps-periodic_disturbance-1", "emps-position_dependent_friction-1"),
    *("emps-position_ripple-1", "emps-presliding_friction-1", "emps-stribeck_friction-1"),
    *("emps-position_ripple+friction_drift-1", "emps-flexible_coupling+stribeck_friction-1"),
    *("heavy-backlash-2", "heavy-mass_change-2", "heavy-stribeck_friction+actuator_delay-1"),
]


@pytest.mark.parametrize("name", CASES)
def test_the_floor_of_a_foreign_record_is_reached(hidden_data, name):
    case = hidden_data / name
    if not case.is_dir():
        pytest.skip(f"{case} is not there")
    truth, record = json.loads((case / "truth.json").read_text()), np.load(case / "holdout.npz")
    axis = healthy_axis(hidden_data, name.split("-")[0])
    b = axis.mechanics.array()
    effects = [{"kind": kind, **translate(kind, truth["parameters"], b)} for kind in truth["effects"]]
    smallest = math.inf
    for phase in np.arange(0.0, 2 * math.pi, 0.1) if None in effects[0].values() else [0.0]:
        whole = [{key: phase if value is None else value for key, value in effect.items()} for effect in effects]
        smallest = min(smallest, error(axis.replace(effects=whole), record))
    assert smallest < 1.08 * truth["floor_closed_loop"]
