"""Retuning, sweeps, mismatch and what an engineer asks next."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from emps_design.axis import Axis
from emps_design.control.discretisation import sample_axis
from emps_design.control.linear_plant import ActuatorMap
from emps_design.control.velocity.design import design_velocity_loop, encoder_voltage_noise, largest_velocity_step
from emps_design.control.velocity.gains import sweep_velocity_loop
from emps_design.control.velocity.limits import retune_velocity_loop
from emps_design.control.velocity.load_range import identified_mismatch, margins_under_mismatch, relative_mismatch
from emps_design.control.velocity.sampled import SampledVelocityLoop, sweep_sampled_margins, sweep_stability
from emps_design.errors import InputError, SpecificationError
from emps_design.machines import machine

AXIS = machine("emps2018")


@pytest.mark.parametrize("at", ["plant-input", "velocity-error"])
@pytest.mark.parametrize("axis", [AXIS, AXIS.replace(sampling={"computation_delay": 2})], ids=["", "late"])
def test_retuned_loop_meets_the_specification(axis, at):
    design = retune_velocity_loop(axis, crossover=100.0, phase_margin_deg=50.0, at=at)
    loop = design.sampled
    margins = loop.margins if at == "plant-input" else loop.velocity_error
    assert loop.stable
    assert margins.crossover == pytest.approx(100.0, rel=1e-9)
    assert margins.phase_margin_deg == pytest.approx(50.0, abs=1e-6)


def test_retuned_bandwidth():
    design = retune_velocity_loop(AXIS, bandwidth=160.0, phase_margin_deg=60.0, at="velocity-error")
    assert design.sampled.bandwidth == pytest.approx(160.0, rel=1e-6)
    assert design.sampled.velocity_error.phase_margin_deg == pytest.approx(60.0, abs=1e-6)
    with pytest.raises(SpecificationError, match=r"the largest bandwidth is 55\.\d+ rad/s") as caught:
        retune_velocity_loop(AXIS, bandwidth=160.0, phase_margin_deg=60.0)
    nearest = dict(caught.value.nearest)
    for pair in (nearest.pop("or"), nearest):
        found = retune_velocity_loop(AXIS, **pair).sampled
        assert found.bandwidth == pytest.approx(pair["bandwidth"], rel=1e-6)
        assert found.margins.phase_margin_deg == pytest.approx(pair["phase_margin_deg"], abs=1e-6)


@pytest.mark.parametrize(
    ("crossover", "phase", "reason"),
    [
        (400.0, 60.0, "the upper limit binds"),
        (100.0, 88.0, "the upper limit binds"),
        (4000.0, 30.0, "above the Nyquist frequency"),
        (100.0, -5.0, "between 0 and 180 deg"),
    ],
)
def test_what_no_gains_can_do(crossover, phase, reason):
    with pytest.raises(SpecificationError, match=reason) as caught:
        retune_velocity_loop(AXIS, crossover=crossover, phase_margin_deg=phase)
    nearest = dict(caught.value.nearest)
    nearest.pop("or", None)
    found = retune_velocity_loop(AXIS, **nearest)
    assert found.sampled.margins.phase_margin_deg == pytest.approx(nearest["phase_margin_deg"], abs=1e-6)


@pytest.mark.parametrize(
    ("at", "crossover", "reason"),
    [
        ("plant-input", 60.0, "crosses 0 dB more than once"),
        ("velocity-error", 400.0, "the gains would not be positive"),
    ],
)
def test_nearest_pair_of_a_retune_works(at, crossover, reason):
    axis = AXIS
    if at == "plant-input":  # a resonance that crosses 0 dB again
        coupling = {"kind": "flexible_coupling", "frequency": 40.0, "damping": 0.02, "share": 0.7}
        axis = AXIS.replace(effects=[coupling])
    with pytest.raises(SpecificationError, match=reason) as caught:
        retune_velocity_loop(axis, crossover=crossover, phase_margin_deg=75.0, at=at)
    nearest = dict(caught.value.nearest)
    for pair in (nearest.pop("or", nearest), nearest):
        assert retune_velocity_loop(axis, **pair, at=at).sampled.stable


def test_place_of_the_margin():
    with pytest.raises(InputError, match="place of the margin: found 'elsewhere'"):
        retune_velocity_loop(AXIS, crossover=100.0, at="elsewhere")


def test_sweep_equals_scalar_designs():
    rng = np.random.default_rng(3)
    w, phase = rng.uniform(20.0, 300.0, 40), rng.uniform(1.0, 89.0, 40)
    sweep = sweep_velocity_loop(AXIS, w, phase)
    found = sweep_sampled_margins(sample_axis(AXIS), sweep.k_v1, sweep.t_v)
    for place in range(40):
        try:
            design = design_velocity_loop(AXIS, crossover=w[place], phase_margin_deg=phase[place])
        except SpecificationError:
            assert not sweep.feasible[place]
            assert np.isnan(sweep.k_v1[place])
            assert not found["stable"][place]
            continue
        assert sweep.feasible[place]
        for name in ("k_v1", "t_v", "K_v", "omega_0v", "z_v", "bandwidth"):
            assert getattr(sweep, name)[place] == pytest.approx(getattr(design, name), rel=1e-9)
        at_input = design.plant_input
        assert sweep.plant_input_phase_margin_deg[place] == pytest.approx(at_input.phase_margin_deg, rel=1e-9)
        assert sweep.plant_input_crossover[place] == pytest.approx(at_input.crossover, rel=1e-9)
        assert sweep.delay_margin[place] == pytest.approx(at_input.delay_margin, rel=1e-9)
        margins = design.sampled.margins
        assert found["stable"][place] == margins.stable
        for name in ("phase_margin_deg", "crossover", "delay_margin", "gain_margin"):
            expected = getattr(margins, name)
            assert found[name][place] == pytest.approx(
                math.nan if expected is None else expected, rel=1e-7, nan_ok=True
            )


def test_sweep_keeps_the_shape_and_refuses_nonsense():
    sweep = sweep_velocity_loop(AXIS, np.array([[50.0], [100.0]]), np.array([40.0, 50.0, 60.0]))
    assert sweep.k_v1.shape == (2, 3)
    assert sweep_sampled_margins(sample_axis(AXIS), sweep.k_v1, sweep.t_v)["gain_margin"].shape == (2, 3)
    with pytest.raises(InputError, match="not a positive number"):
        sweep_velocity_loop(AXIS, np.array([1.0, -1.0]), 60.0)


@settings(max_examples=30, deadline=None)
@given(
    k_v1=st.floats(1.0, 5000.0),
    t_v=st.floats(1e-3, 1.0),
    delay=st.integers(0, 6),
    kind=st.sampled_from([None, "flexible_coupling", "actuator_delay"]),
)
def test_polynomial_test_agrees_with_the_poles(k_v1, t_v, delay, kind):
    effects = {
        None: [],
        "flexible_coupling": [{"kind": "flexible_coupling", "frequency": 40.0, "damping": 0.05, "share": 0.4}],
        "actuator_delay": [{"kind": "actuator_delay", "delay": 0.7e-3}],
    }[kind]
    plant = sample_axis(AXIS.replace(sampling={"computation_delay": delay}, effects=effects))
    loop = SampledVelocityLoop(plant, k_v1, t_v)
    if abs(np.abs(loop.poles[0]) - 1.0) > 1e-7:
        assert sweep_stability(plant, np.array([k_v1]), np.array([t_v]))[0] == loop.stable


def test_mismatch_brackets_the_design():
    design = design_velocity_loop(AXIS, crossover=100.0, phase_margin_deg=60.0)
    study = margins_under_mismatch(design, relative_mismatch(0.02))
    assert study["corners"] == 8
    assert study["stable_share"] == 1.0
    nominal = design.sampled.margins
    for name in ("phase_margin_deg", "crossover", "delay_margin", "gain_margin"):
        assert study[name][0] < getattr(nominal, name) + 1e-9 < study[name][1] + 0.1
    low, high = study["gains"]["k_v1"]
    assert low < design.k_v1 < high
    # (7) is linear in the mass: the highest gain is that of the heaviest carriage with the weakest drive
    heavy = AXIS.replace(mechanics={"mass": 1.02 * 115.7315, "viscous": 0.98 * 474.9727}, drive={"force_gain": 34.447})
    assert high == pytest.approx(design_velocity_loop(heavy, crossover=100.0, phase_margin_deg=60.0).k_v1, rel=1e-4)


def test_mismatch_finds_the_corner_that_breaks():
    late = AXIS.replace(sampling={"computation_delay": 1})
    design = design_velocity_loop(late, crossover=100.0, phase_margin_deg=77.5)
    study = margins_under_mismatch(design, relative_mismatch(0.2))
    assert 0.0 < study["stable_share"] < 1.0
    assert not study["worst"]["stable"]
    assert study["worst"]["parameters"]["mass"] == -0.2
    assert study["worst"]["parameters"]["force_gain"] == 0.2


def test_mismatch_from_an_identification():
    parameters = {
        "mass": {"value": 115.7, "std": 0.2882},
        "viscous_positive": {"value": 474.97, "std": 8.7843},
        "viscous_negative": {"value": 563.9, "std": 9.6544},
    }
    found = identified_mismatch(AXIS, parameters)
    assert found["mass"] == pytest.approx(2 * 0.2882 / 115.7315)
    assert found["viscous"] == pytest.approx(2 * 9.6544 / 474.9727)
    with pytest.raises(InputError, match="viscous has no std"):
        identified_mismatch(AXIS, {"mass": {"value": 1.0, "std": 0.1}})
    with pytest.raises(InputError, match=r"the interval of mass is \+-1\.73 of its value"):
        identified_mismatch(AXIS, {"mass": {"value": 1.0, "std": 100.0}, "viscous": {"value": 1.0, "std": 1.0}})
    with pytest.raises(InputError, match="mismatch: found 1"):
        relative_mismatch(1.0)


def test_the_largest_step_reaches_the_limit():
    """Step the law of the difference equation with that reference: the voltage peaks at the limit less friction's."""
    design = design_velocity_loop(AXIS, crossover=100.0, phase_margin_deg=60.0)
    found = largest_velocity_step(AXIS, design.sampled)
    _, _, voltage = design.sampled.step_response(2000)
    assert found["value"] * np.max(voltage) + found["dry_friction_voltage"] == pytest.approx(10.0)


def test_the_largest_step_is_that_of_the_worse_direction(monkeypatch):
    """An amplifier that passes half of a negative command: friction takes twice the voltage that way."""
    design = design_velocity_loop(AXIS, crossover=100.0, phase_margin_deg=60.0)
    alike = largest_velocity_step(AXIS, design.sampled)
    halves = ActuatorMap(AXIS.drive.command_limit, (lambda u: u if u > 0.0 else 0.5 * u,))
    monkeypatch.setattr(ActuatorMap, "of", classmethod(lambda cls, axis: halves))
    found = largest_velocity_step(AXIS, design.sampled)
    less = found["dry_friction_voltage"] / found["peak_voltage_per_unit"]
    assert found["value"] == pytest.approx(alike["value"] - less)


def test_encoder_noise_against_a_run():
    design = design_velocity_loop(AXIS, crossover=100.0, phase_margin_deg=60.0)
    resolution, T, plant = 5e-8, 1e-3, design.sampled.plant
    noise = np.random.default_rng(4).uniform(-0.5, 0.5, 40_000) * resolution
    x, q1, q2, integral = np.zeros(3), 0.0, 0.0, 0.0
    voltage = np.empty(noise.size)
    for k, error in enumerate(noise):
        q = plant.C @ x + error
        v = (q - q2) / (2 * T)
        integral -= T / design.t_v * v
        voltage[k] = design.k_v1 * (integral - v)
        x = plant.Phi @ x + plant.G0 * voltage[k]
        q1, q2 = q, q1
    found = encoder_voltage_noise(AXIS, design.sampled)
    assert found["rms"] == pytest.approx(np.std(voltage[200:]), rel=0.02)
    assert found["one_step"] == pytest.approx(design.k_v1 * (1 + T / design.t_v) * resolution / (2 * T))


def test_a_bandwidth_that_only_falls_with_the_crossover_is_met():
    """Braking makes the loop fast at any positive gain: the only gains for 1.4 rad/s have little integral action."""
    axis = Axis.from_dict(
        {
            "name": "wheel",
            "motion": "rotary",
            "mechanics": {"mass": 0.104, "viscous": 0.079, "coulomb": 0.006},
            "drive": {"command": "duty", "force_gain": 0.0232, "supply": 24.0, "back_emf": 6.84},
            "sampling": {"period": 1e-2},
            "controller": {"kind": "none", "velocity_estimator": "backward"},
        }
    )
    design = retune_velocity_loop(axis, bandwidth=1.42, phase_margin_deg=60.0, filters=["notch:9.62Hz:0.5:0.1"])
    margins = design.sampled.margins
    assert design.sampled.bandwidth == pytest.approx(1.42, rel=1e-6)
    assert margins.phase_margin_deg == pytest.approx(60.0)
    assert margins.gain_margin > 10.0
