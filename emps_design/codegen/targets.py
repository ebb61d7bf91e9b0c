"""The languages that a controller is written in: the files of each, by name."""

from __future__ import annotations

import json
from typing import Any

from emps_design.codegen.ahead import Ahead
from emps_design.codegen.block import Block
from emps_design.codegen.c import functions_in_c
from emps_design.codegen.pages import gain_names, said_of, template, with_page, words_of
from emps_design.codegen.st import functions_in_st, st_number
from emps_design.codegen.vectors import Vectors
from emps_design.simulation.kernels.inverse import HOOKS


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
        **said_of(ahead),
    }


def in_c(name: str, block: Block, vectors: Vectors) -> dict[str, str]:
    definitions, kernel = functions_in_c(
        block.program, name, dict(zip(list(block.program.kernel.parameters)[4:6], ("LIMIT", "GAINS"), strict=True))
    )
    words = words_of(name, block)
    if block.ahead is not None:
        more, words["ahead"] = _ahead_in_c(name, block.ahead)
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


def in_st(name: str, block: Block, vectors: Vectors) -> dict[str, str]:
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
    gains = list(zip(map(st_number, block.law.gains), gain_names(block), strict=True))
    words = {**words_of(name, block), "parts": parts, "gains": gains, "limit_number": st_number(block.limit)}
    return with_page(name, block, vectors, {f"{name}.st": template("block.st").render(words).rstrip() + "\n"})


def in_json(name: str, block: Block, vectors: Vectors) -> dict[str, str]:
    words = words_of(name, block)
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
            {"value": float(gain), "name": said} for gain, said in zip(block.law.gains, gain_names(block), strict=True)
        ],
        "memory": block.law.memory,
        "vectors": vectors.to_dict(),
    }
    return {f"{name}.json": json.dumps(document, indent=1, allow_nan=False) + "\n"}
