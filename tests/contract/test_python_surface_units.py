"""What Python says of an axis has that axis's words and units: no sentence needs a translation afterwards."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import SequenceMatcher
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from emps_design import (
    Advice,
    Axis,
    EmpsError,
    Record,
    advise,
    controller_margins,
    design_force_loop,
    design_velocity_loop,
    identify,
    impedance_law,
    import_record,
    observe,
    replay,
    retune_velocity_loop,
    synthetic_record,
)
from emps_design.comanipulation.assessment import assess_impedance
from emps_design.commands import Reply, force
from emps_design.control.impedance.law import equivalent_loop
from emps_design.control.linear_plant import Member
from emps_design.control.margins import Margins
from emps_design.control.sampled import NestedLoop
from emps_design.importing import layout_of
from emps_design.importing.read import with_contradictions
from emps_design.messages import Message
from emps_design.simulation.scenarios import breakaway
from tests.axes import KINDS, machine_of
from tests.rewriting import rewritten

NAMES = ("name", "axis", "record", "records", "file", "model_file", "source", "equation")


@dataclass(frozen=True)
class Bench:
    """An axis, a short record of it, and a folder for files of the test."""

    axis: Axis
    record: Record
    folder: Path

    def file(self, name: str, text: str) -> Path:
        """A file of the folder with ``text`` in it."""
        path = self.folder / name
        path.write_text(text)
        return path

    @property
    def loop(self) -> Any:
        """A velocity loop of the axis."""
        return design_velocity_loop(self.axis, 60.0)


@pytest.fixture(scope="module")
def bench(request, tmp_path_factory):
    """A bench with one kind of axis."""
    axis = machine_of(request.param)
    return Bench(axis, synthetic_record(axis, laps=1, stroke=0.1), tmp_path_factory.mktemp("bench"))


def sentences(value: Any) -> Iterator[str]:
    """The strings with a space in plain data, names and file names apart."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            if key not in NAMES:
                yield from sentences(entry)
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from sentences(entry)
    elif isinstance(value, str) and " " in value:
        yield value


def said(result: Any) -> Iterator[str]:
    """Everything that a result says: as text, in a notebook, in warnings and in plain data."""
    yield str(result)
    for make in ("_repr_html_", "to_dict"):
        if hasattr(result, make):
            made = getattr(result, make)()
            yield from [made] if isinstance(made, str) else sentences(made)
    warnings = [] if isinstance(result, Advice) else list(getattr(result, "warnings", ()))
    assert [text for text in warnings if not isinstance(text, Message)] == []
    yield from warnings


def untranslated(axis: Axis, texts: Iterable[str]) -> list[str]:
    """The places in ``texts`` that a translation to the units of ``axis`` would change; a line may be wrapped."""
    places = []
    for text in texts:
        words = text.replace(" m or rad", "").split()  # of a record, which has no axis
        own = rewritten(axis.units, " ".join(words)).split()
        changes = SequenceMatcher(None, words, own, autojunk=False).get_opcodes() if own != words else []
        places += [" ".join(words[max(0, i - 5) : j + 5]) for what, i, j, _, _ in changes if what != "equal"]
    return places


def advised(name: str, result: Any, bench: Bench) -> Any:
    """The advice on a result."""
    document, units = result.to_dict(), bench.axis.units
    return advise(name, document, axis=bench.axis.name, records=[bench.record.name], units=units)


def effect_of(bench: Bench) -> Axis:
    """The axis with a friction that its model of four parameters lacks."""
    size = 0.5 * bench.axis.mechanics.coulomb
    return bench.axis.replace(effects=[{"kind": "position_ripple", "amplitude": size, "period": 0.02, "phase": 0.5}])


RESULTS = {
    "record": lambda b: b.record,
    "imported": lambda b: import_record(_csv(b), b.axis),
    "loop": lambda b: b.loop,
    "loop with a bandwidth": lambda b: design_velocity_loop(b.axis, bandwidth=40.0, velocity=0.02),
    "loop, fast": lambda b: design_velocity_loop(b.axis, 400.0, phase_margin_deg=70.0),
    "loop, unstable": lambda b: design_velocity_loop(b.axis, 2000.0, phase_margin_deg=20.0),
    "loop with an effect": lambda b: design_velocity_loop(effect_of(b), 60.0),
    "loop, retuned": lambda b: retune_velocity_loop(b.axis, 60.0),
    "force loop": lambda b: design_force_loop(b.loop, 1e-3, hand=20.0, environment=1000.0),
    "force loop, unstable": lambda b: design_force_loop(b.loop, 5.0, environment=1e5),
    "force loop with a delay": lambda b: design_force_loop(b.loop, 1e-3, sensor_delay=3, on_carriage=False),
    "margins": lambda b: controller_margins(b.axis),
    "margins over errors": lambda b: controller_margins(b.axis, mismatch=0.1),
    "margins with an effect": lambda b: controller_margins(effect_of(b)),
    "impedance law": lambda b: impedance_law(b.axis, 50.0, 100.0),
    "identified": lambda b: identify(b.record, b.axis),
    "identified by output error": lambda b: identify(b.record, b.axis, estimator="oe"),
    "observed": lambda b: observe(b.record, b.axis),
    "replayed": lambda b: replay(b.axis, b.record),
    "advice on a loop": lambda b: advised("gains", b.loop, b),
    "advice on a record": lambda b: advised("identify", identify(b.record, b.axis), b),
}


def _unstable_elsewhere(bench: Bench) -> Any:
    """A force loop whose worst loop is unstable with another inertia."""
    force = design_force_loop(bench.loop, 1e-3, hand=20.0)
    worst = NestedLoop("velocity loop", "plant input", Margins(stable=False), {"inertia": 3.0, "velocity": 0.1})
    vars(force)["loops"] = (worst,)
    return force


def _unsettled(bench: Bench) -> Any:
    """The linear plant of an effect that finds no equilibrium."""
    effect = effect_of(bench).effects[0]
    member = Member(effect.effect, effect.effect.values(effect.parameters), bench.axis.mechanics.array())
    member.settled = False
    return SimpleNamespace(warnings=member.left_out(0.1, 0.0, bench.axis.units))


MESSAGES = {  # code -> a result with that message
    "recorded-force-acts": lambda b: replay(b.axis, _pushed(b)),
    "no-operator": lambda b: design_force_loop(b.loop, 1e-3),
    "continuous-limit-unbounded": lambda b: design_force_loop(b.loop, 1e-3, hand=20.0),
    "resonance-in-band": lambda b: equivalent_loop(b.axis, 1e4 * b.axis.mechanics.mass, 1e-3, mismatch=0.5),
    "other-machine-unstable": lambda b: _unstable_elsewhere(b),
    "no-steady-state": lambda b: _unsettled(b),
    "coarse-push": lambda b: breakaway(b.axis, rate=0.3 * b.axis.mechanics.coulomb / b.axis.sampling.period),
    "held": lambda b: breakaway(b.axis, peak=0.01 * b.axis.mechanics.coulomb, rate=20.0),
    "no-kalman-observer": lambda b: observe(b.record, b.axis.replace(sampling={"encoder_resolution": 0.0})),
    "contradiction": lambda b: with_contradictions(b.axis, replace(b.record, u=2.0 * b.record.u)),
    "loop-of-the-paper": lambda b: force.answer(force.ForceRequest(axis=effect_of(b), k_e1=1e-3)),
}
REFUSED = {
    "crossover of 0": lambda b: design_velocity_loop(b.axis, 0.0),
    "no specification": lambda b: design_velocity_loop(b.axis),
    "phase of 100 deg": lambda b: design_velocity_loop(b.axis, 60.0, phase_margin_deg=100.0),
    "force gain of 1e9": lambda b: design_force_loop(b.loop, 1e9),
    "force gain of -1": lambda b: design_force_loop(b.loop, -1.0),
    "hand of -1": lambda b: design_force_loop(b.loop, 0.01, hand=-1.0),
    "environment of -1": lambda b: design_force_loop(b.loop, 0.01, environment=-1.0),
    "mismatch of 2": lambda b: controller_margins(b.axis, mismatch=2.0),
    "apparent mass of -1": lambda b: impedance_law(b.axis, -1.0, 100.0),
    "apparent damping of -1": lambda b: impedance_law(b.axis, 50.0, -1.0),
    "filter of 0": lambda b: impedance_law(b.axis, 50.0, 100.0, filter=0.0),
    "stiffness of -1": lambda b: impedance_law(b.axis, 50.0, 100.0, stiffness=-1.0),
    "plants of -1": lambda b: assess_impedance(b.axis, 50.0, 100.0, mismatch=0.02, plants=-1),
    "no motion": lambda b: identify(_still(b), b.axis),
    "cutoff of 1 MHz": lambda b: identify(b.record, b.axis, cutoff=1e6),
    "pushed by hand": lambda b: identify(_pushed(b), b.axis),
    "too short to observe": lambda b: observe(b.record.until(5), b.axis),
    "replay at another period": lambda b: replay(b.axis.replace(sampling={"period": 2e-3}), b.record),
    "mass of -1": lambda b: b.axis.replace(mechanics={"mass": -1.0}),
    "friction of -1": lambda b: b.axis.replace(mechanics={"coulomb": -1.0}),
    "limit of 0": lambda b: b.axis.replace(drive={"command_limit": 0.0}),
    "gain of 0": lambda b: b.axis.replace(drive={"force_gain": 0.0}),
    "no file": lambda b: import_record(b.folder / "missing.csv", b.axis),
    "record without a command": lambda b: import_record(b.file("bad.csv", "t,q,q_ref\n0,0,0\n0.001,0,0\n"), b.axis),
    "command far beyond the limit": lambda b: import_record(_csv(b, command=1e9), b.axis),
    "position in kilometres": lambda b: import_record(_csv(b, position=1e6), b.axis),
    "a word among the numbers": lambda b: import_record(b.file("word.csv", "t,q,q_ref,u\n0,a,0,0\n"), b.axis),
}


def _csv(bench: Bench, position: float = 1.0, command: float = 1.0) -> Path:
    """The record as a file of numbers with a factor on its columns."""
    record = bench.record
    columns = np.column_stack([record.t, position * record.q, record.q_ref, command * record.u])
    path = bench.folder / "record.csv"
    np.savetxt(path, columns, delimiter=",", header="t,q,q_ref,u", comments="")
    return path


def _still(bench: Bench) -> Record:
    record = bench.record
    still = (0.0 * record.q, 0.0 * record.q, 0.0 * record.u)
    return Record.from_arrays(record.t, *still, layout=layout_of(bench.axis))


def _pushed(bench: Bench) -> Record:
    record = bench.record
    return Record.from_arrays(record.t, record.q_ref, record.q, record.u, f_ext=5.0 + 0.0 * record.t)


def cases(table: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Every axis with every case of ``table``."""
    return [(kind, name) for kind in KINDS for name in table]


@pytest.mark.parametrize(("bench", "name"), cases(RESULTS), indirect=["bench"])
def test_results(bench, name):
    assert untranslated(bench.axis, said(RESULTS[name](bench))) == []


@pytest.mark.parametrize(("bench", "code"), cases(MESSAGES), indirect=["bench"])
def test_messages(bench, code):
    result = MESSAGES[code](bench)
    messages = result.document["warnings"] if isinstance(result, Reply) else result.warnings
    assert code in [message.code for message in messages]
    assert untranslated(bench.axis, messages) == []


@pytest.mark.parametrize(("bench", "name"), cases(REFUSED), indirect=["bench"])
def test_refusals(bench, name):
    with pytest.raises(EmpsError) as refused:
        REFUSED[name](bench)
    assert untranslated(bench.axis, [str(refused.value)]) == []


@pytest.mark.parametrize("bench", ["rotary, A"], indirect=True)
def test_impedance(bench):
    assert untranslated(bench.axis, said(assess_impedance(bench.axis, 50.0, 100.0, mismatch=0.02, plants=2))) == []
