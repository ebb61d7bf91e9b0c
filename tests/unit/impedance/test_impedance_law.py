"""The law: closed forms of what it leaves on the plant, and what it refuses."""

import math

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.control.impedance.law import (
    CRITERIA,
    LEAST_SQUARES,
    PRINTED,
    FrictionModel,
    ImpedanceLaw,
    equivalent_impedance,
    equivalent_loop,
    impedance_law,
    safety_words,
)
from emps_design.effects import known_effects
from emps_design.errors import InputError, SpecificationError
from emps_design.laws.law import left_out
from emps_design.machines import machine
from emps_design.paper import written as y
from emps_design.paper.loops import cost_of_printed, derived_law, felt_under, printed_law


def alike(error: float) -> dict[str, float]:
    return {"mass": error, "viscous": error, "coulomb": error}


def test_derived_law_gives_the_target_and_printed_30_does_not(plant):
    law = ImpedanceLaw(50.0, 100.0, plant)
    assert law.apparent(plant).to_dict() == {"apparent_mass": 50.0, "apparent_damping": 100.0, "coulomb_left": 0.0}
    printed = ImpedanceLaw(50.0, 100.0, plant, current_factor=PRINTED).apparent(plant)
    assert printed.mass == pytest.approx(plant.mass**2 / (2 * plant.mass - 50.0))
    assert [round(x, 1) for x in (printed.mass, printed.damping, printed.coulomb_left)] == [73.8, 235.8, 6.3]


@pytest.mark.parametrize("factor", [1.0, PRINTED])
@pytest.mark.parametrize("error", [-0.02, 0.0, 0.05])
def test_closed_forms_agree_with_sympy(plant, factor, error):
    law = ImpedanceLaw(50.0, 100.0, plant.with_errors(alike(error)), current_factor=factor)
    numbers = {
        y.M: plant.mass, y.F_v: plant.viscous_positive, y.F_c: plant.coulomb_positive,
        y.M_h: law.estimate.mass, y.F_vh: law.estimate.viscous_positive, y.F_ch: law.estimate.coulomb_positive,
        y.M_a: 50.0, y.B: 100.0,
    }  # fmt: skip
    felt = felt_under(derived_law()["30"].expression if factor == 1.0 else printed_law())
    for name, value in law.apparent(plant).to_dict().items():
        assert float(felt[name].subs(numbers)) == pytest.approx(value, abs=1e-9)


def test_cost_of_the_printed_law_is_the_closed_form(plant):
    cost = cost_of_printed(plant, 50.0, 100.0)
    assert cost["derived"] == pytest.approx({"apparent_mass": 50.0, "apparent_damping": 100.0, "coulomb_left": 0.0})
    printed = ImpedanceLaw(50.0, 100.0, plant, current_factor=PRINTED).apparent(plant)
    assert cost["printed"] == pytest.approx(printed.to_dict())


def test_continuous_law_balances_the_plant(plant):
    law = ImpedanceLaw(50.0, 100.0, plant, stiffness=30.0, rest_position=0.1)
    q, v, a = 0.3, -0.2, 1.5
    tau_e = 50.0 * a + 100.0 * v + 30.0 * (q - 0.1)
    tau = plant.mass * a + plant.viscous_negative * v - plant.coulomb_negative - tau_e
    assert law.motor_force(q, v, a, tau) == pytest.approx(tau)
    sensor = ImpedanceLaw(50.0, 100.0, plant, stiffness=30.0, rest_position=0.1, force_sensor=True)
    assert sensor.motor_force(q, v, a, tau, tau_e) == pytest.approx(tau)
    with pytest.raises(InputError, match="tau_e: found none"):
        sensor.motor_force(q, v, a, tau)


def test_two_quadrant_friction_comes_from_the_axis():
    model = FrictionModel.of(machine("emps2018-two-quadrant"))
    assert model.to_dict() == pytest.approx(
        {
            "mass": 115.7315,
            "viscous_positive": 474.9727,
            "viscous_negative": 563.8568,
            "coulomb_positive": 17.3811,
            "coulomb_negative": 11.5846,
        }
    )
    assert model.two_quadrant
    assert not FrictionModel.of(machine("emps2018")).two_quadrant


def test_effects_that_are_not_viscous_are_named(axis):
    stribeck = {"kind": "stribeck_friction", "excess": 3.0, "stribeck_velocity": 0.01, "exponent": 1.0}
    assert left_out(axis.replace(effects=[stribeck])) == ("stribeck_friction",)
    assert left_out(machine("emps2018-two-quadrant")) == ()
    kinds = known_effects()
    for kind in kinds:
        effect = kinds[kind]
        if not effect.acts_on("linear"):
            continue
        values = {p.name: p.starts[0] if p.starts else max(p.lower, min(p.upper, 0.01)) for p in effect.parameters}
        viscous = kind in ("asymmetric_viscous_friction", "back_emf_braking")
        assert left_out(axis.replace(effects=[{"kind": kind, **values}])) == (() if viscous else (kind,))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 0.0}, r"M_a: found 0, expected more than 0"),
        ({"mass": -1.0}, r"M_a: found -1"),
        ({"mass": math.nan}, r"M_a: found nan, expected a finite number"),
        ({"damping": -1.0}, r"damping B: found -1, expected at least 0"),
        ({"stiffness": -1.0}, r"stiffness K: found -1"),
        ({"coulomb_factor": -0.1}, r"Coulomb factor: found -0.1"),
        ({"rest_position": math.inf}, r"rest position q_0: found inf, expected a finite number"),
        ({"filter": 0.0}, r"filter: found 0 rad/s, expected more than 0"),
        ({"current_filter": -5.0}, r"current filter: found -5 rad/s"),
        ({"current_factor": 3.0}, r"current factor: found 3, expected 1 \(derived\) or 2 \(printed\)"),
        ({"velocity_estimator": "kalman"}, r"velocity estimator: found 'kalman'"),
        ({"mass": np.array([50.0, -2.0])}, r"M_a: found -2, expected more than 0"),
        ({"filter": np.array([200.0, 0.0])}, r"filter: found 0 rad/s, expected more than 0"),
    ],
)
def test_impossible_laws_are_refused(plant, change, message):
    with pytest.raises(InputError, match=message):
        ImpedanceLaw(**{"mass": 50.0, "damping": 100.0, "estimate": plant, **change})


def test_filter_above_nyquist_is_refused(axis):
    with pytest.raises(InputError, match=r"filter: found 5000 rad/s, expected less than the Nyquist frequency 3141.59"):
        impedance_law(axis, 50.0, 100.0, filter=5000.0)
    with pytest.raises(InputError, match=r"current filter: found 4000 rad/s"):
        impedance_law(axis, 50.0, 100.0, current_filter=4000.0)
    assert impedance_law(axis, 50.0, 100.0, filter=math.inf).filters == (math.inf, math.inf)


def test_estimates_must_stay_positive(plant):
    with pytest.raises(InputError, match=r"mismatch: found -1 on coulomb positive"):
        plant.with_errors({"coulomb": -1.0})


def test_printed_law_without_a_solution_is_refused(plant):
    law = ImpedanceLaw(2.0 * plant.mass, 100.0, plant, current_factor=PRINTED)
    with pytest.raises(InputError, match="no solution with an ideal current loop"):
        law.apparent(plant)


def test_axis_controller_gives_the_filter(axis):
    table = {"kind": "impedance", "mass": 50.0, "damping": 100.0, "filter": 321.0}
    assert impedance_law(Axis.from_dict({**axis.to_dict(), "controller": table}), 50.0, 100.0).filter == 321.0


def test_equivalent_of_the_papers_own_loop_is_not_safe(axis):
    found = equivalent_impedance(axis, 0.01, 100.0, 60.0)
    assert found.damping == 100.0
    assert found.mass == pytest.approx(100.0 * math.sin(math.pi / 3) / 100.0)  # 0.87 kg
    assert found.warnings[0].startswith("not safe: M_a = 0.866 kg is within the 2 % error of M")
    assert safety_words(axis, 50.0, 5.0, 0.02)[0].startswith("not safe: B = 5")


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize(("mass", "damping"), [(50.0, 100.0), (5.0, 40.0), (80.0, 300.0)])
def test_equivalence_runs_both_ways(axis, criterion, mass, damping):
    loop = equivalent_loop(axis, mass, damping, criterion)
    back = equivalent_impedance(axis, loop.k_e1, loop.crossover, loop.phase_margin_deg, criterion)
    assert (back.mass, back.damping) == pytest.approx((mass, damping))
    assert (back.k_v1, back.t_v) == pytest.approx((loop.k_v1, loop.t_v))


def test_least_squares_is_the_minimum_over_the_operators_band(axis):
    loop = equivalent_impedance(axis, 0.01, 40.0, 70.0, LEAST_SQUARES)
    omega = np.linspace(0.0, 20.0, 20001)
    design = np.column_stack([1j * omega, np.ones_like(omega)])
    stacked = np.vstack([design.real, design.imag])
    z = loop.impedance(omega)
    best = np.linalg.lstsq(stacked, np.concatenate([z.real, z.imag]), rcond=None)[0]
    assert (loop.mass, loop.damping) == pytest.approx(tuple(best), rel=1e-4)
    assert np.all(np.diff(loop.error(np.array([30.0, 100.0, 300.0]))) > 0)  # no match at high frequency


def test_equivalence_refuses_what_has_none(axis):
    with pytest.raises(SpecificationError, match="a cascade has 1/k_e1 = B"):
        equivalent_loop(axis, 50.0, 0.0)
    with pytest.raises(InputError, match="k_e1: found 0"):
        equivalent_impedance(axis, 0.0, 100.0, 60.0)
    with pytest.raises(InputError, match="expected M_a > 0 and B >= 0"):
        equivalent_loop(axis, -1.0, 100.0)
    with pytest.raises(InputError, match="criterion: found 'h_infinity'"):
        equivalent_loop(axis, 50.0, 100.0, "h_infinity")
    slow = equivalent_loop(axis, 50.0, 100.0, input_crossover=0.01)
    assert any("resonance" in word for word in slow.warnings)


def test_loop_without_positive_gain_is_named(axis):
    found = equivalent_impedance(axis, 0.01, 1.0, 60.0)  # M w tan(phi) < F_v
    assert found.k_v1 is None
    assert any(word.startswith("no such loop: phase margin: found 60 deg") for word in found.warnings)


def test_an_equivalent_loop_that_the_drive_cannot_run_says_so(axis):
    from emps_design.control.impedance.law import equivalent_loop

    late = axis.replace(sampling={"computation_delay": 2})
    found = equivalent_loop(late, 80.0, 100.0)
    assert not found.stable
    assert found.to_dict()["sampled"] == {"stable": False, "largest_pole": pytest.approx(1.0317, abs=1e-4)}
    assert any("the sampled velocity loop would be unstable, largest pole 1.032" in word for word in found.warnings)
    assert equivalent_loop(axis, 80.0, 100.0).stable
    assert equivalent_loop(late, 80.0, 100.0, input_crossover=200.0).stable
