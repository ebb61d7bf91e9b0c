"""Every law as Structured Text: run from its text, LREAL has the simulation's bits, REAL stays within its tolerance."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from emps_design.codegen import export_controller
from emps_design.codegen.languages import ST_KEYWORDS, functions_in_st
from emps_design.codegen.program import ARRAY, INT, REAL
from emps_design.codegen.reader import read_program
from emps_design.laws import LAWS, get_law
from tests.contract.test_exported_laws import (
    COMPENSATED,
    LONG_RUN,
    OBSERVED,
    compensated_block,
    compensated_run,
    laps,
    observed,
)
from tests.contract.test_laws import ESTIMATED, axis_with
from tests.studies import quick
from tests.unit.codegen.structured_text import Blocks

pytestmark = pytest.mark.usefixtures("short_vectors")

EVERY = pytest.mark.parametrize("kind", LAWS, ids=lambda kind: kind.name)


def assert_the_text_gives_the_vectors(exported):
    """LREAL has the bits of the vectors, REAL stays within their tolerance; the blocks of the text."""
    vectors, blocks = exported.vectors, Blocks(exported.files[f"{exported.name}.st"])
    inputs = vectors.start, vectors.reference, vectors.q, vectors.f_ext, *vectors.motion
    found = blocks.run(exported.name, *inputs)
    np.testing.assert_array_equal(found.view(np.int64), vectors.u.view(np.int64))
    with np.errstate(all="ignore"):
        single = blocks.run(f"{exported.name}_single", *inputs)
    assert single.dtype == np.float32
    assert np.isfinite(vectors.tolerance).all()
    assert np.all(np.abs(single - vectors.u) <= vectors.tolerance)
    return blocks


@EVERY
@pytest.mark.parametrize("estimator", ["two_tap", "backward", *quick(ESTIMATED.values(), 0, "the other estimators")])
def test_the_text_gives_the_bits_of_the_vectors(kind, estimator):
    assert_the_text_gives_the_vectors(export_controller(axis_with(kind, velocity_estimator=estimator), "st"))


def test_the_text_gives_the_bits_of_an_estimator_that_filters():
    assert_the_text_gives_the_vectors(
        export_controller(axis_with(get_law("cascade"), velocity_estimator=ESTIMATED["tracking"]), "st")
    )


@EVERY
def test_a_long_run_has_the_simulations_bits(kind):
    axis = axis_with(kind).replace(drive={"current_time_constant": 5e-4})
    exported = export_controller(axis, "st")
    reference, run = laps(axis, exported.block.law)
    assert np.ptp(run.position) > 0.01
    blocks, start = Blocks(exported.files[f"{exported.name}.st"]), np.arange(run.q.size) == 0
    found = blocks.run(exported.name, start, reference, run.q, run.f_ext)
    assert found.size == LONG_RUN
    np.testing.assert_array_equal(found.view(np.int64), run.u.view(np.int64))


@pytest.mark.parametrize("name", quick(COMPENSATED, {"velocity", "several"}.__contains__, "other compensations"))
def test_a_long_run_of_a_compensated_law_has_the_simulations_bits(name):
    exported, (inputs, u) = compensated_block(name, "st"), compensated_run(name)
    blocks = Blocks(exported.files[f"{exported.name}.st"])
    found = blocks.run(exported.name, np.arange(u.size) == 0, *inputs)
    assert found.size == LONG_RUN
    np.testing.assert_array_equal(found.view(np.int64), u.view(np.int64))


@OBSERVED
def test_the_text_of_the_observer_gives_the_bits_of_a_long_run_and_of_the_vectors(name):
    exported, inputs, force = observed(name, "st")
    blocks = assert_the_text_gives_the_vectors(exported)
    found = blocks.run(exported.name, np.arange(force.size) == 0, *inputs)
    assert found.size == LONG_RUN
    np.testing.assert_array_equal(found.view(np.int64), force.view(np.int64))


@pytest.mark.parametrize("name", quick(COMPENSATED, {"velocity", "several"}.__contains__, "other compensations"))
def test_the_text_of_a_compensated_law_gives_the_bits_of_the_vectors(name):
    assert_the_text_gives_the_vectors(compensated_block(name, "st"))


@EVERY
def test_one_changed_coefficient_changes_the_answer(kind):
    exported = export_controller(axis_with(kind), "st")
    vectors, text = exported.vectors, exported.files[f"{exported.name}.st"]
    table = text.index("gains : ARRAY", text.index(f"FUNCTION_BLOCK {exported.name}\n"))
    end = text.index("];", table)
    places = [
        match.span() for match in re.finditer(r"(?m)(?<=^        )[-\d][\d.E+-]*", text) if table < match.start() < end
    ]
    assert len(places) == len(exported.block.law.gains)
    for start, stop in places:
        value = float(text[start:stop])
        counts = value in range(2, 10)  # of filters, of samples
        changed = value - 1.0 if counts else 1.0 - value if value in (0.0, 1.0) else value * (1.0 + 1e-4)
        blocks = Blocks(f"{text[:start]}{changed!r}{text[stop:]}")
        try:
            found = blocks.run(exported.name, vectors.start, vectors.reference, vectors.q, vectors.f_ext)
        except IndexError:  # it counts what is not there
            continue
        assert not np.array_equal(found, vectors.u), text[start:stop]


def mixed(k, at, memory):
    n = 0
    for i in range(3, 0, -1):
        n = n + i * k
    total = 0.0
    for T in range(n):
        total += at if T % 2 == 0 and not at < 0.0 else memory[min(T, 2)]
    return total**2.0 + abs(at) / max(n, 1)


def test_names_and_statements_of_python_find_theirs():
    definitions, kernel = functions_in_st(read_program(mixed, (INT, REAL, ARRAY)), "x", "LREAL", {"memory": 3})
    text = "\n\n".join(definitions)
    space = Blocks(text).space
    for k, at in ((1, 0.5), (2, -0.25), (0, 3.0)):
        memory = [0.1, 0.2, 0.3]
        assert space[kernel](k, at, memory) == mixed(k, at, list(memory))
    names = set(re.findall(r"(?m)^    (\w+)(?:, \w+)* : ", text))
    assert not {name.lower() for name in names} & ST_KEYWORDS
    assert all(re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name) for name in names)
    assert SimpleNamespace(**space).x_mixed
