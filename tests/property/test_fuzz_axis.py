"""Whatever an axis file holds, it is an axis that comes back from its own TOML, or it is refused in one line."""

import tomli_w
from hypothesis import given, strategies as st

from emps_design.axis import TABLES, Axis
from emps_design.effects import EFFECTS
from emps_design.errors import AxisError
from emps_design.laws import fields_of
from emps_design.machines import machine, machine_names
from tests.property.fuzzing import fuzz


def check(text: str) -> None:
    """An axis that survives being written and read, or one line that names the file."""
    refusal = ""
    try:
        axis = Axis.from_toml(text, "a.toml")
    except AxisError as error:
        refusal = str(error)
    if refusal:
        assert refusal.startswith("a.toml: ")
        assert len(refusal.splitlines()) == 1
        assert len(refusal) < 2000
    else:
        assert Axis.from_toml(axis.to_toml()) == axis


@fuzz
@given(st.text(max_size=400))
def test_any_text(text):
    check(text)


@fuzz
@given(st.data())
def test_damaged_axis_files(data):
    text = machine(data.draw(st.sampled_from(machine_names()))).to_toml()
    for _ in range(data.draw(st.integers(1, 5))):
        at = data.draw(st.integers(0, len(text)))
        until = at + data.draw(st.integers(0, 12))
        text = text[:at] + data.draw(st.text(max_size=6)) + text[until:]
    check(text)


SCALARS = st.one_of(
    st.floats(),
    st.integers(-(2**80), 2**80),
    st.booleans(),
    st.text(max_size=8),
    st.sampled_from((1e-3, 1.0, 100.0, 0, -0.0, 5e-324, 1.7e308, "position_pd", "impedance", "none", "two_tap")),
)
FIELDS = sorted({field for table in TABLES.values() for field in table.model_fields} | set(fields_of()))
KEYS = st.sampled_from([*FIELDS, *TABLES, "name", "effects", "kind", "parameters"]) | st.text(max_size=5)
VALUES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3))
PARAMETERS = sorted({parameter.name for effect in EFFECTS for parameter in effect.parameters})
KINDS = st.sampled_from([effect.name for effect in EFFECTS]) | SCALARS
EFFECT_TABLES = st.builds(
    lambda kind, parameters: {"kind": kind, **parameters},
    KINDS,
    st.dictionaries(st.sampled_from(PARAMETERS), SCALARS, max_size=4),
)


@st.composite
def tables(draw) -> dict:
    """A good axis of which a few entries are replaced, removed or put in."""
    axis = machine(draw(st.sampled_from(machine_names()))).to_dict()
    for _ in range(draw(st.integers(0, 5))):
        table = axis.get(draw(st.sampled_from(list(TABLES))))
        if isinstance(table, dict) and draw(st.booleans()):
            table[draw(KEYS)] = draw(VALUES)
        elif draw(st.booleans()):
            axis[draw(KEYS)] = draw(VALUES)
        else:
            axis.pop(draw(st.sampled_from(list(axis))), None) if axis else None
    if draw(st.booleans()):
        axis["effects"] = draw(st.lists(EFFECT_TABLES, max_size=3))
    return axis


@fuzz
@given(tables())
def test_any_table(table):
    check(tomli_w.dumps(table))


@fuzz
@given(st.data())
def test_effects_with_any_numbers(data):
    effect = data.draw(st.sampled_from(EFFECTS))
    numbers = st.floats() | st.integers(-(2**80), 2**80)
    parameters = {parameter.name: data.draw(numbers) for parameter in effect.parameters}
    effects = [{"kind": effect.name, **parameters}]
    check(tomli_w.dumps({**machine("emps2019").to_dict(), "motion": effect.motion or "linear", "effects": effects}))
