"""The study of `benchmarks.gains`, short: margins against brute force, retune, a notch, a range of loads, a drive."""

from pathlib import Path

import pytest

from benchmarks import gains

SERVO = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "servo"


@pytest.mark.study("random axes")
def test_random_axes_against_brute_force():
    found = gains.summary(gains.random_loops(6, seed=77))
    assert found["margins"] >= 18
    assert set(found["by_name"]) == {"phase_margin_deg", "gain_margin", "delay_margin", "disk_margin"}
    assert found["nearer_pairs"]["nearer"] == 0
    assert found["largest_error"] < 0.01
    assert found["most_optimistic"] < 1e-4
    assert set(found["retune"]) <= {"reached", "nearest"}


def test_a_notch_at_48_hz_gains_crossover_at_equal_margins():
    found = gains.notch()
    assert found["filter"]["kind"] == "notch"
    assert found["gained"]["with_equal_margins"] > 0.15
    assert found["gained"]["with"] > 0.5
    for name in ("phase_margin_deg", "gain_margin", "disk_margin"):
        assert found["with_equal_margins"]["margins"][name] >= (1.0 - 1e-6) * found["without"]["margins"][name], name
    for side in ("without", "with_equal_margins", "with"):
        assert found[side]["margins"]["phase_margin_deg"] == pytest.approx(50.0, abs=1e-5)
        assert found[side]["margins"]["gain_margin"] >= 2.0


def test_a_load_range_of_five_in_simulation():
    for row in gains.load_range():
        assert row["phase_margin_deg"] >= 50.0 - 1e-6
        assert row["delay 0.98"]
        assert row["gain 0.98"]
        assert not row["delay 1.02"]
        assert not row["gain 1.02"]


@pytest.mark.skipif(not SERVO.exists(), reason="the servo records are not here")
def test_pi_at_30_hz_on_the_gantry():
    found = gains.gantry(SERVO)
    assert found["page"]["bandwidth"] == pytest.approx(188.4956, rel=1e-6)
    assert found["drive"]["bandwidth"] == pytest.approx(found["page"]["bandwidth"], rel=0.02)
    assert found["drive"]["overshoot_percent"] == pytest.approx(found["page"]["overshoot_percent"], abs=1.0)
