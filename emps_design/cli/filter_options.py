"""Options that say what the gains of a velocity loop act in: its structure and the filters of its output."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from emps_design.errors import InputError
from emps_design.quantities import read_frequency

if TYPE_CHECKING:
    from emps_design.axis import Axis
    from emps_design.control.velocity.structure import Structure

NOTCH = {"damping": 0.5, "depth": 0.1}  # where only its frequency is given
EXPECTED = "lowpass:350Hz, notch:48Hz, notch:48Hz:DAMPING:DEPTH or none"

StructureOption = Annotated[
    str | None, typer.Option(help="ip or pi: proportional to the measured velocity or to the error [the axis's]")
]
ReferenceFilter = Annotated[bool, typer.Option("--reference-filter", help="with pi: 1/(1 + t_v s) before the loop")]
Filters = Annotated[
    list[str] | None,
    typer.Option("--filter", metavar="FILTER", help=f"instead of the axis's, again for more: {EXPECTED}"),
]


def structure_asked_for(axis: Axis, form: str | None) -> Structure:
    """The structure that the command line asks for, or the one of the controller of ``axis``."""
    from emps_design.control.velocity.structure import Structure, own_structure

    return own_structure(axis, None if form is None else Structure(form))


def filters_asked_for(texts: list[str] | None) -> tuple[Any, ...] | None:
    """The filters of the command line in their order; None where there are none there.

    >>> filters_asked_for(["lowpass:350Hz", "notch:48Hz:0.6:0.2"])[1].depth
    0.2
    >>> filters_asked_for(["none"])
    ()
    """
    if not texts:
        return None
    return () if texts == ["none"] else tuple(map(_filter, texts))


def _filter(text: str) -> Any:
    from pydantic import ValidationError

    from emps_design.laws.library.cascade import Filter

    kind, *numbers = text.split(":")
    if kind not in ("lowpass", "notch") or not numbers or len(numbers) not in ((1,) if kind == "lowpass" else (1, 3)):
        raise InputError(f"--filter: found {text!r}, expected {EXPECTED}")
    frequency, *shape = numbers
    try:
        more = dict(zip(NOTCH, map(float, shape), strict=True)) if shape else NOTCH if kind == "notch" else {}
        return Filter(kind=kind, frequency=read_frequency(frequency, "Hz"), **more)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        name = ".".join(map(str, problem["loc"]))
        raise InputError(f"--filter {text}: {name}: found {problem['input']}, {problem['msg'].lower()}") from error
    except ValueError as error:
        raise InputError(f"--filter: found {text!r}, expected {EXPECTED}") from error
