"""How a frequency (30Hz) or a ratio (6dB) is read from the command line; a bare number is in the option's own unit."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import typer

from emps_design.errors import InputError
from emps_design.quantities import read_frequency, read_ratio


def _read(read: Callable[[str], float], metavar: str) -> dict[str, Any]:
    def parse(text: str) -> float:
        try:
            return read(text)
        except InputError as error:  # a ValueError would lose its words
            raise typer.BadParameter(str(error)) from error

    return {"parser": parse, "metavar": metavar}


# Of an option that asks for a frequency: typer.Option(**RAD_S, help="... [rad/s, or such as 30Hz]").
RAD_S, HERTZ = (_read(partial(read_frequency, unit=unit), "FREQUENCY") for unit in ("rad/s", "Hz"))
RATIO = _read(read_ratio, "RATIO")
