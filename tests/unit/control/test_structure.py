"""IP, PI, and PI with a reference filter: closed forms against the derivation and python-control, and sampled."""

import json
import math

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from emps_design.cli.app import run
from emps_design.control.discretisation import sample_axis
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.control.velocity.gains import IP, PI, PI_WITH_REFERENCE_FILTER, STRUCTURES, Structure
from emps_design.control.velocity.limits import retune_velocity_loop
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.control.verdict import continuous_step, structures_side_by_side
from emps_design.errors import InputError, SpecificationError
from emps_design.laws import law_of
from emps_design.laws.library.cascade import Filter
from emps_design.machines import machine
from emps_design.paper import written as y
from emps_design.paper.loops import derive_pi_loop

AXIS = machine("emps2018")
CASCADE = {
    "kind": "cascade",
    "position": {"kp": 30.0, "every": 2},
    "velocity": {"kp": 300.0, "ti": 0.05},
    "feedforward": {"velocity": 1.0},
    "filters": [{"kind": "lowpass", "frequency": 250.0}],
}
NOTCH = Filter(kind="notch", frequency=90.0, damping=0.5, depth=0.2)


def test_numbers_equal_the_derived_symbols():
    by_title = {step.title: step.equation.rhs for step in derive_pi_loop()}
    design = design_velocity_loop(AXIS, crossover=130.0, phase_margin_deg=47.0, structure=PI)
    numbers = {
        y.M_1: AXIS.mechanics.mass, y.F_v1: AXIS.mechanics.viscous, y.G_tau: AXIS.drive.gain, y.omega_v: 130.0,
        y.phi_v: math.radians(47.0),
    }  # fmt: skip
    assert float(by_title["Gain, PI"].subs(numbers)) == pytest.approx(design.k_v1, rel=1e-12)
    assert float(by_title["Integral time, PI"].subs(numbers)) == pytest.approx(design.t_v, rel=1e-12)
    at = {**numbers, y.k_v1: design.k_v1, y.t_v: design.t_v, y.s: 77.0j}
    assert complex(by_title["Open loop at the velocity error, PI"].subs(at)) == pytest.approx(
        complex(design.velocity_error_loop()(77j))
    )
    assert complex(by_title["Closed loop, PI"].subs(at)) == pytest.approx(complex(design.closed_loop()(77j)))
    filtered = design_velocity_loop(AXIS, 130.0, phase_margin_deg=47.0, structure=PI_WITH_REFERENCE_FILTER)
    assert (filtered.k_v1, filtered.t_v) == (design.k_v1, design.t_v)
    assert complex(by_title["PI with a reference filter"].subs(at)) == pytest.approx(
        complex(filtered.closed_loop()(77j))
    )


@settings(max_examples=60, deadline=None)
@given(
    mass=st.floats(0.05, 2e4),
    friction=st.floats(0.0, 50.0),
    crossover=st.floats(1.0, 1e3),
    share=st.floats(0.02, 0.98),
    structure=st.sampled_from(STRUCTURES),
)
def test_gains_and_bandwidth_are_what_they_say(mass, friction, crossover, share, structure):
    viscous = friction * mass
    low, high = structure.feasible_phase_margin(mass, viscous, crossover)
    phase = float(low + share * (high - low))
    axis = AXIS.replace(mechanics={"mass": mass, "viscous": viscous})
    design = design_velocity_loop(axis, crossover=crossover, phase_margin_deg=phase, structure=structure)
    assert design.crossover == pytest.approx(crossover, rel=1e-6)
    assert design.phase_margin_deg == pytest.approx(phase, rel=1e-5)
    T_vc = design.closed_loop()
    assert abs(T_vc(1j * design.bandwidth)) == pytest.approx(10 ** (-3 / 20), rel=1e-6)
    again = design_velocity_loop(axis, bandwidth=design.bandwidth, phase_margin_deg=phase, structure=structure)
    assert again.bandwidth == pytest.approx(design.bandwidth, rel=1e-6)
    assert again.crossover <= crossover * (1.0 + 1e-6)  # of several with that bandwidth the slowest


@pytest.mark.parametrize("structure", STRUCTURES, ids=lambda one: one.label)
@pytest.mark.parametrize("phase", [40.0, 60.0, 80.0])
def test_overshoot_agrees_with_python_control(structure, phase):
    design = design_velocity_loop(AXIS, crossover=100.0, phase_margin_deg=phase, structure=structure)
    found = continuous_step(design)
    _, expected = control.step_response(design.closed_loop(), found.t)
    assert found.y == pytest.approx(expected, abs=1e-6)
    assert found.overshoot_percent == pytest.approx(max(0.0, 100.0 * (expected.max() - 1.0)), abs=1e-4)


def test_the_gains_of_one_structure_in_the_other():
    """30 Hz asked for of IP and put into a PI drive: half as fast again, and more than twice the overshoot."""
    ip, pi, filtered = structures_side_by_side(design_velocity_loop(AXIS, bandwidth=60 * math.pi))
    assert ip["bandwidth"] / (2 * math.pi) == pytest.approx(30.0)
    assert pi["bandwidth"] / (2 * math.pi) == pytest.approx(50.67, abs=0.005)
    assert (round(ip["overshoot_percent"], 1), round(pi["overshoot_percent"], 1)) == (8.8, 23.6)
    assert (filtered["bandwidth"], filtered["overshoot_percent"]) == (ip["bandwidth"], ip["overshoot_percent"])
    assert (filtered["crossover"], filtered["phase_margin_deg"]) == (pi["crossover"], pi["phase_margin_deg"])


def test_the_range_of_phase_margins_ends_where_the_gains_do():
    low, high = PI.feasible_phase_margin(AXIS.mechanics.mass, AXIS.mechanics.viscous, 100.0)
    for phase, limit in ((low, "lower"), (high, "upper")):
        with pytest.raises(SpecificationError, match=f"the {limit} limit binds") as caught:
            design_velocity_loop(AXIS, 100.0, phase_margin_deg=float(phase), structure=PI)
        nearest = {key: value for key, value in caught.value.nearest.items() if key != "or"}
        assert design_velocity_loop(AXIS, **nearest, structure=PI).sampled.stable
    assert design_velocity_loop(AXIS, 100.0, phase_margin_deg=91.0, structure=PI).t_v > 0.0
    with pytest.raises(InputError, match="structure: found 'pid', expected ip or pi"):
        Structure("pid")
    with pytest.raises(InputError, match="found one with structure 'ip'"):
        Structure("ip", True)


@pytest.mark.parametrize("structure", STRUCTURES, ids=lambda one: one.label)
@pytest.mark.parametrize("filters", [(), (NOTCH, Filter(kind="lowpass", frequency=200.0))], ids=["plain", "filtered"])
def test_the_sampled_response_is_the_closed_state_space(structure, filters):
    """The product of plant, filters and gains, against the law's own kernel closed around the plant."""
    loop = SampledVelocityLoop(sample_axis(AXIS, filters=filters), 250.0, 0.03, structure)
    w = np.array([5.0, 60.0, 300.0, 1500.0])
    z, T = np.exp(1j * w * loop.plant.period), loop.plant.period
    expected = loop.loop.response(w, "mean_velocity", "reference") / z * (0.5 + 0.5 / z)  # as the two-tap estimate
    if structure.reference_filter:
        expected = expected / (1.0 + loop.t_v / T * (1.0 - 1.0 / z))
    assert loop.closed_loop_response(w) == pytest.approx(expected, rel=1e-8)
    assert loop.loop.loop_gain(w) == pytest.approx(loop.plant_input_response(w), rel=1e-8)


def test_pi_with_a_reference_filter_answers_as_ip_does():
    plant = sample_axis(AXIS, filters=(NOTCH,))
    ip, filtered = (SampledVelocityLoop(plant, 250.0, 0.03, one) for one in (IP, PI_WITH_REFERENCE_FILTER))
    assert filtered.bandwidth == pytest.approx(ip.bandwidth, rel=1e-9)
    for one, other in zip(filtered.step_response(), ip.step_response(), strict=True):
        assert one == pytest.approx(other, abs=1e-9)


@pytest.mark.parametrize("structure", STRUCTURES, ids=lambda one: one.label)
@pytest.mark.parametrize("asked", [{"crossover": 60.0}, {"bandwidth": 40.0}])
def test_retuned_with_structure_and_filters(structure, asked):
    design = retune_velocity_loop(AXIS, **asked, phase_margin_deg=55.0, structure=structure, filters=(NOTCH,))
    assert design.sampled.stable
    assert design.sampled.margins.phase_margin_deg == pytest.approx(55.0, abs=1e-6)
    achieved = design.sampled.margins.crossover if "crossover" in asked else design.sampled.bandwidth
    assert achieved == pytest.approx(next(iter(asked.values())), rel=1e-6)
    closed = design.axis.replace(controller=design.controller_table())
    assert closed.controller.kind == "cascade"
    assert law_of(closed, 1e-3).follows == "velocity"


def test_a_cascade_is_designed_as_it_is_and_kept_around_the_loop():
    axis = AXIS.replace(controller=CASCADE)
    design = design_velocity_loop(axis, bandwidth=100.0)
    assert design.structure == PI
    assert [one.frequency for one in design.filters] == [250.0]
    kept = axis.replace(controller=design.controller_table()).controller
    assert (kept.position, kept.feedforward) == (axis.controller.position, axis.controller.feedforward)
    assert kept.velocity == {"kp": design.k_v1, "ti": design.t_v, "form": "pi"}
    plain = design_velocity_loop(axis, bandwidth=100.0, structure=IP, filters=())
    assert plain.loop_axis.controller.kind == "ip_velocity"
    kept = axis.replace(controller=plain.controller_table()).controller
    assert (kept.kind, kept.velocity["form"], kept.filters) == ("cascade", "ip", ())


def document(capsys, line, status=0):
    assert run([*line.split(), "--json"]) == status
    return json.loads(capsys.readouterr().out)


def test_the_command_says_structure_filters_and_the_names_of_the_drive(capsys, tmp_path):
    found = document(capsys, "gains --bandwidth 30Hz --structure pi")
    assert (found["structure"], found["reference_filter"], found["filters"]) == ("pi", False, [])
    assert found["bandwidth"] == pytest.approx(60 * math.pi)
    assert found["drive_names"]["kp"] == {"value": found["k_v1"], "unit": "V/(m/s)"}
    assert found["drive_names"]["Tn"] == {"value": 1e3 * found["t_v"], "unit": "ms"}
    (tmp_path / "axis.toml").write_text(AXIS.replace(controller=CASCADE).to_toml())
    own = document(capsys, f"gains {tmp_path}/axis.toml --bandwidth 10Hz")
    assert (own["structure"], len(own["filters"])) == ("pi", 1)
    without = document(capsys, f"gains {tmp_path}/axis.toml --bandwidth 10Hz --filter none --structure ip")
    assert (without["structure"], without["filters"]) == ("ip", [])
    line = "gains --bandwidth 10Hz --structure pi --filter lowpass:90Hz --filter notch:48Hz:0.3:0.05"
    assert [one["kind"] for one in document(capsys, line)["filters"]] == ["lowpass", "notch"]
    assert run(line.split()) == 0
    assert "PI with lowpass 90 Hz, notch 48 Hz (damping 0.3, depth 0.05), is stable" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--structure pid", "structure: found 'pid', expected ip or pi"),
        ("--filter highpass:3Hz", "--filter: found 'highpass:3Hz', expected lowpass:350Hz"),
        ("--filter notch:48Hz:0.3", "--filter: found 'notch:48Hz:0.3'"),
        ("--filter lowpass:-3Hz", "--filter"),
        ("--filter notch:48Hz:0.3:2", "depth: found 2.0"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(options, message, capsys):
    assert run(["gains", "--crossover", "50", *options.split()]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert message in err
