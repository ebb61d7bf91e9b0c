"""Units of FMI 3.0 for co-simulation: the controller, and the virtual machine with its effects, source and binary."""

from __future__ import annotations

import hashlib
import io
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.codegen.block import Block
from emps_design.codegen.machine import machine_of
from emps_design.codegen.pages import Files, comment, template, with_page, words_of
from emps_design.codegen.targets import in_c
from emps_design.codegen.vectors import Vectors
from emps_design.errors import EmpsError
from emps_design.simulation import Plant

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-fPIC", "-shared")
LONGEST = 300  # s, of a compilation
ROWS = 1000  # of the machine's vectors
MOMENT = (1980, 1, 1, 0, 0, 0)  # of every file in a unit, so that the same axis gives the same bytes


@dataclass(frozen=True)
class Variable:
    """A number that goes in or out: its ``name``, ``causality`` and ``unit``, and what it is."""

    name: str
    causality: str
    unit: str
    said: str


def in_fmu(name: str, block: Block, vectors: Vectors) -> Files:
    """The files of the target: both units, the axis, the vectors of both, the page."""
    made: Files = {
        f"{name}.fmu": controller_unit(name, block, vectors),
        f"{name}_machine.fmu": machine_unit(name, block.axis),
        "machine.csv": machine_vectors(block.axis),
    }
    return with_page(name, block, vectors, made, binary=binary_for(), machine_rows=ROWS)


def controller_unit(name: str, block: Block, vectors: Vectors) -> bytes:
    """The controller of ``block`` as a unit: what it follows and measures in, its command out."""
    unit, words = block.axis.units.unit, words_of(name, block)
    ahead = 0.0 if block.ahead is None else block.ahead.feedforward.wait
    inputs = [
        Variable("reference", "input", words["reference_unit"], f"{words['follows']} that the law follows"),
        Variable("q", "input", unit("m"), "position that the encoder reports"),
        Variable("f_ext", "input", unit("N"), "external force on the carriage, 0 without a sensor"),
        *(
            Variable(title, "input", unit(si), f"motion of the reference {ahead:.6g} s later")
            for title, si in zip(vectors.titles[3:], ("m", "m/s", "m/s^2"), strict=False)
        ),
    ]
    output = Variable("u", "output", unit("V"), "command of the last sample of the step")
    names = ", ".join(one.name.upper() for one in (*inputs, output))
    given = ", ".join(f"value[{one.name.upper()}]" for one in inputs)
    code = (
        f'#include <string.h>\n\n#include "{name}.h"\n\n'
        f"enum {{ TIME, {names}, VALUES, PARAMETER = VALUES }};\nstatic const double START[VALUES] = {{0}};\n"
        f"typedef {name}_state model;\n\n"
        f"static void model_begin(model *m, double *value)\n{{\n    {name}_init(m);\n    value[U] = 0.0;\n}}\n\n"
        f"static int model_step(model *m, double *value)\n{{\n    value[U] = {name}_step(m, {given});\n"
        "    return 1;\n}\n"
    )
    made = in_c(name, block, vectors)
    sources = {file: str(made[file]) for file in (f"{name}.c", f"{name}.h")}
    note = ": the command of the last sample of the step"
    return _unit(name, block.axis, "controller", [*inputs, output], code, sources, note)


def machine_unit(name: str, axis: Axis) -> bytes:
    """The axis with its effects as a unit: command and external force in, encoder and motion out."""
    unit = axis.units.unit
    variables = [
        Variable("u", "input", unit("V"), "command, held over the period"),
        Variable("f_ext", "input", unit("N"), "external force on the carriage, held over the period"),
        Variable("q", "output", unit("m"), "position that the encoder reports"),
        Variable("position", "output", unit("m"), "position"),
        Variable("v", "output", unit("m/s"), "velocity"),
        Variable("q_start", "parameter", unit("m"), "position at which the axis rests at first"),
    ]
    words = {"machine": machine_of(axis, name), "axis": comment(axis.name), "version": _version()}
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
    """The C compiler with which a unit gets its binary; nothing where there is none, or no platform known here."""
    return (shutil.which("cc") or shutil.which("gcc") or "") if sys.platform == "linux" else ""


def binary_for() -> str:
    """The platform of the binaries, as FMI 3.0 calls it; nothing where units hold their source alone."""
    return f"{platform.machine()}-linux" if compiler() else ""


def _version() -> str:
    from importlib import metadata

    return metadata.version("emps-design")


def _unit(
    name: str, axis: Axis, model: str, variables: list[Variable], code: str, sources: Mapping[str, str], note: str
) -> bytes:
    """The bytes of a unit called ``name``."""
    words: dict[str, Any] = {
        "identifier": name,
        "model": model,
        "axis": comment(axis.name),
        "version": _version(),
        "period": repr(axis.sampling.period),
        "note": note,
        "token": "",
        "code": code,
        "settable": sum(one.causality == "input" for one in variables),
        "variables": [asdict(one) for one in variables],
        "units": sorted({"s", *(one.unit for one in variables)}),
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
    """The shared library of ``sources``; raises :class:`EmpsError` where the compiler does not take them."""
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
