"""The 95 % intervals hold what they promise; the plain ones of (15) do not, on the same runs."""

import numpy as np
import pytest

from emps_design.errors import InputError
from emps_design.identification import identify
from emps_design.identification.statistics import hac_covariance, long_run, residual_bootstrap
from emps_design.machines import machine

RUNS = 200


@pytest.mark.study("coverage over 200 records")
@pytest.mark.parametrize("noise_time", [0.03, 0.3])
def test_intervals_cover_the_truth(simulate, truth, noise_time):
    values, held, plain = np.array(list(truth.values())), np.zeros(4), np.zeros(4)
    for seed in range(RUNS):
        record = simulate(seed, laps=2, time=noise_time)
        found = identify(record, machine("emps2019"), estimator="ls", cutoff=30.0).parameters.values()
        low, high = np.array([one.interval_95 for one in found]).T
        held += (low <= values) & (values <= high)
        plain += np.abs([one.value for one in found] - values) <= 1.96 * np.array([one.std for one in found])
    assert np.all((held / RUNS >= 0.90) & (held / RUNS <= 0.98)), held / RUNS
    assert np.all(plain / RUNS < 0.60), plain / RUNS


@pytest.mark.parametrize("lag", [0, 1, 40])
def test_the_sum_over_lags_is_that_of_statsmodels(lag):
    sandwich = pytest.importorskip("statsmodels.stats.sandwich_covariance", reason="statsmodels is not installed")
    rng = np.random.default_rng(lag)
    W, e = rng.standard_normal((300, 3)), rng.standard_normal(300)
    bread = np.linalg.inv(W.T @ W)
    expected = bread @ sandwich.S_hac_simple(W * e[:, None], nlags=lag) @ bread.T
    assert hac_covariance(W, e, lag) == pytest.approx(expected, rel=1e-12)


def noise(n, rho, seed):
    from scipy.signal import lfilter

    return lfilter([1.0], [1.0, -rho], np.random.default_rng(seed).standard_normal(n))


def test_long_run_of_a_mean_is_the_textbook_one():
    """The mean of an AR(1) process has variance sigma^2 / (n (1 - rho)^2)."""
    n, rho = 20000, 0.9
    found = long_run(np.ones((n, 1)), noise(n, rho, 1) - noise(n, rho, 1).mean(), np.ones(n, bool), 1.0)
    assert found.std[0] == pytest.approx(1 / (np.sqrt(n) * (1 - rho)), rel=0.1)
    assert found.correlation_time == pytest.approx(0.5 * (1 + rho) / (1 - rho), rel=0.15)
    assert found.effective_samples == pytest.approx(n * (1 - rho) / (1 + rho), rel=0.15)


def test_hac_and_bootstrap_agree_with_it():
    n, rho = 4000, 0.9
    W, e = np.ones((n, 1)), noise(n, rho, 2)
    expected = long_run(W, e - e.mean(), np.ones(n, bool), 1.0).std[0]
    assert np.sqrt(hac_covariance(W, e - e.mean(), 100)[0, 0]) == pytest.approx(expected, rel=0.25)
    used = np.ones(n, bool)
    bootstrap = residual_bootstrap(W, e - e.mean(), used, long_run(W, e - e.mean(), used, 1.0), draws=300, seed=1)
    assert np.sqrt(float(bootstrap)) == pytest.approx(expected, rel=0.1)


def test_gaps_do_not_hide_the_correlation():
    """Noise over 20 rows in stretches of 30: pairs across a gap are missing, not uncorrelated."""
    used = np.arange(30000) % 60 < 30
    W, e = used[:, None].astype(float), noise(30000, 0.95, 3) * used
    e = e - e[used].mean() * used
    whole = noise(30000, 0.95, 3)
    expected = long_run(np.ones((30000, 1)), whole - whole.mean(), np.ones(30000, bool), 1.0).correlation_time
    assert long_run(W, e, used, 1.0).correlation_time == pytest.approx(expected, rel=0.15)


def test_too_few_rows_are_refused():
    with pytest.raises(InputError, match="found 10 usable rows, expected at least 20"):
        long_run(np.ones((10, 1)), np.ones(10), np.ones(10, bool), 1.0)
