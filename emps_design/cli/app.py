"""The Typer application. Errors become one line and an exit status here, and nowhere else.

Each command is one module with a request and ``answer``. The fields of the request are the options of the command; the
command line is made a request, which is answered and printed.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from emps_design import __version__, interrupts
from emps_design.advice import ADVISED
from emps_design.cli.output import Terminal
from emps_design.commands import Reply
from emps_design.commands.destinations import OVERWRITE, check_folder, check_named_out, check_out
from emps_design.errors import EmpsError, InputError, SimulationError, SpecificationError, UnstableError
from emps_design.interrupts import STATUS as INTERRUPTED
from emps_design.request import OPTION, Option, Request, flags_of, make_request, options_of, types_of
from emps_design.units import Units

if TYPE_CHECKING:
    import typer

# Commands in the order of a project, each with its line in the help of the program.
GROUPS = {
    "Start": {
        "demo": "Run the whole workflow on the embedded machine, without a file.",
        "init": "Make a folder with an axis file and records to start from.",
        "import": "Read a drive's export and show what each column stands for.",
    },
    "Identify from records": {
        "identify": "Identify mass, friction and constant force from records.",
        "law": "Find the controller that made a record, and its gains.",
        "observe": "Observe the external force that acted during a record.",
        "excite": "Design the experiment that measures a frequency response.",
        "frf": "Estimate the response from force to velocity from records.",
    },
    "Design": {
        "gains": "Derive velocity-loop gains from bandwidth and phase margin.",
        "margins": "Compute the margins of the controller in the axis file.",
        "force": "Check the force loop around the velocity loop, in contact.",
        "impedance": "Assess an impedance law that needs no force sensor.",
        "derive": "Derive the paper's equations and show its misprints.",
    },
    "Simulate and compare": {
        "simulate": "Simulate the nonlinear axis along a record or a reference.",
        "diagnose": "Find the physics that the model lacks, and add it.",
    },
    "Deploy to the machine": {
        "compensate": "Design a feed-forward from the model, and test it.",
        "export": "Write the controller as C, Structured Text, FMU or JSON.",
    },
    "Show": {
        "report": "Write the whole design as one page.",
        "studio": "Design in the browser, served on 127.0.0.1 only.",
    },
}
COMMANDS = tuple(name for group in GROUPS.values() for name in group)
BEYOND = "numerical overflow or a singular matrix; check the units in the axis, the record and the options"

ROTARY = "Units are those of a linear axis; for a rotary axis read kg m^2 for kg, N m for N and rad for m."
ABOVE = {"studio": "emps_design.studio.command"}  # commands that stand in a room above the commands
# Options of every command.
COMMON = {
    "as_json": ("--json", "one JSON document on standard output"),
    "debug": ("--debug", "the traceback of an error"),
}


def run(arguments: list[str]) -> int:
    """Run the command line on ``arguments`` and return the exit status."""
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    terminal = Terminal(tuple(arguments))
    try:
        result = _result(arguments, terminal)
        sys.stdout.flush()
        if result == INTERRUPTED:
            terminal.tell("interrupted")
        return result if isinstance(result, int) else 0
    except EmpsError as error:
        if debug:
            raise
        return _refused(error, terminal, "--json" in arguments)
    except BrokenPipeError:
        _discard_output()  # the reader has closed the pipe (`| head`)
        return 1
    except OSError as error:
        if debug:
            raise
        _discard_output()  # the disk behind standard output may be full
        terminal.tell(f"{error.filename or 'output'}: {error.strerror or error} (run with --debug for the traceback)")
        return 1
    except Exception as error:
        if debug and not _is_usage(error):
            raise
        return _failed(error, terminal)
    except KeyboardInterrupt:
        terminal.tell("interrupted")
        return INTERRUPTED


def _refused(error: EmpsError, terminal: Terminal, as_json: bool) -> int:
    """Print an error of the library, as JSON too for a design with ``--json``; return its exit status."""
    if as_json and isinstance(error, SpecificationError | UnstableError | SimulationError):
        terminal.print_json(
            {
                "error": type(error).__name__,
                "reason": str(error),
                "nearest": getattr(error, "nearest", {}),
                "warnings": [str(error)],
                "advice": terminal.advice_on_error(error),
            }
        )
    terminal.tell(error)
    return error.exit_code


def _is_usage(error: Exception) -> bool:
    """Whether ``error`` is a usage error, or Ctrl-C at a prompt.

    It is recognised by name, since click and typer's copy of it have the same names.
    """
    return type(error).__name__ == "Abort" or hasattr(error, "format_message")


def _failed(error: Exception, terminal: Terminal) -> int:
    """Print an ``error`` that the library did not raise; return its exit status."""
    if type(error).__name__ == "Abort":
        terminal.tell("interrupted")
        return INTERRUPTED
    if hasattr(error, "format_message"):
        message = " ".join(error.format_message().split())
        if message:
            terminal.tell(f"{message}; see 'emps-design --help'")
        return 2
    if isinstance(error, ArithmeticError) or type(error).__name__ == "LinAlgError":
        terminal.tell(f"{BEYOND} ({type(error).__name__}: {error})")
        return InputError.exit_code
    terminal.tell(f"{type(error).__name__}: {error} (run with --debug for the traceback)")
    return 1


def _result(arguments: list[str], terminal: Terminal) -> Any:
    """Run the command and return its result; an error after an interrupt becomes KeyboardInterrupt."""
    try:
        return _application(arguments, terminal)(
            args=arguments or ["--help"], prog_name="emps-design", standalone_mode=False
        )
    except Exception as error:
        if interrupts.interrupted.is_set():  # interrupted compiled code may raise another error
            raise KeyboardInterrupt from error
        raise


def _discard_output() -> None:
    """Discard the buffered output, so that the end of the process does not fail on it."""
    with suppress(OSError, ValueError):  # ValueError: standard output has no descriptor, as in a test
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _application(arguments: list[str], terminal: Terminal) -> typer.Typer:
    """Return the Typer application with the command that ``arguments`` name, or with all commands if it is unknown.

    For an option of the program itself, such as ``--help``, no module is imported; the help is in :data:`GROUPS`.
    """
    import typer

    app = typer.Typer(
        name="emps-design",
        cls=_in_groups(),
        help="From a measured record of a one-axis drive to gains, a report, and the physics that the model lacks.",
        add_completion=False,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )

    def print_version(requested: bool) -> None:
        if requested:
            typer.echo(f"emps-design {__version__}")
            raise typer.Exit

    @app.callback()
    def root(
        version: bool = typer.Option(
            False, "--version", is_eager=True, callback=print_version, help="Show the version and exit."
        ),
    ) -> None:
        pass

    first = arguments[0] if arguments else ""
    for name in () if first.startswith("-") else (first,) if first in COMMANDS else COMMANDS:
        register_command(app, name, terminal)
    return app


def _in_groups() -> Any:
    """The Typer group of the program, whose help lists the commands by :data:`GROUPS`."""
    from typer.core import TyperGroup

    class Grouped(TyperGroup):
        """Commands by :data:`GROUPS`."""

        def format_commands(self, ctx: Any, formatter: Any) -> None:
            for title, commands in GROUPS.items():
                with formatter.section(title):
                    formatter.write_dl(list(commands.items()))

    return Grouped


def register_command(app: typer.Typer, name: str, terminal: Terminal) -> None:
    """Add the command ``name`` to ``app``, with the fields of its request as options."""
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
    epilog = ROTARY if "axis" in hints else None
    app.command(name, help=module.__doc__, epilog=epilog)(command)


def module_of(name: str) -> str:
    """The module of the command ``name``."""
    return ABOVE.get(name, f"emps_design.commands.{name}")


def request_of(module: Any) -> type[Request]:
    """The request type of the ``answer`` of a command's ``module``."""
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
    """Make a request from the ``values`` of the command line, print its answer and return the exit status."""
    kind = request_of(module)
    terminal.flags = {entry.name: flags_of(entry)[0] for entry in options_of(kind)}
    given = [key for key in terminal.flags if _on_command_line(context, key)]
    options = {key: value for key, value in values.items() if key in terminal.flags and value is not None}
    _check_outputs(kind, options, bool(values.get("force")))
    as_json = values["as_json"]
    if as_json:
        _refuse_printed(kind, given)

    def use_units(units: Units) -> None:
        terminal.units = units

    with terminal.progress() as progress:
        overwrite = bool(values.get("force"))
        request = make_request(kind, options, given, use_units, progress=progress, overwrite=overwrite)
        answer: Reply = module.answer(request)
    terminal.units = answer.units
    _print(terminal, answer, _with_advice(terminal, answer, options), as_json)
    if answer.then is not None:
        sys.stdout.flush()
        answer.then()
    return answer.status


def _with_advice(terminal: Terminal, answer: Reply, options: Mapping[str, Any]) -> dict[str, Any]:
    """The document of ``answer``, with advice for the commands that have some, and with the folder that was written."""
    document = answer.document
    if terminal.command in ADVISED:
        records = _paths(options.get("records", options.get("record")))
        document = terminal.with_advice(document, options.get("axis"), [str(path) for path in records])
    if answer.write is not None:
        folder = answer.write(f"{terminal.json_text(document)}\n")
        document |= {} if folder is None else {"out": folder}
    return document


def _print(terminal: Terminal, answer: Reply, document: dict[str, Any], as_json: bool) -> None:
    """Print the document or the view, the warnings, the reason not to run the design, and the advice."""
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
        terminal.print_advice(document)


def _on_command_line(context: typer.Context, key: str) -> bool:
    return getattr(context.get_parameter_source(key), "name", "") == "COMMANDLINE"


def _refuse_printed(kind: type[Request], given: Collection[str]) -> None:
    """Raise :class:`InputError` if an option of the printed text is set together with ``--json``."""
    unused = [entry for entry in options_of(kind) if entry.metadata[OPTION].printed and entry.name in given]
    if unused:
        flags = ", ".join(flags_of(entry)[0] for entry in unused)
        raise InputError(f"{flags}: cannot be combined with --json; choose one of the two formats")


def _check_outputs(kind: type[Request], values: Mapping[str, Any], force: bool) -> None:
    """Raise :class:`InputError` for outputs that must not be overwritten, and for ``--force`` without an output."""
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
        raise InputError("--force: requires an output file; without one there is nothing to overwrite")


def _paths(value: Any) -> list[str | Path]:
    """The file names in the value of an option."""
    values = value if isinstance(value, list | tuple) else [value]
    return [entry for entry in values if isinstance(entry, str | Path)]
