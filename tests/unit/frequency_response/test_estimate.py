"""Estimated responses against the exact ones of simulated axes, and how often their bands hold them."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.errors import AxisError, RecordError
from emps_design.frequency_response import estimate_response
from emps_design.frequency_response.answers import Spectra, distortion_of
from emps_design.frequency_response.response import BAND
from emps_design.frequency_response.signals import signals_of, steps_of
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from tests.unit.frequency_response.cases import exact, experiment, multi_sine, passes, run, two_mass


def covered(found, axis):
    """Share of the lines whose 95 % circle holds the exact response, and the median error."""
    error = np.abs(found.response.response / exact(axis, found.response.frequency) - 1.0)
    return float(np.mean(error <= BAND * found.response.std)), float(np.median(error))


def test_multi_sine_on_passes():
    axis, shares = two_mass(), []
    for seed in range(4):
        found = estimate_response(experiment(axis, seed), axis)
        share, error = covered(found, axis)
        shares.append(share)
        assert (found.method, found.instrument, found.passes, found.periods) == ("periodic", "excitation", 4, 16)
        assert error < 0.03
        assert found.reversals == 0
        assert found.warnings == () or "left out" in found.warnings[0]
        low, high = (one for one in found.resonances)
        assert (low.kind, high.kind) == ("antiresonance", "resonance")
        assert low.frequency == pytest.approx(60.0 * np.sqrt(0.6), rel=5e-3)
        assert high.frequency == pytest.approx(60.0, rel=5e-3)
    assert np.mean(shares) >= 0.93


def test_the_ratio_of_spectra_is_biased_where_noise_moves_the_loop():
    axis, joint, ratio = two_mass(), [], []
    for seed in range(8):
        found = estimate_response(experiment(axis, seed, volts=0.15, newtons=5.0, periods=9, top=60.0), axis)
        inside = (found.response.frequency > 22.0) & (found.response.frequency < 40.0)
        truth = exact(axis, found.response.frequency[inside])
        for errors, g in ((joint, found.response.response), (ratio, found.spectral_ratio)):
            errors.append(np.mean(g[inside] / truth - 1.0))
    assert abs(np.mean(joint)) < 3.0 * np.std(joint) / np.sqrt(8)
    assert abs(np.mean(ratio)) > 6.0 * np.std(ratio) / np.sqrt(8)
    assert abs(np.mean(ratio)) > 4.0 * abs(np.mean(joint))


def test_computation_delay_and_force_gain_are_divided_out():
    axis = machine("emps2019").replace(sampling={"computation_delay": 1}, drive={"force_gain": 20.0})
    found = estimate_response(experiment(axis, 1, volts=1.0), axis)
    share, error = covered(found, axis)
    assert share >= 0.93
    assert error < 0.03


def test_reference_as_instrument():
    axis, period, samples = machine("emps2019"), 1e-3, 1000
    rng = np.random.default_rng(3)
    q_ref, starts = passes(period, 200 + 5 * samples, 4, 0.06)
    wobble = 1e-5 * np.tile(multi_sine(samples, np.arange(3, 60, 2), rng, corner=1000), 5)
    for start in starts:
        q_ref[start + 200 : start + 200 + wobble.size] += wobble
    found = estimate_response(run(axis, q_ref, np.zeros(q_ref.size), 0.1 * rng.standard_normal(q_ref.size)), axis)
    assert (found.method, found.instrument) == ("periodic", "reference")
    share, error = covered(found, axis)
    assert share >= 0.9
    assert error < 0.05


@pytest.mark.parametrize("method", ["local-polynomial", "welch"])
def test_noise_as_excitation(method):
    axis, rng = machine("emps2019"), np.random.default_rng(7)
    q_ref, starts = passes(1e-3, 8200, 4, 0.05)
    excitation = np.zeros(q_ref.size)
    for start in starts:
        excitation[start + 100 : start + 8100] = 0.5 * rng.standard_normal(8000)
    record = run(axis, q_ref, excitation, 0.3 * rng.standard_normal(q_ref.size))
    found = estimate_response(record, axis, method=method, low=5.0, high=200.0)
    assert found.method == method
    share, error = covered(found, axis)
    assert share >= 0.9
    assert error < 0.1


def test_one_period_takes_the_local_polynomial_method():
    axis, rng = two_mass(), np.random.default_rng(9)
    samples = 8000
    q_ref, starts = passes(1e-3, samples + 400, 1, 0.05)
    excitation = np.zeros(q_ref.size)
    excitation[starts[0] + 200 : starts[0] + 200 + samples] = 0.5 * multi_sine(samples, np.arange(40, 1600), rng, 500)
    found = estimate_response(run(axis, q_ref, excitation, 0.3 * rng.standard_normal(q_ref.size)), axis, low=5.0)
    assert found.method == "local-polynomial"
    share, error = covered(found, axis)
    assert share >= 0.9
    assert error < 0.05


def test_friction_at_rest_is_seen_and_said():
    axis = machine("emps2019")
    found = estimate_response(experiment(axis, 2, volts=3.0, speed=0.001, newtons=0.1), axis)
    assert found.reversals > 100
    assert any("dry friction biases the response" in warning for warning in found.warnings)
    assert found.distortion.odd > 0.05
    assert any("odd nonlinear distortion" in warning for warning in found.warnings)


def test_distortion_is_what_is_left_at_lines_without_excitation_once_noise_is_taken_off():
    """A response of 2, noise of 0.01 in position power, and 0.3 of it more at odd lines that were left out."""
    line = np.arange(1, 80)
    excited = (line % 2 == 1) & (line % 10 != 5)
    noise = np.zeros((line.size, 2, 2), dtype=complex)
    noise[:, 0, 0] = 0.01
    extra = np.where(line % 2 == 1, 0.3, 0.0)
    z = np.stack([np.where(excited, 2.0, np.sqrt(extra**2 + 0.01)), excited.astype(float)], axis=1)
    nothing = np.zeros(line.size)
    passed = Spectra(line, excited.astype(float), z, noise, 10, 4, excited, nothing, 0.0)
    found = distortion_of([passed], excited, 0.5, np.full(np.count_nonzero(excited), 2.0))
    assert found.odd == pytest.approx(0.3 / 2.0)
    assert found.even == 0.0
    np.testing.assert_allclose(found.odd_power, 0.15**2)
    assert found.noise == pytest.approx(np.sqrt(0.01 * 4) / 2.0)


def test_a_running_carriage_distorts_nothing():
    found = estimate_response(experiment(machine("emps2019"), 2), machine("emps2019"))
    assert (found.distortion.odd, found.distortion.even) == (0.0, 0.0)


def test_coulomb_friction_off_or_on_is_a_constant_on_a_running_carriage():
    axis = machine("emps2019")
    smooth = axis.replace(mechanics={"coulomb": 0.0})
    with_it, without = (estimate_response(experiment(one, 4, newtons=0.0), one) for one in (axis, smooth))
    slow = [one.response.between(5.0, 30.0).response for one in (with_it, without)]
    assert np.max(np.abs(slow[0] / slow[1] - 1.0)) < 3e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"high": 700.0}, "case: found a frequency of 700 Hz, expected at most the Nyquist frequency, 500 Hz"),
        ({"low": 700.0}, "case: found a frequency of 700 Hz, expected at most the Nyquist frequency, 500 Hz"),
        ({"instrument": "reference", "method": "periodic"}, "case: .*expected"),
        ({"method": "stepped"}, "case: found 0 steps at different lines, expected at least 4"),
    ],
)
def test_refused(change, message):
    axis = machine("emps2019")
    with pytest.raises(RecordError, match=message):
        estimate_response(experiment(axis, count=2, periods=2), axis, **change)


def test_too_little_excitation_is_refused():
    axis = machine("emps2019")
    with pytest.raises(
        RecordError,
        match="found .* lines where the answer to the excitation is above the noise.*; increase the amplitude",
    ):
        estimate_response(experiment(axis, volts=1e-4, newtons=2.0, count=2, periods=2), axis)


def test_the_period_is_found_among_many_passes():
    rng = np.random.default_rng(5)
    q_ref, starts = passes(1e-3, 200 + 3 * 400, 80, 0.05)
    excitation, wave = np.zeros(q_ref.size), np.tile(multi_sine(400, np.arange(3, 60, 2), rng), 3)
    for start in starts:
        excitation[start + 200 : start + 200 + wave.size] = wave
    record = Record.from_arrays(1e-3, q_ref, q_ref, 1.0 + excitation, name="many", excitation=excitation)
    found = signals_of(record)
    assert (found.repeats, len(found.stretches)) == (400, 80)


def test_no_reference_is_refused():
    axis, t = machine("emps2019"), np.arange(2000) * 1e-3
    record = Record.from_arrays(1e-3, np.full(t.size, 0.1), 1e-4 * np.sin(9 * t), np.sin(9 * t), name="still")
    with pytest.raises(RecordError, match="still: found no excitation and a reference at rest"):
        estimate_response(record, axis)


def test_a_record_without_reference_takes_its_excitation():
    axis, record = two_mass(), experiment(two_mass())
    found = estimate_response(replace(record, q_ref_recorded=False), axis)
    assert found.instrument == "excitation"
    assert covered(found, axis)[1] < 0.03
    with pytest.raises(RecordError, match="no excitation"):
        estimate_response(replace(record, q_ref_recorded=False, excitation=None), axis)
    with pytest.raises(RecordError, match="found no column excitation"):
        estimate_response(replace(record, excitation=None), axis, instrument="excitation")


def test_records_of_different_periods_are_refused():
    axis = machine("emps2019")
    one = experiment(axis, count=2, periods=2)
    other = Record.from_arrays(2e-3, one.q_ref, one.q, one.u, name="slow", excitation=one.excitation)
    with pytest.raises(RecordError, match="slow: sampled every 0.002 s, case every 0.001 s"):
        estimate_response([one, other], axis)


def test_another_period_than_that_of_a_delay_in_samples_is_refused():
    axis = machine("emps2019").replace(sampling={"computation_delay": 1, "period": 5e-4})
    with pytest.raises(RecordError, match="its computation delay is in samples"):
        estimate_response(experiment(machine("emps2019"), count=2, periods=2), axis)


def test_steps_of_a_drive_that_counts_no_blocks():
    t, period = np.arange(80_000), 1e-3
    frequency = np.repeat([2.3, 3.7, 9.1, 17.9, 41.3], 16_000)
    phase = 2.0 * np.pi * np.cumsum(frequency) * period
    excitation = np.where(t % 16_000 < 14_000, np.sin(phase), 0.0)
    steps = steps_of(excitation)
    found = [step.turns / step.samples / period for step in steps]
    assert found == pytest.approx([2.3, 3.7, 9.1, 17.9, 41.3], rel=1e-3)
    assert all(step.stop - step.start >= 2 * step.samples for step in steps)
    assert steps_of(np.random.default_rng(1).standard_normal(100_000)) == ()
    assert steps_of(np.zeros(1000)) == ()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"low": 300.0, "high": 100.0}, "found a band from 300 to 100 Hz, expected its lowest frequency below"),
        ({"method": "local-polynomial", "low": 499.0}, "found a band from 499 to 400 Hz"),
    ],
)
def test_a_band_without_lines_is_refused(options, message):
    axis = two_mass()
    with pytest.raises(RecordError, match=message):
        estimate_response(experiment(axis), axis, **options)


def test_averaged_spectra_need_blocks_to_average():
    axis = two_mass()
    q_ref, _ = passes(1e-3, 1050, 1, 0.05)
    rng = np.random.default_rng(0)
    record = run(axis, q_ref, 0.4 * rng.standard_normal(q_ref.size), 0.5 * rng.standard_normal(q_ref.size))
    with pytest.raises(RecordError, match="blocks of 0.5 s, expected at least 4 for averaged spectra"):
        estimate_response(record, axis, method="welch")


def test_periods_that_differ_between_records_are_refused():
    axis = two_mass()
    with pytest.raises(RecordError, match="found different periods"):
        estimate_response([experiment(axis), experiment(axis, samples=500)], axis, method="periodic")


SUPPLY = 12.0


def duty(**drive):
    """The embedded machine with a duty as its command, at ``SUPPLY`` as strong as with its voltage up to 10 V."""
    base = machine("emps2019")
    table = base.to_dict()
    gain = 10.0 * base.drive.gain / SUPPLY
    table["drive"] = {"command": "duty", "force_gain": gain, "command_limit": 1.0, "supply": SUPPLY, **drive}
    table["controller"]["kv"] = 0.1 * base.controller.kv
    return type(base).from_dict(table)


def bare(axis):
    """``axis`` without a supply of its own."""
    table = axis.to_dict()
    del table["drive"]["supply"]
    return type(axis).from_dict(table)


def duty_record(axis, supply, enable=None):
    """A record of ``axis`` with its ``supply`` (n,), as :func:`experiment` makes it."""
    q_ref, excitation, rng = *duty_program(), np.random.default_rng(6)
    found = Plant.of(axis).closed_loop(
        q_ref, disturbance=0.3 * rng.standard_normal(q_ref.size), voltage_noise=excitation, supply=supply, enable=enable
    )
    columns = {"excitation": excitation, "supply": supply, "enable": enable}
    return Record.from_arrays(1e-3, found.q_ref, found.q, found.u, name="duty", **columns)


def duty_program():
    """Reference and excitation (n,) of four passes with four periods that count on each."""
    q_ref, starts = passes(1e-3, 5200, 4, 0.05)
    excitation, rng = np.zeros(q_ref.size), np.random.default_rng(8)
    lines = np.arange(3, 250, 2)
    wave = np.tile(0.04 * multi_sine(1000, lines[np.arange(lines.size) % 4 != 3], rng), 5)
    for start in starts:
        excitation[start + 200 : start + 5200] = wave
    return q_ref, excitation


def unbiased(found, axis):
    """The mean of found over exact, less 1, below 60 Hz."""
    low = found.response.between(0.0, 60.0)
    return abs(np.mean(low.response / exact(axis, low.frequency)) - 1.0)


def test_the_supply_of_a_duty_is_that_of_the_record():
    axis, n = duty(), duty_program()[0].size
    record = duty_record(axis, np.full(n, SUPPLY))
    found, same = estimate_response(record, bare(axis)), estimate_response(replace(record, supply=None), axis)
    assert np.allclose(found.response.response, same.response.response, rtol=1e-9)
    assert np.allclose(found.spectral_ratio, same.spectral_ratio, rtol=1e-9)
    assert found.axis.drive.supply == SUPPLY
    assert found.comparison.agreement.sentence == same.comparison.agreement.sentence
    assert covered(found, axis)[0] >= 0.9
    with pytest.raises(AxisError, match=r"drive\.supply: missing"):
        estimate_response(replace(record, supply=None), bare(axis))


@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.parametrize("back_emf", [0.0, 1.0])
def test_a_supply_that_sags_is_no_change_of_the_plant(back_emf, delay):
    n = duty_program()[0].size
    axis = duty(back_emf=back_emf).replace(sampling={"computation_delay": delay})
    record = duty_record(axis, np.where(np.arange(n) < n // 2, SUPPLY, 0.8 * SUPPLY))
    for one in (axis, bare(axis)):
        found = estimate_response(record, one)
        assert unbiased(found, axis) < 0.01
        assert covered(found, axis)[0] >= 0.9
    assert unbiased(estimate_response(replace(record, supply=None), axis), axis) > 0.05


def test_where_the_motor_is_off_there_is_no_force():
    axis, n = duty(back_emf=20.0), duty_program()[0].size
    supply, enable = np.full(n, SUPPLY), np.ones(n)
    enable[n // 2 :] = 0.0
    found = estimate_response(duty_record(axis, supply, enable), axis)
    assert (found.passes, unbiased(found, axis) < 0.01) == (2, True)
    record = duty_record(axis, supply, enable)
    with pytest.raises(RecordError, match="duty: found enable 0 wherever the excitation could be used"):
        estimate_response(replace(record, enable=np.zeros(n)), axis)
