"""Options that several commands share, and the checks of them.

A frequency may be written as 30Hz or 370rad/s; a bare number is in the option's own unit. An option that the command
would ignore in combination with the others is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Annotated, Any

import typer

from emps_design.cli.output import check_option
from emps_design.commands.destinations import OVERWRITE
from emps_design.errors import InputError
from emps_design.quantities import read_frequency


def _read(read: Callable[[str], float], metavar: str) -> dict[str, Any]:
    def parse(text: str) -> float:
        try:
            return read(text)
        except InputError as error:  # click would drop the text of a ValueError
            raise typer.BadParameter(str(error)) from error

    return {"parser": parse, "metavar": metavar}


# Arguments of an option that is a frequency: typer.Option(**RAD_S, help="... [rad/s, or such as 30Hz]").
RAD_S, HERTZ = (_read(partial(read_frequency, unit=unit), "FREQUENCY") for unit in ("rad/s", "Hz"))


def refuse_ignored(context: typer.Context, options: Iterable[str], why: str) -> None:
    """Raise :class:`InputError` with ``why`` if one of ``options`` (parameter names) is on the command line."""
    flags = {option.name: max(option.opts, key=len) for option in context.command.params}
    ignored = [name for name in options if getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"]
    if ignored:
        raise InputError(f"{', '.join(flags[name] for name in ignored)}: {why}")


def refuse_force(context: typer.Context, *outputs: object) -> None:
    """Refuse ``--force`` if all of ``outputs`` are None."""
    if all(output is None for output in outputs):
        refuse_ignored(context, ["force"], "goes with a file to write; there is none to overwrite")


def within(unit: str) -> Any:
    """Return the ``callback`` of an option in ``unit``: it refuses a number outside the plausible range of the unit."""

    def check(option: typer.CallbackParam, value: float | None) -> float | None:
        name = f"--{(option.name or '').replace('_', '-')}"
        return value if value is None else check_option(name, value, unit)

    return check


AxisArgument = Annotated[str, typer.Argument(help="TOML file or embedded machine")]
Crossover = Annotated[
    float | None, typer.Option(**RAD_S, callback=within("rad/s"), help="crossover w_v of T_vo [rad/s, or such as 30Hz]")
]
Bandwidth = Annotated[
    float | None,
    typer.Option(**RAD_S, callback=within("rad/s"), help="closed-loop -3 dB of T_vc [rad/s, or such as 30Hz]"),
]
PhaseMargin = Annotated[float, typer.Option(callback=within("deg"), help="phase margin phi_v [deg]")]
AsJson = Annotated[bool, typer.Option("--json", help="one JSON document on standard output")]
Force = Annotated[bool, typer.Option("--force", help=OVERWRITE)]
