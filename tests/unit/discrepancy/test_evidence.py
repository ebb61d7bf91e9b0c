"""The evidence on trial: its likelihood against closed forms, and what it reads from a residual that is known."""

import numpy as np
import pytest
from scipy import stats

from emps_design.discrepancy import evidence
from emps_design.discrepancy.evidence import GROUPS, TAILS, Unknown, noise_of
from emps_design.discrepancy.noise_floor import Whitening
from emps_design.discrepancy.problem import Problem
from emps_design.discrepancy.records import Split
from emps_design.machines import machine
from emps_design.records import Record
from tests.hidden.generate import Case, make, write
from tests.hidden.score import score

SAMPLES, ODDS = 3000, 18.0
WHITE = Whitening(np.array([1.0]), 1.0)


def unknown_of(columns, group):
    """Columns (n, m) as the responses of one record's loop to forces of the groups ``group`` (m,)."""
    t = 1e-3 * np.arange(len(columns))
    used = np.ones(len(columns), bool)
    record = Record.from_arrays(1e-3, np.sin(t), np.sin(t), np.cos(t))
    problem = Problem(machine("emps2019"), (record,), (Split(((0, len(t)),), 0, used, ~used),), WHITE)
    return Unknown(problem, (columns,), (columns,), np.array(group), (np.zeros(len(group)),))


@pytest.fixture(name="waves", scope="module")
def two_groups_of_waves():
    """Ten waves: five of the first group, five of the second."""
    t = np.linspace(0.0, 1.0, SAMPLES)
    return unknown_of(np.column_stack([np.sin(np.pi * k * t) for k in range(1, 11)]), [0] * 5 + [1] * 5)


def test_the_tails_are_those_of_student():
    x = np.random.default_rng(0).standard_t(TAILS, 200)
    expected = stats.t.logpdf(x, TAILS, scale=1.7).sum()
    assert evidence._student(x, 1.7) == pytest.approx(expected, rel=1e-12)


def test_the_scale_is_that_of_most_likelihood():
    x = 2.5 * np.random.default_rng(1).standard_t(TAILS, 5000)
    assert evidence._scale(x) == pytest.approx(stats.t.fit(x, f0=TAILS, floc=0.0)[2], rel=1e-3)


def test_an_unknown_force_is_integrated(waves):
    """Against the density of a normal vector with the covariance 1 + B diag(variances) B'."""
    few = slice(0, SAMPLES, 30)
    columns, x = waves.responses[0][few], np.random.default_rng(2).standard_normal(SAMPLES // 30)
    part = evidence._Whitened(x, columns, np.ones(10), np.ones(x.size))
    variances = np.repeat([0.3, 2.0], 5)
    covariance = np.eye(x.size) + columns * variances @ columns.T
    dense = stats.multivariate_normal.logpdf(x, cov=covariance) - stats.norm.logpdf(x).sum()
    assert evidence._gain([part], variances) == pytest.approx(dense, rel=1e-9)


def test_what_may_be_an_unknown_force_is_taken_off_in_part(waves):
    """The basis and its shares are the inverse square root of the same covariance."""
    few = slice(0, SAMPLES, 30)
    columns, x = waves.responses[0][few], np.random.default_rng(3).standard_normal(SAMPLES // 30)
    part = evidence._Whitened(x, columns, np.ones(10), np.ones(x.size))
    variances = np.repeat([0.3, 2.0], 5)
    posterior = evidence._posterior(part, variances)
    quiet = x - (posterior.basis * posterior.share) @ (posterior.basis.T @ x)
    covariance = np.eye(x.size) + columns * variances @ columns.T
    assert quiet @ quiet == pytest.approx(x @ np.linalg.solve(covariance, x), rel=1e-9)


def test_noise_has_no_unknown_force(waves):
    x = np.random.default_rng(4).standard_normal(SAMPLES)
    noise = noise_of(waves, (x,), WHITE, 0.5, ODDS)
    assert not noise.variances.any()
    assert noise.noise_rms == pytest.approx(1.0, abs=0.1)  # bursts count little


def test_the_group_is_found(waves):
    generator = np.random.default_rng(5)
    force = waves.responses[0][:, 5:] @ np.array([1.0, -0.8, 0.6, 0.9, -1.1])
    noise = noise_of(waves, (force + 0.5 * generator.standard_normal(SAMPLES),), WHITE, 0.1, ODDS)
    assert noise.variances[0] == 0.0
    assert noise.variances[1] > 0.0
    assert not noise.variances[2:].any()
    assert noise.force_rms == pytest.approx(np.std(force), rel=0.1)
    assert noise.gain > ODDS


def test_bursts_change_the_noise_little(waves):
    x = np.random.default_rng(6).standard_normal(SAMPLES)
    burst = x.copy()
    burst[100:130] += 40.0
    before, after = (noise_of(waves, (force,), WHITE, 0.1, ODDS).noise_rms for force in (x, burst))
    assert after < 1.2 * before


def test_a_group_costs_its_odds(waves):
    """A force that gains more than one price and less than another is there at the first, and not at the second."""
    force = 0.2 * waves.responses[0][:, 0] + np.random.default_rng(7).standard_normal(SAMPLES)
    cheap, dear = (noise_of(waves, (force,), WHITE, 0.1, odds) for odds in (3.0, 300.0))
    assert cheap.variances[0] > 0.0
    assert not dear.variances.any()
    assert cheap.likelihood > dear.likelihood


def test_every_group_has_a_name():
    assert len({kind.name for kind in GROUPS}) == len(GROUPS)


@pytest.mark.study("four diagnoses by the evidence on trial")
@pytest.mark.parametrize(
    "case",
    [
        Case(("stribeck_friction",), 2, 2),
        Case(("actuator_delay",), 2, 2),
        Case(("unknown_cross",), 1, 1),
        Case((), 1, 0),
    ],
    ids=lambda case: case.name,
)
def test_what_was_hidden_is_named(tmp_path, case):
    write(tmp_path / case.name, make(case, 20))
    answer = score(tmp_path / case.name, trial=True)
    assert answer.result == "right", f"{answer.named or answer.verdict} {answer.note}"
