"""Write a controller as code into a folder: C99, Structured Text or JSON, with the vectors that prove it."""

from __future__ import annotations

import ast
import hashlib
import inspect
import json
import math
import re
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib import metadata
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from emps_design.axis.tables import field_in
from emps_design.codegen.ahead import Ahead
from emps_design.codegen.block import Block
from emps_design.codegen.c import KEYWORDS, functions_in_c
from emps_design.codegen.printer import safe_names
from emps_design.codegen.st import functions_in_st, st_number
from emps_design.codegen.vectors import MOTION, REST, Vectors, vectors_of
from emps_design.compensation.feedforward import FeedForward, terms_of
from emps_design.errors import InputError
from emps_design.files import write_text, write_together
from emps_design.laws import law_of, leaves, unit_of
from emps_design.simulation.kernels.inverse import HOOKS

if TYPE_CHECKING:
    from pathlib import Path

    from emps_design.axis import Axis

INPUTS = {"position": "m", "velocity": "m/s", "rest position": "m"}  # unit of what a law follows
LONGEST_NAME = 40
CHARACTERS = 120  # of a line of a comment


@dataclass(frozen=True)
class Exported:
    """What was exported: the ``files`` by name with their text, and the ``vectors`` they were proved with."""

    name: str
    target: str
    block: Block
    vectors: Vectors = field(repr=False)
    files: dict[str, str] = field(repr=False)

    def write(self, folder: Path) -> None:
        """Write the files into ``folder``, which exists, all of them or none."""
        with write_together(folder) as aside:
            for name, text in self.files.items():
                write_text(aside / name, text)

    def to_dict(self) -> dict[str, Any]:
        """Names of the files and what the vectors are."""
        bound = [one for one in self.vectors.bound.tolist() if math.isfinite(one)]
        return {
            "name": self.name,
            "target": self.target,
            "axis": self.block.axis.name,
            "law": self.block.kind.name,
            "compensation": list(self.block.ahead.feedforward.terms) if self.block.ahead is not None else [],
            "files": list(self.files),
            "sha256": {name: _hash(text) for name, text in self.files.items()},
            "vectors": {
                "rows": int(self.vectors.q.size),
                "inputs": list(self.vectors.titles),
                "states": int(self.vectors.answers[1].shape[1]),
                "single_precision_bound": max(bound, default=None),
                "rows_without_bound": int(self.vectors.q.size - len(bound)),
            },
            "units": {"single_precision_bound": self.block.axis.units.unit("V")},
            "warnings": [],
        }


def export_controller(axis: Axis, target: str, compensation: Mapping[str, Any] | None = None) -> Exported:
    """Return the controller of ``axis`` as the files of a ``target``: one of ``TARGETS``.

    ``compensation`` is what :func:`~emps_design.compensation.compensate` found, as plain data; C alone takes one. The
    same axis gives the same bytes. Raises :class:`InputError` for another target, for an axis without a controller, for
    a law that has no translation and for a compensation of another axis.

    >>> from emps_design.machines import machine
    >>> list(export_controller(machine("emps2019"), "c").files)
    ['emps2019.c', 'emps2019.h', 'emps2019_check.c', 'Makefile', 'emps2019.toml', 'vectors.csv', 'README.md']
    """
    if target not in TARGETS:
        raise InputError(f"`target`: found {target!r}, expected one of {', '.join(TARGETS)}")
    block = Block.of(axis, None if compensation is None else _ahead(axis, target, compensation))
    name, vectors = block_name(axis.name), vectors_of(block)
    return Exported(name, target, block, vectors, TARGETS[target](name, block, vectors))


def _ahead(axis: Axis, target: str, found: Mapping[str, Any]) -> Ahead:
    """The feed-forward of a ``compensation`` for this ``axis``, checked."""
    kept, reversal, taken = found.get("kept"), found.get("reversal"), found.get("law_taken_off")
    if not isinstance(kept, list) or not isinstance(reversal, int | float) or not isinstance(taken, bool):
        raise InputError("compensation: found no kept, reversal and law_taken_off, expected what compensate writes")
    unknown = [str(term) for term in kept if term not in terms_of(axis)[0]]
    if unknown or found.get("axis") != axis.name:
        raise InputError(
            f"compensation: found the terms {', '.join(map(str, kept))} of the axis {found.get('axis')}, expected "
            f"those of {axis.name}; run compensate on this axis"
        )
    if target != "c":
        raise InputError(f"`target`: found {target!r} with a compensation, expected c: no other takes one yet")
    ahead = replace(FeedForward.of(axis, kept), reversal=float(reversal))
    if taken and law_of(axis, axis.sampling.period).follows != "position":
        raise InputError("compensation: found one of a law that follows a velocity, expected a position")
    return Ahead.of(ahead, taken)


def block_name(name: str) -> str:
    """``name`` as an identifier that C and IEC 61131-3 take.

    >>> block_name("emps2018-two-quadrant"), block_name("Achse 3 (Ü)"), block_name("double"), block_name("3")
    ('emps2018_two_quadrant', 'Achse_3', 'double_2', 'x3')
    """
    plain = re.sub("[^0-9A-Za-z]+", "_", name)[:LONGEST_NAME].strip("_") or "axis"
    return safe_names([plain], KEYWORDS | frozenset({"end_if", "program", "function", "var", "type"}))[plain]


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@lru_cache
def _template(name: str) -> Any:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(undefined=StrictUndefined, keep_trailing_newline=True, autoescape=False)
    return environment.from_string((files("emps_design.codegen") / "templates" / name).read_text(encoding="utf-8"))


def _words(name: str, block: Block) -> dict[str, Any]:
    """What every template may say."""
    axis, law = block.axis, block.law
    table = axis.controller.parameters
    own = {key: table[key] for key in block.kind.table.model_fields if key in table}
    said = block.kind.equations(block.kind.table(**own), axis, axis.sampling.period)
    unit = axis.units.unit
    parameters = [
        f"{'.'.join(path)} = {value} {unit(unit_of(field_in(('controller', *path), block.kind.name)))}".rstrip()
        for path, value in leaves(own)
    ]
    return {
        "name": name,
        "macro": name.upper(),
        "axis": _comment(axis.name),
        "kind": block.kind.name,
        "label": _comment(block.kind.label),
        "source": _comment(block.kind.source),
        "version": metadata.version("emps-design"),
        "period": repr(axis.sampling.period),
        "equations": [_comment(line, 1000) for line in said],
        "parameters": list(map(_comment, parameters)),
        "memory": max(1, law.memory),
        "memories": law.memory,
        "states": law.memory * (2 if block.ahead is not None and block.ahead.takes_off else 1),
        "inputs": 6 if block.ahead is not None else 3,
        "ahead": None,
        "feedforward": None if block.ahead is None else _feedforward(block.ahead),
        "velocity_unit": unit("m/s"),
        "acceleration_unit": unit("m/s^2"),
        "mass_unit": unit("kg"),
        "limit": repr(block.limit),
        "follows": f"a {law.follows}",
        "reference_unit": unit(INPUTS[law.follows]),
        "position_unit": unit("m"),
        "force_unit": unit("N"),
        "command_unit": unit("V"),
    }


def _comment(text: object, longest: int = CHARACTERS) -> str:
    """``text`` as part of a comment or a page: one line, ASCII, nothing that ends a comment."""
    plain = " ".join(str(text).split()).encode("ascii", "replace").decode()
    for mark in ("*/", "/*", "*)", "(*", "`", "??"):
        plain = plain.replace(mark, " ")
    return plain if len(plain) <= longest else f"{plain[: longest - 3]}..."


def _gain_names(block: Block) -> list[str]:
    """What the kernel's own file calls each of its gains: the constants it uses as their places."""
    kernel = block.law.kernel
    space, array, named = vars(inspect.getmodule(kernel)), list(block.program.kernel.parameters)[5], {}
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(kernel)))):
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id == array:
            place = space.get(node.slice.id) if isinstance(node.slice, ast.Name) else None
            if isinstance(place, int) and isinstance(node.slice, ast.Name):
                named[place] = node.slice.id.lower().replace("_", " ")
    return [_comment(named.get(place, "")) for place in range(len(block.law.gains))]


def _with_page(name: str, block: Block, vectors: Vectors, made: dict[str, str]) -> dict[str, str]:
    """``made`` with the axis, the vectors, and a page that says what is there."""
    made = {**made, f"{name}.toml": block.axis.to_toml(comments=True), "vectors.csv": vectors.to_csv()}
    bounds = [one for one in vectors.bound.tolist() if math.isfinite(one)]
    left = vectors.q.size - len(bounds)
    unit, moving = block.axis.units.unit("V"), vectors.bound[REST : REST + MOTION].max()
    said = (
        f"Here the largest is {moving:.3g} {unit} in motion within the limit and "
        f"{max(bounds, default=0.0):.3g} {unit} in all"
        + (f"; {left} rows have none, behind a comparison that rounding decides." if left else ".")
    )
    hashes = [(file, _hash(text)) for file, text in made.items()]
    words = {**_words(name, block), "files": list(made), "rows": vectors.q.size, "bound": said, "hashes": hashes}
    return {**made, "README.md": _template("README.md").render(words)}


def _ahead_in_c(name: str, ahead: Ahead) -> tuple[list[str], dict[str, Any]]:
    """Definitions of the kernels that are fed forward, and what the templates say of them."""
    definitions, calls = [], {hook: list[str]() for hook in HOOKS}
    for part in ahead.parts:
        made, kernel = functions_in_c(part.program, f"{name}_{part.term}", {})
        definitions += made
        calls[part.hook].append(kernel)
    return definitions, {
        "hooks": [{"name": hook, "calls": calls[hook]} for hook in HOOKS],
        "own": [repr(one) for one in ahead.own],
        "repeats": ahead.repeats,
        "passes": ahead.passes,
        "gain": repr(float(ahead.feedforward.axis.drive.force_gain)),
        **_feedforward(ahead),
    }


def _feedforward(ahead: Ahead) -> dict[str, Any]:
    """What a page says of a feed-forward."""
    return {
        "terms": [term.replace("_", " ") for term in ahead.feedforward.terms],
        "wait": repr(ahead.feedforward.wait),
        "reversal": repr(ahead.reversal) if ahead.reversal > 0.0 else "",
        "takes_off": ahead.takes_off,
    }


def _c(name: str, block: Block, vectors: Vectors) -> dict[str, str]:
    definitions, kernel = functions_in_c(
        block.program, name, dict(zip(list(block.program.kernel.parameters)[4:6], ("LIMIT", "GAINS"), strict=True))
    )
    words = _words(name, block)
    if block.ahead is not None:
        more, words["ahead"] = _ahead_in_c(name, block.ahead)
        definitions = list(dict.fromkeys([*definitions, *more]))
    gains = list(zip((repr(float(gain)) for gain in block.law.gains), _gain_names(block), strict=True))
    repeats = block.ahead is not None and block.ahead.repeats
    words |= {
        "definitions": definitions,
        "kernel": kernel,
        "gains": gains or [("0.0", "none")],
        "uses_math": repeats or any("FN(" in definition for definition in definitions),
    }
    made = {
        f"{name}.c": _template("controller.c").render(words),
        f"{name}.h": _template("controller.h").render(words),
        f"{name}_check.c": _template("check.c").render(words),
        "Makefile": _template("Makefile").render(words),
    }
    return _with_page(name, block, vectors, made)


def _st(name: str, block: Block, vectors: Vectors) -> dict[str, str]:
    sizes = {
        parameter: size
        for parameter, size in zip(
            list(block.program.kernel.parameters)[5:], (len(block.law.gains), block.law.memory), strict=True
        )
    }
    parts = []
    for real, block_name in (("LREAL", name), ("REAL", f"{name}_single")):
        definitions, kernel = functions_in_st(block.program, block_name, real, sizes)
        parts.append({"real": real, "name": block_name, "definitions": definitions, "kernel": kernel})
    gains = list(zip(map(st_number, block.law.gains), _gain_names(block), strict=True))
    words = {**_words(name, block), "parts": parts, "gains": gains, "limit_number": st_number(block.limit)}
    return _with_page(name, block, vectors, {f"{name}.st": _template("block.st").render(words).rstrip() + "\n"})


def _json(name: str, block: Block, vectors: Vectors) -> dict[str, str]:
    words = _words(name, block)
    document = {
        "schema": "emps-design/controller/1",
        **{key: words[key] for key in ("name", "axis", "kind", "label", "source", "version")},
        "period": block.axis.sampling.period,
        "limit": block.limit,
        "units": {"period": "s", "limit": words["command_unit"], "u": words["command_unit"]},
        "follows": block.law.follows,
        "parameters": block.axis.controller.model_dump(),
        "equations": words["equations"],
        "gains": [
            {"value": float(gain), "name": said} for gain, said in zip(block.law.gains, _gain_names(block), strict=True)
        ],
        "memory": block.law.memory,
        "vectors": vectors.to_dict(),
    }
    return {f"{name}.json": json.dumps(document, indent=1, allow_nan=False) + "\n"}


TARGETS: dict[str, Callable[[str, Block, Vectors], dict[str, str]]] = {"c": _c, "st": _st, "json": _json}
