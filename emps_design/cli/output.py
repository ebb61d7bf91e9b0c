"""The output of a command: JSON or a view on standard output; progress, warnings and errors on standard error.

The library writes arguments between backquotes, such as `cutoff`; here they become the flags of the command line. The
advice on a result is a key of the document, and the last line that is printed.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from emps_design.advice import Advice, advise, advise_on_error
from emps_design.errors import EmpsError, one_line, printable
from emps_design.progress import Progress
from emps_design.units import LINEAR, Units
from emps_design.view import BLOCKS, Line, View, show

# Arguments of the library whose flag differs from their name.
FLAGS = {
    "cutoff_hz": "--cutoff",
    "identify": "--estimator ls",
    "overwrite": "--force",
    "target": "--to",
    "window": "--time A:B",
}
FLAGS_OF = {  # of one command: a report identifies too, but without the options of identify
    "report": {
        "cutoff": "--cutoff of 'identify'",
        "external_force='known'": "--external-force known of 'identify'",
        "filter='hold'": "--record-filter hold",
        "with_": "--with of 'identify'",
    }
}

NAMES = ("name", "axis", "record", "records", "file", "files", "out", "directory", "machine", "column", "title", "next")
MESSAGES = ("reason", "warnings")  # keys of the library's messages; all other text is data

ASCII = str.maketrans(f"{BLOCKS}─", "_.-=+*#@-")  # for a terminal that cannot show blocks and rules


@dataclass
class Terminal:
    """Standard output and standard error of one command line.

    ``words`` are the arguments from the name of the command on, ``flags`` the flags of its options by name, ``units``
    those of the axis, once it is read.

    >>> Terminal(("identify",)).with_flags("give `cutoff`, or use `filter='report'`")
    'give --cutoff, or use --filter report'
    >>> Terminal(("report",)).with_flags("use `filter='hold'`")
    'use --record-filter hold'
    """

    words: tuple[str, ...] = ()
    flags: dict[str, str] = field(default_factory=dict)
    units: Units = LINEAR

    @property
    def command(self) -> str:
        """The name of the command, "" for none."""
        return self.words[0] if self.words else ""

    def with_flags(self, text: str) -> str:
        """``text`` with the flag of the command line for every argument between backquotes."""
        flags = FLAGS | self.flags | FLAGS_OF.get(self.command, {})

        def as_flag(argument: re.Match[str]) -> str:
            name, _, value = argument[1].partition("=")
            if argument[1] in flags or not name.isidentifier():
                return flags.get(argument[1], argument[0])
            flag = flags.get(name, f"--{name.strip('_').replace('_', '-')}")
            return f"{flag} {value.strip(chr(39))}".rstrip()

        return re.sub(r"`([^`]+)`", as_flag, text)

    def json_data(self, value: Any, key: str = "") -> Any:
        """``value`` as JSON data: numpy to Python, complex to [re, im], Infinity and NaN to None.

        In messages, arguments between backquotes become flags.
        """
        if hasattr(value, "to_dict"):
            return self.json_data(value.to_dict())
        if isinstance(value, str):
            return self.with_flags(value) if key in MESSAGES else value
        if isinstance(value, dict):
            return {str(name): self.json_data(item, str(name)) for name, item in value.items()}
        if isinstance(value, list | tuple):
            return [self.json_data(item, key) for item in value]
        if hasattr(value, "tolist"):
            return self.json_data(value.tolist())
        if isinstance(value, complex):
            return [self.json_data(value.real), self.json_data(value.imag)]
        if isinstance(value, float):
            return value if math.isfinite(value) else None
        return value

    def json_text(self, document: Any) -> str:
        """``document`` as JSON; control characters of a terminal are escaped.

        >>> print(Terminal().json_text({"name": "é\\x9b31m", "gain": math.inf}))
        {
         "name": "é\\u009b31m",
         "gain": null
        }
        """
        text = json.dumps(self.json_data(document), indent=1, allow_nan=False, ensure_ascii=False)
        return "\n".join(line if line.isprintable() else _escaped(line, str.isprintable) for line in text.split("\n"))

    def print_json(self, document: Any) -> None:
        """Print one JSON document on standard output."""
        text = self.json_text(document)
        sys.stdout.write(f"{text if _unicode() else _escaped(text, str.isascii)}\n")

    def print_view(self, view: View) -> None:
        """Print ``view`` on standard output."""
        from rich.console import Console

        console = Console(markup=False, emoji=False, highlight=False)
        for part in view:
            if isinstance(part, Line):
                words = part.text if part.style == "code" else self.with_flags(part.text)
                part = replace(part, text=words if _unicode() else words.translate(ASCII))
            show(console, part, wrap=console.is_terminal)

    def tell(self, text: object) -> None:
        """Print ``text`` as one line on standard error."""
        print(f"emps-design: {one_line(self.with_flags(str(text)))}", file=sys.stderr)

    def print_warnings(self, warnings: Iterable[str]) -> None:
        """Print each warning as one line on standard error."""
        for warning in warnings:
            self.tell(f"warning: {warning}")

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """Yield a progress function that draws a bar on a terminal, and otherwise prints each new stage as a line."""
        if not sys.stderr.isatty():
            yield self._stage_by_stage()
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress as Bar, TextColumn, TimeElapsedColumn

        percent = TextColumn("{task.percentage:3.0f} %")
        columns = (TextColumn("{task.description}"), BarColumn(), percent, TimeElapsedColumn())
        bar = Bar(*columns, console=Console(stderr=True), transient=True)
        task = bar.add_task("", total=1.0)

        def draw(stage: str, share: float) -> None:
            bar.start()  # has no effect after the first call
            bar.update(task, description=stage, completed=share)

        try:
            yield draw
        finally:
            bar.stop()

    def _stage_by_stage(self) -> Progress:
        stages: list[str] = []

        def report(stage: str, share: float) -> None:
            if stages[-1:] != [stage]:
                stages.append(stage)
                self.tell(stage)

        return report

    def with_advice(self, document: dict[str, Any], axis: str | None, records: Sequence[str]) -> dict[str, Any]:
        """The ``document`` of the command with its advice; ``axis`` and ``records`` are the files that were read."""
        advice = advise(self.command, document, self.words, axis, records, self.units)
        return {**document, "advice": replace(advice, text=self.with_flags(advice.text)).to_dict()}

    def advice_on_error(self, error: EmpsError) -> Advice | None:
        """The advice when the command ends with ``error``; None if the error does not concern a design."""
        if error.exit_code not in (3, 4) or not self.words:
            return None
        nearest = getattr(error, "nearest", {})
        advice = advise_on_error(self.command, error.exit_code, str(error), nearest, self.words)
        return replace(advice, text=self.with_flags(advice.text))

    def print_advice(self, document: dict[str, Any]) -> None:
        """Print the advice of ``document`` as one line on standard output."""
        advice = Advice(**document["advice"])
        print(printable(str(replace(advice, text=self.with_flags(advice.text)))))


def _unicode() -> bool:
    """Whether standard output can show every character."""
    return (sys.stdout.encoding or "").lower().startswith("utf")


def _escaped(text: str, shown: Any) -> str:
    """``text`` with the JSON escape, in UTF-16 units, of every character that is not ``shown``."""

    def escape(character: str) -> str:
        units = character.encode("utf-16-be", "surrogatepass").hex()
        return "".join(f"\\u{units[i : i + 4]}" for i in range(0, len(units), 4))

    return "".join(character if shown(character) else escape(character) for character in text)
