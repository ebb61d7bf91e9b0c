"""Directives for what a measuring command wrote, a table from its JSON or a page, or a word that it has not run."""

import json
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive, directives
from docutils.statemachine import StringList

ROOT = Path(__file__).resolve().parents[2]


class Measured(Directive):
    """``{measured} benchmarks/latest.json`` with ``:columns:`` keys of its rows and ``:command:`` that writes it.

    ``:titles:`` with ``|`` between them stand over the columns in the place of the keys.
    """

    required_arguments = 1
    option_spec = {  # noqa: RUF012
        "columns": directives.unchanged_required,
        "titles": directives.unchanged_required,
        "command": directives.unchanged_required,
    }

    def run(self):
        path = ROOT / self.arguments[0]
        if not path.exists():
            return [missing(self, self.arguments[0])]
        columns = self.options["columns"].split()
        rows = [[shown(row.get(key)) for key in columns] for row in json.loads(path.read_text())["rows"]]
        titles = [title.strip() for title in self.options["titles"].split("|")] if "titles" in self.options else columns
        document = json.loads(path.read_text())
        return [written(self, document.get("date")), table(rows, titles)]


class MeasuredPage(Directive):
    """``{measured-page} hidden_effects`` puts the page into the table of contents here, with ``:command:`` as above."""

    required_arguments = 1
    option_spec = {"command": directives.unchanged_required}  # noqa: RUF012

    def run(self):
        page = f"docs/{self.arguments[0]}.md"
        if not (ROOT / page).exists():
            return [missing(self, page)]
        contents = nodes.container()
        lines = ["```{toctree}", ":maxdepth: 1", "", self.arguments[0], "```"]
        self.state.nested_parse(StringList(lines), self.content_offset, contents)
        return [written(self), *contents.children]


def missing(directive, file: str) -> nodes.paragraph:
    """Say that nothing was measured."""
    text = f"Not measured in this tree; {directive.options['command']} writes {file}."
    return nodes.paragraph(text, text)


def written(directive, date: str | None = None) -> nodes.paragraph:
    """Say what measured it, and when."""
    command = directive.options["command"]
    when = f" on {date}:" if date else ":"
    return nodes.paragraph("", "", nodes.Text("Written by "), nodes.literal(command, command), nodes.Text(when))


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
    app.add_directive("measured-page", MeasuredPage)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
