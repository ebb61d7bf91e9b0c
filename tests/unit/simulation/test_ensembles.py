"""Ensembles: the same numbers however they are handed out, bad plants flagged, interrupts kept."""

import numpy as np
import pytest

from emps_design.errors import InputError
from emps_design.machines import machine
from emps_design.simulation import Plant, corners, ensembles, monte_carlo, simulate_ensemble, sweep
from tests.physics.cases import CASES

AXIS = machine("emps2019")
EXTENDED = AXIS.replace(effects=[{"kind": "stribeck_friction", **CASES["stribeck_friction"]}])
Q_REF = 0.05 * np.sin(2 * np.pi * 0.6 * np.arange(1500) * 1e-3) ** 2


def same(first, second):
    assert first.metrics.keys() == second.metrics.keys()
    for name in first.metrics:
        np.testing.assert_array_equal(first.metrics[name], second.metrics[name])


@pytest.mark.parametrize("axis", [AXIS, EXTENDED], ids=["lanes", "effects"])
def test_same_numbers_for_any_number_of_workers_and_neighbours(axis):
    plants = monte_carlo(axis, 0.05, 300 if axis is AXIS else 40, seed=3)
    one, two, three = (simulate_ensemble(axis, plants, Q_REF, workers=w) for w in (1, 2, 3))
    same(one, two)
    same(one, three)
    alone = simulate_ensemble(axis, sweep(axis, "mass", plants.baseline[:5, 0]), Q_REF)
    assert (alone.status == ensembles.DONE).all()


@pytest.mark.parametrize("quantise", [True, False])
def test_lanes_are_the_plant_alone(quantise):
    plants = monte_carlo(AXIS, 0.05, 37)
    record = Plant.of(AXIS).closed_loop(Q_REF).record()
    found = simulate_ensemble(AXIS, plants, record=record, quantise=quantise)
    for i in (0, 17, 36):
        run = Plant.of(AXIS).closed_loop(Q_REF, plants.baseline[i], q0=record.q[0], quantise=quantise)
        missed = np.sqrt(np.mean((record.q - run.q)[50:] ** 2))
        force = np.sqrt(np.mean((AXIS.drive.force_gain * (record.u - run.u))[50:] ** 2))
        assert found.metrics["position_rms"][i] == pytest.approx(missed, rel=1e-9)
        assert found.metrics["force_rms"][i] == pytest.approx(force, rel=1e-6)
        assert found.metrics["tracking_rms"][i] == pytest.approx(np.sqrt(np.mean((Q_REF - run.position)[50:] ** 2)))
        assert found.metrics["peak_voltage"][i] == pytest.approx(np.abs(run.u).max(), rel=1e-9)
        assert found.metrics["rest_share"][i] == pytest.approx(np.mean(run.v[50:] == 0))


@pytest.mark.parametrize("axis", [AXIS, EXTENDED], ids=["lanes", "effects"])
def test_bad_plants_never_lose_the_others(axis):
    plants = monte_carlo(axis, 0.02, 60)
    good = simulate_ensemble(axis, plants, Q_REF)
    plants.baseline[7, 0] = -1.0
    plants.baseline[8, 2] = np.nan
    plants.baseline[9, 0] = 0.01  # unstable: the loop gain is thousands of times too high
    found = simulate_ensemble(axis, plants, Q_REF)
    assert np.flatnonzero(found.status == ensembles.FAILED).tolist() == [7, 8, 9]
    assert "mass > 0" in found.reasons[7]
    assert "unstable" in found.reasons[9] or "is unbounded" in found.reasons[9]
    others = np.setdiff1d(np.arange(60), [7, 8, 9])
    for name in good.metrics:
        np.testing.assert_array_equal(found.metrics[name][others], good.metrics[name][others])
        assert np.isnan(found.metrics[name][[7, 8, 9]]).all()
    summary = found.to_dict()
    assert summary["status"] == {"done": 57, "failed": 3, "unfinished": 0}
    assert set(summary["failures"]) == {"7", "8", "9"}


def test_an_interrupt_keeps_what_is_finished():
    plants = monte_carlo(EXTENDED, 0.02, 64)
    seen = []

    def interrupt(stage, fraction):
        seen.append(fraction)
        if len(seen) == 3:
            raise KeyboardInterrupt

    found = simulate_ensemble(EXTENDED, plants, Q_REF, workers=1, progress=interrupt)
    assert found.interrupted
    assert (found.status == ensembles.DONE).sum() == 24
    assert (found.status == ensembles.UNFINISHED).sum() == 40
    done = found.status == ensembles.DONE
    whole = simulate_ensemble(EXTENDED, plants, Q_REF, workers=1)
    np.testing.assert_array_equal(found.metrics["tracking_rms"][done], whole.metrics["tracking_rms"][done])


def test_progress_is_told():
    progress = []
    simulate_ensemble(AXIS, monte_carlo(AXIS, 0.02, 600), Q_REF, workers=2, progress=lambda *now: progress.append(now))
    assert progress[-1] == ("plants", 1.0)
    assert len(progress) == 3


def test_what_is_varied():
    assert len(corners(AXIS, 0.02)) == 17
    np.testing.assert_array_equal(corners(AXIS, 0.02).baseline[0], Plant.of(AXIS).baseline)
    drawn = monte_carlo(EXTENDED, {"stribeck_friction.excess": 0.5, "mass": 0.1}, 200, seed=1)
    assert 4.0 <= drawn.parameters[0][:, 0].min() < drawn.parameters[0][:, 0].max() <= 12.0
    np.testing.assert_array_equal(drawn.baseline[:, 1], AXIS.mechanics.viscous)
    np.testing.assert_array_equal(monte_carlo(AXIS, 0.1, 9, seed=5).values, monte_carlo(AXIS, 0.1, 9, seed=5).values)
    swept = sweep(EXTENDED, "stribeck_friction.stribeck_velocity", [0.01, 0.02])
    np.testing.assert_array_equal(swept.parameters[0][:, 1], [0.01, 0.02])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sweep(AXIS, "mas", [1.0]), "parameter: found 'mas', .*did you mean 'mass'"),
        (lambda: sweep(AXIS, "mass", []), "sweep of mass: found"),
        (lambda: monte_carlo(AXIS, 1.5, 3), "spread of mass: found 1.5"),
        (lambda: monte_carlo(AXIS, 0.1, 0), "plants: found 0"),
        (lambda: corners(AXIS, {f"x{i}": 0.1 for i in range(17)}), "corners: found 17 parameters"),
        (lambda: simulate_ensemble(AXIS, corners(AXIS, 0.1)), "found neither q_ref nor record"),
    ],
)
def test_what_cannot_be_meant_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


@pytest.mark.slow("starts a cluster")
def test_two_workers_of_a_cluster_give_the_same():
    distributed = pytest.importorskip(
        "dask.distributed", reason="the extra `cluster` (dask.distributed) is not installed"
    )
    import joblib

    plants = monte_carlo(EXTENDED, 0.02, 24)
    here = simulate_ensemble(EXTENDED, plants, Q_REF)
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "host": "127.0.0.1"}
    with (
        distributed.LocalCluster(**options) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config(backend="dask"),
    ):
        there = simulate_ensemble(EXTENDED, plants, Q_REF)
    same(here, there)
