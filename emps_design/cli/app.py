"""One Typer application, one module per command; errors become one line and an exit status here and nowhere else."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from emps_design import __version__, interrupts
from emps_design.cli.command import register_command
from emps_design.cli.output import Terminal
from emps_design.errors import EmpsError, InputError, SimulationError, SpecificationError, UnstableError
from emps_design.interrupts import STATUS as INTERRUPTED

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
