"""The same, interactive, in a browser window served on 127.0.0.1 only; Ctrl-C ends it."""

from __future__ import annotations

from pathlib import Path

import typer


def command(
    axis: str = typer.Argument("emps2018", help="TOML file or embedded machine."),
    record: Path | None = typer.Option(None, "--record", help="Record to open: .mat, .csv or .npz."),
    port: int = typer.Option(0, "--port", min=0, max=65535, help="Port on 127.0.0.1; 0 takes a free one."),
    as_json: bool = typer.Option(False, "--json", help="Print the address as one JSON document."),
) -> None:
    """The same, interactive, in a browser window served on 127.0.0.1 only; Ctrl-C ends it."""
    import sys
    from importlib.util import find_spec

    from emps_design.cli.output import load_axis, print_json, say
    from emps_design.errors import InputError

    loaded = load_axis(axis)
    if find_spec("panel") is None:
        raise InputError(
            "studio: found no panel in this environment, expected the extra: pip install -e '.[studio]' in the clone"
        )
    from emps_design.studio.app import serve

    def ready(address: str) -> None:
        if as_json:
            print_json({"address": address})
        else:
            say(f"emps-design studio: {address} (Ctrl-C ends it)")
        sys.stdout.flush()

    try:
        serve(loaded, record, port, ready)
        raise KeyboardInterrupt  # the server handles Ctrl-C itself, and nothing else ends it
    except OSError as error:
        raise InputError(f"--port: cannot listen on 127.0.0.1:{port}, {error.strerror}; choose another or 0") from error
