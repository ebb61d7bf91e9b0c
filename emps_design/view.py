"""What a reader is to see of a result: lines and tables in their order, as data.

One description is rendered as text for the terminal and ``str``, and as HTML for a page and a notebook. A view is made
in the units and words of its axis; a renderer changes no text.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape, unescape
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from emps_design.errors import printable

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console
    from rich.table import Table as RichTable

STYLES = {"good": "bold green", "bad": "bold red", "strong": "bold"}  # of a line on a terminal
WHOLE = ("good", "bad", "code")  # styles of a line that is not wrapped
BLOCKS = "▁▂▃▄▅▆▇█"
Cell = Any  # text, a number or None


class Html(str):
    """Text that is HTML already, such as a symbol with its subscript: not escaped, and without its tags as text."""

    __slots__ = ()


@dataclass(frozen=True)
class Line:
    """A line of text; ``style`` is "" or one of "good" and "bad" for a verdict, "strong", "prose" and "code".

    A terminal wraps it at words, but a verdict and code, which stand as they are; a file has it in one line, but prose.
    """

    text: str
    style: str = ""


@dataclass(frozen=True)
class Table:
    """Rows under headings, with a title; a number has four significant digits, None is ``missing``.

    ``words`` are the headings of columns of text, aligned left as the first one is; the others are aligned right.
    With ``row_headings`` the first cell of a row is a heading, as HTML. Headings that are all empty are not shown.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    title: str = ""
    words: Sequence[str] = ("unit",)
    missing: str = "-"
    row_headings: bool = False
    kind: str = field(default="table", init=False)

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.headings):
                raise ValueError(f"table {self.title!r}: a row has {len(row)} cells, expected {len(self.headings)}")

    def texts(self) -> list[list[str]]:
        """The rows as text.

        >>> Table(("", "value"), [("mass", 95.1089), ("limit", None)]).texts()
        [['mass', '95.11'], ['limit', '-']]
        """
        return [[self._text(cell) for cell in row] for row in self.rows]

    def _text(self, cell: Cell) -> str:
        if cell is None:
            return self.missing
        return f"{cell:.4g}" if isinstance(cell, float) else cell if isinstance(cell, str) else str(cell)


View = tuple[Line | Table, ...]


class Viewed:
    """A result with a ``view``: it prints as text and shows itself in a notebook."""

    def view(self) -> View:
        """What a reader is to see of it."""
        raise NotImplementedError

    def __str__(self) -> str:
        return text(self.view())

    def _repr_html_(self) -> str:
        return html(self.view())


def text(view: View, width: int = 80) -> str:
    """``view`` as text of at most ``width`` columns where its tables fit.

    >>> print(text((Line("stable", "good"), Table(("", "value", "unit"), [("mass", 95.1089, "kg")], "Loop"))))
    stable
    Loop
    <BLANKLINE>
            value   unit
     ───────────────────
     mass   95.11   kg
    """
    from rich.console import Console

    console = Console(width=width, markup=False, emoji=False, highlight=False, color_system=None)
    with console.capture() as captured:
        for part in view:
            show(console, part)
    return "\n".join(line.rstrip() for line in captured.get().rstrip().split("\n"))


def show(console: Console, part: Line | Table, wrap: bool = True) -> None:
    """Print ``part`` on ``console``; unprintable characters, which names may hold, are shown as ``?``."""
    from rich.text import Text

    if isinstance(part, Line):
        whole = part.style in WHOLE or not (wrap or part.style == "prose")
        console.print(Text(printable(part.text), STYLES.get(part.style, "")), soft_wrap=whole)
    else:
        table = _rich(part)
        if console.measure(table, options=console.options.update(width=10_000)).maximum > console.width:
            table.padding = (0, 1, 0, 0)  # closer columns
        console.print(table)


def _rich(table: Table) -> RichTable:
    """The table with numbers on the right."""
    from rich import box
    from rich.table import Table as RichTable

    title = printable(table.title) or None
    shown = RichTable(
        title=title,
        title_justify="left",
        box=box.SIMPLE,
        pad_edge=False,
        min_width=len(table.title),
        show_header=any(table.headings),
    )
    for place, heading in enumerate(table.headings):
        words = place == 0 or heading in table.words
        shown.add_column(_plain(heading), justify="left" if words else "right", overflow="fold")
    for row in table.texts():
        shown.add_row(*map(_plain, row))
    return shown


def sparkline(values: np.ndarray, width: int = 60) -> str:
    """The means of ``values`` (n,) drawn in ``width`` characters.

    >>> import numpy as np
    >>> sparkline(np.arange(100.0), 8), sparkline(np.ones(5), 3)
    ('▁▂▃▄▅▆▇█', '▁▁▁')
    """
    import numpy as np

    edges = np.linspace(0, values.size, min(width, values.size) + 1).astype(int)
    means = np.array([values[a:b].mean() for a, b in pairwise(edges)])
    span = float(np.ptp(means))
    heights = np.zeros(means.size) if span == 0.0 else (means - means.min()) / span * (len(BLOCKS) - 1)
    return "".join(BLOCKS[round(height)] for height in heights)


def _plain(text: str) -> str:
    """``text`` as a terminal shows it.

    >>> _plain(Html("<i>k</i><sub>v1</sub> &lt; 1")), _plain("a <b>")
    ('kv1 < 1', 'a <b>')
    """
    return printable(unescape(re.sub(r"<[^<>]*>", "", text)) if isinstance(text, Html) else text)


def html(view: View) -> str:
    """``view`` as HTML, for a page or a notebook.

    >>> html((Line("stable", "good"), Table(("", "value"), [("gain <", 2.0)], "Loop")))  # doctest: +ELLIPSIS
    '<p class="good">stable</p>\\n<table><caption>Loop</caption><thead><tr><th></th><th>value</th></tr></thead>...'
    """
    return "\n".join(_paragraph(part) if isinstance(part, Line) else _table(part) for part in view)


def _paragraph(line: Line) -> str:
    style = f' class="{line.style}"' if line.style else ""
    return f"<p{style}>{_escaped(line.text)}</p>"


def _escaped(text: str) -> str:
    return str(text) if isinstance(text, Html) else escape(printable(text))


def _table(table: Table) -> str:
    numeric = [place > 0 and heading not in table.words for place, heading in enumerate(table.headings)]

    def row(cells: Sequence[str], headings: int) -> str:
        """A row whose first cells are ``headings``."""
        tags = ["th" if place < headings else "td" for place in range(len(cells))]
        style = [' class="number"' * (number and tag == "td") for tag, number in zip(tags, numeric, strict=True)]
        written = zip(tags, style, map(_escaped, cells), strict=True)
        return f"<tr>{''.join(f'<{tag}{look}>{cell}</{tag}>' for tag, look, cell in written)}</tr>"

    caption = f"<caption>{_escaped(table.title)}</caption>" if table.title else ""
    head = f"<thead>{row(table.headings, len(table.headings))}</thead>" if any(table.headings) else ""
    body = "".join(row(cells, int(table.row_headings)) for cells in table.texts())
    return f"<table>{caption}{head}<tbody>{body}</tbody></table>"
