"""Which controller made a record: structure and gains from closed loops that the tests compute themselves."""

from dataclasses import replace

import pytest

from emps_design.identification.controller import TOLD, identify_law
from emps_design.records import Record
from tests.unit.identification.controller.closed_loop import Loop

# A loop, the numbers that have to be found, and the structure.
CASES = {
    "position_pd, backward, coarse encoder": (
        Loop(kp=30.0, kv=300.0, step=1e-5, noise=0.1),
        {"kp": 30.0, "kv": 300.0},
        {"kind": "position_pd", "velocity_estimator": "backward"},
    ),
    "position_pd, two-tap": (
        Loop(kp=60.0, kv=300.0, step=1e-6, two_tap=True, noise=0.01),
        {"kp": 60.0, "kv": 300.0},
        {"kind": "position_pd", "velocity_estimator": "two_tap"},
    ),
    "ip_velocity, two-tap": (
        Loop(kp=None, kv=400.0, ti=0.05, form="ip", share=1.0, two_tap=True, noise=0.01),
        {"k_v1": 400.0, "t_v": 0.05},
        {"kind": "ip_velocity", "velocity_estimator": "two_tap"},
    ),
    "velocity reference": (
        Loop(kp=None, kv=300.0, ti=0.04, velocity_reference=True, lowpass=200.0, noise=0.02),
        {"velocity.kp": 300.0, "velocity.ti": 0.04, "filters.0.frequency": 200.0},
        {"kind": "cascade", "velocity.form": "pi", "filters.0.kind": "lowpass"},
    ),
    "ip cascade": (
        Loop(kp=20.0, kv=400.0, ti=0.03, form="ip", share=0.5, lowpass=150.0, noise=0.02),
        {"position.kp": 20.0, "velocity.kp": 400.0, "velocity.ti": 0.03, "feedforward.velocity": 0.5}
        | {"filters.0.frequency": 150.0},
        {"kind": "cascade", "position.every": 1, "velocity.form": "ip", "filters.0.kind": "lowpass"},
    ),
    "late by a sample": (
        Loop(kp=20.0, kv=400.0, ti=0.03, share=1.0, acceleration=5.0, delay=1, noise=0.02),
        {"position.kp": 20.0, "velocity.kp": 400.0, "velocity.ti": 0.03, "feedforward.acceleration": 5.0},
        {"kind": "cascade", "velocity.form": "pi", "feedforward.velocity": 1.0},
    ),
}


def record_of(loop: Loop) -> Record:
    r, q, u = loop.run()
    if not loop.velocity_reference:
        return Record.from_arrays(loop.period, r, q, u, name="loop")
    record = Record.from_arrays(loop.period, q, q, u, name="loop")
    return replace(record, velocity_reference=r, q_ref_recorded=False)


def at(table, name: str):
    for key in name.split("."):
        table = table[int(key)] if isinstance(table, list) else table[key]
    return table


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_structure_and_gains_of_a_loop(name):
    loop, numbers, structure = CASES[name]
    found = identify_law(record_of(loop))
    assert found.verdict == TOLD, found.reason
    assert {key: at(found.controller, key) for key in structure} == structure
    assert found.delay == loop.delay
    assert len(found.controller.get("filters", [])) == (loop.lowpass is not None)
    for key, true in numbers.items():
        value, std = at(found.controller, key), at(found.std, key)
        assert value == pytest.approx(true, rel=0.03), key
        assert abs(value - true) < 4.0 * std, (key, value, std)
    assert found.residual_rms == pytest.approx(loop.noise, rel=0.1)
