"""One Typer application, one module a command; errors become one line and an exit status here and nowhere else."""

from __future__ import annotations

import importlib
import os
import sys

from emps_design.cli.output import print_json
from emps_design.errors import EmpsError, SpecificationError, UnstableError

# Commands in the order of the work: record, axis, gains, simulation, what disagrees, page.
COMMANDS = (
    "gains",
    "force",
    "impedance",
    "simulate",
    "identify",
    "observe",
    "diagnose",
    "derive",
    "report",
    "studio",
    "demo",
    "init",
)


def run(arguments: list[str]) -> int:
    """Run the command line on ``arguments`` and return the exit status of the contract."""
    debug = "--debug" in arguments
    as_json = "--json" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    try:
        result = _application(arguments)(args=arguments or ["--help"], prog_name="emps-design", standalone_mode=False)
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except EmpsError as error:
        if debug:
            raise
        if as_json and isinstance(error, SpecificationError | UnstableError):
            print_json(
                {
                    "error": type(error).__name__,
                    "reason": str(error),
                    "nearest": error.nearest,
                    "warnings": [str(error)],
                }
            )
        print(f"emps-design: {error}", file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:
        # The reader of our output has left (`| head`); what is still buffered goes nowhere, in silence.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        # Usage errors and Ctrl-C in a prompt come from click, or from the copy of click inside typer: same names.
        if type(error).__name__ == "Abort":
            print("emps-design: interrupted", file=sys.stderr)
            return 1
        if hasattr(error, "format_message"):
            message = " ".join(error.format_message().split())
            if message:
                print(f"emps-design: {message}; see 'emps-design --help'", file=sys.stderr)
            return 2
        if debug:
            raise
        print(f"emps-design: {type(error).__name__}: {error} (run with --debug for the traceback)", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("emps-design: interrupted", file=sys.stderr)
        return 1


def _application(arguments: list[str]):
    """The Typer application. Only the module of the command that runs is imported, unless help is asked for."""
    import typer

    app = typer.Typer(
        name="emps-design",
        help="From a measured record of a one-axis drive to gains, a report, and the physics the model lacks.",
        add_completion=False,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.callback()(_root)
    wanted = arguments[0] if arguments else ""
    for name in (wanted,) if wanted in COMMANDS else COMMANDS:
        module = importlib.import_module(f"emps_design.cli.{name}")
        app.command(name, help=module.__doc__)(module.command)
    return app


def _root() -> None:
    """From a measured record of a one-axis drive to gains, a report, and the physics the model lacks."""
