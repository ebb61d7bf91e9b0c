"""From a request to a Typer command and back: options from its fields, a request from the words, the answer printed."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Collection, Mapping
from dataclasses import MISSING, Field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from emps_design.advice import ADVISED
from emps_design.cli.output import Terminal
from emps_design.commands import Reply
from emps_design.commands.destinations import OVERWRITE, check_folder, check_named_out, check_out
from emps_design.errors import InputError
from emps_design.request import OPTION, Option, Request, flags_of, make_request, options_of, types_of
from emps_design.units import LINEAR

if TYPE_CHECKING:
    import typer

    from emps_design.axis import Axis

TURNING = "Units are those of a linear axis. For one that turns read kg m^2 for kg, N m for N and rad for m."
ABOVE = {"studio": "emps_design.studio.command"}  # a command whose room lies above the commands
# Options that every command has, and those of a command that writes a file.
COMMON = {
    "as_json": ("--json", "one JSON document on standard output"),
    "debug": ("--debug", "the traceback of an error"),
}


def register_command(app: typer.Typer, name: str, terminal: Terminal) -> None:
    """Add the command ``name`` to ``app``: its module has one request, and ``answer``."""
    import typer

    module = importlib.import_module(module_of(name))
    kind = request_of(module)
    hints = types_of(kind)
    parameters = [
        _parameter(entry, hints[entry.name]) for entry in options_of(kind) if not entry.metadata[OPTION].hidden
    ]
    writes = kind.overwrites or any(entry.metadata[OPTION].writes for entry in options_of(kind))
    flags = {"force": ("--force", OVERWRITE)} if writes else {}
    parameters += [
        inspect.Parameter(
            key,
            inspect.Parameter.KEYWORD_ONLY,
            default=False,
            annotation=Annotated[bool, typer.Option(flag, help=words)],
        )
        for key, (flag, words) in (flags | COMMON).items()
    ]

    def command(context: typer.Context, **values: Any) -> int:
        return _perform(context, terminal, module, values)

    described: Any = command
    first = inspect.Parameter("context", inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=typer.Context)
    described.__signature__ = inspect.Signature([first, *parameters])
    described.__annotations__ = {parameter.name: parameter.annotation for parameter in (first, *parameters)}
    epilog = TURNING if "axis" in hints else None
    app.command(name, help=module.__doc__, epilog=epilog)(command)


def module_of(name: str) -> str:
    """The module of the command ``name``."""
    return ABOVE.get(name, f"emps_design.commands.{name}")


def request_of(module: Any) -> type[Request]:
    """The request that the ``answer`` of a command's ``module`` takes."""
    annotation = inspect.signature(module.answer).parameters["request"].annotation
    kind = getattr(module, annotation) if isinstance(annotation, str) else annotation
    assert issubclass(kind, Request)
    return kind


def _parameter(entry: Field[Any], hint: Any) -> inspect.Parameter:
    """The parameter of a Typer command for a field of a request."""
    import typer

    about: Option = entry.metadata[OPTION]
    least, most = about.limits
    metavar = about.metavar or ("|".join(filter(None, about.choices)) or None)
    look: dict[str, Any] = {"help": about.help, "metavar": metavar, "min": least, "max": most}
    info = typer.Argument(**look) if about.argument else typer.Option(*flags_of(entry), **look)
    default = inspect.Parameter.empty if entry.default is MISSING else entry.default
    default = None if default == () else default  # of an option that may be given several times
    return inspect.Parameter(
        entry.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[hint, info]
    )


def _perform(context: typer.Context, terminal: Terminal, module: Any, values: Mapping[str, Any]) -> int:
    """Make the request from the ``values`` of the command line, answer it and print the answer; its exit status."""
    kind = request_of(module)
    terminal.flags = {entry.name: flags_of(entry)[0] for entry in options_of(kind)}
    given = [key for key in terminal.flags if _from_words(context, key)]
    own = {key: value for key, value in values.items() if key in terminal.flags and value is not None}
    _check_outputs(kind, own, bool(values.get("force")))
    as_json = values["as_json"]
    if as_json:
        _refuse_printed(kind, given)

    def in_units_of(axis: Axis | None) -> None:
        terminal.units = LINEAR if axis is None else axis.units

    with terminal.progress() as progress:
        overwrite = bool(values.get("force"))
        request = make_request(kind, own, given, in_units_of, progress=progress, overwrite=overwrite)
        answer: Reply = module.answer(request)
    terminal.units = answer.units
    _print(terminal, answer, _with_advice(terminal, answer, own), as_json)
    if answer.then is not None:
        sys.stdout.flush()
        answer.then()
    return answer.status


def _with_advice(terminal: Terminal, answer: Reply, own: Mapping[str, Any]) -> dict[str, Any]:
    """The document of ``answer`` with its advice, if there is a judge, and with the folder that was written."""
    document = answer.document
    if terminal.command in ADVISED:
        records = _paths(own.get("records", own.get("record")))
        document = terminal.with_advice(document, own.get("axis"), [str(path) for path in records])
    if answer.write is not None:
        folder = answer.write(f"{terminal.json_text(document)}\n")
        document |= {} if folder is None else {"out": folder}
    return document


def _print(terminal: Terminal, answer: Reply, document: dict[str, Any], as_json: bool) -> None:
    """Print ``answer``: the document or the view, warnings, the reason not to run it, and the advice."""
    if as_json:
        terminal.print_json(document)
    else:
        terminal.print_view(answer.view)
    terminal.print_warnings(answer.warnings)
    if answer.error is not None:
        raise answer.error
    if answer.reason:
        terminal.tell(answer.reason)
    if not as_json and "advice" in document:
        terminal.say_advice(document)


def _from_words(context: typer.Context, key: str) -> bool:
    return getattr(context.get_parameter_source(key), "name", "") == "COMMANDLINE"


def _refuse_printed(kind: type[Request], given: Collection[str]) -> None:
    """Refuse options of what is printed where a document is printed instead."""
    unused = [entry for entry in options_of(kind) if entry.metadata[OPTION].printed and entry.name in given]
    if unused:
        flags = ", ".join(flags_of(entry)[0] for entry in unused)
        raise InputError(f"{flags}: goes without --json; a document is one or the other")


def _check_outputs(kind: type[Request], values: Mapping[str, Any], force: bool) -> None:
    """Refuse files that must not be overwritten, before any work, and ``--force`` where no file is written."""
    outputs = [entry for entry in options_of(kind) if entry.metadata[OPTION].writes]
    if not outputs:
        return
    inputs = [path for entry in options_of(kind) if entry not in outputs for path in _paths(values.get(entry.name))]
    for entry in outputs:
        about, path, flag = entry.metadata[OPTION], values.get(entry.name), flags_of(entry)[0]
        if isinstance(about.writes, str):
            check_out(path, about.writes, inputs, force, flag)
        elif all(name.startswith(".") for name in about.writes):
            check_named_out(path, about.writes, inputs, force, flag)
        else:
            check_folder(path, about.writes, inputs, force)
    if force and not any(values.get(entry.name) for entry in outputs):
        raise InputError("--force: goes with a file to write; there is none to overwrite")


def _paths(value: Any) -> list[str | Path]:
    """The names of files in the value of an option."""
    values = value if isinstance(value, list | tuple) else [value]
    return [entry for entry in values if isinstance(entry, str | Path)]
