"""An option that what was asked for would not read is refused: nobody is left to think that it did something."""

from __future__ import annotations

from collections.abc import Iterable

import typer

from emps_design.errors import InputError


def refuse_ignored(context: typer.Context, options: Iterable[str], why: str) -> None:
    """Raise :class:`InputError` with ``why`` where one of ``options`` (parameter names) is on the command line."""
    flags = {option.name: max(option.opts, key=len) for option in context.command.params}
    given = [name for name in options if getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"]
    if given:
        raise InputError(f"{', '.join(flags[name] for name in given)}: {why}")


def refuse_force(context: typer.Context, *outputs: object) -> None:
    """Refuse ``--force`` where none of ``outputs`` is to be written."""
    if all(output is None for output in outputs):
        refuse_ignored(context, ["force"], "goes with a file to write; there is none to overwrite")
