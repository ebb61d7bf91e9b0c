"""Terms beside mass and friction: a weight, friction by direction, friction that bends; asked for and proposed."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.effects.terms import TERMS
from emps_design.errors import InputError
from emps_design.identification import identify, identify_several
from emps_design.identification.model import Model
from emps_design.identification.proposals import proposed_terms
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import synthetic_record, there_and_back

PERIOD = 4e-3
JOINT = Axis.from_dict(
    {
        "name": "joint",
        "motion": "rotary",
        "mechanics": {"mass": 1.15, "viscous": 8.1, "coulomb": 7.2, "offset": 0.4},
        "drive": {"command": "current", "force_gain": 9.2, "command_limit": 20.0},
        "sampling": {"period": PERIOD, "encoder_resolution": 3e-6},
        "controller": {
            "kind": "cascade",
            "position": {"kp": 20.0},
            "velocity": {"kp": 6.0, "ti": 0.05},
            "feedforward": {"velocity": 1.0},
        },
    }
)
WEIGHT = {"kind": "gravity", "torque": 6.0, "angle": 0.4}
DIRECTED = {"kind": "asymmetric_viscous_friction", "viscous_difference": 2.0}
BENT = {"kind": "nonlinear_viscous_friction", "amount": 9.0 * 0.1**0.6, "exponent": 0.6}
PLAIN = {"mass": 1.15, "viscous": 8.1, "coulomb": 7.2, "constant_force": 0.4}
TWINS = {  # what the machine has, its viscous friction, and what is to be found beside mass, Coulomb and offset
    "gravity": ([WEIGHT], 8.1, {"gravity_torque": 6.0, "gravity_angle": 0.4}),
    "asymmetric-viscous": ([DIRECTED], 8.1, {"viscous_difference": 2.0}),
    "bent-viscous": ([BENT], 0.0, {"viscous": 9.0, "viscous_exponent": 0.6}),
}


def recorded(axis: Axis, seed: int = 0, speeds=(1.6, 0.8, 0.4, 0.2), noise: float = 0.1) -> Record:
    """The ``axis`` there and back by 2 rad at each of the ``speeds``, with ``noise`` [N m] of the command."""
    strokes = [there_and_back(PERIOD, 2.0 if v > 0.3 else 0.6, v, 8.0, 0.2) for v in speeds]
    reference = np.concatenate([np.zeros(50), *strokes])
    random = np.random.default_rng(seed)
    run_ = Plant.of(axis).closed_loop(reference, disturbance=noise * random.standard_normal(reference.size))
    command = run_.u + noise / axis.drive.gain * random.standard_normal(reference.size)
    return Record.from_arrays(PERIOD, reference, run_.q, command, name="joint")


def twin(effects, viscous: float = 8.1) -> Axis:
    return JOINT.replace(effects=effects, mechanics={**JOINT.mechanics.model_dump(), "viscous": viscous})


@pytest.fixture(scope="module")
def records():
    return {name: recorded(twin(effects, viscous)) for name, (effects, viscous, _) in TWINS.items()}


@pytest.mark.parametrize("estimator", ["auto", "ls", "iv", "oe"])
@pytest.mark.parametrize("term", TWINS)
def test_a_record_asks_for_what_the_machine_has(records, term, estimator):
    found = identify(records[term], JOINT, estimator=estimator)
    assert found.proposed == (term,) == tuple(found.to_dict()["proposed"])
    truth = {**PLAIN, **TWINS[term][2]}
    assert list(found.parameters) == list(Model("symmetric", (term,)).names)
    for name, one in found.parameters.items():
        low, high = one.interval_95
        assert low - 0.5 * (high - low) < truth[name] < high + 0.5 * (high - low), name
        assert high - low < 0.2 * max(truth[name], 1.0), name


def test_a_healthy_axis_is_asked_for_nothing():
    record = recorded(JOINT)
    default, none = identify(record, JOINT).to_dict(), identify(record, JOINT, with_="none").to_dict()
    assert default["proposed"] == []
    assert default == none


def test_all_together_are_told_apart():
    """Each alone is no half of what the other two leave."""
    axis = twin([WEIGHT, DIRECTED, BENT], 0.0)
    found = identify(recorded(axis, speeds=(1.6, 0.8, 0.4, 1.2, 0.6)), JOINT, estimator="oe")
    assert found.proposed == tuple(TERMS)
    for name, value in {"gravity_torque": 6.0, "viscous_difference": 2.0, "viscous_exponent": 0.6}.items():
        assert found.parameters[name].value == pytest.approx(value, rel=0.05)


@pytest.mark.parametrize("term", TWINS)
def test_the_identified_axis_is_the_machine(records, term):
    """Its simulation follows the record as that of the machine that made it; identified again, it keeps what it has."""
    record, (effects, viscous, _) = records[term], TWINS[term]
    found = identify(record, JOINT)
    axis = Axis.from_dict(found.to_axis().to_dict())
    assert [one.kind for one in axis.effects] == [one["kind"] for one in effects]
    truth, seen = (Plant.of(one).closed_loop(record.q_ref) for one in (twin(effects, viscous), axis))
    assert np.std(seen.u - truth.u) < 0.02 * np.std(truth.u)
    again = identify(record, axis)
    assert again.proposed == ()
    assert list(again.parameters) == list(PLAIN)
    anew = identify(record, axis, with_=[term])
    assert anew.values() == pytest.approx(found.values(), rel=1e-3)
    assert [one.kind for one in anew.to_axis().effects] == [one["kind"] for one in effects]


def test_what_is_asked_for_is_identified_and_nothing_else(records):
    found = identify(records["gravity"], JOINT, with_="gravity, bent-viscous", estimator="ls")
    assert found.proposed == ()
    assert found.fitted.terms == ("gravity", "bent-viscous")
    low, high = found.parameters["viscous_exponent"].interval_95
    assert low < 1.0 < high
    bare = identify(records["gravity"], JOINT, with_="none", estimator="ls")
    assert bare.proposed == ()
    assert list(bare.parameters) == list(PLAIN)
    by_direction = identify(records["gravity"], JOINT, model="asymmetric", estimator="ls")
    assert by_direction.proposed == ("gravity",)
    assert by_direction.parameters["gravity_torque"].value == pytest.approx(6.0, rel=0.05)


@pytest.mark.parametrize("chain", ["report", "paper"])
def test_the_other_chains_take_a_term_and_propose_none(records, chain):
    slow = records["gravity"]
    fast = Record.from_arrays(1e-3, *(np.interp(np.arange(slow.t[-1], step=1e-3), slow.t, x) for x in
                                      (slow.q_ref, slow.q, slow.u)))  # fmt: skip
    assert identify(fast, JOINT, filter=chain).proposed == ()
    found = identify(fast, JOINT, filter=chain, with_=["gravity"])
    assert found.parameters["gravity_torque"].value == pytest.approx(6.0, rel=0.1)


def test_a_weight_is_told_however_the_encoder_counts(records):
    """The angle is where the encoder's zero is, and nothing else depends on that."""
    record, shift = records["gravity"], 2.0
    moved = replace(record, q=record.q + shift, q_ref=record.q_ref + shift)
    own, other = (identify(one, JOINT, estimator="ls").parameters for one in (record, moved))
    turned = own["gravity_angle"].value - shift - other["gravity_angle"].value
    assert math.remainder(turned, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-3)
    assert other["gravity_torque"].value == pytest.approx(own["gravity_torque"].value, rel=1e-3)
    assert -math.pi <= other["gravity_angle"].value <= math.pi


def test_the_work_of_a_hand_tells_neither_inertia_nor_friction():
    """The motor holds the weight and a person moves the arm: all that the record tells is the weight."""
    t = np.arange(0.0, 12.0, 2e-3)
    q = 1.2 * np.sin(1.7 * t) + 0.5 * np.sin(2.9 * t)
    u = 3.3 * np.sin(q + 0.1) + 4e-3 * np.random.default_rng(0).standard_normal(t.size)
    axis = JOINT.replace(controller={"kind": "none"}, drive={"force_gain": 1.0, "command_limit": 20.0})
    found = identify(Record(t=t, q_ref=q, q=q, u=u, period=2e-3, q_ref_recorded=False), axis)
    assert found.proposed == ("gravity",)
    assert found.parameters["gravity_torque"].value == pytest.approx(3.3, rel=0.01)
    for name in ("mass", "viscous", "coulomb"):
        assert not found.parameters[name].determined
        said = next(text for text in found.warnings if text.startswith(f"{axis.units.word(name)} is not determined"))
        assert "record motion that the motor causes" in said or "record more of it" in said


def test_a_weight_on_a_line_is_the_constant_force():
    axis = machine("emps2019")
    found = identify(synthetic_record(axis, laps=1, stroke=0.1), axis, with_="gravity")
    assert list(found.parameters) == list(PLAIN)
    assert any("constant_force" in text for text in found.warnings)


def test_what_is_no_term_is_refused():
    with pytest.raises(InputError, match="did you mean 'gravity'"):
        identify(recorded(JOINT, speeds=(1.6,)), JOINT, with_="gravty")
    with pytest.raises(InputError, match="bent-viscous requires"):
        identify(recorded(JOINT, speeds=(1.6,)), JOINT, model="asymmetric", with_=["bent-viscous"])


def test_several_records_are_identified_with_the_same_terms(records):
    """One of them asks for the weight, which the other is too short for."""
    short = records["gravity"].part(0, 800, "short")
    assert identify(short, JOINT, estimator="ls").proposed == ()
    found = identify_several([records["gravity"], short], JOINT, estimator="ls")
    document = found.to_dict()
    assert document["proposed"] == ["gravity"]
    assert document["parameters"]["gravity_torque"]["mean"] == pytest.approx(6.0, rel=0.05)
    assert np.all(found.cross_validation < 3.0 * np.min(found.cross_validation))


def test_the_table_says_which_rows_were_proposed(records, tmp_path, capsys):
    JOINT.save(tmp_path / "axis.toml") if hasattr(JOINT, "save") else (tmp_path / "axis.toml").write_text(
        JOINT.to_toml()
    )
    records["gravity"].save(tmp_path / "record.npz")
    base = ["identify", str(tmp_path / "record.npz"), "--axis", str(tmp_path / "axis.toml")]
    assert run([*base, "--estimator", "ls"]) == 0
    text = capsys.readouterr().out
    assert "gravity_torque +" in text
    assert "--with none" in text
    assert run([*base, "--with", "none", "--estimator", "ls"]) == 0
    assert "gravity" not in capsys.readouterr().out
    assert run([*base, "--with", "gravity", "--json", "--out", str(tmp_path / "found.toml")]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["proposed"] == []
    assert document["parameters"]["gravity_torque"]["unit"] == "N m"
    weight = Axis.load(tmp_path / "found.toml").effects[0].parameters
    assert weight["torque"] == pytest.approx(document["parameters"]["gravity_torque"]["value"])
    assert weight["angle"] == pytest.approx(document["parameters"]["gravity_angle"]["value"])
    assert run([*base, "--with", "gravty"]) == 2
    assert "--with" in capsys.readouterr().err


@pytest.mark.study("false proposals are counted over a hundred healthy records")
def test_healthy_axes_are_asked_for_nothing():
    for seed in range(71_000, 71_100):
        random = np.random.default_rng(seed)
        mass, viscous, coulomb = random.uniform((0.5, 4.0, 3.0), (4.0, 20.0, 12.0)).tolist()
        axis = JOINT.replace(mechanics={"mass": mass, "viscous": viscous, "coulomb": coulomb, "offset": 0.4})
        axis = axis.replace(
            controller={**JOINT.to_dict()["controller"], "velocity": {"kp": 5.0 * mass, "ti": 0.05}},
            name=f"joint {seed}",
        )
        record = recorded(axis, seed, noise=float(random.uniform(0.01, 0.1)) * coulomb)
        assert proposed_terms(record, axis, "symmetric", 30.0) == (), seed
