"""How a frequency is read from the command line: with its unit, such as 30Hz, or a bare number in the option's own."""

from __future__ import annotations

from typing import Any

import typer

from emps_design.errors import InputError
from emps_design.quantities import read_frequency


def _read(unit: str) -> dict[str, Any]:
    def parse(text: str) -> float:
        try:
            return read_frequency(text, unit)
        except InputError as error:  # a ValueError would lose its words
            raise typer.BadParameter(str(error)) from error

    return {"parser": parse, "metavar": "FREQUENCY"}


# Of an option that asks for a frequency: typer.Option(**RAD_S, help="... [rad/s, or such as 30Hz]").
RAD_S, HERTZ = _read("rad/s"), _read("Hz")
