"""The words of a diagnosis in the units of its axis: nothing of another machine is in them."""

from dataclasses import replace

import numpy as np
import pytest

from emps_design.discrepancy import preparation, unexplained
from emps_design.discrepancy.placement import extent, where_document
from emps_design.discrepancy.preparation import check_law, check_records
from emps_design.discrepancy.residual_views import views
from emps_design.discrepancy.result import Finding
from emps_design.discrepancy.unknown_force import MissingForce
from emps_design.discrepancy.words import changed, filled, label_of, worded
from emps_design.effects import Motion, known_effects
from emps_design.errors import InputError, RecordError
from emps_design.simulation.synthetic import synthetic_record
from tests.axes import CONTROLLER, KINDS, axis_of
from tests.rewriting import rewritten


@pytest.fixture(scope="module", params=KINDS)
def axis(request):
    """An axis of each kind."""
    return axis_of(request.param, **CONTROLLER)


@pytest.fixture(scope="module")
def record(axis):
    """Strokes of the axis, as its model makes them."""
    return synthetic_record(axis, laps=1)


def refused(error, check, *arguments) -> str:
    """The message with which ``check`` refuses the arguments."""
    with pytest.raises(error) as raised:
        check(*arguments)
    return str(raised.value)


def places(record, units) -> list[str]:
    """Where forces act at low speed, at one place, and at the reversals of a record, in words."""
    v = np.gradient(record.q, record.period)
    low, middle = record.q < record.q.min() + 0.02, np.abs(v) > 0.1
    turning = np.convolve(np.abs(np.diff(np.sign(v), prepend=0.0)), np.ones(50), "same") > 0
    every = np.ones(len(record), bool)
    return [where_document(extent(record, 1.0 * mask, every), units)["text"] for mask in (low, middle, turning)]


def messages(axis, record) -> list[str]:
    """What a diagnosis of the axis would say, from its parts."""
    units, limit = axis.units, axis.drive.command_limit
    texts = [filled(text, units) for text in (*unexplained.ASSUMPTIONS, unexplained.FOLLOWED, preparation.ONE_SPEED)]
    texts += [unexplained.like("friction that depends on the past motion", 0.5, units), *places(record, units)]
    texts.append(changed(axis.mechanics.array(), 1.1 * axis.mechanics.array(), range(4), units))
    effects = [worded(effect, units) for effect in known_effects().values()]
    texts += [text for effect in effects for text in (effect.label, effect.words.experiment, effect.words.remedy)]
    texts += [label_of(effect.name, units) for effect in effects]
    fast = replace(record, q_ref=np.where(record.q_ref > record.q_ref.mean(), 1.0, -1.0), u=np.full(len(record), limit))
    texts.append(refused(RecordError, check_records, (fast,), axis))
    texts += check_records((replace(record, q_ref=10.0 * record.q_ref),), axis)
    texts.append(refused(InputError, check_law, replace(record, u=0.3 * record.u), axis, ()))
    where = {"text": "throughout", "force": {"value": 0.92, "unit": units.unit("N"), "sense": "more or less"}}
    parameters = {
        name: {"value": 0.0123, "std": 0.001, "unit": unit}
        for name, unit in (("force", "N"), ("period", "m"), ("level", "V"), ("velocity", "m/s"), ("delay", "s"))
    }
    finding = Finding("external_force", label_of("external_force", units), "plant", where, parameters, 0.0, 2.0, 1.0)
    return [*texts, finding.in_words(units)]


def drawn(axis, record) -> list[str]:
    """The quantities of the views of a residual, and their titles."""
    v = np.gradient(record.q, record.period)
    motion = Motion(record.t, record.q, v, np.gradient(v), 10.0 * v, record.period, record.u)
    missing = MissingForce(motion, np.sin(record.t), np.abs(v) > 1e-3)
    return [
        text
        for view in views(missing, missing, np.ones(v.size, bool), 1.0, axis)
        for text in (view.quantity, view.title)
    ]


def test_nothing_has_to_be_rewritten(axis, record):
    texts = [*messages(axis, record), *drawn(axis, record)]
    assert [rewritten(axis.units, text) for text in texts] == texts


def test_they_are_those_of_the_linear_axis_in_other_words(axis, record):
    linear = [rewritten(axis.units, text) for text in drawn(axis_of("linear, V", **CONTROLLER), record)]
    assert drawn(axis, record) == linear
    assert ("motor torque" in linear) == axis.units.rotary


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (
            "linear, V",
            "up to 0.92 N: External force, force 0.012 +- 0.001 N, period 12 +- 1 mm, level 12 +- 1 mV, "
            "velocity 12 +- 1 mm/s, delay 12 +- 1 ms",
        ),
        (
            "rotary, A",
            "up to 0.92 N m: External torque, torque 0.012 +- 0.001 N m, period 0.70 +- 0.06 deg, "
            "level 12 +- 1 mA, velocity 0.70 +- 0.06 deg/s, delay 12 +- 1 ms",
        ),
    ],
)
def test_a_finding_has_the_units_of_its_axis(kind, expected):
    axis = axis_of(kind, **CONTROLLER)
    assert messages(axis, synthetic_record(axis, laps=1))[-1].endswith(expected)
