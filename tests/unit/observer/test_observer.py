"""Observers against forces that are known."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.errors import InputError, RecordError
from emps_design.identification.filters import held_force, low_pass, motion
from emps_design.identification.observation import direct_validation, observe, step_answer, with_known_push
from emps_design.machines import machine
from emps_design.observer import (
    ForceObserver,
    KalmanForceObserver,
    _lag,
    kalman_trade_off,
    observe_offline,
    observe_online,
    smallest_observable_force,
)
from emps_design.records import Record
from emps_design.simulation import Plant
from tests.unit.records.with_gaps import as_one, lost

AXIS = machine("emps2019")
PERIOD = 1e-3


@pytest.fixture(scope="module")
def pushed():
    """4 s of sine motion with a 30 N square wave from outside."""
    t = np.arange(4000) * PERIOD
    q_ref = 0.03 * (1 - np.cos(2 * np.pi * 0.4 * t))
    push = np.where((t % 0.8) < 0.4, 30.0, 0.0)
    run = Plant.of(AXIS).closed_loop(q_ref, disturbance=push)
    return Record(t=t, q_ref=q_ref, q=run.q, u=run.u, f_ext=push, period=PERIOD, name="pushed")


@pytest.mark.parametrize("make", [ForceObserver, KalmanForceObserver])
def test_loop_and_array_give_identical_numbers(pushed, make):
    observer = make(AXIS)
    force = observe_online(observer, pushed.q, pushed.u)
    again = make(AXIS)
    one_by_one = [again.step(pushed.q[k], pushed.u[max(k - 1, 0)]) for k in range(len(pushed))]
    assert force.tolist() == one_by_one


def test_online_is_causal(pushed):
    """What comes later changes nothing that was said before."""
    observer, cut = ForceObserver(AXIS), 2000
    u, q = pushed.u.copy(), pushed.q.copy()
    u[cut:], q[cut:] = 5.0, 0.0
    before = observe_online(observer, pushed.q, pushed.u)[:cut]
    assert before.tolist() == observe_online(observer, q, u)[:cut].tolist()


@pytest.mark.parametrize(
    "observer",
    [ForceObserver(AXIS), ForceObserver(AXIS, cutoff_hz=5.0), KalmanForceObserver(AXIS, bandwidth_hz=40.0)],
    ids=["low-pass 20 Hz", "low-pass 5 Hz", "kalman 40 Hz"],
)
def test_stated_delay_is_that_of_a_ramp(observer):
    """A force that rises steadily is seen late by the delay that the observer states, to a fifth of a sample."""
    n, slope = 1500, 40.0
    t = np.arange(n) * PERIOD
    run = Plant.of(AXIS.replace(sampling={"encoder_resolution": 0.0})).open_loop(
        np.full(n, 2.0), disturbance=slope * (t + 0.5 * PERIOD), v0=0.15
    )
    seen = observe_online(observer, run.position, run.u)[1000:]
    assert np.mean(t[1000:] - seen / slope) == pytest.approx(observer.delay, abs=0.2 * PERIOD)


def test_rise_time_is_that_of_the_step_answer():
    observer = ForceObserver(AXIS, cutoff_hz=10.0)
    assert observer.rise_time == pytest.approx(2.2 / (2 * np.pi * 10.0), rel=0.01)


def test_observers_find_the_push(pushed):
    found = observe(pushed, AXIS)
    # Sliding for 0.1 s and more, and 0.1 s from every edge of the push.
    calm = np.convolve(np.abs(np.gradient(pushed.q, PERIOD)) < 0.01, np.ones(200), "same") == 0
    calm &= np.convolve(np.abs(np.gradient(pushed.f_ext)) > 0, np.ones(200), "same") == 0
    calm[-100:] = False
    assert np.sum(calm) > 400
    for name, limit in (("offline", 0.5), ("online", 0.5), ("kalman", 0.5)):
        steps = found.methods[name].steps
        error = (found.methods[name].force - pushed.f_ext)[calm]
        assert np.sqrt(np.mean(error**2)) < limit, name
        assert abs(steps.plateau_error_percent) < 2.0, name
        assert found.methods[name].rms_error_aligned <= found.methods[name].rms_error
    assert abs(found.methods["offline"].steps.delay) < 1e-3
    assert found.methods["online"].steps.delay > 3e-3
    assert set(found.to_dict()["online"]) >= {"rms_error", "delay", "smallest_observable_force"}


def test_offline_is_the_exact_inverse_of_the_hold(pushed):
    """Without the hold modelled the error of (19) grows at every edge of the voltage."""
    gain, seen = AXIS.drive.force_gain, motion(pushed, 60.0)
    held = observe_offline(seen, held_force(pushed, gain, 60.0), AXIS)
    late = observe_offline(seen, low_pass(gain * pushed.u, 60.0, PERIOD), AXIS)
    truth = low_pass(0.5 * (pushed.f_ext + np.roll(pushed.f_ext, 1)), 60.0, PERIOD)
    away = np.abs(seen.v) > 0.01
    assert np.std((held - truth)[away]) < np.std((late - truth)[away])


def test_two_quadrant_axis_is_observed_with_its_effect():
    axis = machine("emps2018-two-quadrant").replace(drive={"current_time_constant": 0.0}, controller={
        "kind": "position_pd", "kp": 100.0, "kv": 300.0})  # fmt: skip
    t = np.arange(3000) * PERIOD
    run = Plant.of(axis).closed_loop(0.03 * (1 - np.cos(2 * np.pi * 0.5 * t)))
    record = Record(t=t, q_ref=run.q_ref, q=run.q, u=run.u, f_ext=np.zeros(3000), period=PERIOD, name="free")
    for result in observe(record, axis).methods.values():
        sliding = np.abs(run.v) > 0.02
        assert np.sqrt(np.mean(result.force[sliding] ** 2)) < 1.0


def test_kalman_bandwidth_is_what_was_asked_and_noise_grows_with_it():
    table = kalman_trade_off(AXIS, np.array([10.0, 30.0, 90.0]))
    np.testing.assert_allclose(table["bandwidth_hz"], [10.0, 30.0, 90.0], rtol=1e-3)
    assert np.all(np.diff(table["noise_std"]) > 0)
    assert np.all(np.diff(table["delay"]) < 0)


def test_kalman_noise_is_that_of_simulation():
    observer = KalmanForceObserver(AXIS, bandwidth_hz=60.0)
    noise = observer.position_noise * np.random.default_rng(0).standard_normal(60000)
    # Far above rest velocity in the state, the friction is constant; take it out by observing a sliding carriage.
    speed, n = 0.1, 60000
    hold = AXIS.mechanics.viscous * speed + AXIS.mechanics.coulomb + AXIS.mechanics.offset
    q = speed * PERIOD * np.arange(n) + noise
    force = observe_online(observer, q, np.full(n, hold / AXIS.drive.force_gain))[5000:]
    assert np.std(force) == pytest.approx(observer.noise_std, rel=0.05)


def test_smallest_force_is_the_largest_bound():
    stribeck = {"kind": "stribeck_friction", "excess": 3.0, "stribeck_velocity": 0.01, "exponent": 1.0}
    axis = AXIS.replace(effects=[stribeck])
    found = smallest_observable_force(axis, noise=5.0, parameter=1.0)
    assert found.bound == "break_away"
    assert found.value == pytest.approx(AXIS.mechanics.coulomb + 3.0)
    assert smallest_observable_force(AXIS, noise=50.0, parameter=1.0).bound == "noise"


def test_direct_validation_beats_the_cross_one(pushed):
    """(21)-(23): parameters from the same record leave less than parameters from elsewhere."""
    wrong = AXIS.replace(mechanics={"viscous": 230.0})
    direct = direct_validation(pushed, AXIS, model="symmetric", filter="hold", cutoff=40.0)
    cross = observe(pushed, wrong, offline_cutoff_hz=40.0).methods["offline"]
    assert direct.rms_error < cross.steps.rms_error_away_from_edges


def test_with_known_push_moves_it_from_the_voltage_to_the_outside(pushed):
    moved = with_known_push(pushed, np.ones(len(pushed)), 35.0)
    np.testing.assert_allclose(moved.u, pushed.u - 1.0)
    np.testing.assert_allclose(moved.f_ext, 35.0)


def test_refusals(pushed):
    with pytest.raises(InputError, match="cut-off: found 600 Hz"):
        ForceObserver(AXIS, cutoff_hz=600.0)
    with pytest.raises(InputError, match="cut-off: found 0 Hz"):
        observe(pushed, AXIS, offline_cutoff_hz=0.0)
    with pytest.raises(InputError, match="bandwidth_hz or force_rate, not both"):
        KalmanForceObserver(AXIS, bandwidth_hz=20.0, force_rate=1.0)
    with pytest.raises(InputError, match=r"bandwidth: found 300 Hz"):
        KalmanForceObserver(AXIS, bandwidth_hz=300.0)
    with pytest.raises(InputError, match=r"force rate: found -1"):
        KalmanForceObserver(AXIS, force_rate=-1.0)
    with pytest.raises(InputError, match="give encoder_resolution"):
        KalmanForceObserver(AXIS.replace(sampling={"encoder_resolution": 0.0}))
    with pytest.raises(RecordError, match=r"0\.1 s long, expected at least 1 s"):
        observe(pushed.part(0, 100), AXIS)
    with pytest.raises(RecordError, match="no measured external force"):
        direct_validation(with_known_push(pushed, np.zeros(len(pushed)), 1.0), AXIS)


def test_effects_that_the_motion_does_not_give_are_named(pushed):
    flexible = {"kind": "flexible_coupling", "frequency": 40.0, "damping": 0.05, "share": 0.4}
    found = observe(pushed, AXIS.replace(effects=[flexible]))
    assert [w for w in found.warnings if "flexible_coupling" in w and w.startswith("online: not included")]
    bare = observe(pushed, AXIS).methods["online"]
    np.testing.assert_array_equal(found.methods["online"].force, bare.force)


@pytest.mark.parametrize(
    "fault",
    [
        {"effects": [{"kind": "actuator_delay", "delay": 2.4e-3}]},
        {"effects": [{"kind": "actuator_deadzone", "width": 0.3}]},
        {"sampling": {"computation_delay": 2}},
        {"drive": {"current_time_constant": 2e-3}},
    ],
    ids=["delay", "dead zone", "computation", "current loop"],
)
def test_what_the_actuator_does_is_allowed_for(fault):
    """With the actuator's fault in the axis no observer takes it for an external force."""
    faulty = AXIS.replace(**fault)
    t = np.arange(4000) * PERIOD
    run = Plant.of(faulty).closed_loop(0.03 * (1 - np.cos(2 * np.pi * 1.5 * t)))
    record = Record(t=t, q_ref=run.q_ref, q=run.q, u=run.u, f_ext=np.zeros(4000), period=PERIOD, name="faulty")
    known, unknown = observe(record, faulty), observe(record, AXIS)
    calm = np.convolve(np.abs(run.v) < 0.03, np.ones(200), "same") == 0
    calm[:300] = calm[-300:] = False
    assert np.sum(calm) > 200
    for name, result in known.methods.items():
        rms, without = (np.sqrt(np.mean(x.force[calm] ** 2)) for x in (result, unknown.methods[name]))
        assert rms < 0.5 * without, name


def test_mass_that_changes_is_in_the_observer(pushed):
    """An effect that adds mass enters with the acceleration."""
    heavier = AXIS.replace(effects=[{"kind": "mass_change", "change": 0.1, "time": 0.0}])
    plain, changed = (observe_online(ForceObserver(axis), pushed.q, pushed.u) for axis in (AXIS, heavier))
    a = np.convolve(np.gradient(np.gradient(pushed.q, PERIOD), PERIOD), np.ones(20) / 20, "same")
    assert np.polyfit(a[500:], (changed - plain)[500:], 1)[0] == pytest.approx(0.1 * AXIS.mechanics.mass, rel=0.3)


def test_every_effect_with_a_column_gives_a_finite_force(pushed):
    """A model that a diagnosis extended runs through the observers, whatever was found."""
    from emps_design.effects import EFFECTS

    for effect in EFFECTS:
        small = {p.name: p.starts[0] if p.starts else max(p.lower, min(1e-6, p.upper)) for p in effect.parameters}
        motion = effect.motion or "linear"
        found = observe(pushed, AXIS.replace(motion=motion, effects=[{"kind": effect.name, **small}]))
        for result in found.methods.values():
            start, stop = (round(edge / PERIOD) for edge in result.reliable)
            assert np.all(np.isfinite(result.force[start:stop])), effect.name


def test_no_number_where_an_observer_cannot_know(pushed):
    """The ends of the record are left empty, and what is left is as good there as elsewhere."""
    found = observe(pushed, AXIS)
    for name, result in found.methods.items():
        start, stop = (round(edge / PERIOD) for edge in result.reliable)
        assert np.all(np.isnan(result.force[:start]))
        assert np.all(np.isnan(result.force[stop:]))
        assert start >= 0.03 / PERIOD
        assert (stop == len(pushed)) == (name != "offline")
        early = (result.force - pushed.f_ext)[start : start + 100]
        assert np.sqrt(np.mean(early**2)) < 3.0 + 3.0 * result.steps.rms_error_away_from_edges
    with pytest.raises(RecordError, match=r"4 s long, expected at least 5\.\d+ s to observe with these cut-offs"):
        observe(pushed.part(0, 4000), AXIS, offline_cutoff_hz=1.5)


def test_a_record_with_gaps_is_observed_in_its_pieces(pushed):
    record = lost(pushed, 1500, 1900)
    found, bridged, whole = (observe(one, AXIS).methods for one in (record, as_one(record), pushed))
    for name, result in found.items():
        assert np.all(np.isnan(result.force[1500:1900]))
        assert np.all(np.isfinite(result.force[2200:3500]))
        assert result.rms_error < 1.2 * whole[name].rms_error < bridged[name].rms_error
    with pytest.raises(RecordError, match=r"no piece between its gaps is 0\.\d+ s long"):
        observe(replace(pushed, bridged=(np.arange(4000) % 200 < 11).astype(float)), AXIS)


def test_long_work_says_how_far_it_is(pushed):
    heard = []
    observe(pushed, AXIS, progress=lambda stage, fraction: heard.append((stage, fraction)))
    assert list(dict(heard)) == ["off-line observer", "online observer", "kalman observer"]
    fractions = [fraction for _, fraction in heard]
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)


def test_a_motor_that_is_switched_off_gives_no_force_and_brakes_nothing():
    """The carriage is pushed through 2 s in which the drive asks for force and gives none."""
    axis = machine("emps2019").replace(drive={"back_emf": 8.0}, sampling={"encoder_resolution": 1e-8})
    t = np.arange(8000) * axis.sampling.period
    enable = np.where((t > 3.0) & (t < 5.0), 0.0, 1.0)
    push = np.where(enable > 0.0, 0.0, 60.0 * np.sin(2.0 * np.pi * 0.5 * (t - 3.0)))
    run = Plant.of(axis).closed_loop(0.05 * np.sin(2.0 * t), disturbance=push, enable=enable)
    record = Record.from_arrays(axis.sampling.period, run.q_ref, run.q, run.u, f_ext=push, enable=enable)
    found = observe(record, axis)
    off = (t > 3.2) & (t < 4.8) & (np.abs(run.v) > 0.01)
    assert off.sum() > 500
    for method, most in (("offline", 1.0), ("online", 8.0), ("kalman", 8.0)):
        error = found.methods[method].force[off] - push[off]
        assert float(np.sqrt(np.mean(error**2))) < most, method
    wrong = observe(replace(record, enable=None), axis).methods["offline"].force[off] - push[off]
    assert float(np.sqrt(np.mean(wrong**2))) > 30.0


@pytest.mark.parametrize("bandwidth", [0.06, 0.2, 0.35, 0.7, 2.0, 150.0])
def test_a_bandwidth_that_is_asked_for_is_reached(bandwidth):
    assert KalmanForceObserver(AXIS, bandwidth_hz=bandwidth).bandwidth_hz == pytest.approx(bandwidth, rel=1e-3)


def test_a_bandwidth_too_low_to_be_reached_is_refused():
    with pytest.raises(InputError, match="bandwidth: found 0.02 Hz, expected between 0.05 and 200 Hz"):
        KalmanForceObserver(AXIS, bandwidth_hz=0.02)


def test_steps_without_a_complete_edge_have_no_delay_and_one_height_alone_is_no_step():
    truth = np.zeros(4000)
    truth[50:3950] = 1.0
    assert step_answer(truth, truth, 1e-3, slice(250, 3750)) is None
    truth[2000:2050] = 0.0
    truth[2500:3000] = 0.0
    force = truth.copy()
    force[[1990, 2040, 2510, 2990]] = np.nan  # near every edge
    found = step_answer(force, truth, 1e-3, slice(250, 3750))
    assert (found.delay, found.rise_time) == (None, None)


def test_a_slow_axis_keeps_its_friction_and_a_slow_clock_its_observers():
    """Half a millimetre a second: friction of 20 N is no external force there. At 100 Hz the cut-offs are lower."""
    axis = machine("emps2019").replace(controller={"kp": 30.0, "kv": 100.0})
    t = 1e-3 * np.arange(20_000)
    q_ref = 1e-3 * (1.0 - np.cos(2.0 * np.pi * t / 10.0))
    run = Plant.of(axis).closed_loop(q_ref)
    assert np.abs(run.v).max() < 1e-3
    found = observe(Record.from_arrays(1e-3, q_ref, run.q, run.u), axis)
    moving = np.abs(run.v) > 2e-4
    for one in found.methods.values():
        assert np.nanmedian(np.abs(one.force[moving])) < 0.05 * axis.mechanics.coulomb
    slow = axis.replace(sampling={"period": 0.01}, controller={"kp": 3.0, "kv": 10.0})
    q_ref = 0.1 * (1.0 - np.cos(2.0 * np.pi * 0.01 * np.arange(3000) / 5.0))
    run = Plant.of(slow).closed_loop(q_ref)
    record = Record.from_arrays(0.01, q_ref, run.q, run.u)
    assert {*observe(record, slow).methods} == {"offline", "online", "kalman"}
    with pytest.raises(
        InputError, match=r"`cutoff_hz`: found 12 Hz, expected less than 10 Hz, a tenth of the sampling"
    ):
        observe(record, slow, cutoff_hz=12.0)


@pytest.mark.parametrize("constant", [0.4, 2.0, 7.5])
def test_the_mean_of_a_lagging_command_over_each_period(constant):
    """A step, and the exponential that follows it, averaged over fine steps of time."""
    fine = np.linspace(0.0, 1.0, 2001)
    means = [np.trapezoid(1.0 - np.exp(-(k + fine) / constant), fine) for k in range(20)]
    step = np.concatenate([[0.0, 0.0], np.ones(20)])
    np.testing.assert_allclose(_lag(step, constant), [0.0, 0.0, *means], atol=1e-6)
