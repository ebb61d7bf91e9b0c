"""Each effect, and several together, within 1e-9 m of scipy's solve_ivp with events, over nine tenths of a second."""

import numpy as np
import pytest

from emps_design.effects import EFFECTS
from emps_design.machines import machine
from emps_design.simulation import Plant
from tests.physics.cases import CASES, OUTSIDE, axis_with, voltage
from tests.physics.reference import Reference
from tests.studies import quick

TOGETHER = (
    ("stribeck_friction", "flexible_coupling", "actuator_delay"),
    ("backlash", "asymmetric_viscous_friction", "external_force"),
    ("presliding_friction", "position_ripple", "actuator_lag"),
    ("presliding_friction", "maxwell_slip_friction", "friction_map"),
    ("presliding_friction", "friction_ripple", "actuator_delay"),
    ("presliding_friction", "stribeck_friction", "position_ripple"),
    ("presliding_friction", "friction_drift", "position_dependent_friction"),
    ("presliding_friction", "position_dependent_friction", "actuator_lag"),
    ("maxwell_slip_friction", "load_dependent_friction", "friction_ripple", "actuator_lag"),
    ("presliding_friction", "load_dependent_friction"),
    ("position_dependent_friction", "end_stop", "mass_change", "periodic_disturbance"),
)


def test_every_effect_has_a_case():
    assert set(CASES) == {"none", *(effect.name for effect in EFFECTS)}


@pytest.mark.parametrize("name", [name for name in CASES if name not in OUTSIDE])
def test_effect(name):
    axis, u = axis_with(name), voltage(0.9)
    run = Plant.of(axis).open_loop(u)
    reference = Reference(axis).positions(u)
    assert np.ptp(reference) > 5e-3
    assert np.abs(run.position - reference).max() < 1e-9


@pytest.mark.parametrize("names", quick(map("+".join, TOGETHER), 5, "more together"))
def test_effects_together(names):
    axis, u = axis_with(*names.split("+")), voltage(0.9)
    run = Plant.of(axis).open_loop(u)
    assert np.abs(run.position - Reference(axis).positions(u)).max() < 1e-9


@pytest.mark.parametrize("period", [5e-4, 4e-3])
@pytest.mark.parametrize("stiffness", [2e4, 1e6, 1e8])
@pytest.mark.parametrize("name", ["friction_ripple", "stribeck_friction", "friction_map", "friction_drift"])
def test_a_contact_under_friction_that_varies(name, stiffness, period):
    """Soft or so stiff that it bends a thousand times while the carriage goes on by one sample: as in tiny steps."""
    axis, u = axis_with("presliding_friction", name), np.repeat(voltage(), round(4e-3 / period))
    contact, other = (one.parameters for one in axis.effects)
    effects = [{"kind": "presliding_friction", **contact, "stiffness": stiffness}, {"kind": name, **other}]
    plant = Plant.of(axis.replace(effects=effects, sampling={"period": period}))
    tiny = plant.open_loop(u, tolerance=1e-6)
    assert np.ptp(np.sign(tiny.v)) == 2.0
    assert np.abs(plant.open_loop(u).position - tiny.position).max() < 2e-9  # 1.6e-9 at most


@pytest.mark.parametrize("other", ["none", "presliding_friction"])
def test_a_carriage_that_moves_at_first(other):
    """Friction depends on speed and on the motor's force; without stick the direction at first means nothing later."""
    axis, u = axis_with("stribeck_friction", "load_dependent_friction", other), voltage()
    run = Plant.of(axis).open_loop(u, v0=0.1)
    assert np.ptp(np.sign(run.v)) == 2.0
    assert np.abs(run.position - Reference(axis).positions(u, v0=0.1)).max() < 1e-9


@pytest.mark.parametrize("name", OUTSIDE)
def test_effect_outside_the_plant_in_closed_loop(name):
    axis = machine("emps2019").replace(effects=[{"kind": name, **CASES[name]}], sampling={"encoder_resolution": 0.0})
    t = np.arange(2000) * 1e-3
    q_ref = 0.02 * np.sin(2 * np.pi * 0.8 * t) ** 2
    run = Plant.of(axis).closed_loop(q_ref)
    reference = Reference(axis).positions(q_ref, closed=True)
    assert np.abs(run.position - reference).max() < 1e-9
    plain = Plant.of(axis.replace(effects=[])).closed_loop(q_ref)
    assert np.abs(run.position - plain.position).max() > 1e-6


def test_current_loop_is_the_lag_of_the_effect():
    u = voltage()
    lag = CASES["actuator_lag"]["time_constant"]
    as_effect = Plant.of(axis_with("actuator_lag")).open_loop(u)
    as_drive = Plant.of(axis_with().replace(drive={"current_time_constant": lag})).open_loop(u)
    assert np.abs(as_effect.position - as_drive.position).max() < 1e-9


@pytest.mark.parametrize("lag", quick([5e-3, 0.25e-3, 1e-5], 2, "short lags: many small steps"))
@pytest.mark.parametrize(
    "other", quick(["flexible_coupling", "load_dependent_friction", "none", "actuator_delay"], 2, "another effect")
)
def test_lag_of_any_length_with_others(lag, other):
    axis, u = axis_with(other), voltage(0.8 if lag > 1e-3 else 0.5)
    axis = axis.replace(effects=[*axis.effects, {"kind": "actuator_lag", "time_constant": lag}])
    run = Plant.of(axis).open_loop(u)
    assert np.ptp(np.sign(run.v)) == 2.0
    assert np.abs(run.position - Reference(axis).positions(u)).max() < 1e-9


def test_two_lags_act_one_behind_the_other():
    """A current loop and a lag found in the record: the slower by far hides the faster, whichever it is."""
    u = voltage()
    slow, fast = {"kind": "actuator_lag", "time_constant": 5e-3}, 1e-5
    both = Plant.of(axis_with().replace(effects=[slow], drive={"current_time_constant": fast})).open_loop(u)
    alone = Plant.of(axis_with().replace(effects=[slow])).open_loop(u)
    assert np.abs(both.position - alone.position).max() < 1e-5


def test_a_carriage_comes_to_rest_where_only_friction_of_its_direction_holds_it():
    """Beyond its stop friction of the other direction, which is less, would turn it: no step may feel that.

    Undriven on a spring against constant friction, it stops at a quarter period's end, in closed form.
    """
    mass, coulomb, offset, stiffness, share = 0.0065, 0.017, 0.002, 0.4, 0.38
    axis = machine("emps2019").replace(
        mechanics={"mass": mass, "viscous": 0.0, "coulomb": coulomb, "offset": offset},
        effects=[
            {"kind": "elastic_force", "stiffness": stiffness, "rest_position": 0.0},
            {"kind": "load_dependent_friction", "share": share, "motor_side": 1.0},
        ],
    )
    level, other = coulomb + share * (offset + coulomb), coulomb + share * (coulomb - offset)
    for pull, speed in ((0.02416, 8.1e-4), (0.0237, 0.01), (0.0239, 2e-3)):
        assert other < pull < level
        start, balanced = -(pull + offset) / stiffness, -(level + offset) / stiffness
        run = Plant.of(axis).open_loop(np.zeros(100), q0=start, v0=speed, period=5e-3, tolerance=1e-2)
        stop = balanced + np.hypot(start - balanced, speed * np.sqrt(mass / stiffness))
        assert run.v[-1] == 0.0
        assert run.position[-1] == pytest.approx(stop, abs=1e-11)
