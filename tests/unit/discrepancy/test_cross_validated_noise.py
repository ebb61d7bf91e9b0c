"""A reference without laps: what noise is, and what is found all the same."""

import numpy as np
import pytest

from emps_design.discrepancy import diagnose
from emps_design.discrepancy.noise_floor import usual_rms
from emps_design.discrepancy.unknown_force import smooth_of_state
from emps_design.effects import get_effect
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from tests.studies import quick

AXIS = machine("emps2019")
LIBRARY = tuple(get_effect(n) for n in ("elastic_force", "stribeck_friction", "actuator_delay", "position_ripple"))
T = np.arange(16_000) * 1e-3


def multi_sine(seed: int) -> np.ndarray:
    chance = np.random.default_rng(seed)
    waves = [np.sin(2 * np.pi * f * T + chance.uniform(0, 6)) / f for f in chance.uniform(0.1, 0.8, 5)]
    wave = np.sum(waves, axis=0) * np.minimum(T / 2, 1) ** 2
    return 0.2 * (wave - wave[0]) / np.ptp(wave)


def record(*effects, seed=0, disturbance=None) -> Record:
    chance, q_ref = np.random.default_rng(seed), multi_sine(seed)
    run = Plant.of(AXIS.replace(effects=list(effects))).closed_loop(
        q_ref, voltage_noise=4e-3 * chance.standard_normal(T.size), disturbance=disturbance
    )
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=1e-3, name="free")


@pytest.mark.parametrize("seed", quick([1, 2, 3], 1, "other seeds"))
def test_a_spring_is_no_noise(seed):
    answer = diagnose(
        record({"kind": "elastic_force", "stiffness": 500.0, "rest_position": 0.1}, seed=seed), AXIS, library=LIBRARY
    )
    assert [f.effect for f in answer.findings] == ["elastic_force"]
    assert answer.findings[0].parameters["stiffness"]["value"] == pytest.approx(500.0, rel=0.01)
    assert answer.train.extended_60hz < 0.01 * answer.train.baseline_60hz
    assert not answer.noise.from_laps


def test_the_noise_of_a_healthy_record_is_what_was_put_in():
    healthy = record(seed=4)
    exact = Plant.of(AXIS).closed_loop(healthy.q_ref, quantise=False)
    put_in = usual_rms([AXIS.drive.force_gain * (healthy.u - exact.u)[50:]])  # where it sticks, noise moves it
    answer = diagnose(healthy, AXIS, library=LIBRARY)
    assert answer.verdict == "nothing-missing"
    assert answer.floor == pytest.approx(put_in, rel=0.05)
    assert any("not the difference between laps" in text for text in answer.details["warnings"])


def test_an_effect_without_a_start_is_said_not_to_be_looked_for():
    rows = diagnose(record(seed=4), AXIS, library=(*LIBRARY, get_effect("external_force"))).details["not_excluded"]
    assert {row["effect"]: row["size"] for row in rows}["external_force"] is None
    assert rows[-1]["text"].startswith("not tested")


@pytest.mark.study("a whole diagnosis")
def test_physics_without_a_name_is_no_noise_either():
    # A force that depends on position and velocity together, as no effect of the library does.
    q_ref = multi_sine(5)
    v = np.gradient(q_ref, 1e-3)
    answer = diagnose(record(seed=5, disturbance=-3000.0 * (q_ref - q_ref.mean()) * v), AXIS, library=LIBRARY)
    assert answer.verdict == "unnamed"
    assert answer.findings == ()


def test_functions_of_the_state_are_smooth_and_of_the_past():
    q = multi_sine(6)
    stopped = np.concatenate([q[:9000], np.full(7000, q[9000])])
    one, other = (smooth_of_state(x, 1e-3) for x in (q, stopped))
    fading = slice(-8 - 15, None)  # after the surfaces, which are scaled by what the whole record visits
    assert np.allclose(one[:8999, fading], other[:8999, fading])
    assert np.abs(one).max() <= 1.0 + 1e-12
