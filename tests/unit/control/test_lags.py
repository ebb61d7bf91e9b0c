"""The continuous loop with every lag of the axis, and what the closed forms say that they leave out."""

import json
import math

import pytest

from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.control.discretisation import sample_axis
from emps_design.control.linear_plant import linear_plant
from emps_design.control.velocity.design import VelocityLoopDesign, design_velocity_loop
from emps_design.control.velocity.gains import IP, PI
from emps_design.control.velocity.limits import faster_in_words, reach, retune_velocity_loop
from emps_design.control.velocity.sampled import LaggedVelocityLoop, left_out
from emps_design.control.velocity.specification import carriage_in_words
from emps_design.laws.library.cascade import Filter
from emps_design.machines import machine

# From a public question: with k_v1 = 1 and t_v = 0.5 s the loop with its lag has 32.61 deg at 0.7494 rad/s, and with
# G(s) = 2/(s (s + 1) (s + 2)) behind that a gain margin of 3.
LAGGED = Axis.from_dict(
    {
        "name": "n1",
        "motion": "rotary",
        "mechanics": {"mass": 2.618033988749895, "viscous": 1.0, "coulomb": 0.0},
        "drive": {"force_gain": 1.0, "command_limit": 10.0, "current_time_constant": 0.3819660112501051},
        "sampling": {"period": 0.05, "encoder_resolution": 1e-6},
    }
)
COUPLING = {"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}
BENT = machine("emps2018").replace(effects=[COUPLING])


def document(capsys, line, status=0):
    assert run([*line.split(), "--json"]) == status
    return json.loads(capsys.readouterr().out)


def test_a_current_lag_is_in_the_loop_of_a_published_question():
    found = LaggedVelocityLoop.of(LAGGED, 0.1, 1.0, 0.5, IP, ()).velocity_error
    assert found.crossover == pytest.approx(0.7494, abs=5e-5)
    assert found.phase_margin_deg == pytest.approx(32.61, abs=5e-3)
    assert found.gain_margin == pytest.approx(3.0)


def test_the_command_says_what_its_rows_leave_out(capsys, tmp_path):
    path = tmp_path / "axis.toml"
    path.write_text(LAGGED.to_toml())
    line = f"gains {path} --crossover 0.7494 --phase-margin 32.61"
    said = document(capsys, line)
    assert said["phase_margin_deg"] == pytest.approx(32.61)  # of the closed form, as before
    assert said["closed_forms_leave_out"] == ["the sampling", "the current loop (382 ms)"]
    lagged = said["continuous_with_lags"]
    assert (round(lagged["phase_margin_deg"], 1), round(lagged["gain_margin"], 2)) == (17.4, 2.16)
    assert {"crossover", "delay_margin"} <= lagged.keys()
    (note,) = [one for one in said["warnings"] if "gain margin is unbounded" in one]
    assert "with all lags it has 17.4 deg of phase margin and a gain margin of 2.16" in note
    assert run(line.split()) == 0
    rows = capsys.readouterr().out.splitlines()
    first, second, third = (next(k for k, row in enumerate(rows) if f"phase margin of T_vo, {words}" in row)
                            for words in ("sampled", "with lags", "ideal"))  # fmt: skip
    assert first < second < third
    assert "ideal: without the sampling, the current loop (382 ms)" in rows


@pytest.mark.parametrize("structure", [IP, PI])
@pytest.mark.parametrize(
    ("effects", "filters"),
    [
        ([], (Filter(kind="lowpass", frequency=90.0),)),
        ([{"kind": "actuator_delay", "delay": 2.5e-3}], ()),
        ([COUPLING, {"kind": "actuator_lag", "time_constant": 1e-3}], ()),
        ([], (Filter(kind="notch", frequency=60.0, damping=0.4, depth=0.2),)),
    ],
)
def test_it_is_the_sampled_loop_of_a_fast_clock(structure, effects, filters):
    """But for the half period of the hold and that of the backward difference."""
    axis = machine("emps2018").replace(effects=effects, controller={"kind": "none", "velocity_estimator": "backward"})
    gains = design_velocity_loop(axis, crossover=40.0, structure=structure, filters=filters)
    fast = axis.replace(sampling={"period": 1e-4})
    sampled = VelocityLoopDesign(fast, gains.k_v1, gains.t_v, {}, structure=structure, filters=filters).sampled
    for found, true in (
        (gains.with_lags.velocity_error, sampled.velocity_error),
        (gains.with_lags.plant_input, sampled.margins),
    ):
        assert found.stable
        sampling = math.degrees(true.crossover * 1e-4) if true is sampled.margins or structure == PI else 0.0
        assert found.phase_margin_deg - sampling == pytest.approx(true.phase_margin_deg, abs=0.35)
        assert found.crossover == pytest.approx(true.crossover, rel=5e-3)
        if found.gain_margin is not None and found.gain_margin < 10.0:  # beyond it the period counts
            assert found.gain_margin == pytest.approx(true.gain_margin, rel=0.05)


@pytest.mark.parametrize("by", [0.99, 1.01])
def test_a_delay_of_the_margin_is_where_it_turns_unstable(by):
    free = machine("emps2018")
    gains = design_velocity_loop(free, crossover=100.0)
    margin = gains.with_lags.plant_input.delay_margin
    late = free.replace(effects=[{"kind": "actuator_delay", "delay": by * margin}])
    assert LaggedVelocityLoop.of(late, 0.1, gains.k_v1, gains.t_v, IP, ()).stable == (by < 1.0)


def test_computation_delay_filters_and_effects_are_named():
    late = BENT.replace(sampling={"computation_delay": 2})
    words = left_out(late, (Filter(kind="lowpass", frequency=90.0),))
    assert words == (
        "the current loop (0.5 ms)", "the computation delay (2 ms)", "the filters of the command",
        "the effects of the axis",
    )  # fmt: skip


def test_two_masses_are_the_mass_of_both():
    """Not that of the motor's side, nor is the coupling's damper a friction."""
    linear = linear_plant(BENT)
    mass, slope = linear.in_slow_motion
    assert mass == pytest.approx(BENT.mechanics.mass, rel=1e-3)
    assert slope == pytest.approx(BENT.mechanics.viscous, rel=1e-6)
    assert linear.viscous > 1.5 * slope  # what was said before
    frictionless = BENT.replace(mechanics={"viscous": 0.0})
    assert linear_plant(frictionless).in_slow_motion == pytest.approx((BENT.mechanics.mass, 0.0), rel=1e-6, abs=1e-6)
    (said,) = carriage_in_words(BENT, linear, 0.1)
    assert said.startswith("(7) assumes one rigid mass of 115.7 kg; the sampled loop has the resonance at 47.99 Hz")
    assert said.endswith(", with 34.72 kg before it")


def test_a_pi_design_does_not_cite_the_equation_of_ip():
    for structure, cited in ((IP, True), (PI, False)):
        warnings = design_velocity_loop(BENT, crossover=20.0, structure=structure).warnings
        (said,) = [one for one in warnings if "assumes one rigid mass" in one]
        assert said.startswith("(7)") == cited
    braked = machine("emps2018-two-quadrant")
    (said,) = [one for one in design_velocity_loop(braked, 20.0, structure=PI).warnings if "friction slope" in one]
    assert "(7)" not in said


def test_a_loop_faster_than_the_fastest_says_which_limit_it_exceeds(capsys, tmp_path):
    axis = machine("emps2018").replace(effects=[{**COUPLING, "frequency": 200.0, "share": 0.5}])
    fastest = reach(sample_axis(axis), 50.0).crossover
    faster = retune_velocity_loop(axis, crossover=1.05 * fastest, phase_margin_deg=50.0)
    said = faster_in_words(faster.sampled, 50.0, fastest)
    assert "is above the largest within the limits: gain margin 1." in said
    slower = retune_velocity_loop(axis, crossover=0.8 * fastest, phase_margin_deg=50.0)
    assert faster_in_words(slower.sampled, 50.0, fastest) == ""
    path = tmp_path / "axis.toml"
    path.write_text(axis.to_toml())
    line = f"gains {path} --crossover {1.05 * fastest} --phase-margin 50 --retune"
    assert document(capsys, line)["suggestion"]["these_gains"] == said
