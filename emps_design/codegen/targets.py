"""The files of a controller in each language, from templates, and its gains as parameters of common drives.

The page and the heads of the files name the law, the axis, units, the axis file with the comment in its first line,
and the commit of this package.

Each parameter of a drive has a row with its name and unit, from the drive's public manual.
Families whose manual was not found, or gives no unit for a gain, are left out. A drive uses values on the motor side:
if the axis file has the reduction between motor and axis, the values here are on that side too, else on the load side.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import json
import math
import re
import shutil
import subprocess
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import metadata
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from emps_design.axis import Axis, field_in
from emps_design.codegen import languages
from emps_design.codegen.block import COMMAND, Ahead, Block
from emps_design.codegen.languages import functions_in_c, functions_in_st, st_number
from emps_design.codegen.program import Program, safe_names
from emps_design.codegen.vectors import FACTOR, MOTION, REST, TRAVEL, Vectors, operations_of
from emps_design.effects.effect import ADDED
from emps_design.errors import one_line
from emps_design.laws import leaves, unit_of

POSITION, PROPORTIONAL, INTEGRAL = "position.kp", "velocity.kp", "velocity.ti"
BECKHOFF, YASKAWA = "https://infosys.beckhoff.com/content", "https://azmanual.top/manuals/802369"
Value = Callable[[float, Any], float | None]  # of a gain and an axis

LONGEST, DIGITS = 10, 12  # s, timeout of git; digits of the commit

INPUTS = {"position": "m", "velocity": "m/s", "rest position": "m", COMMAND: "V"}  # unit of what a law follows
OPERATIONS = {"multiply": "products", "add": "sums and differences", "divide": "quotients", "compare": "comparisons",
              "call": "calls of math.h"}  # fmt: skip
Files = Mapping[str, str | bytes]  # by name
EXERCISED = "in motion within the limit, in and out of the limit"
LONGEST_NAME = 40
# Lines after the equations of a law with feed-forward.
FEEDFORWARD_LINES = (
    "(q_ref[k], v_ref[k]: 0; q[k]: position less reference; u[k]: before feed-forward and limit)",
    "command[k] = u[k] + feedforward(ahead_q[k], ahead_v[k], ahead_a[k]), within the limit",
)
WAITS = "; while that acts, i[k] = i[k-1]"
CHARACTERS = 120  # of a line of a comment

Printed = Callable[[Program, str], tuple[list[str], str]]  # definitions, and what the kernel is called there


@dataclass(frozen=True)
class Setting:
    """A parameter of a drive ``family``: its ``name``, its ``unit``, the gain that it holds, and its manual.

    ``value`` makes a gain of the axis file, SI, a number of that unit, None where the axis has another command.
    """

    family: str
    name: str
    unit: str
    gain: str
    source: str
    value: Value


def _scaled(factor: float) -> Value:
    return lambda gain, axis: factor * gain


def side_of(axis: Axis) -> str:
    """The side on which :func:`drive_settings` counts force and speed: ``motor`` or ``axis``."""
    return "motor" if axis.drive.reduction else "axis"


def _force(gain: float, axis: Axis) -> float:
    return float(gain * axis.drive.gain) / (axis.drive.reduction or 1.0) ** 2


def _turns(axis: Axis) -> bool:
    """Whether the motion on that side is a rotation."""
    return axis.motion == "rotary" or axis.drive.reduction is not None


def _torque(gain: float, axis: Axis) -> float | None:
    return _force(gain, axis) if _turns(axis) else None


def _current(gain: float, axis: Axis) -> float | None:
    """In steps of 0.1 mA; None for a command in % of rated, whose amperes are not known."""
    amperes = axis.units.command_in("A")
    if amperes is None or not _turns(axis):
        return None
    return 1e4 * gain * amperes / (axis.drive.reduction or 1.0)


def _crossover(gain: float, axis: Axis) -> float:
    return float(gain * axis.drive.gain / axis.mechanics.mass / (2.0 * math.pi))


SETTINGS = (
    Setting("Beckhoff AX5000", "S-0-0100", "Nm/(rad/s) or N/(m/s), with P-0-0010 bit 15 set", PROPORTIONAL,
            f"{BECKHOFF}/1031/ax5000_idn_description/1000502539.html", _force),
    Setting("Beckhoff AX5000", "S-0-0101", "ms", INTEGRAL,
            f"{BECKHOFF}/1031/ax5000_idn_description/1000532747.html", _scaled(1e3)),
    Setting("Beckhoff AX8000", "3140:01", "Nm/(rad/s), by default", PROPORTIONAL,
            f"{BECKHOFF}/1033/ax8xxx_object/18798255883.html", _torque),
    Setting("Beckhoff AX8000", "3140:02", "s", INTEGRAL,
            f"{BECKHOFF}/1031/ax8xxx_object/18798159243.html", _scaled(1.0)),
    Setting("Beckhoff EP7047", "8014:03", "0.1 mA/(rad/s)", PROPORTIONAL,
            f"{BECKHOFF}/1031/ep7047-1032/9243797771.html", _current),
    Setting("Beckhoff EP7047", "8014:04", "0.01 ms", INTEGRAL,
            f"{BECKHOFF}/1031/ep7047-1032/9243797771.html", _scaled(1e5)),
    Setting("Beckhoff AX2000-B750", "S-0-0104", "0.01 (m/min)/mm", POSITION,
            f"{BECKHOFF}/1031/ax2000-b750/15064279307.html", _scaled(6.0)),
    Setting("Beckhoff AX2000-B750", "S-0-0101", "0.1 ms", INTEGRAL,
            f"{BECKHOFF}/1031/ax2000-b750/15064277259.html", _scaled(1e4)),
    Setting("Yaskawa Sigma-II", "Pn102", "1/s", POSITION,
            "https://manualarchiveguide.com/manuals/YASKAWA-SGMAH-User-Manual-4781235?page=268", _scaled(1.0)),
    Setting("Yaskawa Sigma-II", "Pn100", "Hz, with Pn103 the inertia ratio", PROPORTIONAL,
            f"{YASKAWA}/yaskawa-large-capacity-sigma-ii-series.html?page=214", _crossover),
    Setting("Yaskawa Sigma-II", "Pn101", "0.01 ms", INTEGRAL,
            f"{YASKAWA}/yaskawa-large-capacity-sigma-ii-series.html?page=189", _scaled(1e5)),
)  # fmt: skip


def drive_settings(axis: Axis, gains: dict[str, float]) -> list[dict[str, Any]]:
    """The parameters of each drive for ``gains`` of a PI cascade on ``axis``: position.kp, velocity.kp, .ti, SI.

    Each row also has its ``side``, as :func:`side_of` gives it.

    >>> from emps_design.machines import machine
    >>> rows = drive_settings(machine("emps2019"), {"velocity.ti": 0.018})
    >>> [(row["parameter"], round(row["value"], 9), row["unit"]) for row in rows if row["family"] == "Beckhoff AX5000"]
    [('S-0-0101', 18.0, 'ms')]
    """
    rows = []
    for setting in SETTINGS:
        value = setting.value(gains[setting.gain], axis) if setting.gain in gains else None
        if value is not None:
            rows.append({"family": setting.family, "parameter": setting.name, "value": value, "unit": setting.unit,
                          "gain": setting.gain, "side": side_of(axis), "source": setting.source})  # fmt: skip
    return rows


def gains_of(axis: Axis) -> dict[str, float]:
    """The gains of the axis's own controller that drives have names for; none where it is no PI cascade."""
    table = axis.controller.parameters
    velocity, position = table.get("velocity"), table.get("position")
    if not isinstance(velocity, dict) or velocity.get("form", "pi") != "pi":
        return {}
    gains = {POSITION: (position or {}).get("kp"), PROPORTIONAL: velocity.get("kp"), INTEGRAL: velocity.get("ti")}
    return {name: float(value) for name, value in gains.items() if isinstance(value, int | float)}


def drives_of(block: Block) -> list[dict[str, Any]]:
    """The parameters of each drive for the gains of ``block``; none of an observer."""
    return [] if block.observes else drive_settings(block.axis, gains_of(block.axis))


def origin_of(name: str, content: bytes) -> str:
    """Origin of the axis file ``name`` for the page: its SHA-256, and the comment in its first line.

    In a file of ``diagnose`` that comment names the record.

    >>> origin_of("model.toml", b"# of a record\\nname = 'x'")[-13:]
    ': of a record'
    """
    first = content.decode("utf-8", "replace").partition("\n")[0]
    note = f": {first.lstrip('# ')}" if first.startswith("#") else ""
    return one_line(f"{name}, SHA-256 {hashlib.sha256(content).hexdigest()}{note}")


@lru_cache
def commit() -> str:
    """The commit of this package where it runs from its own repository, and whether it was changed since."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists() or shutil.which("git") is None:
        return ""
    head, changed = (_git_output(root, *arguments) for arguments in (("rev-parse", "HEAD"), ("status", "-s", "-uno")))
    return head[:DIGITS] + (", changed since" if changed else "")


def _git_output(root: Path, *arguments: str) -> str:
    """Output of git, stripped; "" where it fails."""
    done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, timeout=LONGEST, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""


def block_name(name: str) -> str:
    """``name`` as an identifier that C and IEC 61131-3 take.

    >>> block_name("emps2018-two-quadrant"), block_name("Achse 3 (Ü)"), block_name("double"), block_name("Move")
    ('emps2018_two_quadrant', 'Achse_3', 'double_2', 'Move_2')
    """
    plain = re.sub("[^0-9A-Za-z]+", "_", name)[:LONGEST_NAME].strip("_") or "axis"
    return safe_names([plain], languages.C_KEYWORDS | languages.ST_KEYWORDS)[plain]


def hash_of(content: str | bytes) -> str:
    """SHA-256 of what is written."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


@lru_cache
def template(name: str) -> Any:
    """The template called ``name``."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(undefined=StrictUndefined, keep_trailing_newline=True, autoescape=False)
    return environment.from_string((files("emps_design.codegen") / "templates" / name).read_text(encoding="utf-8"))


def words_of(name: str, block: Block) -> dict[str, Any]:
    """Words and numbers for every template."""
    axis, law = block.axis, block.law
    own, fields = block.parameters, block.kind.table.model_fields
    equations = block.kind.equations(block.kind.table(**own), axis, axis.sampling.period)
    if law.error_alone:
        first, last = FEEDFORWARD_LINES
        equations = (*equations, first, last + (WAITS if block.waits is not None else ""))
    units, unit = axis.units, axis.units.unit
    force = units.word("force")
    parameters = [
        f"{'.'.join(path)} = {value} {unit(unit_of(field))}".rstrip()
        for path, value in leaves(own)
        for field in [field_in(("controller", *path), block.kind.name) or fields.get(path[0])]
    ]
    return {
        "name": name,
        "macro": name.upper(),
        "axis": comment(axis.name),
        "kind": block.kind.name,
        "label": comment(units.words(block.kind.label)),
        "source": comment(block.kind.source),
        "version": metadata.version("emps-design"),
        "commit": commit(),
        "origin": comment(block.origin, 1000),
        "period": repr(axis.sampling.period),
        "equations": [comment(line, 1000) for line in equations],
        "parameters": list(map(comment, parameters)),
        "memory": max(1, law.memory),
        "memories": law.memory,
        "inputs": 6 if block.ahead is not None else 3,
        "ahead": None,
        "waits": block.waits,
        "feedforward": None if block.ahead is None else feedforward_words(block.ahead),
        "velocity_unit": unit("m/s"),
        "acceleration_unit": unit("m/s^2"),
        "mass_unit": unit("kg"),
        "limit": repr(block.limit),
        "observes": block.observes,
        "exercised": f"motion of up to {units.quantity(TRAVEL, 'm', 'g')}, motion thirty times that"
        if block.observes
        else EXERCISED,
        "late": axis.sampling.computation_delay,
        "lag": axis.drive.current_time_constant,
        "what": f"observer of the external {force}" if block.observes else "controller",
        "bounded": "" if block.observes else f", command limited to {block.limit!r} {unit('V')}",
        "answer": f"external {force}" if block.observes else "command",
        "either_way": "" if block.observes else f", between -{block.limit!r} and {block.limit!r}",
        "output_unit": block.output_unit,
        "follows": _reference_text(block),
        "reference_unit": unit(INPUTS[law.follows]),
        "position_unit": unit("m"),
        "force_unit": unit("N"),
        "command_unit": unit("V"),
        "force": force,
        "carriage": units.word("carriage"),
    }


def _reference_text(block: Block) -> str:
    """The reference of the block, in words."""
    if block.observes:
        return "the command that acted in the period that ends now"
    return "the position of the reference" if block.law.error_alone else f"a {block.law.follows}"


def comment(text: object, longest: int = CHARACTERS) -> str:
    """``text`` as part of a comment or a page: one line, ASCII, nothing that ends a comment."""
    plain = " ".join(str(text).split()).encode("ascii", "replace").decode()
    for mark in ("*/", "/*", "*)", "(*", "`", "??"):
        plain = plain.replace(mark, " ")
    return plain if len(plain) <= longest else f"{plain[: longest - 3]}..."


def gain_names(block: Block) -> list[str]:
    """Name of each gain: the constant that the kernel's file uses as its index, "" where it uses none."""
    kernel = block.law.kernel
    space, array, named = vars(inspect.getmodule(kernel)), list(block.program.kernel.parameters)[5], {}
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(kernel)))):
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id == array:
            place = space.get(node.slice.id) if isinstance(node.slice, ast.Name) else None
            if isinstance(place, int) and isinstance(node.slice, ast.Name):
                named[place] = node.slice.id.lower().replace("_", " ")
    return [comment(named.get(place, "")) for place in range(len(block.law.gains))]


def with_page(name: str, block: Block, vectors: Vectors, made: Files, **more: Any) -> Files:
    """``made`` with the axis, the vectors and the page; ``more`` are words for its template."""
    made = {**made, f"{name}.toml": block.axis.to_toml(comments=True), "vectors.csv": vectors.to_csv()}
    words = {**words_of(name, block), **more, "rows": vectors.q.size, "factor": FACTOR}
    words["measured"] = single_precision(vectors)
    hashes = [(file, hash_of(text)) for file, text in made.items()]
    words |= {"files": list(made), "hashes": hashes}
    words["operations"] = ", ".join(f"{n} {OPERATIONS[kind]}" for kind, n in operations_of(block).items())
    words["drives"] = drives_of(block)
    return {**made, "README.md": template("README.md").render(words)}


def single_precision(vectors: Vectors) -> str:
    """Sentences for the page on what single precision does, as measured."""
    difference, unit = vectors.difference, vectors.block.output_unit
    finite, otherwise = np.isfinite(difference), vectors.decided_otherwise
    text = (
        f"The largest difference is {difference[REST : REST + MOTION].max():.3g} {unit} in the first motion and "
        f"{difference[finite].max(initial=0.0):.3g} {unit} in all."
    )
    if np.any(otherwise):
        jump = difference[otherwise & finite].max(initial=0.0)
        text += (
            f" At {np.count_nonzero(otherwise)} of the samples a comparison (a sign, a limit, a switch) has the other "
            f"result in single precision; there the difference is at most {jump:.3g} {unit}."
        )
    if not np.all(finite):
        text += f" {np.count_nonzero(~finite)} samples have no bound: a number exceeds the range of single precision."
    return text


def feedforward_words(ahead: Ahead) -> dict[str, Any]:
    """Words of a feed-forward for the page."""
    return {
        "terms": [term.replace("_", " ") for term in ahead.feedforward.terms],
        "wait": repr(ahead.feedforward.wait),
        "reversal": repr(ahead.reversal) if ahead.reversal > 0.0 else "",
    }


def _sums(name: str, ahead: Ahead, printed: Printed) -> tuple[list[str], list[dict[str, Any]]]:
    """Definitions of the kernels of the feed-forward, and for each hook the names of those to call."""
    definitions, calls = [], {hook: list[str]() for hook in ADDED}
    for part in ahead.parts:
        made, kernel = printed(part.program, f"{name}_{part.term}")
        definitions += made
        calls[part.hook].append(kernel)
    return definitions, [{"name": hook, "calls": calls[hook]} for hook in ADDED]


def _numbers(ahead: Ahead, number: Callable[[float], Any]) -> dict[str, Any]:
    """Words and numbers of a feed-forward for the templates; ``number`` writes one in the language."""
    return {
        **feedforward_words(ahead),
        "own": list(map(number, ahead.own)),
        "repeats": ahead.repeats,
        "passes": ahead.passes,
        "back_emf": number(ahead.feedforward.back_emf) if ahead.feedforward.back_emf else "",
        "gain": number(float(ahead.feedforward.axis.drive.gain)),
        "reversal": number(ahead.reversal) if ahead.reversal > 0.0 else "",
    }


def in_c(name: str, block: Block, vectors: Vectors) -> Files:
    """C99: source, header, check and Makefile, with the axis, the vectors and the page."""
    definitions, kernel = functions_in_c(
        block.program, name, dict(zip(list(block.program.kernel.parameters)[4:6], ("LIMIT", "GAINS"), strict=True))
    )
    words = words_of(name, block)
    if block.ahead is not None:
        more, hooks = _sums(name, block.ahead, partial(functions_in_c, constants={}))
        words["ahead"] = {**_numbers(block.ahead, repr), "hooks": hooks}
        definitions = list(dict.fromkeys([*definitions, *more]))
    gains = list(zip((repr(float(gain)) for gain in block.law.gains), gain_names(block), strict=True))
    repeats = block.ahead is not None and block.ahead.repeats
    words |= {
        "definitions": definitions,
        "kernel": kernel,
        "gains": gains or [("0.0", "none")],
        "uses_math": repeats or any("FN(" in definition for definition in definitions),
    }
    made = {
        f"{name}.c": template("controller.c").render(words),
        f"{name}.h": template("controller.h").render(words),
        f"{name}_check.c": template("check.c").render(words),
        "Makefile": template("Makefile").render(words),
    }
    return with_page(name, block, vectors, made)


def in_st(name: str, block: Block, vectors: Vectors) -> Files:
    """Structured Text in LREAL and REAL, with the axis, the vectors and the page."""
    sizes = {
        parameter: size
        for parameter, size in zip(
            list(block.program.kernel.parameters)[5:], (len(block.law.gains), block.law.memory), strict=True
        )
    }
    parts = []
    for real, block_name in (("LREAL", name), ("REAL", f"{name}_single")):
        definitions, kernel = functions_in_st(block.program, block_name, real, sizes)
        part: dict[str, Any] = {"real": real, "name": block_name, "definitions": definitions, "kernel": kernel}
        if block.ahead is not None:
            more, part["hooks"] = _sums(block_name, block.ahead, partial(functions_in_st, real=real, sizes={}))
            part["definitions"] = [*definitions, *more]
        parts.append(part)
    gains = list(zip(map(st_number, block.law.gains), gain_names(block), strict=True))
    words = {**words_of(name, block), "parts": parts, "gains": gains, "limit_number": st_number(block.limit)}
    if block.ahead is not None:
        words["ahead"] = _numbers(block.ahead, st_number)
    return with_page(name, block, vectors, {f"{name}.st": template("block.st").render(words).rstrip() + "\n"})


def in_json(name: str, block: Block, vectors: Vectors) -> Files:
    """One document: numbers, equations and vectors."""
    words, feedforward = words_of(name, block), None
    if (ahead := block.ahead) is not None:
        own = {"reversal": ahead.reversal, "wait": ahead.feedforward.wait, "back_emf": ahead.feedforward.back_emf}
        feedforward = {**_numbers(ahead, float), **own}
    document = {
        "schema": "emps-design/controller/1",
        **{key: words[key] for key in ("name", "axis", "kind", "label", "source", "version")},
        "origin": block.origin,
        "period": block.axis.sampling.period,
        "limit": None if block.observes else block.limit,
        "units": {"period": "s", "limit": words["output_unit"], "u": words["output_unit"]},
        "follows": block.law.follows,
        "law_on_error": block.law.error_alone,
        "parameters": block.parameters,
        "equations": words["equations"],
        "effects": block.axis.to_dict().get("effects", []),
        "gains": [
            {"value": float(gain), "name": gain_name}
            for gain, gain_name in zip(block.law.gains, gain_names(block), strict=True)
        ],
        "memory": block.law.memory,
        "integral_that_waits": block.waits,
        "operations": operations_of(block),
        "drives": drives_of(block),
        "feedforward": feedforward,
        "vectors": vectors.to_dict(),
    }
    return {f"{name}.json": json.dumps(document, indent=1, allow_nan=False) + "\n"}
