"""What ``identify`` does unless told otherwise: one function with its command, a cut-off that is tried, a law found."""

import inspect
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from emps_design.axis import Axis
from emps_design.cli.app import run
from emps_design.cli.output import Terminal
from emps_design.errors import InputError
from emps_design.identification import identify, identify_several
from emps_design.identification.assemble import assemble, cutoff_sensitivity
from emps_design.identification.closed_loop import identify_by_output_error, identify_with_instruments
from emps_design.identification.controller import TOLD, LawEstimate
from emps_design.identification.filters import encoder_variance
from emps_design.identification.result import IdentificationRequest
from emps_design.identification.several import identify_together
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.request import OPTION, options_of
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import synthetic_record, trapezoid_laps

AXIS = machine("emps2019")
BARE = AXIS.replace(controller={"kind": "none"})
STEPPING = Axis.from_dict(
    {
        "name": "belt",
        "mechanics": {"mass": 0.5, "viscous": 7.0, "coulomb": 0.3},
        "drive": {"force_gain": 1.0, "command_limit": 10.0},
        "sampling": {"period": 1e-3, "encoder_resolution": 5e-6},
        "controller": {"kind": "p", "kp": 130.0},
    }
)


@pytest.fixture(scope="module")
def day():
    return synthetic_record(AXIS, laps=1, stroke=0.1)


@pytest.fixture(scope="module")
def stepping():
    """Steps of a reference, answered within a tenth of a second: most of the record stands still."""
    levels = np.cumsum(np.tile([0.02, -0.02, 0.035, -0.035], 4))
    reference = np.repeat(levels, 500)
    run = Plant.of(STEPPING).closed_loop(reference)
    return Record.from_arrays(1e-3, reference, run.q, run.u, name="stepping")


@pytest.mark.parametrize(
    ("flags", "options"),
    [
        ([], {}),
        (["--estimator", "iv", "--cutoff", "40"], {"estimator": "iv", "cutoff": 40.0}),
        (["--filter", "report", "--model", "asymmetric"], {"filter": "report", "model": "asymmetric"}),
        (["--bootstrap", "9", "--seed", "3"], {"bootstrap": 9, "seed": 3}),
    ],
)
def test_the_command_and_the_function_are_one(day, tmp_path, capsys, flags, options):
    path = tmp_path / "day.npz"
    day.save(path)
    assert run(["identify", str(path), "--json", *flags]) == 0
    document = json.loads(capsys.readouterr().out)
    found = json.loads(Terminal().json_text(identify(replace(day, name="day"), AXIS, **options)))
    del document["sha256"], found["sha256"]
    for either in (document, found):  # the command knows the files, and names them in what to do next
        del either["advice"]["next"]
    assert document == found


def test_no_function_of_it_takes_more_than_eight():
    for function in (identify_with_instruments, identify_by_output_error, assemble, cutoff_sensitivity):
        assert len(inspect.signature(function).parameters) <= 8


@pytest.mark.parametrize("function", [identify, identify_several, identify_together])
def test_help_says_every_option(function):
    for entry in options_of(IdentificationRequest):
        assert inspect.signature(function).parameters[entry.name].default == entry.default
        assert f"{entry.name}: {entry.metadata[OPTION].help}" in function.__doc__


def test_a_request_is_taken_as_it_is(day):
    found = identify(day, AXIS, IdentificationRequest(estimator="ls", cutoff=60.0))
    np.testing.assert_array_equal(found.values(), identify(day, AXIS, estimator="ls", cutoff=60.0).values())


def test_a_result_shows_what_the_command_prints(day, tmp_path, capsys):
    path = tmp_path / "day.npz"
    day.save(path)
    assert run(["identify", str(path), "--estimator", "ls"]) == 0
    shown = str(identify(replace(day, name="day"), AXIS, estimator="ls"))
    assert " ".join(capsys.readouterr().out.split()).startswith(" ".join(shown.split()))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"estimator": "olse"}, r"`estimator`: found 'olse', expected one of auto, ls, iv, oe"),
        ({"external_force": "maybe"}, r"`external_force`: found 'maybe', expected one of refuse, known"),
        ({"estimator": "oe", "filter": "report"}, r"`filter`: requires `estimator='ls'`, found oe"),
        ({"seed": 3}, r"`seed`: requires `bootstrap`"),
        ({"estimator": "iv", "bootstrap": 9}, r"`bootstrap`: requires `estimator='ls'`, found iv"),
    ],
)
def test_options_that_do_not_go_together_are_refused(day, options, words):
    with pytest.raises(InputError, match=words):
        identify(day, AXIS, **options)


def test_old_names_are_no_options(day):
    for name in ("chain", "cutoff_hz", "external_force_known"):
        with pytest.raises(TypeError, match=name):
            identify(day, AXIS, **{name: None})


def test_an_axis_at_rest_shows_none_of_its_encoders_noise(stepping):
    """Three quarters of the record stand still, and the rounding of the rest is that of the encoder."""
    step = STEPPING.sampling.encoder_resolution
    assert 0.9 < encoder_variance(stepping) ** 0.5 / (step / 12**0.5) < 1.5


def test_the_cutoff_of_steps_is_where_noise_does_not_hide_the_mass(stepping):
    alone = replace(stepping, q_ref_recorded=False)
    found = identify(alone, STEPPING, estimator="ls")
    assert found.cutoff_hz < 120.0
    low, high = found.parameters["mass"].interval_95
    assert low < 0.5 < high
    assert identify(alone, STEPPING, estimator="ls", cutoff=200.0).parameters["mass"].value < 0.97 * 0.5
    low, high = identify(stepping, STEPPING).parameters["mass"].interval_95
    assert low < 0.5 < high < 1.3 * low


def test_the_interval_holds_what_the_cutoff_moves(simulate, truth):
    record = simulate(0, laps=2)  # half the cut-off leaves too little of one lap
    noise = 2e-4 * np.random.default_rng(4).standard_normal(len(record))
    noisy = replace(record, q=record.q + noise, q_ref_recorded=False)
    found = identify(noisy, AXIS)
    mass = found.parameters["mass"]
    low, high = mass.interval_95
    assert low < truth["mass"] < high
    assert mass.cutoff > 0.03 * mass.value
    sensitivity = found.to_dict()["cutoff_sensitivity"]
    assert sensitivity["mass"] > 0.05 > sensitivity["coulomb"]
    tried = found.extra["cutoffs_tried"]["cutoff_hz"]
    assert tried == pytest.approx([0.5 * found.cutoff_hz, 2.0 * found.cutoff_hz])


def test_a_healthy_record_keeps_its_intervals(record):
    found = identify(record, AXIS)
    for one in found.parameters.values():
        assert np.diff(one.interval_95)[0] < 1.2 * 2.0 * found.residual.quantile * one.std_long_run
    assert found.extra["unexplained"]["widening"] == 1.0
    assert found.extra["unexplained"]["structure"] == 0.0
    assert not any("diagnose" in text for text in found.warnings)


def test_structure_that_the_model_lacks_is_said_and_widens_the_intervals(record):
    """Viscous friction of 300 and 100 N/(m/s) by direction, under a model of one."""
    lacking = AXIS.replace(effects=[{"kind": "asymmetric_viscous_friction", "viscous_difference": 100.0}])
    push = np.random.default_rng(2).standard_normal(len(record))
    run_ = Plant.of(lacking).closed_loop(record.q_ref, voltage_noise=4e-3 * push)
    seen = replace(record, q=run_.q, u=run_.u)
    found = identify(seen, AXIS, with_="none")
    left = found.extra["unexplained"]
    assert left["structure"] > 0.8 * left["share"] > 0.02
    assert left["widening"] > 1.2
    said = next(text for text in found.warnings if "diagnose" in text)
    assert re.match(r"the model does not explain \S+ % of the force", said)
    assert "repeats with the motion" in said
    assert not any("diagnose" in text for text in identify(seen, AXIS, model="asymmetric").warnings)


@pytest.fixture(scope="module")
def viscous():
    """Records by seed of a slide with F_v/M of 60 1/s: noise of the force moves its speed at once."""
    axis = AXIS.replace(
        mechanics={"mass": 8.0, "viscous": 480.0, "coulomb": 12.0, "offset": -1.5},
        drive={"force_gain": 25.0, "voltage_limit": 48.0},
        sampling={"encoder_resolution": 1e-6},
        controller={"kp": 25.0, "kv": 30.0},
    )
    plant, reference, decay = Plant.of(axis), trapezoid_laps(1e-3, 0.2, 0.3, 3.0, 1), np.exp(-0.094)

    def record(seed):
        random = np.random.default_rng(seed)
        push = lfilter([2.0 * np.sqrt(1.0 - decay**2)], [1.0, -decay], random.standard_normal(reference.size))
        made = plant.closed_loop(reference, disturbance=push)
        return Record.from_arrays(1e-3, reference, made.q, made.u + 0.06 * random.standard_normal(reference.size))

    return axis, record


def test_noise_that_moves_a_viscous_axis_is_no_structure(viscous):
    """The motion is late by 1/kp, and what is meant is still told by the reference, not by what the noise did."""
    axis, record = viscous
    left = identify(record(72_000), axis).extra["unexplained"]
    assert (left["structure"], left["widening"]) == (0.0, 1.0)


def test_instruments_tell_a_mass_that_noise_hides_from_least_squares():
    """Steps of the encoder are most of the acceleration of a damped joint, and none of what its instrument says."""
    joint = Axis.from_dict(
        {
            "name": "damped joint",
            "motion": "rotary",
            "mechanics": {"mass": 0.02, "viscous": 1.6, "coulomb": 0.3, "offset": 0.02},
            "drive": {"command": "current", "force_gain": 0.9, "command_limit": 12.0},
            "sampling": {"period": 0.5e-3, "encoder_resolution": 1e-4},
            "controller": {"kind": "cascade", "position": {"kp": 30.0}, "velocity": {"kp": 2.0, "ti": 0.03}},
        }
    )
    reference = trapezoid_laps(0.5e-3, 2.0, 2.5, 30.0, 1)
    push = lfilter([0.01], [1.0, -0.95], np.random.default_rng(7).standard_normal(reference.size))
    made = Plant.of(joint).closed_loop(reference, disturbance=push)
    record = Record.from_arrays(0.5e-3, reference, made.q, made.u, name="joint")
    assert not identify(record, joint, estimator="ls").parameters["mass"].determined
    found = identify(record, joint)
    assert found.estimator == "instrumental_variables"
    low, high = found.parameters["mass"].interval_95
    assert low < 0.02 < high < 1.1 * low
    assert any("inertia: the reference explains" in text and "of its column" in text for text in found.warnings)


def test_a_force_that_does_not_repeat_is_said_where_it_is_much(record):
    """The command of another axis: nothing of it comes again with the motion, and half of the force is left."""
    other = 0.5 * np.std(record.u) * np.random.default_rng(3).standard_normal(len(record) // 200 + 1).repeat(200)
    found = identify(replace(record, u=record.u + other[: len(record)], q_ref_recorded=False), AXIS)
    assert found.extra["unexplained"]["share"] > 0.2
    assert any(
        "does not explain" in text and "% of the force" in text and "diagnose" in text for text in found.warnings
    )


def test_the_law_is_found_where_the_axis_has_none(simulate, truth, monkeypatch):
    """Least squares is biased by this record: instruments need the controller that the axis does not give."""
    table = {"kind": "position_pd", "kp": AXIS.controller.kp, "kv": AXIS.controller.kv}
    told = LawEstimate("simulated", TOLD, "", table, {}, 0.0, 0.0, "V")  # looking for it takes seconds
    monkeypatch.setattr("emps_design.identification.controller.identify_law", lambda record, unit: told)
    bare = identify(simulate(0, std=25.0, time=0.005), BARE, cutoff=60.0)
    assert bare.estimator == "instrumental_variables"
    low, high = bare.parameters["mass"].interval_95
    assert low < truth["mass"] < high
    assert any(
        text.startswith("emps2019 has no controller; the controller identified from the record was used")
        for text in bare.warnings
    )
    assert bare.to_axis().controller.kind == "none"


def test_a_law_that_cannot_be_told_leaves_least_squares(simulate):
    record = simulate(0, laps=1).part(0, 4000)
    lost = replace(record, u=record.u + np.random.default_rng(0).standard_normal(len(record)))
    found = identify(lost, BARE)
    assert found.estimator == "least_squares"
    assert any("and none was identified from the record" in text for text in found.warnings)
