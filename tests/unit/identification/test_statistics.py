"""The 95 % intervals hold what they promise; the plain ones of (15) do not, on the same runs."""

import numpy as np
import pytest

from emps_design.errors import InputError
from emps_design.identification.coverage import coverage
from emps_design.identification.statistics import block_bootstrap, hac_covariance, long_run
from emps_design.machines import machine

RUNS = 200


@pytest.mark.slow
@pytest.mark.parametrize("noise_time", [0.03, 0.1, 0.3])
def test_intervals_cover_the_truth(noise_time):
    found = coverage(machine("emps2019"), RUNS, noise_time)
    assert all(0.90 <= share <= 0.98 for share in found.long_run.values()), found.long_run
    assert all(share < 0.60 for share in found.plain.values()), found.plain


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
    bootstrap = block_bootstrap(W, e, np.array([e.mean()]), 100, draws=300, seed=1)
    assert np.sqrt(float(bootstrap)) == pytest.approx(expected, rel=0.25)


def test_too_few_rows_are_refused():
    with pytest.raises(InputError, match="found 50 usable rows, expected at least 80"):
        long_run(np.ones((50, 1)), np.ones(50), np.ones(50, bool), 1.0)
