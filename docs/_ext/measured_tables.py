"""The ``measured`` directive: a table from the JSON that a measuring command wrote, or a word that it has not run."""

import json
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive, directives

ROOT = Path(__file__).resolve().parents[2]


class Measured(Directive):
    """``{measured} benchmarks/latest.json`` with ``:columns:`` keys of its rows and ``:command:`` that writes it."""

    required_arguments = 1
    option_spec = {"columns": directives.unchanged_required, "command": directives.unchanged_required}  # noqa: RUF012

    def run(self):
        path = ROOT / self.arguments[0]
        if not path.exists():
            text = f"Not measured in this tree; {self.options['command']} writes {self.arguments[0]}."
            return [nodes.paragraph(text, text)]
        columns = self.options["columns"].split()
        return [
            table([[shown(row.get(key)) for key in columns] for row in json.loads(path.read_text())["rows"]], columns)
        ]


def shown(value) -> str:
    """A value as a person writes it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def table(rows: list[list[str]], columns: list[str]) -> nodes.table:
    """A docutils table with a head."""
    group = nodes.tgroup(cols=len(columns))
    group += [nodes.colspec(colwidth=1) for _ in columns]
    for part, lines in ((nodes.thead(), [columns]), (nodes.tbody(), rows)):
        for line in lines:
            row = nodes.row()
            for cell in line:
                entry = nodes.entry()
                entry += nodes.paragraph(cell, cell)
                row += entry
            part += row
        group += part
    whole = nodes.table()
    whole += group
    return whole


def setup(app):
    """Register the directive."""
    app.add_directive("measured", Measured)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
