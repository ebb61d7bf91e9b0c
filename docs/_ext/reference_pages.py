"""Write the reference from the docstrings: a page for each room, a section for each module, an entry for each name."""

import importlib
import inspect
import pkgutil
import re
from pathlib import Path

ROOMS = {
    "records": "Records",
    "axis": "Axis",
    "tables": "Tables of an axis file",
    "machines": "Machines",
    "importing": "Exports of drives",
    "effects": "What an effect is",
    "laws": "Control laws",
    "observer": "Observer",
    "control": "Control",
    "simulation": "Simulation",
    "compensation": "Compensation",
    "codegen": "Code for a drive",
    "comanipulation": "Co-manipulation",
    "identification": "Identification",
    "frequency_response": "Frequency responses",
    "paper": "The paper",
    "discrepancy": "Discrepancy",
    "report": "Reports",
    "quantities": "Quantities",
    "registry": "What a user adds",
    "files": "Files",
    "request": "Requests",
    "view": "Views",
    "figures": "Figures",
    "errors": "Errors",
}
# One page of the catalogue for each effect; the reference has what they share.
ONLY = {"effects": ("emps_design.effects", "emps_design.effects.effect")}


def modules(room: str) -> list[str]:
    """Names of the modules of a room, the room itself first."""
    package = importlib.import_module(f"emps_design.{room}")
    inside = pkgutil.walk_packages(getattr(package, "__path__", []), f"{package.__name__}.")
    names = [package.__name__, *(found.name for found in inside if "._" not in found.name)]
    return [name for name in names if name in ONLY.get(room, names)]


def room_page(room: str, title: str) -> str:
    """The page of a room as MyST."""
    parts = [f"# {title}\n"]
    for name in modules(room):
        module = importlib.import_module(name)
        parts.append(f"## `{name}`\n\n{prose(inspect.getdoc(module) or '')}\n")
        for entry, thing in vars(module).items():
            own = getattr(thing, "__module__", None) == name and not entry.startswith("_")
            if own and (inspect.isclass(thing) or inspect.isfunction(thing)):
                parts.append(described(entry, thing, 3))
                parts += [described(f"{entry}.{n}", m, 4) for n, m in members(thing)] if inspect.isclass(thing) else []
    return "\n".join(parts)


def members(thing: type) -> list[tuple[str, object]]:
    """Public methods and properties that a class defines itself, with a docstring."""
    found = []
    for name, member in vars(thing).items():
        member = getattr(member, "__func__", member)
        member = getattr(member, "func", getattr(member, "fget", member))
        if not name.startswith("_") and inspect.isfunction(member) and member.__doc__:
            found.append((name, member))
    return found


def described(name: str, thing, level: int) -> str:
    """Heading, signature and docstring of one name."""
    try:
        signature = str(inspect.signature(thing))
    except (TypeError, ValueError):
        signature = "(...)"
    signature = re.sub(r" at 0x[0-9a-f]+", "", signature)
    return f"{'#' * level} `{name}`\n\n```python\n{name}{signature}\n```\n\n{prose(inspect.getdoc(thing) or '')}\n"


def prose(text: str) -> str:
    """A docstring as MyST: roles and double backticks become code, examples and `::` blocks code blocks."""
    text = re.sub(r":(?:class|func|meth|mod|attr|data|exc):`~?([^`]*)`", r"`\1`", text).replace("``", "`")
    lines, fence = [], ""
    for line in text.splitlines():
        indented = line.startswith("    ")
        if (fence == ">>>" and not line.strip()) or (fence == "::" and line.strip() and not indented):
            lines += ["```", ""]
            fence = ""
        if not fence and line.startswith(">>>"):
            lines.append("```pycon")
            fence = ">>>"
        elif not fence and indented:
            lines += ["", "```text"]
            fence = "::"
        lines.append(re.sub(r"::$", ":", line) if not fence else line)
    return "\n".join([*lines, *(["```"] if fence else [])])


def write(app) -> None:
    """Write the pages of all rooms and their index."""
    folder = Path(app.srcdir) / "reference"
    folder.mkdir(exist_ok=True)
    for room, title in ROOMS.items():
        (folder / f"{room}.md").write_text(room_page(room, title), encoding="utf-8")
    toc = "\n".join(ROOMS)
    text = f"# Reference\n\nWritten from the docstrings.\n\n```{{toctree}}\n:maxdepth: 1\n\n{toc}\n```\n"
    (folder / "index.md").write_text(text, encoding="utf-8")


def setup(app):
    """Write the reference before Sphinx looks for pages."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
