"""Records without noise, made in open loop on axes solved exactly: an error that is no noise is in the deviations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import chirp, lfilter

from emps_design.errors import RecordError
from emps_design.frequency_response import estimate_response
from emps_design.frequency_response.response import BAND
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation.synthetic import synthetic_record
from tests.unit.records.with_gaps import as_one, lost

OPEN = {"kind": "none"}


def rigid(mass, time_constant, period):
    """A rigid axis without dry friction, whose controller is not known."""
    return machine("emps2019").replace(
        mechanics={"mass": mass, "viscous": mass / time_constant, "coulomb": 0.0, "offset": 0.0},
        drive={"force_gain": 1.0},
        sampling={"period": period, "encoder_resolution": 1e-12},
        controller=OPEN,
    )


def driven(axis, u, step=0.0, **columns):
    """The record of a rigid ``axis`` under the command ``u`` (n,) held over each period, on an encoder of ``step``."""
    m, f, T = axis.mechanics.mass, axis.mechanics.viscous, axis.sampling.period
    decay = np.exp(-f / m * T)
    v = lfilter([0.0, (1.0 - decay) / f], [1.0, -decay], u)
    moved = m / f * (1.0 - decay) * v + (T - m / f * (1.0 - decay)) * u / f
    q = np.concatenate([[0.0], np.cumsum(moved)[:-1]])
    q = np.rint(q / step) * step if step else q
    made = Record.from_arrays(T, np.zeros(u.size), q, u, name="open", **{"excitation": u, **columns})
    return replace(made, q_ref_recorded=False)


def errors(found, axis):
    """Of each line the error over its deviation (n,)."""
    exact = 1.0 / (1j * found.response.w * axis.mechanics.mass + axis.mechanics.viscous)
    return np.abs(found.response.response / exact - 1.0) / found.response.std


@pytest.mark.parametrize(("mass", "time_constant", "period"), [(5.0, 4.0, 5e-3), (0.3, 0.06, 1e-3), (80.0, 0.7, 2e-3)])
@pytest.mark.parametrize("method", ["linear", "logarithmic"])
def test_what_interpolation_misses_of_a_sweep_is_in_the_deviations(mass, time_constant, period, method):
    axis = rigid(mass, time_constant, period)
    t = np.arange(round(8.0 / period)) * period
    found = estimate_response(driven(axis, chirp(t, 0.5, t[-1], 0.3 / period, method=method)), axis)
    ratio = errors(found, axis)
    assert np.mean(ratio <= BAND) >= 0.95
    assert np.sqrt(np.mean(ratio**2)) < 1.2
    assert found.resonances == ()


def test_a_record_with_gaps_is_taken_as_its_pieces():
    axis = rigid(0.72, 0.72 / 8.4, 2e-3)
    record = lost(driven(axis, np.random.default_rng(2).standard_normal(12000)), 4000, 4600)
    found, bridged = (estimate_response(one, axis) for one in (record, as_one(record)))
    assert np.mean(errors(found, axis) <= BAND) >= 0.95
    assert np.median(bridged.response.std) > 2.0 * np.median(found.response.std)
    assert found.warnings[0] == "open: used as 2 pieces, without the gaps between them"
    assert found.seconds == pytest.approx(22.8, abs=0.01)


def test_a_step_with_a_gap_is_the_longer_part_of_it():
    axis = rigid(0.72, 0.72 / 8.4, 1e-3)
    t = np.arange(4000) * 1e-3
    records = [driven(axis, 2.5 * np.sin(2.0 * np.pi * f * t)) for f in (1.0, 3.0, 5.0, 8.0, 16.0)]
    found = estimate_response([*records[:3], lost(records[3], 2000, 2030), records[4]], axis)
    assert found.method == "stepped"
    assert found.response.frequency == pytest.approx([1.0, 3.0, 5.0, 8.0, 16.0])
    assert np.all(errors(found, axis) < 3.0)


def test_pieces_that_are_too_short_are_refused():
    axis = rigid(0.72, 0.72 / 8.4, 1e-3)
    record = driven(axis, np.random.default_rng(3).standard_normal(4000))
    short = replace(record, bridged=(np.arange(4000) % 60 == 0).astype(float))
    with pytest.raises(RecordError, match="no stretch between its gaps that is long enough for the excitation"):
        estimate_response(short, axis)


@pytest.mark.parametrize("step", [0.0, 1e-4])
def test_one_sine_per_record(step):
    axis = rigid(0.72, 0.72 / 8.4, 1e-3)
    t = np.arange(4000) * 1e-3
    records = [driven(axis, 2.5 * np.sin(2.0 * np.pi * f * t), step) for f in (1.0, 3.0, 5.0, 8.0, 16.0, 20.0)]
    found = estimate_response(records, axis)
    assert (found.method, found.passes) == ("stepped", 6)
    assert found.response.frequency == pytest.approx([1.0, 3.0, 5.0, 8.0, 16.0, 20.0])
    assert np.all(found.response.coherence > 0.9)
    assert np.all(errors(found, axis) < 3.0)
    with pytest.raises(RecordError, match=r"found 1 step at .* at least 4; give the records of the other lines too"):
        estimate_response(records[0], axis)


def test_the_command_is_the_excitation_in_open_loop_alone():
    axis = rigid(0.72, 0.72 / 8.4, 1e-3)
    record = driven(axis, np.random.default_rng(1).standard_normal(6000))
    found = estimate_response(record, axis).response
    without = replace(record, excitation=None)
    assert np.array_equal(estimate_response(without, axis, instrument="command").response.response, found.response)
    closed = axis.replace(controller={"kind": "position_pd", "kp": 10.0, "kv": 5.0})
    for one, instrument in ((record, ""), (without, "command")):
        with pytest.raises(RecordError, match=r"found the command as the excitation too, .*position_pd.*\"none\""):
            estimate_response(one, closed, instrument=instrument)


def test_a_record_without_a_reference_is_told_what_excites_it():
    axis = rigid(5.0, 1.0, 1e-3)
    record = replace(driven(axis, np.random.default_rng(4).standard_normal(4000)), excitation=None)
    with pytest.raises(RecordError, match=r"for a record made in open loop .*, `instrument='command'`"):
        estimate_response(record, axis)
    assert len(estimate_response(record, axis, instrument="command").response) > 50


def test_dry_friction_of_a_rigid_axis_makes_no_resonance():
    """Its answer differs from line to line, which was named 1.65, 1.92 and 2.71 Hz, each known to 0.01 Hz."""
    axis = machine("emps2019")
    found = estimate_response(synthetic_record(axis), axis)
    assert found.resonances == ()
    assert any("dry friction biases the response" in warning for warning in found.warnings)
