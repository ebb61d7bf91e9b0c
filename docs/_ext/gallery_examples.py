"""Examples as gallery pages: the first line of a script's docstring is its title, and pictures are asked for."""

import ast
import re
from pathlib import Path


def gallery_sources(examples: Path, target: Path) -> Path | None:
    """Copy the scripts to ``target`` with their titles underlined; None where there are none."""
    scripts = sorted(examples.glob("[0-9]*.py"))
    if not scripts:
        return None
    target.mkdir(parents=True, exist_ok=True)
    for script in scripts:
        text = script.read_text(encoding="utf-8")
        docstring = ast.get_docstring(ast.parse(text), clean=False) or script.stem
        title, _, rest = docstring.partition("\n")
        title = title.strip().rstrip(".")
        heading = f"{title}\n{'=' * len(title)}\n{rest}"
        page = text.replace(docstring, heading, 1)
        copy = target / script.name
        if not copy.exists() or copy.read_text(encoding="utf-8") != page:
            copy.write_text(page, encoding="utf-8")
    header = (
        "Examples\n========\n\nEvery script of ``examples/``, with what it prints and draws. The tests run them too.\n"
    )
    (target / "GALLERY_HEADER.rst").write_text(header, encoding="utf-8")
    return target


def arguments(gallery_conf: dict, script_vars: dict) -> list[str]:
    """A name for the figure where that is a script's first argument."""
    source = Path(script_vars["src_file"])
    docstring = ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""
    return figure_argument(docstring, source.stem)


def figure_argument(docstring: str, stem: str) -> list[str]:
    """``["stem.png"]`` for a docstring that says ``script.py [figure.png]``.

    >>> figure_argument("Run: python examples/01_gains.py [figure.svg]", "01_gains")
    ['01_gains.svg']
    """
    match = re.search(r"\.py\s+\[figures?\.(\w+)\]", docstring)
    return [f"{stem}.{match[1]}"] if match else []
