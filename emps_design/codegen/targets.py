"""The languages that a controller is written in: the files of each, by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from typing import Any

from emps_design.codegen.ahead import Ahead
from emps_design.codegen.block import Block
from emps_design.codegen.c import functions_in_c
from emps_design.codegen.operations import operations_of
from emps_design.codegen.pages import Files, gain_names, said_of, template, with_page, words_of
from emps_design.codegen.program import Program
from emps_design.codegen.st import functions_in_st, st_number
from emps_design.codegen.vectors import Vectors
from emps_design.effects.effect import ADDED
from emps_design.laws.drives import drive_settings, gains_of

Printed = Callable[[Program, str], tuple[list[str], str]]  # definitions, and what the kernel is called there


def _sums(name: str, ahead: Ahead, printed: Printed) -> tuple[list[str], list[dict[str, Any]]]:
    """Definitions of the kernels that are fed forward, and for each hook what is called."""
    definitions, calls = [], {hook: list[str]() for hook in ADDED}
    for part in ahead.parts:
        made, kernel = printed(part.program, f"{name}_{part.term}")
        definitions += made
        calls[part.hook].append(kernel)
    return definitions, [{"name": hook, "calls": calls[hook]} for hook in ADDED]


def _numbers(ahead: Ahead, number: Callable[[float], Any]) -> dict[str, Any]:
    """What the templates say of a feed-forward, its numbers as the language has them."""
    return {
        **said_of(ahead),
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


def _as_numbers(ahead: Ahead) -> dict[str, Any]:
    """What a document says of a feed-forward."""
    own = ahead.feedforward
    return {**_numbers(ahead, float), "reversal": ahead.reversal, "wait": own.wait, "back_emf": own.back_emf}


def in_json(name: str, block: Block, vectors: Vectors) -> Files:
    """One document: numbers, equations and vectors."""
    words = words_of(name, block)
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
            {"value": float(gain), "name": said} for gain, said in zip(block.law.gains, gain_names(block), strict=True)
        ],
        "memory": block.law.memory,
        "integral_that_waits": block.waits,
        "operations": operations_of(block),
        "drives": drive_settings(block.axis, {} if block.observes else gains_of(block.axis)),
        "feedforward": None if block.ahead is None else _as_numbers(block.ahead),
        "vectors": vectors.to_dict(),
    }
    return {f"{name}.json": json.dumps(document, indent=1, allow_nan=False) + "\n"}
