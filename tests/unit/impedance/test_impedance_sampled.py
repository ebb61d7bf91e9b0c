"""The sampled loop: matrices against the z-transform and against the compiled plant, poles, contact, passivity."""

import math
from dataclasses import replace

import numpy as np
import pytest

from emps_design.comanipulation.run import run_task
from emps_design.comanipulation.task import Task
from emps_design.control.impedance.law import DERIVED, PRINTED, FrictionModel, ImpedanceLaw, impedance_law
from emps_design.control.impedance.passivity import (
    Clock,
    Environment,
    admittance_polynomials,
    contact_map,
    impedance_error,
    largest_wall,
    passivity,
    recursion_poles,
    relay_oscillations,
    sampled_loop,
)
from emps_design.control.impedance.robustness import (
    check_mismatch,
    coulomb_factor_without_creep,
    creep_speed,
    dead_band,
    drift_speed,
    nearest_stable,
    smallest_mass,
    stability_map,
    verdict,
    worst_radius,
)
from emps_design.control.margins import transfer
from emps_design.errors import InputError


def over(error: float) -> dict[str, float]:
    return {"mass": error, "viscous": error, "coulomb": error}


@pytest.mark.parametrize("estimator", ["two_tap", "backward"])
@pytest.mark.parametrize("force_sensor", [False, True])
@pytest.mark.parametrize("clock", [Clock(1e-3, 5e-4), Clock(1e-3, 0.0, 1), Clock(2e-3, 1e-3, 3)])
@pytest.mark.parametrize("stiffness", [0.0, 50.0])
def test_matrices_and_z_transform_are_the_same_loop(plant, estimator, force_sensor, clock, stiffness):
    law = ImpedanceLaw(
        50.0, 100.0, plant.with_errors(over(0.02)), stiffness, filter=150.0, current_filter=400.0,
        force_sensor=force_sensor, velocity_estimator=estimator,
    )  # fmt: skip
    omega = np.array([0.1, 1.0, 20.0, 300.0, 1500.0])
    loop = sampled_loop(law, plant, clock)
    per_force, per_coulomb = z_transform(law, plant, clock, omega)
    np.testing.assert_allclose(loop.admittance(omega), per_force, rtol=1e-8)
    np.testing.assert_allclose(loop.response(omega, by="coulomb"), per_coulomb, rtol=1e-8)


def z_transform(law, plant, clock, omega):
    """Mean velocity per held force, and per newton of the Coulomb compensation: the recursions solved by hand in z."""
    from scipy.linalg import expm

    T, lag, z = clock.period, clock.current_time_constant, np.exp(1j * omega * clock.period)
    generator = np.zeros((5, 5))  # q, v, tau; the law's force, the force from outside
    generator[0, 1] = 1.0
    generator[1, [1, 4]] = -plant.viscous_positive / plant.mass, 1.0 / plant.mass
    if lag:
        generator[1, 2], generator[2, [2, 3]] = 1.0 / plant.mass, (-1.0 / lag, 1.0 / lag)
    else:
        generator[1, 3] = 1.0 / plant.mass
    step = expm(generator * T)[:3]
    if not lag:
        step[2] = 0.0, 0.0, 0.0, 1.0, 0.0
    motor = step[2, 3] / (z - step[2, 2])
    a11, a12, a21, a22 = z - step[0, 0], -step[0, 1], -step[1, 0], z - step[1, 1]
    by_law, by_hand = step[:2, 3, None] + step[:2, 2, None] * motor, step[:2, 4]
    from_c, from_e = ((a22 * b[0] - a12 * b[1]) / (a11 * a22 - a12 * a21) for b in (by_law, by_hand))

    r, estimate = law.ratio, law.estimate
    two_tap = law.velocity_estimator == "two_tap"
    taps = (1.0 - z**-2) / (2.0 * T) if two_tap else (1.0 - 1.0 / z) / T
    of_q = (estimate.viscous_positive - r * law.damping) * taps - r * law.stiffness
    of_c, of_e, of_level = 0.0, r - 1.0, 1.0
    if not law.force_sensor:
        low_a, low_t = ((1.0 - keep) / (1.0 - keep / z) for keep in (np.exp(-w * T) for w in law.filters))
        seen = estimate.mass * low_a * taps * (1.0 - 1.0 / z) / T + estimate.viscous_positive * taps
        of_q, of_c = of_q + (r - 1.0) * seen, -law.current_factor * (r - 1.0) * low_t * motor
        of_e, of_level = 0.0, r
    late = z ** -float(clock.delay)
    held = 1.0 - late * of_c
    closed = (1.0 - from_c * late * of_q / held) * T / (z - 1.0)
    return (from_e + from_c * late * of_e / held) / closed, from_c * late * of_level / held / closed


@pytest.mark.parametrize("force_sensor", [False, True])
@pytest.mark.parametrize(("lag", "delay"), [(5e-4, 0), (0.0, 0), (5e-4, 2), (0.0, 1)])
def test_compiled_plant_without_dry_friction_is_the_linear_loop(axis, force_sensor, lag, delay):
    smooth = axis.replace(
        mechanics={"coulomb": 0.0},
        drive={"current_time_constant": lag, "command_limit": 1e4},
        sampling={"encoder_resolution": 0.0, "computation_delay": delay},
    )
    plant = FrictionModel.of(smooth)
    law = impedance_law(smooth, 60.0, 100.0, 300.0, force_sensor=force_sensor).with_errors({"mass": 0.01})
    n = 400
    push = 10.0 + 30.0 * np.random.default_rng(1).standard_normal(n)  # white, and mostly one way
    push[0] = 500.0  # off and away, so that the velocity keeps its sign
    found = run_task(smooth, law, Task("noise", push, np.full(n, np.nan), (0.0, 0.0), n - 1, n - 1, 1e-3))
    assert found.v[1:].min() > 0.0
    loop = sampled_loop(law, plant, Clock.of(smooth))
    inputs = np.zeros((n - 1, len(loop.inputs)))
    inputs[:, loop.inputs.index("force")] = push[: n - 1]
    np.testing.assert_allclose(found.v[: n - 1], loop.simulate(inputs)[:, 0], rtol=1e-9, atol=1e-12)


def test_slowest_pole_is_the_apparent_impedance(plant, clock):
    for error in (-0.02, 0.0, 0.02):
        law = ImpedanceLaw(50.0, 100.0, plant, filter=1000.0).with_errors(over(error))
        felt = law.apparent(plant)
        pole = sampled_loop(law, plant, clock).radius
        assert -math.log(pole) / clock.period == pytest.approx(felt.damping / felt.mass, rel=0.02)


def test_acceleration_filtered_and_current_not_is_unstable(axis, plant, clock):
    law = impedance_law(axis, 50.0, 100.0, 200.0, current_filter=math.inf)
    assert sampled_loop(law.with_errors(over(-0.02)), plant, clock).stable
    assert not sampled_loop(law.with_errors(over(0.02)), plant, clock).stable
    assert verdict(law.with_errors(over(0.02)), plant, clock) == "unstable"


@pytest.mark.parametrize("filter", [50.0, 200.0, 500.0, 1000.0])
@pytest.mark.parametrize("error", [-0.02, 0.0, 0.02])
def test_same_filter_on_both_is_stable(axis, plant, clock, filter, error):
    assert sampled_loop(impedance_law(axis, 50.0, 100.0, filter).with_errors(over(error)), plant, clock).stable


def test_recursion_in_its_own_current_without_filter(plant):
    law = ImpedanceLaw(50.0, 100.0, plant)
    ideal = Clock(1e-3)
    assert law.recursion_gain == pytest.approx(plant.mass / 50.0 - 1.0)
    assert recursion_poles(law, ideal)[0].real == pytest.approx(-law.recursion_gain)  # -1.31: diverges at rest
    assert abs(recursion_poles(ImpedanceLaw(50.0, 100.0, plant, filter=200.0), ideal)[0]) < 1.0
    assert verdict(ImpedanceLaw(100.0, 100.0, plant, filter=500.0), plant, ideal) == "stable"


def test_creep_and_dead_band_in_closed_form(plant):
    law = ImpedanceLaw(50.0, 100.0, plant)
    creep = 0.02 * plant.coulomb_positive / (100.0 - 0.02 * plant.viscous_positive)
    assert creep_speed(law.with_errors(over(0.02)), plant) == pytest.approx(creep)
    assert 1e3 * creep == pytest.approx(3.84, abs=0.005)
    assert dead_band(law.with_errors(over(-0.02)), plant) == pytest.approx(0.02 * plant.coulomb_positive)
    assert creep_speed(law, plant) == dead_band(law, plant) == 0.0
    thin = ImpedanceLaw(50.0, 5.0, plant).with_errors(over(0.02))
    assert creep_speed(thin, plant) == math.inf


def test_coulomb_factor_rules_creep_out(plant):
    law = ImpedanceLaw(50.0, 100.0, plant)
    factor = coulomb_factor_without_creep(law, plant, 0.02)
    assert factor == pytest.approx(1 / 1.02)
    for c, creeps in ((factor, False), (factor + 1e-3, True)):
        worst = ImpedanceLaw(50.0, 100.0, plant, coulomb_factor=c).with_errors(over(0.02))
        assert (drift_speed(worst, plant) > 1e-9) is creeps


def test_map_and_smallest_mass_agree(axis, plant, clock):
    law = impedance_law(axis, 50.0, 100.0, 200.0)
    smallest = smallest_mass(law, plant, clock, 0.02)
    assert smallest > 0.02 * plant.mass  # necessary: M_a above the error of M
    assert worst_radius(replace(law, mass=smallest), plant, clock, 0.02) <= 1.0 + 1e-9
    assert worst_radius(replace(law, mass=0.99 * smallest), plant, clock, 0.02) > 1.0
    found = stability_map(law, plant, clock, masses=[0.5 * smallest, 1.1 * smallest], filters=[200.0])
    assert found.stable[1, 0].tolist() == [False, True]
    assert found.to_dict()["smallest_stable_mass"][1] == [pytest.approx(1.1 * smallest)]
    none = stability_map(law, plant, clock, masses=[1.0], filters=[200.0]).to_dict()
    assert none["smallest_stable_mass"][1] == [None]


def test_nearest_stable_law_is_stable(axis, plant, clock):
    bad = impedance_law(axis, 1.0, 5.0)
    nearest = nearest_stable(bad, plant, clock, 0.02)
    good = impedance_law(axis, nearest["mass"], nearest["damping"], nearest["filter"])
    assert worst_radius(good, plant, clock, 0.02) <= 1.0 + 1e-9
    assert smallest_mass(bad, plant, clock, 0.02) is None  # B within the error of F_v


def test_many_loops_at_once_are_the_single_ones(axis, plant, clock):
    law = impedance_law(axis, 50.0, 100.0)
    masses = np.array([5.0, 20.0, 50.0, 100.0])
    together = sampled_loop(replace(law, mass=masses), plant, clock).radius
    alone = [sampled_loop(impedance_law(axis, mass, 100.0), plant, clock).radius for mass in masses]
    np.testing.assert_allclose(together, alone, rtol=1e-9)


@pytest.mark.parametrize("force_sensor", [False, True])
@pytest.mark.parametrize("factor", [DERIVED, PRINTED])
@pytest.mark.parametrize("delay", [0, 2])
def test_errors_of_many_estimates_at_once_are_the_single_ones(plant, force_sensor, factor, delay):
    clock = Clock(1e-3, 5e-4, delay)
    law = ImpedanceLaw(50.0, 100.0, plant, 20.0, filter=500.0, current_factor=factor, force_sensor=force_sensor)
    drawn = np.random.default_rng(4).uniform(-0.05, 0.05, (3, 50))
    errors = dict(zip(over(0.0), drawn, strict=True))

    def error(wrong):
        off = law.with_errors(wrong)
        return impedance_error(sampled_loop(off, plant, clock), off)

    single = [dict(zip(errors, one, strict=True)) for one in drawn.T.tolist()]
    np.testing.assert_allclose(error(errors), [error(one)[0] for one in single], rtol=1e-9)


def test_systems_that_are_not_alike_are_solved_one_by_one():
    random = np.random.default_rng(6)
    A, b, c, d = random.normal(size=(5, 4, 4)), *random.normal(size=(2, 5, 4)), random.normal(size=5)
    z = np.exp(1j * np.linspace(0.1, 3.0, 6)).reshape(2, 3)
    together = transfer(A, b, c, d, z)
    assert together.shape == (5, 2, 3)
    alone = [transfer(*one, z) for one in zip(A, b, c, d, strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_impedance_error_grows_with_a_slower_filter(axis, plant, clock):
    every = [impedance_law(axis, 50.0, 100.0, w) for w in (2000.0, 500.0, 200.0, 50.0)]
    errors = [float(impedance_error(sampled_loop(law, plant, clock), law)[0]) for law in every]
    assert errors == sorted(errors)
    assert errors[1] < 0.05


def test_relay_oscillation_needs_the_filter(axis, plant, clock):
    ((frequency, speed),) = relay_oscillations(impedance_law(axis, 50.0, 100.0, 20.0), plant, clock)
    assert 3.0 < frequency < 10.0
    assert 5e-3 < speed < 3e-2
    assert relay_oscillations(impedance_law(axis, 50.0, 100.0, 1000.0), plant, clock) == [None]
    weaker = impedance_law(axis, 50.0, 100.0, 20.0, coulomb_factor=0.3)
    assert relay_oscillations(weaker, plant, clock) == [None]


def test_polynomials_are_the_continuous_limit_of_the_sampled_loop(axis, plant):
    fine = Clock(1e-6, 5e-4)
    omega = np.array([0.5, 5.0, 50.0, 500.0])
    for options in ({}, {"force_sensor": True}, {"stiffness": 80.0}):
        law = impedance_law(axis, 50.0, 100.0, 200.0, **options).with_errors(over(0.02))
        numerator, denominator = (side.astype(float) for side in admittance_polynomials(law, plant, 5e-4))
        s = 1j * omega
        exact = np.polynomial.polynomial.polyval(s, denominator) / np.polynomial.polynomial.polyval(s, numerator)
        found = 1.0 / sampled_loop(law, plant, fine).admittance(omega)
        np.testing.assert_allclose(found, exact, rtol=2e-2)


def test_active_bands_are_where_the_real_part_is_negative(axis, plant, clock):
    law = impedance_law(axis, 50.0, 100.0, 50.0)
    found = passivity(law, plant, clock)
    ((low, high),) = found.continuous_bands
    sides = admittance_polynomials(law, plant, clock.current_time_constant)
    numerator, denominator = (side.astype(float) for side in sides)

    def real_part(omega: float) -> float:
        s = 1j * omega
        return (np.polynomial.polynomial.polyval(s, numerator) / np.polynomial.polynomial.polyval(s, denominator)).real

    assert real_part(0.99 * low) > 0 > real_part(1.01 * low)
    assert real_part(0.99 * high) < 0 < real_part(1.01 * high)
    assert not found.continuous
    assert not found.sampled
    assert found.to_dict()["continuous"]["active_bands"] == [[low, high]]


def real_admittance(law, plant, lag, omega):
    """Re of velocity over external force at ``omega`` in 50 digits, from the equations of the law."""
    import mpmath

    with mpmath.workdps(50):
        s, r = mpmath.mpc(0, mpmath.mpf(omega)), mpmath.mpf(law.estimate.mass) / mpmath.mpf(law.mass)
        low_a, low_t = (1 / (1 + s / mpmath.mpf(w)) if math.isfinite(w) else mpmath.mpf(1) for w in law.filters)
        f_hat, damping = mpmath.mpf(law.estimate.viscous[0]), mpmath.mpf(law.damping)
        motion = (r - 1) * (mpmath.mpf(law.estimate.mass) * s * low_a + f_hat) + f_hat - r * damping
        motor = motion / (1 + mpmath.mpf(lag) * s + law.current_factor * (r - 1) * low_t)
        return mpmath.re(1 / (mpmath.mpf(plant.mass) * s + mpmath.mpf(plant.viscous[0]) - motor))


def test_the_active_band_of_a_lagged_current_loop_ends(axis, plant, clock):
    """It was said to be unbounded: the coefficient that ends it is 1e-15 of the largest, in rad/s."""
    law = impedance_law(axis, 50.0, 100.0)
    ((low, high),) = passivity(law, plant, clock).continuous_bands
    assert (round(low, 1), round(high)) == (37.4, 28399)
    for edge, side in ((low, 1), (high, -1)):
        before, after = (real_admittance(law, plant, 5e-4, edge * (1.0 + sign * 1e-12)) for sign in (-1, 1))
        assert side * before > 0 > side * after


@pytest.mark.parametrize("seed", [5, 6])
def test_active_bands_of_unlike_axes_in_fifty_digits(seed):
    """Edges to 1e-9, and nothing between them missed: masses over six powers of ten, with lag and filter or without."""
    random = np.random.default_rng(seed)
    for _ in range(30):
        mass, period = 10.0 ** random.uniform(-2, 4), 10.0 ** random.uniform(-4.3, -2)
        viscous = random.choice([0.0, 1.0]) * mass * 10.0 ** random.uniform(-1, 2)
        plant = FrictionModel(mass, viscous, viscous, 0.1 * mass, 0.1 * mass)
        law = ImpedanceLaw(
            mass * 10.0 ** random.uniform(-1, 0.5),
            mass * 10.0 ** random.uniform(-1.5, 1.5),
            plant,
            filter=random.choice([0.5 / period, math.inf]),
            current_filter=random.choice([None, 0.3 / period]),
            current_factor=random.choice([1.0, 2.0]),
        ).with_errors({"mass": random.choice([0.0, 0.02])})
        lag = random.choice([0.0, 1.0]) * period * 10.0 ** random.uniform(-1.5, 0.5)
        bands = passivity(law, plant, Clock(period, lag), points=50).continuous_bands
        edges = [edge for band in bands for edge in band if 0.0 < edge < math.inf]
        for edge in edges:
            before, after = (real_admittance(law, plant, lag, edge * (1.0 + sign * 1e-9)) for sign in (-1, 1))
            assert before * after < 0
        for omega in np.geomspace(1e-3, 1e8, 40):
            inside = any(low < omega < high for low, high in bands)
            assert (real_admittance(law, plant, lag, omega) < 0) == inside


def test_plant_alone_is_passive(axis, plant, clock):
    # M_a = M and B = F_v: the law compensates Coulomb friction and does nothing else.
    law = ImpedanceLaw(plant.mass, plant.viscous_positive, plant, filter=500.0)
    found = passivity(law, plant, clock)
    assert found.continuous
    assert found.sampled
    assert contact_map(law, plant, clock).stable.all()
    assert largest_wall(law, plant, clock) is None


def test_wall_limit_is_where_the_poles_cross(axis, plant, clock):
    law = impedance_law(axis, 50.0, 100.0)
    wall = largest_wall(law, plant, clock)
    assert sampled_loop(law, plant, clock, environment=Environment(stiffness=wall)).stable
    assert not sampled_loop(law, plant, clock, environment=Environment(stiffness=1.01 * wall)).stable
    grid = contact_map(law, plant, clock, np.array([0.0, 0.5 * wall, 2.0 * wall]), np.array([0.0, 1e4]))
    assert grid.stable[0].tolist() == [True, True, False]
    assert grid.to_dict()["stable_share"] == pytest.approx(grid.stable.mean())


def test_hand_of_some_mass_is_a_heavier_carriage_for_the_law(axis, plant, clock):
    # A hand's mass moves with the carriage: the law is that of an under-estimated mass.
    law = impedance_law(axis, 50.0, 100.0)
    held = sampled_loop(law, plant, clock, environment=Environment(mass=10.0, damping=20.0))
    heavier = FrictionModel(plant.mass + 10.0, *(x + 20.0 for x in plant.viscous), *plant.coulomb)
    np.testing.assert_allclose(held.poles, sampled_loop(law, heavier, clock).poles, rtol=1e-9, atol=1e-9)


def test_force_sensor_reads_the_whole_environment(axis, plant):
    # Measured force (28), fast sampling: the hand's own impedance adds to the apparent one.
    law = impedance_law(axis, 50.0, 100.0, force_sensor=True)
    loop = sampled_loop(law, plant, Clock(1e-5), environment=Environment(mass=3.0, damping=20.0, stiffness=400.0))
    slow = np.log(loop.poles[np.abs(loop.poles - 1.0) < 0.05][:2]) / 1e-5
    np.testing.assert_allclose(sorted(np.poly(slow)), sorted([1.0, 120.0 / 53.0, 400.0 / 53.0]), rtol=2e-3)


@pytest.mark.parametrize("mismatch", [-0.1, 1.0, 1.5, math.nan, math.inf])
def test_mismatch_that_turns_an_estimate_negative_is_refused(mismatch):
    with pytest.raises(InputError, match=r"mismatch: found .*, expected a number in \[0, 1\)"):
        check_mismatch(mismatch)
