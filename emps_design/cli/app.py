"""One Typer application, one module per command; errors become one line and an exit status here and nowhere else.

A command is made of its request: options from the fields, a request from the words, the answer printed.
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

# Commands in the order of the work, each with its sentence in the help of all commands.
GROUPS = {
    "Start": {
        "demo": "Run the main job on the embedded machine; no file is needed.",
        "init": "Make a folder with an axis file and records to start from.",
        "import": "Read a drive's export and say what each column is taken for.",
    },
    "Learn from records": {
        "identify": "Identify mass, friction and constant force from records.",
        "law": "Find the controller that made a record, and its gains.",
        "observe": "Observe the external force that acted during a record.",
        "excite": "Make the experiment that measures a frequency response.",
        "frf": "Estimate the response from force to velocity from records.",
    },
    "Design": {
        "gains": "Derive velocity-loop gains from bandwidth and phase margin.",
        "margins": "Say what the controller in the axis file achieves.",
        "force": "Check the force loop around the velocity loop, in contact.",
        "impedance": "Judge an impedance law that needs no force sensor.",
        "derive": "Derive the paper's equations and show its misprints.",
    },
    "Simulate and compare": {
        "simulate": "Simulate the nonlinear axis along a record or a reference.",
        "diagnose": "Name the physics that the model lacks, and add it.",
    },
    "Bring to the machine": {
        "compensate": "Find the feed-forward of all that the model knows.",
        "export": "Write the controller as C, Structured Text, FMU or JSON.",
    },
    "Show": {
        "report": "Write the whole design as one page.",
        "studio": "Design in the browser, served on 127.0.0.1 only.",
    },
}
COMMANDS = tuple(name for group in GROUPS.values() for name in group)
BEYOND = "numbers too far apart to compute with; check the units in the axis, the record and the options"

TURNING = "Units are those of a linear axis. For one that turns read kg m^2 for kg, N m for N and rad for m."
ABOVE = {"studio": "emps_design.studio.command"}  # a command whose room lies above the commands
# Options that every command has, and those of a command that writes a file.
COMMON = {
    "as_json": ("--json", "one JSON document on standard output"),
    "debug": ("--debug", "the traceback of an error"),
}


def run(arguments: list[str]) -> int:
    """Run the command line on ``arguments`` and return the exit status of the contract."""
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
        _discard_output()  # standard output itself may be full
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
    """Print why the library refused, with a design's document where JSON is asked for; its exit status."""
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
    """Whether ``error`` is of the words of the command line, or Ctrl-C at a prompt.

    They come from click or from typer's copy of it: the names are the same.
    """
    return type(error).__name__ == "Abort" or hasattr(error, "format_message")


def _failed(error: Exception, terminal: Terminal) -> int:
    """Print an ``error`` that is none of the library's own; its exit status."""
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
    """Run the command and return what it returns; an error after an interrupt is raised as that interrupt."""
    try:
        return _application(arguments, terminal)(
            args=arguments or ["--help"], prog_name="emps-design", standalone_mode=False
        )
    except Exception as error:
        if interrupts.interrupted.is_set():  # interrupted compiled code may raise an error of its own
            raise KeyboardInterrupt from error
        raise


def _discard_output() -> None:
    """Discard what is still buffered for standard output when the process ends."""
    with suppress(OSError, ValueError):  # a ValueError: no descriptor, as in a test
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _application(arguments: list[str], terminal: Terminal) -> typer.Typer:
    """Return the Typer application with the command that ``arguments`` name, or with all commands if none has the name.

    For an option of the program itself, such as ``--help``, no module is imported: :data:`GROUPS` has the sentences.
    """
    import typer

    app = typer.Typer(
        name="emps-design",
        cls=_in_groups(),
        help="From a measured record of a one-axis drive to gains, a report, and the physics the model lacks.",
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

    wanted = arguments[0] if arguments else ""
    for name in () if wanted.startswith("-") else (wanted,) if wanted in COMMANDS else COMMANDS:
        register_command(app, name, terminal)
    return app


def _in_groups() -> Any:
    """The class of the program: its help has the commands in the order of the work."""
    from typer.core import TyperGroup

    class Grouped(TyperGroup):
        """Commands in the order of the work."""

        def format_commands(self, ctx: Any, formatter: Any) -> None:
            for title, commands in GROUPS.items():
                with formatter.section(title):
                    formatter.write_dl(list(commands.items()))

    return Grouped


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

    def speak_in(units: Units) -> None:
        terminal.units = units

    with terminal.progress() as progress:
        overwrite = bool(values.get("force"))
        request = make_request(kind, own, given, speak_in, progress=progress, overwrite=overwrite)
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
