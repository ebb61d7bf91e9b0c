"""Sweeps and random excitation: blocks of the right length, honest deviations, the masses behind them."""

import numpy as np
import pytest
from scipy.signal import butter, chirp, lfilter

from emps_design.errors import RecordError
from emps_design.frequency_response import estimate_response
from emps_design.frequency_response.response import BAND
from emps_design.machines import machine
from tests.studies import quick
from tests.unit.frequency_response.cases import exact, passes, run

SECONDS = 20


def record_of(axis, excitation, newtons, rng):
    """The record of ``axis`` on two passes with the same ``excitation`` on each."""
    q_ref, starts = passes(1e-3, excitation.size + 500, 2, 0.06)
    added = np.zeros(q_ref.size)
    for start in starts:
        added[start + 250 : start + 250 + excitation.size] = excitation
    return run(axis, q_ref, added, newtons * rng.standard_normal(q_ref.size))


def sweep(method, volts=0.5):
    """A sweep from 2 to 250 Hz that swells and fades."""
    t = np.arange(1000 * SECONDS) * 1e-3
    return volts * chirp(t, 2.0, SECONDS, 250.0, method=method) * np.clip(np.minimum(t, SECONDS - t) / 0.1, 0.0, 1.0)


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


def test_a_band_without_excitation_is_refused_for_that():
    axis = machine("emps2019")
    record = record_of(axis, sweep("linear"), 1.0, np.random.default_rng(3))
    with pytest.raises(RecordError, match="lines that the instrument excites, .* excite that band"):
        estimate_response(record, axis, low=300.0, high=390.0)
