"""The ``constants`` directive: numbers of ``emps_design.discrepancy`` with their words, as their files have them."""

from pathlib import Path

from assigned import assigned
from docutils.parsers.rst import Directive
from measured_tables import table

ROOM = Path(__file__).resolve().parents[2] / "emps_design" / "discrepancy"


class Constants(Directive):
    """``{constants}`` with lines ``module NAME NAME ...``, or ``module`` for all of them: one row per number."""

    has_content = True

    def run(self):
        rows = []
        for line in self.content:
            module, *names = line.split()
            path = next(ROOM.rglob(f"{module}.py"))
            self.state.document.settings.env.note_dependency(str(path))
            found = assigned(path)
            for name in names or found:
                if name not in found:
                    raise self.error(f"{path}: no constant {name}; found {', '.join(found)}")
                value, meaning = found[name]
                rows.append([f"{module}.{name}", value, meaning])
        return [table(rows, ["constant", "value", "what it is"])]


def setup(app):
    """Register the directive."""
    app.add_directive("constants", Constants)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
