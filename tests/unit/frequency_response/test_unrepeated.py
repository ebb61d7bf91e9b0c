"""Sweeps and random excitation: blocks of the right length, honest deviations, the masses behind them."""

import numpy as np
import pytest
from scipy.signal import butter, chirp, lfilter

from emps_design.errors import RecordError
from emps_design.frequency_response import estimate_response
from emps_design.frequency_response.estimate import Lines, longest_blocks
from emps_design.frequency_response.response import BAND
from emps_design.machines import machine
from tests.studies import quick
from tests.unit.frequency_response.cases import exact, passes, run, two_mass

SECONDS = 20


def record_of(axis, excitation, newtons, rng, count=2):
    """The record of ``axis`` on ``count`` passes with the same ``excitation`` on each."""
    q_ref, starts = passes(1e-3, excitation.size + 500, count, 0.06)
    added = np.zeros(q_ref.size)
    for start in starts:
        added[start + 250 : start + 250 + excitation.size] = excitation
    return run(axis, q_ref, added, newtons * rng.standard_normal(q_ref.size))


def sweep(method, volts=0.5, seconds=SECONDS):
    """A sweep from 2 to 250 Hz that swells and fades."""
    t = np.arange(1000 * seconds) * 1e-3
    return volts * chirp(t, 2.0, seconds, 250.0, method=method) * np.clip(np.minimum(t, seconds - t) / 0.1, 0.0, 1.0)


def inside(found, axis):
    """Whether the 95 % circle of each line holds the exact response (n,)."""
    response = found.response
    return np.abs(response.response / exact(axis, response.frequency) - 1.0) <= BAND * response.std


@pytest.mark.parametrize("method", quick(["linear", "logarithmic"], 1, "the other sweep"))
def test_a_sweep(method):
    axis = machine("emps2019")
    found = estimate_response(record_of(axis, sweep(method), 1.0, np.random.default_rng(3)), axis)
    assert found.method == "local-polynomial"
    assert found.response.frequency[0] < 9.0
    assert 200.0 < found.response.frequency[-1] < 255.0  # beyond there is leakage alone
    assert np.mean(inside(found, axis)) >= 0.9
    chain = found.comparison.chain
    mass, std, _ = chain.parameters["mass"]
    assert chain.masses.size == 1
    assert abs(mass - axis.mechanics.mass) < 3.5 * std < 1.0


def lines_of(frequency, variance, kept):
    """Lines of which only what decides between block lengths is given."""
    return Lines(frequency, frequency, np.broadcast_to(variance, frequency.shape), frequency, kept)


def test_each_part_of_a_band_is_of_the_longest_blocks_that_serve_it():
    """Blocks twice as long have twice the variance a line at the same information; above 100 Hz theirs is noise."""
    short, long = np.arange(2.0, 250.0), np.arange(4.0, 500.0) / 2.0
    parts = [lines_of(short, 0.01, short < 240.0), lines_of(long, 0.02, long < 100.0)]
    below, above = (part.frequency[mask] for part, mask in zip(parts[::-1], longest_blocks(parts)[::-1], strict=True))
    assert (below[0], above[-1]) == (2.0, 249.0)
    assert 96.0 < below[-1] < above[0] < 104.0
    assert np.all(np.diff(above) == 1.0)
    # With less than half of the information nowhere; where that is so on a few lines only, everywhere.
    parts[1] = lines_of(long, np.where(np.abs(long - 40.0) < 1.0, 1.0, 0.03), long < 1e3)
    assert [np.count_nonzero(mask) for mask in longest_blocks(parts)] == [0, long.size]
    parts = [lines_of(short, 0.01, short < 1e3), lines_of(long, 0.05, long <= 249.0)]
    assert [np.count_nonzero(mask) for mask in longest_blocks(parts)] == [short.size, 0]
    # Without any line the longest stand for all.
    nothing = [lines_of(part.frequency, 0.01, part.frequency < 0.0) for part in parts]
    assert [np.count_nonzero(mask) for mask in longest_blocks(nothing)] == [0, long.size]


def test_random_excitation_resolves_a_slow_resonance():
    axis = machine("emps2019").replace(
        effects=[{"kind": "flexible_coupling", "frequency": 12.0, "damping": 0.02, "share": 0.4}]
    )
    rng = np.random.default_rng(1)
    noise = lfilter(*butter(2, 0.6), rng.standard_normal(1000 * SECONDS))
    found = estimate_response(record_of(axis, np.clip(0.4 * noise, -1.2, 1.2), 0.5, rng), axis, high=250.0)
    near = np.abs(found.response.frequency - 11.0) < 4.0
    assert np.mean(inside(found, axis)) >= 0.9
    assert np.mean(inside(found, axis)[near]) >= 0.8
    chain = found.comparison.chain
    assert chain.masses.size == 2
    for name, value in (("frequency", 12.0), ("share", 0.4), ("mass", axis.mechanics.mass)):
        assert abs(chain.parameters[name][0] - value) < 3.5 * chain.parameters[name][1], name
    assert all(np.isfinite(std) for _, std, _ in chain.parameters.values())


def test_the_width_of_averaged_spectra_is_in_their_deviations():
    axis = machine("emps2019")
    record = record_of(axis, sweep("linear"), 1.0, np.random.default_rng(3))
    found = estimate_response(record, axis, method="welch")
    assert np.mean(inside(found, axis)) >= 0.9
    chain = found.comparison.chain
    assert chain.parameters["mass"][0] == pytest.approx(axis.mechanics.mass, rel=0.02)


@pytest.mark.parametrize("masses", quick([1, 2], 1, "the other machine"))
def test_averaged_spectra_of_random_excitation_are_as_good_as_they_say(masses):
    """Below 100 Hz, with 1 N of noise that is independent of the excitation: of one generator they may not be."""
    axis, held = machine("emps2019") if masses == 1 else two_mass(), []
    for seed in (61, 62):
        excitation, disturbance = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
        record = record_of(axis, 0.3 * excitation.standard_normal(1000 * SECONDS), 1.0, disturbance)
        found = estimate_response(record, axis, method="welch", low=5.0, high=100.0)
        f = found.response.frequency
        held.append([np.mean(inside(found, axis)[(f >= low) & (f < low + 35.0)]) for low in (5.0, 35.0, 65.0)])
    assert np.min(np.mean(held, axis=0)) >= 0.93


@pytest.mark.parametrize("kind", ["sweep", "noise"])
def test_averaged_spectra_without_noise_are_no_better_than_they_say(kind):
    """What the windows cut off is the same on every pass, and the aliases of a plant with a lag do not cancel."""
    lag, fine = {"current_time_constant": 0.5e-3}, {"encoder_resolution": 1e-12}
    axis = machine("emps2019").replace(drive=lag, sampling=fine)
    rng = np.random.default_rng(5)
    noise = 0.4 * lfilter(*butter(2, 0.6), rng.standard_normal(30_000))
    excitation = sweep("linear", seconds=30) if kind == "sweep" else np.clip(noise, -1.2, 1.2)
    found = estimate_response(record_of(axis, excitation, 0.0, rng), axis, method="welch", high=200.0)
    f, held = found.response.frequency, inside(found, axis)
    assert f[0] < 15.0
    for low, high in ((0.0, 20.0), (20.0, 60.0), (60.0, 200.1)):
        band = (f >= low) & (f < high)
        assert np.mean(held[band]) >= 0.9, (low, high)
        assert np.median(found.response.std[band]) < 1e-2


def test_a_sweep_once_on_each_of_many_passes():
    axis = machine("emps2019")
    record = record_of(axis, sweep("linear", seconds=8), 0.5, np.random.default_rng(4), count=4)
    for method in ("local-polynomial", "welch"):
        found = estimate_response(record, axis, method=method, high=200.0)
        assert np.mean(inside(found, axis)) >= 0.9
    assert estimate_response(record, axis).method == "local-polynomial"


def test_a_band_without_excitation_is_refused_for_that():
    axis = machine("emps2019")
    record = record_of(axis, sweep("linear"), 1.0, np.random.default_rng(3))
    with pytest.raises(RecordError, match="excited lines, .* excite that band"):
        estimate_response(record, axis, low=300.0, high=390.0)
