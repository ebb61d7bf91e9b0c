"""An axis whose effects are known: they are taken out, they stay, and what cannot be taken out is named."""

import numpy as np
import pytest

from emps_design.effects import EFFECTS
from emps_design.identification import identify
from emps_design.identification.closed_loop import identify_by_output_error, identify_with_instruments
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant

AXIS = machine("emps2019")
BEND = {"kind": "nonlinear_viscous_friction", "amount": -6.0, "exponent": 2.0}
RIPPLE = {"kind": "position_ripple", "amplitude": 2.0, "phase": 0.5, "period": 0.02}
ASYMMETRY = {"kind": "asymmetric_viscous_friction", "viscous_difference": -25.0}
LATE = {"kind": "actuator_delay", "delay": 2.3e-3}
LAG = {"kind": "actuator_lag", "time_constant": 2e-3}
FLEXIBLE = {"kind": "flexible_coupling", "frequency": 60.0, "damping": 0.05, "share": 0.2}


def recorded(record, axis):
    run = Plant.of(axis).closed_loop(record.q_ref)
    return Record(t=run.t, q_ref=record.q_ref, q=run.q, u=run.u, period=record.period, name="known")


@pytest.mark.parametrize(
    "table",
    [{"effects": [BEND, RIPPLE]}, {"effects": [LATE]}, {"effects": [LAG]}, {"drive": {"current_time_constant": 2e-3}}],
    ids=["forces", "delay", "lag", "current loop"],
)
@pytest.mark.parametrize("estimate", [identify, identify_with_instruments], ids=["ls", "iv"])
def test_what_is_known_does_not_go_into_the_parameters(record, truth, estimate, table):
    axis = AXIS.replace(**table)
    seen = recorded(record, axis)
    options = {"estimator": "ls"} if estimate is identify else {}
    known, bare = (estimate(seen, one, cutoff=40.0, **options) for one in (axis, AXIS))
    for name, value in truth.items():
        assert known.parameters[name].value == pytest.approx(value, rel=0.01, abs=0.05), name
    assert known.rms_error < 0.6 * bare.rms_error
    assert known.to_axis().effects == axis.effects


def test_output_error_simulates_the_effects(record, truth):
    axis = AXIS.replace(effects=[BEND])
    found = identify_by_output_error(recorded(record, axis), axis, cutoff=40.0)
    assert found.parameters["viscous"].value == pytest.approx(truth["viscous"], rel=1e-3)
    assert found.to_axis().effects == axis.effects


def test_an_asymmetry_in_the_axis_is_identified_anew(record):
    axis = AXIS.replace(effects=[ASYMMETRY, BEND])
    seen = recorded(record, axis)
    wrong = AXIS.replace(effects=[{**ASYMMETRY, "viscous_difference": 99.0}, BEND])
    again = identify(seen, wrong, model="asymmetric", filter="hold", cutoff=40.0).to_axis()
    assert [one.kind for one in again.effects] == [ASYMMETRY["kind"], BEND["kind"]]
    assert again.effects[0].parameters["viscous_difference"] == pytest.approx(-25.0, abs=1.0)


def test_it_is_said_what_was_done_with_each_effect(record):
    warnings = identify(record, AXIS.replace(effects=[RIPPLE, LATE, FLEXIBLE])).warnings
    assert "taken as known from emps2019, and kept in the identified axis: position_ripple, actuator_delay" in warnings
    assert any("does not follow from the motion: flexible_coupling; they bias mass" in text for text in warnings)
    assert (
        "valid only if the axis was identified from this record, because of their phase or time: position_ripple"
        in warnings
    )
    assert not np.any(["known" in text for text in identify(record, AXIS).warnings])


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_identify_runs_on_every_effect(record, effect):
    """A model that a diagnosis extended is an axis like any other."""
    small = {p.name: p.starts[0] if p.starts else max(p.lower, min(1e-6, p.upper)) for p in effect.parameters}
    axis = AXIS.replace(motion=effect.motion or "linear", effects=[{"kind": effect.name, **small}])
    found = identify(record, axis, filter="hold", cutoff=40.0)
    assert np.all(np.isfinite(found.values()))
    assert [one.kind for one in found.to_axis().effects] == [effect.name]
