"""A law's linear form is its kernel: on signals, on symbols, in closed form; and a user's law is judged like ours."""

import json
from dataclasses import replace

import numpy as np
import pytest

import emps_design.laws as laws
from emps_design.axis import Axis
from emps_design.cli import app
from emps_design.control.discretisation import sample_axis
from emps_design.control.impedance.law import ImpedanceLaw, law_for
from emps_design.control.sampled import axis_loop, close
from emps_design.control.velocity.sampled import velocity_law
from emps_design.errors import AxisError
from emps_design.laws import LAWS, Law, law_of
from emps_design.laws.law import FrictionModel
from emps_design.laws.library import impedance as impedance_file
from emps_design.laws.linear import Linear, LinearLaw, linear_law, own_poles, run_linear
from emps_design.machines import machine
from tests.contract.test_laws import ESTIMATED, GIVEN, OWN, OWN_TABLE, axis_with

EVERY = pytest.mark.parametrize("kind", LAWS, ids=lambda kind: kind.name)
T = 1e-3


def followed(law: Law, q: np.ndarray, reference: np.ndarray, f_ext: np.ndarray) -> np.ndarray:
    memory = np.zeros(law.memory)
    signals = zip(reference, q, f_ext, strict=True)
    return np.array([law.kernel(k, r, x, f, np.inf, law.gains, memory) for k, (r, x, f) in enumerate(signals)])


@EVERY
@pytest.mark.parametrize("estimator", ["two_tap", "backward", *ESTIMATED.values()])
@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("delay", [0, 2])
def test_kernel_and_linear_form_are_one_law(kind, estimator, direction, delay):
    """Two slides that differ by random signals: the kernel's voltages differ by what the linear form makes of them."""
    axis = axis_with(kind, "emps2018-two-quadrant", velocity_estimator=estimator)
    law = law_of(axis.replace(sampling={"computation_delay": delay}), T)
    rng = np.random.default_rng(7)
    n = 80
    slide = direction * 0.2 * T * np.arange(n)
    more = np.array([slide, slide + 0.05, np.zeros(n)])
    away = np.array([3e-5 * rng.uniform(-1, 1, n), 3e-5 * rng.uniform(-1, 1, n), 5.0 * rng.normal(size=n)])
    away[:, 0] = 0.0  # both start from the same rest
    plain, moved = (followed(law, x[1], x[0], x[2]) for x in (more, more + away))
    form, memory, found = linear_law(law, T, direction), np.zeros(law.memory), np.zeros(n)
    samples = [[getattr(form, name)] if form.cycle == 1 else getattr(form, name) for name in "ABCD"]
    for k in range(n):
        A, B, C, D = (matrices[k % form.cycle] for matrices in samples)
        found[k] = C @ memory + D @ away[:, k]
        memory = A @ memory + B @ away[:, k]
    np.testing.assert_allclose(moved - plain, found, rtol=1e-7, atol=1e-6 * np.abs(found).max())


def test_symbols_through_the_kernel_are_the_derived_law():
    """(28) and (29) by SymPy, (30) derived, come out of the kernel that runs in the drive, gain by gain."""
    import sympy as sp

    from emps_design.paper import written as d
    from emps_design.paper.loops import derived_law

    i, T_s, tau = impedance_file, sp.Symbol("T", positive=True), sp.Symbol("tau", real=True)
    law = ImpedanceLaw(50.0, 100.0, FrictionModel(115.0, 470.0, 470.0, 17.0, 17.0), stiffness=30.0)
    values = law_for(machine("emps2018"), law, T).gains.tolist()
    gains = [Linear(value, value) for value in values]
    for place, symbol in {
        i.RATIO: d.M_h / d.M_a, i.MASS: d.M_h, i.DAMPING: d.B, i.STIFFNESS: d.K, i.VISCOUS_POSITIVE: d.F_vh,
        i.COULOMB_POSITIVE: d.F_ch, i.FORCE_GAIN: d.G_ti, i.RATE: 1 / T_s,
    }.items():  # fmt: skip
        gains[place] = Linear(values[place], symbol)
    u, _ = run_linear(i.law_with(gains, 0), T)
    cells = sp.symbols("m0:6", real=True)
    by_name = {**dict(enumerate(cells)), "q": d.q, "reference": d.q_0, "f_ext": sp.Symbol("f")}
    found = d.G_ti * (u.constant + sum(slope * by_name[name] for name, slope in u.slopes.items()))
    v = (d.q - cells[1]) / (2 * T_s)
    a = (d.q - cells[0] - cells[1] + cells[2]) / (2 * T_s**2)
    expected = derived_law()["30"].expression.subs(d.current, tau / d.G_ti) - d.M_h / d.M_a * d.K * (d.q - d.q_0)
    # No filter here: the acceleration is the one computed now, the motor force that of the drive's model.
    expected = expected.subs({d.qdd: a, d.qd: v, d.S: 1, tau: cells[i.MOTOR]})
    assert sp.simplify(sp.nsimplify(sp.expand(found - expected))) == 0


def test_the_pure_algebra_is_the_derived_law():
    from emps_design.paper import written as d
    from emps_design.paper.loops import derived_law

    i = impedance_file
    observed = i.observed_force(d.M_h, d.F_vh, d.F_ch * d.S, 1, d.qdd, d.qd, d.G_ti * d.current)
    assert (observed - derived_law()["29"].expression).expand() == 0
    believed = (d.F_vh, d.F_ch * d.S, d.qd)
    still = i.demanded_force(d.M_h / d.M_a, d.B, 0, *believed, 0, d.tau_e, 0, 0)
    assert (still - derived_law()["28"].expression).expand() == 0
    sensorless = i.demanded_force(d.M_h / d.M_a, d.B, 0, *believed, 0, observed, 0, 0)
    assert (sensorless - derived_law()["30"].expression).expand() == 0
    moving = i.demanded_force(d.M_h / d.M_a, d.B, d.K, *believed, d.q - d.q_0, d.tau_e, d.qd_0, 0)
    assert (moving - derived_law()["27"].expression).expand() == 0


@pytest.mark.parametrize("estimator", ["two_tap", "backward"])
def test_velocity_law_is_the_block_diagram(estimator):
    """Fig. 4 in z: u = k_v1 (T z/(z-1)/t_v (r + k_e1 f - v) - v), v the estimate."""
    axis = machine("emps2018").replace(controller={"velocity_estimator": estimator})
    form = velocity_law(sample_axis(axis), 400.0, 0.02, k_e1=0.002)
    z = np.exp(1j * np.array([3.0, 50.0, 700.0]) * T)
    memory = np.linalg.solve(z[:, None, None] * np.eye(3) - form.A, np.broadcast_to(form.B, (3, 3, 3)))
    by_reference, by_q, by_force = np.moveaxis(form.C @ memory + form.D, -1, 0)
    integrator = T * z / (z - 1) / 0.02
    v = (1 - z**-2) / (2 * T) if estimator == "two_tap" else (1 - 1 / z) / T
    np.testing.assert_allclose(by_reference, 400.0 * integrator, rtol=1e-9)
    np.testing.assert_allclose(by_q, -400.0 * (1 + integrator) * v, rtol=1e-8)
    np.testing.assert_allclose(by_force, 0.002 * by_reference, rtol=1e-12)


@pytest.mark.parametrize("lag", [0.0, 5e-4])
@pytest.mark.parametrize("delay", [0, 2])
def test_the_laws_model_of_its_current_is_the_plants_own(lag, delay):
    """Left in the state, the model adds poles at exp(-T/T_c) and at 0, and nothing else; the answers are the same."""
    axis = axis_with(LAWS[2]).replace(
        drive={"current_time_constant": lag}, sampling={"computation_delay": delay, "encoder_resolution": 0.0}
    )
    law = linear_law(law_of(axis, T), T)
    lean, whole = (close(sample_axis(axis), law, plant_input=both) for both in (False, True))
    extra = list(whole.poles)
    for pole in lean.poles[np.abs(lean.poles) > 1e-2]:
        place = int(np.argmin(np.abs(np.array(extra) - pole)))
        assert abs(extra.pop(place) - pole) < 1e-9
    modelled = np.exp(-T / lag) if lag else 0.0
    assert all(abs(pole) < 1e-2 or abs(pole - modelled) < 1e-9 for pole in extra)
    assert sum(abs(pole) > 1e-2 for pole in extra) == (1 if lag else 0)
    w = np.array([1.0, 40.0, 800.0])
    np.testing.assert_allclose(lean.response(w), whole.response(w), rtol=1e-9)


@pytest.mark.parametrize("form", ["ip", "pi"])
@pytest.mark.parametrize("ti", [0.01, None])
def test_a_cell_that_nothing_drives_puts_no_pole_into_the_loop(form, ti):
    """The cascade's position loop is not there, and neither is the integral where it has none."""
    velocity = {"kp": 500.0, "form": form, **({"ti": ti} if ti else {})}
    table = {"kind": "cascade", "velocity": velocity, "velocity_estimator": "backward"}
    axis = machine("emps2018").replace(controller=table)
    poles = axis_loop(axis).poles
    assert abs(poles[0]) < 1.0 - 1e-3
    if form == "ip" and ti:
        own = {"kind": "ip_velocity", "k_v1": 500.0, "t_v": ti, "velocity_estimator": "backward"}
        np.testing.assert_allclose(poles, axis_loop(axis.replace(controller=own)).poles, atol=1e-9)


def test_a_cell_that_remembers_where_the_carriage_started_stays_in_the_loop():
    """u = 2e3 (q_0 - q) with q_0 from the first sample: no input reaches the cell, and it is a spring all the same."""
    none, first = np.zeros((1, 3)), np.array([0.0, -2e3, 0.0])
    law = LinearLaw(np.eye(1), none, np.array([2e3]), first, np.array([1.0]))
    assert law.used().tolist() == [False]
    assert law.used(moved=True).tolist() == [True]
    plant = sample_axis(machine("emps2018"))
    spring = LinearLaw(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros(0), first, np.zeros(0))
    np.testing.assert_allclose(close(plant, law).poles, close(plant, spring).poles, atol=1e-7)


def test_what_a_law_hears_of_its_own_voltage():
    law = ImpedanceLaw(50.0, 100.0, FrictionModel(115.0, 470.0, 470.0, 17.0, 17.0))
    ideal = machine("emps2018").replace(drive={"current_time_constant": 0.0})
    found = law_for(ideal, law, T)
    poles = own_poles(found, T)
    assert poles == pytest.approx([-(115.0 / 50.0 - 1.0)])
    proportional = law_of(axis_with(LAWS[0]), T)
    assert own_poles(proportional, T).size == 0


def test_a_product_of_signals_is_refused():
    def wrong(k, reference, q, f_ext, limit, gains, memory):
        return gains[0] * q * reference

    with pytest.raises(AxisError, match="law: found a product of two signals"):
        linear_law(Law(wrong, np.array([1.0]), 0), T)

    def worse(k, reference, q, f_ext, limit, gains, memory):
        return gains[0] / (q + 1.0)

    with pytest.raises(AxisError, match="law: found a division by a signal"):
        linear_law(Law(worse, np.array([1.0]), 0), T)


GENTLE = OWN.replace(
    "e = reference - q\n    return gains[0] * e + gains[1] * e * e * e - gains[2] * v",
    "e = reference - q\n    if gains[1] > 0.0 and (e > 2e-3 or e < -2e-3):\n        e = 1.5 * e\n"
    "    return gains[0] * e - gains[2] * v",
)


@pytest.fixture
def own_axis(tmp_path):
    """An axis file with a user's own law, harder beyond 2 mm of error, and a record that it made."""
    from emps_design.simulation import Plant
    from emps_design.simulation.synthetic import trapezoid_laps

    (tmp_path / "hardening.py").write_text(GENTLE, encoding="utf-8")
    laws.load_file(tmp_path / "hardening.py")
    axis = Axis.from_dict({**machine("emps2019").to_dict(), "controller": OWN_TABLE})
    (tmp_path / "axis.toml").write_text(axis.to_toml(), encoding="utf-8")
    rng = np.random.default_rng(11)
    q_ref = trapezoid_laps(T, laps=2)
    noise = 0.02 * rng.standard_normal(q_ref.size)
    record = Plant.of(axis).closed_loop(q_ref, voltage_noise=noise).record("made")
    np.savez(tmp_path / "made.npz", t=record.t, q_ref=record.q_ref, q=record.q, u=record.u)
    yield axis, tmp_path
    laws.REGISTRY.added.clear()


def document(capsys, *arguments):
    assert app.run([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_users_law_has_poles_that_the_simulation_confirms(own_axis):
    from emps_design.errors import SimulationError
    from emps_design.simulation import Plant

    axis, _ = own_axis
    smooth = axis.replace(
        mechanics={"coulomb": 0.0}, drive={"command_limit": 1e9}, sampling={"encoder_resolution": 0.0}
    )
    kick = np.where(np.arange(400) < 5, 1.0, 0.0)
    stable = {}
    for kv in (243.0, 2000.0, 3500.0, 6000.0):
        tried = smooth.replace(controller={"kv": kv})
        try:
            v = Plant.of(tried).closed_loop(np.zeros(400), disturbance=kick).v
            calm = np.abs(v[-50:]).max() < np.abs(v[:60]).max()
        except SimulationError:
            calm = False
        stable[kv] = (axis_loop(tried).stable, calm)
    assert all(poles == simulated for poles, simulated in stable.values())
    assert len(set(stable.values())) == 2


def test_a_users_law_in_replay_and_output_error(own_axis, capsys):
    axis, folder = own_axis
    found = document(capsys, "simulate", folder / "axis.toml", "--scenario", "replay", "--record", folder / "made.npz")
    assert found["relative_error_percent"]["position"] < 0.5
    found = document(capsys, "identify", folder / "made.npz", "--axis", folder / "axis.toml", "--estimator", "oe")[
        "parameters"
    ]
    for name in ("mass", "viscous", "coulomb"):
        true = getattr(axis.mechanics, name)
        assert found[name]["value"] == pytest.approx(true, abs=4 * found[name]["std"] + 0.01 * true)


def test_a_users_law_in_diagnose(own_axis, capsys):
    _, folder = own_axis
    found = document(capsys, "diagnose", folder / "made.npz", "--axis", folder / "axis.toml")
    assert found["verdict"] == "nothing-missing"


def test_given_examples_are_those_of_the_laws():
    assert set(GIVEN) == {kind.name for kind in LAWS}


def test_a_long_cycle_is_gone_through_once():
    """A position loop in every thousandth sample: as many runs of the kernel as samples, not as their square."""
    table = {"kind": "cascade", "position": {"kp": 1.0, "every": 1000}, "velocity": {"kp": 300.0, "ti": 0.05}}
    law, runs = law_of(machine("emps2018").replace(controller=table), T), []

    def counted(k, *more):
        runs.append(k)
        return law.kernel(k, *more)

    form = linear_law(replace(law, kernel=counted), T)
    assert form.A.shape[0] == 1000
    assert len(runs) <= 4 * 1000
