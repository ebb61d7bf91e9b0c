"""When a law is told: what it leaves against what the record allows, and the same numbers in every part of it."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.errors import InputError
from emps_design.identification.controller import NOT_TOLD, TOLD, LawEstimate, identify_law
from emps_design.identification.controller.best_law import BestLaw
from emps_design.identification.controller.fit import LawFit, covariance, fit, with_deviations
from emps_design.identification.controller.identify_law import signals_of
from emps_design.identification.controller.regressors import LawStructure, Timing, joined_signals
from emps_design.identification.controller.wording import (
    TIMES,
    disagreement,
    halves,
    in_parts,
    numbers_of,
    times_allowed,
    unlike,
)
from emps_design.laws.estimators import Estimator
from emps_design.records import Record
from tests.unit.identification.controller.closed_loop import Loop

SLOPE = Estimator(kind="slope", points=4)
LOOP = Loop(kp=30.0, kv=300.0, estimator=("slope", 4), noise=0.02, samples=3000)
PD = LawStructure(form="", share=0, acceleration=False, coulomb=False, offset=False)


def record_of(loop):
    r, q, u = loop.run()
    return Record.from_arrays(loop.period, r, q, u, name=f"kv {loop.kv:g}")


def found_with(signals, estimator="backward", structure=PD):
    """The law of a structure and an estimator, fitted, as a search would leave it."""
    fitted = fit(signals, LawFit(structure, Timing(velocity_estimator=estimator), (), 0.0, np.zeros(0), 1.0, 1))
    rms = (fitted.cost / fitted.samples) ** 0.5
    return BestLaw(signals, fitted, [], rms, rms / float(np.std(signals.command)), None, None, True)


def numbers(one):
    return numbers_of(one, False)


@pytest.fixture(scope="module")
def signals():
    return signals_of(record_of(LOOP))


def test_a_right_law_leaves_what_the_record_allows(signals):
    assert times_allowed(found_with(signals, SLOPE)) == pytest.approx(1.0, abs=0.02)
    assert found_with(signals, SLOPE).rms == pytest.approx(LOOP.noise, rel=0.05)


def test_a_wrong_estimator_leaves_more(signals):
    """Each leaves under 5 % of the command, which passed for the law; what is left follows from the position."""
    for estimator in ("backward", "two_tap", Estimator(kind="slope", points=6)):
        found = found_with(signals, estimator)
        assert found.share < 0.05
        assert times_allowed(found) > TIMES
        assert found.rms / times_allowed(found) == pytest.approx(LOOP.noise, rel=0.05)


def test_noise_that_is_not_white_is_the_records_own(signals):
    """A slow wander of the measured command knows nothing of the motion."""
    rng = np.random.default_rng(2)
    wander = 0.05 * np.convolve(rng.normal(size=len(signals)), np.exp(-np.arange(200) / 20.0))[: len(signals)]
    found = found_with(replace(signals, command=signals.command + wander), SLOPE)
    assert times_allowed(found) < 1.2


def test_halves_of_one_law_agree_and_of_two_do_not(signals):
    found = found_with(signals, SLOPE)
    assert disagreement(found, halves(signals), numbers) is None
    late = np.arange(len(signals)) > len(signals) // 2
    doubled = replace(signals, command=np.where(late, 1.02, 1.0) * signals.command)
    apart = disagreement(found_with(doubled, SLOPE), halves(doubled), numbers)
    assert apart is not None
    assert apart.name == "kv"
    assert apart.second[0] / apart.first[0] == pytest.approx(1.02, rel=2e-3)
    assert in_parts(apart, [record_of(LOOP)]).startswith("its halves disagree: kv is 300")


@pytest.mark.parametrize(("kind", "number"), [("filtered", 60.0), ("tracking", 500.0)])
def test_the_number_of_an_estimator_is_fitted(kind, number):
    """From 1.4 times it, with a deviation that holds it."""
    signals = signals_of(record_of(replace(LOOP, estimator=(kind, number))))
    name = {"filtered": "frequency", "tracking": "bandwidth"}[kind]
    found = found_with(signals, Estimator.model_validate({"kind": kind, name: 1.4 * number}))
    told = with_deviations(found.fit, covariance(signals, found.fit, None), numbers)
    for key, true in {"kp": 30.0, "kv": 300.0, f"velocity_estimator.{name}": number}.items():
        value, std = told[key]
        assert value == pytest.approx(true, rel=0.02), key
        assert abs(value - true) < 4.0 * std, key
    assert times_allowed(found) == pytest.approx(1.0, abs=0.02)


def test_records_of_two_controllers_are_told_apart():
    """By their numbers, each fitted to the structure of both."""
    several = [record_of(replace(LOOP, kv=kv, samples=2000)) for kv in (300.0, 305.0)]
    signals = joined_signals([signals_of(one) for one in several])
    parts = [signals.levels == place for place in (0, 1)]
    apart = disagreement(found_with(signals, SLOPE), parts, numbers)
    said = in_parts(apart, several)
    assert said.startswith("the records disagree: kv is 299.99 +- ")
    assert said.endswith("in kv 305")


def told(table, std):
    return LawEstimate("r", TOLD, "", table, std, 0.0, 0.0, "V")


def test_laws_that_differ_are_said_to_differ_on_what():
    one = told({"kind": "position_pd", "kp": 30.0, "kv": 300.0, "velocity_estimator": "backward"}, {"kv": 1.0})
    slope = {"kind": "slope", "points": 4}
    two = told({"kind": "position_pd", "kp": 30.0, "kv": 310.0, "velocity_estimator": slope}, {"kv": 1.0})
    near = told({"kind": "position_pd", "kp": 30.0, "kv": 302.0, "velocity_estimator": "backward"}, {"kv": 1.0})
    together = LawEstimate("r + r", NOT_TOLD, "much is left", None, {}, 0.1, 0.1, "V", closest={"kind": "p"})
    said = unlike(together, [one, two])
    assert said.closest is None
    assert "kv 300 and 310" in said.reason
    assert "velocity_estimator backward and slope of 4 points" in said.reason
    assert unlike(together, [one, near]) == together
    assert unlike(together, [one, together]) == together


@pytest.mark.study("a search over structures")
def test_a_law_with_something_no_structure_has_is_close_and_not_told():
    """A second-order low-pass of the velocity: no estimator here, whatever filters may make of it."""
    loop = Loop(kp=30.0, kv=300.0, noise=1e-4, samples=4000)
    r, q, _ = loop.run()
    v = np.diff(q, prepend=q[0]) / loop.period
    slow = np.zeros(v.size)
    for k in range(2, v.size):
        slow[k] = 1.6 * slow[k - 1] - 0.73 * slow[k - 2] + 0.13 * v[k]
    u = 300.0 * (30.0 * (r - q) - slow) + np.random.default_rng(0).normal(0.0, loop.noise, v.size)
    found = identify_law(Record.from_arrays(loop.period, r, q, u))
    assert (found.verdict, found.controller) == (NOT_TOLD, None)
    assert found.closest is not None
    assert (
        f"{found.residual_rms / found.allowed_rms:.3g} times what noise and resolution of the record explain"
        in found.reason
    )
    assert found.to_dict()["residual"]["allowed"] == found.allowed_rms


def test_an_estimator_on_the_command_line():
    from emps_design.commands.options import estimator_from_text

    assert estimator_from_text("tracking:1000") == {"kind": "tracking", "bandwidth": 1000.0}
    with pytest.raises(InputError, match="found 'slope:4.5', expected a whole number after slope:"):
        estimator_from_text("slope:4.5")
