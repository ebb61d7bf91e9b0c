"""Records too long to be searched whole: what is searched of them, and what is told of the rest."""

import numpy as np
import pytest

from emps_design.discrepancy import diagnose, long_records, rules
from emps_design.effects import get_effect
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import synthetic_record, trapezoid_laps

AXIS = machine("emps2019")
LIBRARY = (get_effect("elastic_force"),)


@pytest.fixture
def short(monkeypatch):
    """As if 30,000 samples were too many, and 20,000 of them could be searched."""
    monkeypatch.setattr(rules, "MOST_SAMPLES", 30_000)
    monkeypatch.setattr(rules, "SEARCHED", 20_000)


def diagnosed(effects, **how):
    record = synthetic_record(AXIS.replace(effects=effects), laps=2)
    result = diagnose(record, AXIS, library=LIBRARY, **how)
    texts = [text for text in result.details["warnings"] if "searched" in text]
    assert result.sentence.endswith(" ".join(f"{text}." for text in texts))
    return result.verdict, texts


def test_the_rest_of_a_long_record_is_simulated(short):
    verdict, (text,) = diagnosed([])
    assert verdict == "nothing-missing"
    assert text.startswith("synthetic-emps2019: only 20.1 of 36.41 s were searched, because 36412 samples")
    assert "over the whole record the residual is 0.3" in text
    assert "as a rule" not in text


def test_what_changes_after_the_part_searched_is_told(short):
    verdict, (text,) = diagnosed([{"kind": "mass_change", "change": 0.3, "time": 25.0}])
    assert verdict == "unnamed"
    assert "in the 10 s from 20 s on" in text
    assert "another effect acts there, or the machine changed; examine it with `fit_time`" in text


def test_what_a_controller_adds_is_known_in_the_rest_too(short):
    q_ref, noise = trapezoid_laps(1e-3, laps=2), np.random.default_rng(0)
    dither = 0.1 * np.repeat(noise.standard_normal(1 + q_ref.size // 60), 60)[: q_ref.size]
    run = Plant.of(AXIS).closed_loop(q_ref, voltage_noise=dither)
    recorded = Record.from_arrays(1e-3, q_ref, run.q, run.u)
    warnings = diagnose(recorded, AXIS, library=LIBRARY).details["warnings"]
    (text,) = (message for message in warnings if message.code == "part-searched")
    residual = float(text.partition("the residual is ")[2].split()[0])
    assert residual < 0.1 * AXIS.drive.gain * np.std(dither)


def test_a_window_decides_how_much_is_read(short):
    _, (text,) = diagnosed([], fit_time=(0.0, 15.0), confirm_time=(15.0, 25.0))
    assert ": only 25 of " in text


def test_a_window_too_long_is_refused(short):
    hour = synthetic_record(AXIS, laps=1, stroke=0.1)
    assert long_records.beginnings((hour, hour), (0.0, 1e4)) == (hour, hour)


def test_a_record_that_can_be_searched_is_left_alone():
    record = synthetic_record(AXIS, laps=1, stroke=0.1)
    assert long_records.beginnings((record,), None) == (record,)


def test_a_record_that_rests_first_is_read_from_its_first_motion_on(short):
    wave = np.append(np.zeros(20_000), np.sin(np.arange(12_000) / 300))
    (part,) = long_records.beginnings((Record.from_arrays(1e-3, wave, wave, wave),), None)
    assert len(part) == len(wave)
    (part, _) = long_records.beginnings((Record.from_arrays(1e-3, wave, wave, wave),) * 2, None)
    assert len(part) == 20_001 + 10_000
