"""What measured machines ask for: friction on the EMPS, and a pendulum on a servo in free run, judged on other data."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from emps_design.axis import Axis
from emps_design.discrepancy import diagnose
from emps_design.discrepancy.fit import fit
from emps_design.discrepancy.noise_floor import RESIDUAL, floor_of_residual
from emps_design.discrepancy.preparation import prepare
from emps_design.discrepancy.problem import Hypothesis
from emps_design.effects import get_effect
from emps_design.importing import import_record
from emps_design.machines import machine
from emps_design.records import read_record
from emps_design.simulation import Plant
from emps_design.simulation.run import driven_by
from tests.conftest import DATA

LAP = 6240  # samples of DATA_EMPS


@pytest.mark.study("one diagnosis of 25,000 samples with the whole library")
def test_lap_4_of_the_emps_is_followed_by_what_describes_laps_1_to_3(emps_data):
    """Some of it has a name and is asked for by lap 4; the rest is friction that remembers and maps over the travel."""
    axis, record = machine("emps2019"), read_record(emps_data / "DATA_EMPS.mat")
    laps = [k * LAP * record.period for k in (0, 3, 4)]
    answer = diagnose(record, axis, fit_time=tuple(laps[:2]), confirm_time=tuple(laps[1:]), closest=True)
    assert answer.verdict == "partly-named"
    assert {"nonlinear_viscous_friction", "position_ripple"} <= {finding.effect for finding in answer.findings}
    found = answer.closest
    assert found.holdout.extended_60hz < 0.70 < answer.holdout.extended_60hz < 1.05  # N; laps differ by 0.3
    assert found.share < 0.016  # of the force, unfiltered
    (ripple,) = (effect for effect in found.axis.effects if effect.kind == "friction_ripple")
    assert ripple.parameters["period"] == pytest.approx(2.5e-3, rel=2e-3)  # one revolution of the encoder


@pytest.fixture(scope="module")
def pendulum():
    """The axis of the servo and its records by gain."""
    folder = DATA / "real"
    if not (folder / "xl330.toml").exists():
        pytest.skip(f"the records of the servo are not in {folder}")
    axis = Axis.load(folder / "xl330.toml")
    paths = {kp: sorted(folder.glob(f"xl330/*_kp{kp}.npz")) for kp in (100, 200, 400)}
    return axis, {kp: [import_record(path, axis) for path in found] for kp, found in paths.items()}


PENDULUM = ("gravity", "load_dependent_friction")


def free_run(axis, kinds, x, records):
    """Position errors [rad] of the records with baseline, back-EMF and effects ``x``, from their references alone."""
    own = np.split(x[5:], np.cumsum([len(get_effect(kind).parameters) for kind in kinds])[:-1])
    effects = [(get_effect(kind), values) for kind, values in zip(kinds, own, strict=True)]
    errors = []
    for record in records:
        one = axis.replace(drive={"back_emf": float(x[4])}).supplied_by(record)
        run = Plant(one, effects).closed_loop(**driven_by(one, record), baseline=x[:4], quantise=False, tolerance=1e4)
        errors.append(record.q - run.q)
    return errors


def free_run_fit(axis, kinds, first, records, back_emf=True):
    """Least squares, robust, of baseline, ``back_emf`` and effects from ``first`` on the positions; choices stay."""
    parameters = [p for kind in kinds for p in get_effect(kind).parameters]
    size = np.maximum(np.abs(first), 1e-2)
    held = [p.held_at(value) for p, value in zip(parameters, first[5:], strict=True)]
    free = np.array([*[True] * 4, back_emf, *np.logical_not(held)])
    lower = np.where(np.arange(len(first)) == 0, 1e-3 * first[0], 0.0)
    lower[[3, 6]] = -np.inf  # a constant torque and an angle have a sign

    def whole(x):
        values = np.array(first)
        values[free] = x * size[free]
        return values

    found = least_squares(
        lambda x: np.concatenate(free_run(axis, kinds, whole(x), records)),
        (first / size)[free], bounds=((lower / size)[free], np.inf), loss="soft_l1", f_scale=0.05, max_nfev=40,
        diff_step=1e-3,
    )  # fmt: skip
    return whole(found.x)


def missed(axis, kinds, x, records):
    """Mean absolute error of the positions in free run [mrad]."""
    return 1e3 * np.mean([np.abs(error).mean() for error in free_run(axis, kinds, x, records)])


def load_fits(axis, records, **options):
    """Gravity and a gear that carries all the motor's force; the same of what motor and input stage leave of it."""
    first = np.array([*axis.mechanics.array(), axis.drive.back_emf, 0.48, 0.0, 0.3, 0.0, 0.0])
    whole = free_run_fit(axis, PENDULUM, first, records, **options)
    return whole, free_run_fit(axis, PENDULUM, np.array([*whole[:8], 1.0, 0.0]), records, **options)


@pytest.mark.study("fits of eight records in free run")
def test_a_pendulum_on_a_servo_needs_friction_that_grows_with_the_load(pendulum):
    """Fitted at gains 100 and 400, judged at 200; published parameter sets leave 60 to 82 mrad."""
    axis, records = pendulum
    first = np.array([*axis.mechanics.array(), axis.drive.back_emf, 0.48, 0.0])
    bare = free_run_fit(axis, ("gravity",), first, records[100] + records[400])
    assert missed(axis, ("gravity",), bare, records[200]) > 45  # mrad
    whole, behind = load_fits(axis, records[100] + records[400])
    assert missed(axis, PENDULUM, whole, records[200]) < 32
    assert missed(axis, PENDULUM, behind, records[200]) < 32
    # Motor and input stage before the gear, the loss a share of the force behind it: then the numbers are those of
    # data sheet and scales, the back-EMF and the weight of 0.49 kg at 0.10 m.
    assert behind[4] == pytest.approx(axis.drive.back_emf, rel=0.1)
    assert behind[5] / (1.0 - behind[7] ** 2) == pytest.approx(0.49 * 9.81 * 0.10, rel=0.03)


def test_a_pendulum_that_falls_with_the_motor_off_loads_the_gear_by_the_motors_friction(pendulum):
    """Fitted to motion under power alone, which leaves back-EMF and viscous friction open: here the sheet's."""
    axis, records = pendulum
    every = [record for some in records.values() for record in some]
    dropped = [record for record in every if record.enable.min() < 0.5]
    powered = [record for record in every if record.enable.min() > 0.5]
    whole, behind = (missed(axis, PENDULUM, x, dropped) for x in load_fits(axis, powered, back_emf=False))
    assert behind < 50 < 80 < whole  # mrad


@pytest.mark.study("two diagnoses of a record with five lines")
def test_a_motor_cogs_72_times_a_turn_and_as_much_with_its_table_on():
    """Three seconds without the table, less the first half second, in which the cogging holds the motor; then with it.

    A measured current is that of the period before its sample. The table's current is in it: what cogs is the motor.
    """
    folder = DATA / "real"
    if not (folder / "odri.toml").exists():
        pytest.skip(f"the records of the motor are not in {folder}")
    axis, ripple = Axis.load(folder / "odri.toml"), get_effect("position_ripple")
    axis = axis.replace(record=columns_with_a_late(axis, "command"))
    record = import_record(folder / "odri_cogging" / "speed_test.npz", axis)
    found = diagnose(record, axis, fit_time=(0.5, 3.5), library=(ripple,))
    lines = [{name: one["value"] for name, one in finding.parameters.items()} for finding in found.findings]
    assert found.verdict == "named"
    assert [2 * np.pi / line["period"] for line in lines[:3]] == pytest.approx([72.0, 18.0, 24.0], abs=0.02)
    # What current and speed tell of the mass, the file says.
    assert found.axis.mechanics.mass == pytest.approx(axis.mechanics.mass, rel=0.07)

    prepared = prepare((record,), axis, (ripple,), None, (8.2, 16.0), None)
    on, model = prepared.start, prepared.start.model
    for number, line in zip(prepared.library, lines, strict=False):  # bounds and scales are those of this axis
        model = model.with_effect(number, number.values(line))
    start = fitted = on.with_model(model)
    for _ in range(2):  # noise is what the model leaves
        noise = floor_of_residual(fitted.remaining_force(), record.period, RESIDUAL).whitening
        fitted = fit(Hypothesis(on.problem.with_whitening(noise), fitted.model), part="used", steps=20)
    assert fitted.model.values[0][0, 0] != start.model.values[0][0, 0]
    assert tuple(fitted.model.baseline[:3]) == tuple(axis.mechanics.array()[:3])  # one speed does not tell them
    for index, finding in enumerate(found.findings[:4]):
        off = finding.parameters["amplitude"]
        apart = abs(fitted.model.values[index][0, 0] - off["value"])
        assert apart < 1.96 * (off["std"] + fitted.std(index, 0))  # the intervals of 95 % have a part in common
    assert fitted.model.values[0][0, 0] == pytest.approx(5.1e-3, abs=0.3e-3)  # N m


def columns_with_a_late(axis, key):
    """The ``[record]`` table of ``axis`` with a column that is recorded one period late."""
    table = axis.record.model_dump(exclude_none=True)
    return {**table, key: {**table[key], "delay": axis.sampling.period}}
