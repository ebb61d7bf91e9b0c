"""Write a controller as code into a folder: C99, Structured Text, units of FMI 3.0 or JSON, with test vectors.

The units of FMI 3.0 are for co-simulation: the controller, and the virtual machine with its effects, source and binary.
"""

from __future__ import annotations

import hashlib
import io
import math
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.codegen.block import Ahead, Block
from emps_design.codegen.machine import machine_of
from emps_design.codegen.targets import (
    OPERATIONS,
    Files,
    block_name,
    comment,
    drives_of,
    hash_of,
    in_c,
    in_json,
    in_st,
    template,
    with_page,
    words_of,
)
from emps_design.codegen.vectors import Vectors, operations_of, vectors_of
from emps_design.compensation.feedforward import FeedForward, terms_of
from emps_design.compensation.study import digest_of
from emps_design.control.sampled import loop_in_words
from emps_design.control.verdict import worst_loop_of
from emps_design.errors import AxisError, EmpsError, InputError, UnstableError
from emps_design.files import write_text, write_together
from emps_design.messages import note, warning
from emps_design.simulation import Plant
from emps_design.view import Line, Table, View, Viewed

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC", "-shared")
LONGEST = 300  # s, of a compilation
ROWS = 1000  # of the machine's vectors
MOMENT = (1980, 1, 1, 0, 0, 0)  # of every file in a unit, so that the same axis gives the same bytes

NO_TERM_KEPT = note("no-term-kept", "the compensation has no useful term: only the law was exported")
LEAST = float(np.finfo(np.float32).tiny)  # smallest speed by which single precision can divide
NO_COMPILER = note(
    "no-compiler", "no C compiler was found: the FMUs contain only source code, which the importing tool has to compile"
)


@dataclass(frozen=True)
class Variable:
    """A number that goes in or out: its ``name``, ``causality``, ``unit`` and ``description``."""

    name: str
    causality: str
    unit: str
    description: str


def in_fmu(name: str, block: Block, vectors: Vectors) -> Files:
    """The files of the target: both units, the axis, the vectors of both, the page."""
    made: Files = {
        f"{name}.fmu": controller_unit(name, block, vectors),
        f"{name}_machine.fmu": machine_unit(name, block.axis),
        "machine.csv": machine_vectors(block.axis),
    }
    return with_page(name, block, vectors, made, binary=binary_for(), machine_rows=ROWS)


def controller_unit(name: str, block: Block, vectors: Vectors) -> bytes:
    """The controller of ``block`` as a unit: reference and measurements in, command out."""
    unit, words = block.axis.units.unit, words_of(name, block)
    force, carriage = words["force"], words["carriage"]
    ahead = 0.0 if block.ahead is None else block.ahead.feedforward.wait
    inputs = [
        Variable("reference", "input", words["reference_unit"], f"{words['follows']} that the law follows"),
        Variable("q", "input", unit("m"), "position that the encoder reports"),
        Variable("f_ext", "input", unit("N"), f"external {force} on the {carriage}, 0 without a sensor"),
        *(
            Variable(title, "input", unit(si), f"motion of the reference {ahead:.6g} s later")
            for title, si in zip(vectors.titles[3:], ("m", "m/s", "m/s^2"), strict=False)
        ),
    ]
    output = Variable("u", "output", unit("V"), "command of the last sample of the step")
    names = ", ".join(variable.name.upper() for variable in (*inputs, output))
    arguments = ", ".join(f"value[{variable.name.upper()}]" for variable in inputs)
    code = (
        f'#include <string.h>\n\n#include "{name}.h"\n\n'
        f"enum {{ TIME, {names}, VALUES, PARAMETER = VALUES }};\nstatic const double START[VALUES] = {{0}};\n"
        f"typedef {name}_state model;\n\n"
        f"static void model_begin(model *m, double *value)\n{{\n    {name}_init(m);\n    value[U] = 0.0;\n}}\n\n"
        f"static int model_step(model *m, double *value)\n{{\n    value[U] = {name}_step(m, {arguments});\n"
        "    return 1;\n}\n"
    )
    made = in_c(name, block, vectors)
    sources = {file: str(made[file]) for file in (f"{name}.c", f"{name}.h")}
    note = ": the command of the last sample of the step"
    return _unit(name, block.axis, "controller", [*inputs, output], code, sources, note)


def machine_unit(name: str, axis: Axis) -> bytes:
    """The axis with its effects as a unit: command and external force in, encoder and motion out."""
    unit, word = axis.units.unit, axis.units.word
    held = f"external {word('force')} on the {word('carriage')}, held over the period"
    variables = [
        Variable("u", "input", unit("V"), "command, held over the period"),
        Variable("f_ext", "input", unit("N"), held),
        Variable("q", "output", unit("m"), "position that the encoder reports"),
        Variable("position", "output", unit("m"), "position"),
        Variable("v", "output", unit("m/s"), "velocity"),
        Variable("q_start", "parameter", unit("m"), "position at which the axis rests at first"),
    ]
    words = {"machine": machine_of(axis, name), "axis": comment(axis.name), "version": metadata.version("emps-design")}
    code = template("machine.c").render(words)
    return _unit(f"{name}_machine", axis, "virtual machine", variables, code, {}, "")


def machine_vectors(axis: Axis) -> str:
    """Command and motion of the machine from rest (``ROWS`` samples), by the simulation itself, to the last bit."""
    period = axis.sampling.period
    t = np.arange(ROWS) * period
    wave = np.sin(2.0 * np.pi * 3.0 * t / t[-1]) + 0.5 * np.sin(2.0 * np.pi * 17.0 * t / t[-1] + 1.0)
    dry = axis.mechanics.coulomb + abs(axis.mechanics.offset)
    size = min(0.5 * axis.drive.command_limit, 3.0 * dry / axis.drive.gain or 0.1 * axis.drive.command_limit)
    run = Plant.of(axis).open_loop(size * wave)
    columns = np.column_stack([run.u, run.q, run.position, run.v]).tolist()
    return "\n".join(["u,q,position,v", *(",".join(map(repr, row)) for row in columns)]) + "\n"


def compiler() -> str:
    """Path of the C compiler for the binary of a unit; "" where there is none, or on another platform than Linux."""
    return (shutil.which("cc") or shutil.which("gcc") or "") if sys.platform == "linux" else ""


def binary_for() -> str:
    """The platform of the binaries, as FMI 3.0 names it; "" where the FMUs contain only source code."""
    return f"{platform.machine()}-linux" if compiler() else ""


def _unit(
    name: str, axis: Axis, model: str, variables: list[Variable], code: str, sources: Mapping[str, str], note: str
) -> bytes:
    """The bytes of a unit called ``name``."""
    words: dict[str, Any] = {
        "identifier": name,
        "model": model,
        "axis": comment(axis.name),
        "version": metadata.version("emps-design"),
        "period": repr(axis.sampling.period),
        "note": note,
        "token": "",
        "code": code,
        "settable": sum(variable.causality == "input" for variable in variables),
        "variables": [asdict(variable) for variable in variables],
        "units": sorted({"s", *(variable.unit for variable in variables)}),
    }
    plain = "".join([template("fmu.c").render(words), *sources.values()])
    words["token"] = hashlib.sha256(plain.encode()).hexdigest()
    written = {"fmu.c": template("fmu.c").render(words), **sources}
    inside: dict[str, bytes] = {
        "modelDescription.xml": template("modelDescription.xml").render(words).encode(),
        "sources/buildDescription.xml": template("buildDescription.xml")
        .render(identifier=name, sources=[file for file in written if file.endswith(".c")])
        .encode(),
        **{f"sources/{file}": text.encode() for file, text in written.items()},
    }
    if compiler():
        inside[f"binaries/{binary_for()}/{name}.so"] = _compiled(name, written)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, content in inside.items():
            archive.writestr(zipfile.ZipInfo(file, MOMENT), content, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _compiled(name: str, sources: Mapping[str, str]) -> bytes:
    """The shared library of ``sources``; raises :class:`EmpsError` where they do not compile."""
    with tempfile.TemporaryDirectory() as folder:
        for file, text in sources.items():
            Path(folder, file).write_text(text, encoding="utf-8")
        files = [file for file in sources if file.endswith(".c")]
        made = subprocess.run(
            [compiler(), *FLAGS, "-o", f"{name}.so", *files, "-lm"],
            cwd=folder, capture_output=True, text=True, timeout=LONGEST, check=False,
        )  # fmt: skip
        if made.returncode != 0:
            reason = next((line for line in made.stderr.splitlines() if "error" in line), made.stderr[:200])
            raise EmpsError(f"{compiler()}: does not take the source of {name}: {reason}")
        return Path(folder, f"{name}.so").read_bytes()


@dataclass(frozen=True)
class Exported(Viewed):
    """What was exported: the ``files`` by name with their text, and the ``vectors`` that test them.

    ``checked``: whether the loop was found stable; ``bare``: a compensation was given, and keeps nothing.
    """

    name: str
    target: str
    block: Block
    vectors: Vectors = field(repr=False)
    files: Files = field(repr=False)
    checked: bool = True
    bare: bool = False

    def write(self, folder: Path) -> None:
        """Write the files into ``folder``, which exists, all of them or none."""
        with write_together(folder) as aside:
            for name, text in self.files.items():
                write_text(aside / name, text) if isinstance(text, str) else (aside / name).write_bytes(text)

    def view(self) -> View:
        """The vectors, the operations of one step, and the gains as parameters of common drives."""
        counts = operations_of(self.block).items()
        drives = drives_of(self.block)
        side = "motor's" if drives and drives[0]["side"] == "motor" else "axis's own"
        headings = ("drive", "parameter", "value", "unit", "gain")
        rows = [(d["family"], d["parameter"], f"{d['value']:.6g}", d["unit"], d["gain"]) for d in drives]
        title = f"The gains as parameters of common drives, on the {side} side"
        return (
            Line(f"{self.vectors.q.size} vectors of the law {self.block.kind.name}, axis {self.block.axis.name}"),
            Line(f"one step: {', '.join(f'{number} {OPERATIONS[kind]}' for kind, number in counts)}", "prose"),
            *([Table(headings, rows, title, words=("parameter", "unit", "gain"))] if rows else []),
        )

    def to_dict(self) -> dict[str, Any]:
        """Names and hashes of the files, the vectors, operations, drive settings, as plain data."""
        finite = self.vectors.difference[np.isfinite(self.vectors.difference)]
        carriage = self.block.axis.units.word("carriage")
        text = f"the stability of the loop was not checked: the law is not linear while the {carriage} slides"
        return {
            "name": self.name,
            "target": self.target,
            "axis": self.block.axis.name,
            "law": self.block.kind.name,
            "compensation": list(self.block.ahead.feedforward.terms) if self.block.ahead is not None else [],
            "files": list(self.files),
            "sha256": {name: hash_of(text) for name, text in self.files.items()},
            "vectors": {
                "rows": int(self.vectors.q.size),
                "inputs": list(self.vectors.titles),
                "states": int(self.vectors.outputs[1].shape[1]),
                "single_precision_bound": float(finite.max()) if finite.size else None,
                "rows_without_bound": int(self.vectors.q.size - finite.size),
                "rows_that_rounding_decides": int(self.vectors.decided_otherwise.sum()),
            },
            "operations": operations_of(self.block),
            "drives": drives_of(self.block),
            "units": {"single_precision_bound": self.block.output_unit},
            "binary": (binary_for() or None) if self.target == "fmu" else None,
            "warnings": [warning("stability-not-checked", text)] * (not self.checked)
            + [NO_TERM_KEPT] * self.bare
            + [NO_COMPILER] * (self.target == "fmu" and not binary_for()),
        }


def export_observer(axis: Axis, target: str, cutoff_hz: float, origin: str = "") -> Exported:
    """Return the on-line force observer of ``axis``, low-passed at ``cutoff_hz``, as the files of a ``target``.

    Any target but ``fmu``; the page says the ``origin`` of the axis. Raises :class:`InputError` for that target, for
    another, and for effects that have a part in the force.

    >>> from emps_design.machines import machine
    >>> list(export_observer(machine("emps2018"), "st", 20.0).files)
    ['emps2018_observer.st', 'emps2018_observer.toml', 'vectors.csv', 'README.md']
    """
    possible = [name for name in TARGETS if name != "fmu"]
    if target not in possible:
        raise InputError(f"`target`: found {target!r} for an observer, expected one of {', '.join(possible)}")
    block, name = replace(Block.observer(axis, cutoff_hz), origin=origin), block_name(f"{axis.name} observer")
    vectors = vectors_of(block)
    return Exported(name, target, block, vectors, TARGETS[target](name, block, vectors))


def export_controller(
    axis: Axis, target: str, compensation: Mapping[str, Any] | None = None, origin: str = ""
) -> Exported:
    """Return the controller of ``axis`` as the files of a ``target``: one of ``TARGETS``.

    ``compensation`` is what :func:`~emps_design.compensation.compensate` found, as plain data; the page says the
    ``origin`` of the axis. The same axis gives the same bytes. Raises :class:`InputError` for another target, for an
    axis without a controller, for a law that has no translation and for a compensation of another axis, and
    :class:`UnstableError` for a controller with an unstable loop on the axis, in either direction.

    >>> from emps_design.machines import machine
    >>> list(export_controller(machine("emps2019"), "c").files)
    ['emps2019.c', 'emps2019.h', 'emps2019_check.c', 'Makefile', 'emps2019.toml', 'vectors.csv', 'README.md']
    """
    if target not in TARGETS:
        raise InputError(f"`target`: found {target!r}, expected one of {', '.join(TARGETS)}")
    block = replace(Block.of(axis, None if compensation is None else _ahead(axis, compensation)), origin=origin)
    checked = _loop_stable(axis)
    name, vectors = block_name(axis.name), vectors_of(block)
    bare = compensation is not None and block.ahead is None
    return Exported(name, target, block, vectors, TARGETS[target](name, block, vectors), checked, bare)


def _loop_stable(axis: Axis) -> bool:
    """Whether the loops of ``axis`` are stable; False where a law is not linear, :class:`UnstableError` where not."""
    try:
        loop = worst_loop_of(axis)
    except AxisError:
        return False
    if not loop.margins.stable:
        words = loop_in_words(loop, axis.units)
        raise UnstableError(f"axis {axis.name}: the {words} is unstable; no code was exported")
    return True


def _ahead(axis: Axis, compensation: Mapping[str, Any]) -> Ahead | None:
    """The feed-forward of a ``compensation`` for this ``axis``, checked; None if it has no terms."""
    kept, reversal, taken = compensation.get("kept"), compensation.get("reversal"), compensation.get("law_taken_off")
    if not isinstance(kept, list) or not isinstance(reversal, int | float) or not isinstance(taken, bool):
        raise InputError(
            "compensation: found no kept, reversal and law_taken_off, expected the document that compensate writes"
        )
    speed = math.nan if isinstance(reversal, bool) else float(reversal)
    if not (math.isfinite(speed) and (speed == 0.0 or speed >= LEAST)):
        raise InputError(f"compensation: found a reversal of {speed:g}, expected the speed that compensate writes")
    unknown = [str(term) for term in kept if term not in terms_of(axis)[0]]
    if unknown or compensation.get("axis") != axis.name:
        raise InputError(
            f"compensation: found the terms {', '.join(map(str, kept))} of the axis {compensation.get('axis')}, "
            f"expected those of {axis.name}; run compensate on this axis"
        )
    if compensation.get("axis_sha256") != digest_of(axis):
        raise InputError(
            f"compensation: found one of {axis.name} with other parameters or another controller; run compensate on "
            "this axis"
        )
    if not kept:
        return None
    if not taken:
        raise InputError(
            "compensation: found one for a law that also follows its reference, expected one for the law on the "
            "position error; run compensate on this axis again"
        )
    return Ahead.of(replace(FeedForward.of(axis, kept), reversal=speed))


TARGETS: dict[str, Callable[[str, Block, Vectors], Files]] = {
    "c": in_c, "st": in_st, "fmu": in_fmu, "json": in_json,
}  # fmt: skip
