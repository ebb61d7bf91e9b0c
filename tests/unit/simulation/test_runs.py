"""What a simulation returns: signals, events, files, plots."""

import numpy as np
import pytest

from emps_design.errors import InputError, RecordError
from emps_design.importing import import_record
from emps_design.machines import machine
from emps_design.records import read_record
from emps_design.simulation import Hand, Plant, Run
from emps_design.simulation.run import SIGNALS, STORED
from emps_design.simulation.synthetic import trapezoid_laps
from tests.physics.cases import CASES


@pytest.fixture(scope="module")
def run():
    effects = [{"kind": "stribeck_friction", **CASES["stribeck_friction"]}]
    q_ref = trapezoid_laps(1e-3, stroke=0.02, speed=0.05)[:3000]
    plant = Plant.of(machine("emps2019").replace(effects=effects))
    return plant.closed_loop(q_ref, disturbance=np.full(3000, 2.0), energy=True)


def test_signals_have_one_length_and_units(run):
    assert {getattr(run, name).shape for name in SIGNALS} == {(3000,)}
    np.testing.assert_allclose(run.force, machine("emps2019").drive.force_gain * run.u)
    assert run.to_dict()["signals"]["f_ext"] == {"label": "external force", "unit": "N"}


def test_an_axis_with_titles_of_its_own_reads_its_runs(run, tmp_path):
    columns = {"time": {"column": "Zeit"}, "position": {"column": "Lageistwert", "unit": "mm"}}
    axis = machine("emps2019").replace(record=columns)
    run.save(tmp_path / "run.npz")
    run.to_csv(tmp_path / "run.csv", mapped=True)
    for name in ("run.npz", "run.csv"):
        record = import_record(tmp_path / name, axis)
        np.testing.assert_array_equal(record.q, run.q)
        np.testing.assert_allclose(record.t, run.t, atol=1e-12)


def test_stick_intervals_are_where_velocity_is_zero(run):
    assert len(run.stick_intervals) >= 2
    resting = np.zeros(len(run), bool)
    for begin, end in run.stick_intervals:
        assert begin < end
        resting |= (run.t > begin + 1e-12) & (run.t < end - 1e-12)
    assert not run.v[resting].any()
    assert (run.v[~resting] == 0).sum() <= 2 * len(run.stick_intervals) + 2


def test_crossings_are_where_velocity_changes_sign(run):
    signs = np.sign(run.v)
    for k in np.flatnonzero(signs[1:] * signs[:-1] < 0):
        assert ((run.crossings >= run.t[k]) & (run.crossings <= run.t[k + 1])).any()


def test_saved_and_loaded_without_loss(run, tmp_path):
    run.save(tmp_path / "run.npz")
    again = Run.load(tmp_path / "run.npz")
    for name in (*STORED, "t", "force", "events"):
        np.testing.assert_array_equal(getattr(again, name), getattr(run, name))
    assert (again.energy, again.period, again.name) == (run.energy, run.period, run.name)
    run.save(tmp_path / "twice.npz")
    assert (tmp_path / "twice.npz").read_bytes() == (tmp_path / "run.npz").read_bytes()


def test_a_table_keeps_every_digit(run, tmp_path):
    run.to_csv(tmp_path / "run.csv")
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True, deletechars="")
    assert table.dtype.names[3] == "position_[m]"
    np.testing.assert_array_equal(table["position_[m]"], run.position)


def test_a_run_is_a_record(run, tmp_path):
    record = run.record()
    np.testing.assert_array_equal(record.f_ext, 2.0)
    run.to_csv(tmp_path / "run.csv")
    np.testing.assert_array_equal(read_record(tmp_path / "run.csv").u, run.u)


@pytest.mark.parametrize("content", [b"", b"PK", b"not a run"])
def test_a_file_that_is_no_run_is_refused(tmp_path, content):
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    with pytest.raises(RecordError, match="not a simulated run"):
        Run.load(path)
    with pytest.raises(RecordError, match="not a simulated run"):
        Run.load(tmp_path / "missing.npz")


def test_pickles_stay_closed(tmp_path):
    np.savez(tmp_path / "evil.npz", q=np.array([{}], dtype=object))
    with pytest.raises(RecordError, match="not a simulated run"):
        Run.load(tmp_path / "evil.npz")


def test_plot_labels_everything(run):
    axes = run.plot()
    assert [panel.get_ylabel() for panel in axes] == ["position [mm]", "velocity [mm/s]", "force [N]"]
    assert axes[-1].get_xlabel() == "time [s]"
    assert all(panel.get_legend() is not None for panel in axes)
    assert "grey" in axes[0].get_title()


def test_same_input_same_bits():
    plant = Plant.of(machine("emps2019").replace(effects=[{"kind": "backlash", **CASES["backlash"]}]))
    q_ref = 0.02 * np.sin(np.arange(1500) / 200) ** 2
    first, second = plant.closed_loop(q_ref), plant.closed_loop(q_ref)
    for name in STORED:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_a_touched_plant_takes_one_hand():
    plant = Plant.of(machine("emps2019")).touched_by(Hand(1.0), Hand(1.0))
    with pytest.raises(InputError, match="found 2 hands"):
        plant.open_loop(np.zeros(5), intention=np.zeros(5))
    with pytest.raises(InputError, match="mass: found -1 kg"):
        Hand(-1.0)
