"""Feed-forward of what the model knows: below no feed-forward and below the rigid one, and honest about the rest."""

import json
from dataclasses import replace

import numpy as np
import pytest

from emps_design.advice import advise
from emps_design.cli import app
from emps_design.codegen import export_controller
from emps_design.compensation import FeedForward, compensate
from emps_design.compensation.feedforward import BASELINE, feedback_cures, largest_factor, motion_ahead, terms_of
from emps_design.compensation.study import Trial
from emps_design.control.sampled import axis_loop, nested_loops
from emps_design.effects import EFFECTS
from emps_design.errors import InputError, SimulationError, UnstableError
from emps_design.laws import get_law, law_of
from emps_design.machines import machine
from emps_design.simulation import Plant, trapezoid_laps
from tests.inverse_model import inverse_force, plant_force

PROGRAM = trapezoid_laps(1e-3, 0.05, 0.15, 1.0, laps=1)
EFFECTS_HERE = [
    {"kind": "position_ripple", "amplitude": 6.0, "phase": 0.7, "period": 0.005},
    {"kind": "asymmetric_viscous_friction", "viscous_difference": -50.0},
    {"kind": "nonlinear_viscous_friction", "amount": 9.0, "exponent": 2.0},
    {"kind": "position_dependent_friction", "amplitude": 8.0, "phase": 0.3, "length": 0.3},
    {"kind": "load_dependent_friction", "share": 0.1},
    {"kind": "stribeck_friction", "excess": 10.0, "stribeck_velocity": 0.01, "exponent": 1.0},
    {"kind": "elastic_force", "stiffness": 120.0, "rest_position": 0.0},
    {"kind": "actuator_delay", "delay": 2e-3},
]
GAINS = {
    "ip_velocity": {"k_v1": 400.0, "t_v": 0.02},
    "cascade": {"position": {"kp": 40.0}, "velocity": {"kp": 400.0, "ti": 0.03}, "feedforward": {"velocity": 1.0}},
    "p": {"kp": 4000.0},
}


# A motor without a current loop whose command is a share of 24 V.
DUTY = {
    "drive": {"command": "duty", "command_unit": "", "command_limit": 1.0, "supply": 24.0, "back_emf": 15.0},
    "controller": {"kp": 160.0, "kv": 10.0},
}


def with_effects(*effects, **more):
    return machine("emps2019").replace(effects=list(effects), **more)


@pytest.mark.parametrize("effect", EFFECTS_HERE, ids=lambda effect: effect["kind"])
def test_every_effect_is_compensated(effect):
    found = compensate(with_effects(effect), PROGRAM).to_dict()
    rms = found["tracking_rms"]
    assert rms["with"] < rms["baseline"] / 3.0 < rms["without"] / 9.0
    assert rms["with"] <= rms["worst"] < rms["baseline"]
    assert {*BASELINE} < {*found["kept"]}


def test_each_set_of_terms_is_run_once(monkeypatch):
    runs, run = [], Trial.run
    monkeypatch.setattr(Trial, "run", lambda trial, ahead: runs.append(ahead) or run(trial, ahead))
    found = compensate(with_effects(EFFECTS_HERE[1]), PROGRAM, terms=("viscous", "asymmetric_viscous_friction"))
    for terms in ((), ("viscous",), found.feedforward.terms):
        ahead = FeedForward.of(found.axis, terms).along(PROGRAM) if terms else None
        assert sum(ahead is one if ahead is None else np.array_equal(ahead, one) for one in runs) == 1


def test_the_formula_is_the_models():
    """Along a motion the feed-forward is the inverse dynamic model, whose kernels are the effects' own."""
    axis = with_effects(*EFFECTS_HERE[:6])
    terms, left = terms_of(axis)
    assert not left
    q, v, a = motion_ahead(PROGRAM, 1e-3, 5e-4)
    moving = np.abs(v) > 0.01
    given = replace(FeedForward.of(axis, terms), reversal=1e-3)
    force = axis.drive.force_gain * given.command(q, v, a)
    model = plant_force(axis, q, v, a, np.zeros(q.size))
    np.testing.assert_allclose(force[moving], model[moving], rtol=1e-9, atol=1e-7)


def test_the_back_emf_and_the_supply_are_in_the_command():
    """Against the inverse model of the axis, and on the nonlinear machine."""
    axis = with_effects(EFFECTS_HERE[4], **DUTY)
    found = compensate(axis, PROGRAM)
    assert found.achieved < found.baseline / 3.0 < found.without / 9.0
    q, v, a = motion_ahead(PROGRAM, 1e-3, 5e-4)
    moving, t = np.abs(v) > 0.01, np.zeros(q.size)
    force, model = axis.drive.gain * found.feedforward.command(q, v, a), inverse_force(axis, q, v, a, t)
    np.testing.assert_allclose(force[moving], model[moving], rtol=1e-9, atol=1e-7)


def test_a_term_that_does_harm_within_its_uncertainty_is_left_out():
    """A ripple whose phase may be 90 degrees wrong is worse than none."""
    found = compensate(with_effects(EFFECTS_HERE[0]), PROGRAM, phase_deg=90.0)
    assert "position_ripple" not in found.feedforward.terms
    assert any("position_ripple is left out: within its uncertainty the error is" in line for line in found.warnings)
    assert found.achieved <= found.baseline


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_every_effect_is_a_term_or_is_said_not_to_be(effect):
    parameters = effect.checks[0][0]
    rotary = {"motion": "rotary"} if effect.motion == "rotary" else {}
    axis = with_effects({"kind": effect.name, **parameters}, **rotary)
    terms, left = terms_of(axis)
    assert (effect.name in terms) + (effect.name in left) + (
        effect.delay is not None or effect.solver.lag is not None
    ) == 1
    if effect.name in terms:
        ahead = FeedForward.of(axis, terms).along(PROGRAM)
        assert np.isfinite(ahead).all()


def test_backlash_is_said_in_one_line(capsys):
    axis = with_effects({"kind": "backlash", "gap": 1e-4, "frequency": 60.0, "damping": 0.15, "share": 0.4})
    found = compensate(axis, PROGRAM)
    assert found.not_compensated == {"backlash": "it has a state that does not follow from position and velocity"}
    assert found.to_dict()["warnings"][0].startswith("backlash is not compensated: ")


@pytest.mark.parametrize("kind", GAINS)
def test_every_law_that_follows_a_reference_is_compensated(kind):
    axis = machine("emps2018").replace(controller={"kind": kind, **GAINS[kind]}, effects=[EFFECTS_HERE[1]])
    found = compensate(axis, PROGRAM)
    assert found.unit == ("m/s" if kind == "ip_velocity" else "m")
    assert found.achieved < found.baseline / 3.0 < found.without / 9.0
    assert not found.warnings


def test_a_law_on_its_error_answers_what_it_answers_less_its_answer_on_its_reference():
    """For every linear law: on random signals, by its own kernel."""
    rng = np.random.default_rng(41)
    for kind, table in {**GAINS, "position_pd": {"kp": 160.0, "kv": 243.0}}.items():
        axis = machine("emps2019").replace(controller={"kind": kind, **table})
        law, q_ref = law_of(axis, 1e-3), np.cumsum(rng.normal(0.0, 1e-3, 400))
        q = q_ref[0] + np.cumsum(rng.normal(0.0, 1e-3, 400))
        q[:2] = q_ref[:2] = q_ref[0]  # at rest before the first sample, a velocity too
        both, own = (law.commands(law.reference(q_ref, 1e-3), at, np.inf) for at in (q, q_ref))
        alone = law.on_error().commands(q_ref, q, np.inf)
        np.testing.assert_allclose(alone, both - own, rtol=1e-9, atol=1e-9 * np.abs(both).max())


def test_feedback_is_left_on_a_motion_that_saturates_the_law():
    """A cascade that would be at its limit on its own reference is on its error far from it."""
    table = {"kind": "cascade", "position": {"kp": 40.0}, "velocity": {"kp": 400.0, "ti": 0.03}}
    axis = machine("emps2018").replace(controller=table)
    law, limit = law_of(axis, 1e-3), axis.drive.command_limit
    assert (np.abs(law.commands(PROGRAM, PROGRAM, limit)) == limit).any()
    off = PROGRAM + 1e-5 * np.sin(np.arange(PROGRAM.size) / 50.0)
    assert 0.0 < np.abs(law.on_error().commands(PROGRAM, off, limit)).max() < 0.5 * limit


FAST = {"kind": "cascade", "position": {"kp": 30.0}, "velocity": {"kp": 100.0, "ti": 0.005}}


def ramps(acceleration, speed, stroke):
    """Rest, a trapezoid of velocity, rest."""
    t = np.arange(int((stroke / speed + speed / acceleration) / 1e-3)) * 1e-3
    v = np.clip(np.minimum(acceleration * t, acceleration * (t[-1] - t)), 0.0, speed)
    q = np.cumsum(v) * 1e-3
    return np.concatenate([np.zeros(100), q, np.full(600, q[-1])])


@pytest.mark.parametrize(("wind", "largest"), [("hold", 1.5e-3), ("none", np.inf)])
def test_the_integral_waits_while_the_limit_acts_on_law_and_feed_forward(wind, largest):
    """The motion asks for twice what the limit gives: 4.5 mm too far while the law saw its own share alone."""
    axis = machine("emps2018").replace(controller={**FAST, "anti_windup": wind})
    q_ref = ramps(5.0, 0.3, 0.15)
    trial, ahead = Trial(axis, q_ref), FeedForward.of(axis, tuple(BASELINE)).along(q_ref)
    error, limited = trial.error(ahead)
    assert limited > 0.2
    assert trial.overshoot(ahead) == pytest.approx(-error.min(), abs=1e-9)
    assert trial.overshoot(ahead) < largest
    assert (trial.overshoot(ahead) > 3e-3) == (wind == "none")


def test_a_limit_that_does_not_let_the_axis_follow_is_said_with_how_far_it_goes():
    """Less lag than without feed-forward, and so more speed where it has to brake: no anti-windup changes that."""
    table = {"kind": "cascade", "position": {"kp": 20.0}, "velocity": {"kp": 300.0, "ti": 0.01}}
    axis = machine("emps2018").replace(controller=table)
    found = compensate(axis, ramps(5.0, 0.3, 0.15), mismatch=0.0)
    document = found.to_dict()
    assert document["overshoot"]["without"] < 1e-5 < 2e-3 < document["overshoot"]["with"] < 3e-3
    assert document["tracking_rms"]["with"] < 0.5 * document["tracking_rms"]["without"]
    beyond = f"overshoots the reference by up to {1e3 * document['overshoot']['with']:.3g} mm"
    assert any(beyond in text and "less acceleration" in text for text in found.warnings)


def test_an_integral_that_winds_up_is_named():
    table = {"kind": "cascade", **GAINS["cascade"], "anti_windup": "none"}
    found = compensate(machine("emps2018").replace(controller=table), PROGRAM, mismatch=0.0)
    assert any("the integral winds up on the whole error at the limit" in text for text in found.warnings)


def test_no_feed_forward_is_an_answer():
    """Where the numbers are so wrong that every term does harm, the law stays as it is, in the code too."""
    axis = machine("emps2018").replace(controller={"kind": "cascade", **GAINS["cascade"]})
    found = compensate(axis, PROGRAM, mismatch=50.0)
    assert found.feedforward.terms == ()
    assert found.achieved == found.without
    assert export_controller(axis, "c", found.to_dict()).block.ahead is None


def test_what_has_nothing_to_follow_is_refused():
    axis = machine("emps2018").replace(controller={"kind": "impedance", "mass": 50.0, "damping": 100.0})
    with pytest.raises(InputError, match="found 'impedance', which has no reference"):
        compensate(axis, PROGRAM)
    with pytest.raises(InputError, match="found 'none'"):
        compensate(machine("emps2018"), PROGRAM)
    with pytest.raises(UnstableError, match="unstable without feed-forward"):
        compensate(with_effects(controller={"kp": 900.0, "kv": 4000.0}), PROGRAM)
    with pytest.raises(InputError, match="found the term 'position_ripple', expected one of inertia, viscous"):
        compensate(with_effects(), PROGRAM, terms=("inertia", "position_ripple"))
    with pytest.raises(InputError, match="mismatch`: found -1"):
        compensate(with_effects(), PROGRAM, mismatch=-1.0)


def test_the_command_prints_and_writes(tmp_path, capsys):
    (tmp_path / "axis.toml").write_text(with_effects(EFFECTS_HERE[0]).to_toml(), encoding="utf-8")
    line = ["compensate", str(tmp_path / "axis.toml"), "--stroke", "0.05", "--out", str(tmp_path / "out")]
    assert app.run([*line, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document["tracking_rms"]) == {"without", "baseline", "with", "worst"}
    assert document["terms"][-1]["note"].startswith("its phase refers to the encoder zero of one record")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"axis.toml", "compensation.json"}
    assert json.loads((tmp_path / "out" / "compensation.json").read_text()) == {
        key: value for key, value in document.items() if key != "out"
    }
    assert app.run(line) == 0
    assert "position ripple" in capsys.readouterr().out
    assert app.run(["compensate", "emps2019", "--scenario", "lap"]) == 2
    assert "did you mean 'laps'" in capsys.readouterr().err
    assert app.run(["compensate", "emps2019", "--scenario", "reference"]) == 2
    assert "expected --reference FILE" in capsys.readouterr().err
    assert app.run(["compensate", "emps2019", "--scenario", "half-ramp", "--stroke", "0.1"]) == 2
    assert "--stroke: not used by the half-ramp scenario" in capsys.readouterr().err


# Plays of unlike axes: heavy with late loops, a cascade with a position loop, light and fast.
PLAYS = {
    "late": ("emps2019", {"sampling": {"computation_delay": 2}}, {"gap": 2e-4, "frequency": 20.0, "share": 0.7}),
    "later": ("emps2019", {"sampling": {"computation_delay": 3}}, {"gap": 1e-3, "frequency": 12.0, "share": 0.5}),
    "integral": (
        "emps2018",
        {
            "sampling": {"computation_delay": 2},
            "controller": {"kind": "cascade", "position": {"kp": 10.0}, "velocity": {"kp": 300.0, "ti": 0.05}},
        },
        {"gap": 2e-4, "frequency": 25.0, "share": 0.6},
    ),
    "light": (
        "emps2019",
        {
            "mechanics": {"mass": 0.3, "viscous": 1.0},
            "drive": {"force_gain": 0.5},
            "sampling": {"period": 2.5e-4, "computation_delay": 2},
            "controller": {"kp": 90.0, "kv": 90.0},
        },
        {"gap": 2e-4, "frequency": 80.0, "share": 0.7},
    ),
}


@pytest.mark.parametrize("name", PLAYS)
def test_around_the_limit_of_the_gain_a_play_comes_to_rest_and_does_not(name):
    """On the nonlinear machine without dry friction, pushed once: at rest below the limit, swinging beyond it."""
    base, changes, play = PLAYS[name]
    axis = machine(base).replace(**changes).replace(mechanics={"coulomb": 0.0, "offset": 0.0})
    axis = axis.replace(effects=[{"kind": "backlash", "damping": 0.02, **play}])
    factor = largest_factor(axis, 0)
    assert 0.01 < factor < 100.0
    t = axis.sampling.period * np.arange(6000)
    q_ref = 0.01 * np.clip((t / t[-1] - 0.02) / 0.02, 0.0, 1.0)
    push = np.where(np.abs(t / t[-1] - 0.1) < 0.01, 0.2 * axis.mechanics.mass, 0.0)

    def swing(times):
        drive = {"force_gain": axis.drive.force_gain * factor * times}
        try:
            run = Plant.of(axis.replace(drive=drive)).closed_loop(q_ref, disturbance=push)
        except SimulationError:  # it swings from limit to limit
            return np.inf
        return np.ptp(run.position[-1500:])

    assert swing(0.85) < 0.2 * play["gap"]
    assert swing(1.3) > 2.0 * swing(0.85)


@pytest.mark.parametrize("kind", [*GAINS, "position_pd"])
def test_the_gain_that_is_named_scales_the_loop(kind):
    axis = machine("emps2019").replace(controller={"kind": kind, **GAINS[kind]} if kind in GAINS else {})
    name, table = get_law(kind).gain.split("."), axis.to_dict()["controller"]
    inner = table
    for part in name[:-1]:
        inner = inner[part]
    inner[name[-1]] *= 0.5
    halved = axis.replace(controller=table)
    weaker = axis.replace(drive={"force_gain": 0.5 * axis.drive.force_gain})
    np.testing.assert_allclose(axis_loop(halved).poles, axis_loop(weaker).poles, atol=1e-6)


def test_the_limit_of_a_gain_leaves_the_back_emf_of_a_motor_as_it_is():
    play = {"kind": "backlash", "gap": 2e-4, "frequency": 20.0, "damping": 0.02, "share": 0.7}
    controller = {"kind": "position_pd", **DUTY["controller"]}
    axis = with_effects(play, drive=DUTY["drive"], controller=controller, sampling={"computation_delay": 2})
    halved = axis.replace(controller={**controller, get_law("position_pd").gain: 0.5 * controller["kv"]})
    factor = largest_factor(axis, 0)
    assert 0.01 < factor < 100.0
    assert largest_factor(halved, 0) == pytest.approx(2.0 * factor, rel=1e-3)


def test_a_coupling_gets_a_filter_that_the_loop_can_be_run_with():
    """The advised gains behave as advised in the loop of an axis that has them, and not without the filter."""
    coupling = {"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}
    loop = {"kind": "cascade", "velocity": {"kp": 100.0, "ti": 0.03}}
    axis = machine("emps2018").replace(effects=[coupling, EFFECTS_HERE[0]], controller=loop)
    (found,) = feedback_cures(axis)
    assert found["filter"]["kind"] == "notch"
    assert abs(found["filter"]["frequency"] - 48.0) < 2.0
    assert found["with"]["crossover"] > 1.3 * found["without"]["crossover"]
    law = {"kind": "cascade", "velocity": {"kp": found["with"]["k_v1"], "ti": found["with"]["t_v"], "form": "pi"}}
    margins = {
        name: nested_loops(axis.replace(controller={**law, "filters": filters}))[0].margins
        for name, filters in (("with", [found["filter"]]), ("without", []))
    }
    assert margins["with"].phase_margin_deg == pytest.approx(60.0, abs=1e-3)
    assert not margins["without"].stable or margins["without"].phase_margin_deg < 50.0


@pytest.mark.parametrize(
    ("factor", "code", "level"),
    [
        (0.0, "limit-cycle-at-any-gain", "caution"),
        (0.5, "limit-cycle-at-this-gain", "caution"),
        (5.0, "limit-cycle-above", "safe"),
        (np.inf, "no-limit-cycle", "safe"),
    ],
)
def test_a_limit_cycle_with_the_gain_as_it_is_makes_no_design_safe(monkeypatch, factor, code, level):
    monkeypatch.setattr("emps_design.compensation.feedforward.largest_factor", lambda axis, place: factor)
    play = {"kind": "backlash", "gap": 1e-4, "frequency": 60.0, "damping": 0.15, "share": 0.4}
    (cure,) = feedback_cures(with_effects(play))
    assert (cure["advice"].code, cure["advice"].partition(": ")[0]) == (code, "backlash")
    rms, assumed = {"without": 1.0, "worst": 0.1}, {"mismatch": 0.02}
    document = {"tracking_rms": rms, "feedback": [cure], "kept": ["mass"], "assumed": assumed, "warnings": []}
    assert advise("compensate", document).level == level


def test_a_law_without_a_linear_form_gets_no_cure(monkeypatch):
    def refused(axis, place):
        raise InputError("the law has no linear form")

    monkeypatch.setattr("emps_design.compensation.feedforward.largest_factor", refused)
    play = {"kind": "backlash", "gap": 1e-4, "frequency": 60.0, "damping": 0.15, "share": 0.4}
    (cure,) = feedback_cures(with_effects(play))
    assert (cure["advice"], cure["advice"].code) == ("backlash: no advice, the law has no linear form", "no-cure")


def test_the_advice_is_in_document_and_text(tmp_path, capsys):
    axis = with_effects({"kind": "backlash", "gap": 1e-4, "frequency": 60.0, "damping": 0.15, "share": 0.4})
    (tmp_path / "axis.toml").write_text(axis.to_toml(), encoding="utf-8")
    line = ["compensate", str(tmp_path / "axis.toml"), "--stroke", "0.05"]
    assert app.run([*line, "--json"]) == 0
    (cure,) = json.loads(capsys.readouterr().out)["feedback"]
    assert (cure["gain"], cure["now"]) == ("kv", 243.45)
    assert cure["limit"] == pytest.approx(cure["factor"] * 243.45)
    assert app.run(line) == 0
    assert f"keep kv below {cure['limit']:.4g}" in " ".join(capsys.readouterr().out.split())
    assert compensate(with_effects(), PROGRAM).feedback == ()
