"""Examples as gallery pages: the first line of a script's docstring is its title, and pictures are asked for.

A script that draws nothing itself is shown with the report's pictures of the results it holds at its end.
"""

import ast
import re
from pathlib import Path


def gallery_sources(examples: Path, target: Path) -> Path:
    """Copy the scripts to ``target`` with their titles underlined."""
    target.mkdir(parents=True, exist_ok=True)
    for script in scripts(examples):
        text, docstring = script.read_text(encoding="utf-8"), docstring_of(script)
        title, _, rest = docstring.partition("\n")
        title = title.strip().rstrip(".")
        heading = f"{title}\n{'=' * len(title)}\n{rest}"
        page = text.replace(docstring, heading, 1)
        copy = target / script.name
        if not copy.exists() or copy.read_text(encoding="utf-8") != page:
            copy.write_text(page, encoding="utf-8")
    header = (
        "Examples\n========\n\nEvery script of ``examples/``, with what it prints and draws; one that needs a "
        "record of yours is shown only.\nThe tests run them too.\n"
    )
    (target / "GALLERY_HEADER.rst").write_text(header, encoding="utf-8")
    return target


def needs_nothing(examples: Path) -> str:
    """A pattern of the scripts that the gallery runs: all but those which cannot do without a file of the reader's."""
    return "/(" + "|".join(script.stem for script in scripts(examples) if not required(script)) + r")\.py$"


def scripts(examples: Path) -> list[Path]:
    """The examples in their order."""
    return sorted(examples.glob("[0-9]*.py"))


def required(script: Path) -> bool:
    """Whether the docstring of ``script`` shows an argument without brackets."""
    return re.search(r"\.py\s+[A-Z]", docstring_of(script)) is not None


def docstring_of(script: Path) -> str:
    """The docstring as it is written."""
    return ast.get_docstring(ast.parse(script.read_text(encoding="utf-8")), clean=False) or script.stem


def arguments(gallery_conf: dict, script_vars: dict) -> list[str]:
    """A name for the figure where that is a script's first argument."""
    source = Path(script_vars["src_file"])
    return figure_argument(docstring_of(source), source.stem)


def figure_argument(docstring: str, stem: str) -> list[str]:
    """``["stem.png"]`` for a docstring that says ``script.py [figure.png]``.

    >>> figure_argument("Run: python examples/01_gains.py [figure.svg]", "01_gains")
    ['01_gains.svg']
    """
    match = re.search(r"\.py\s+\[figures?\.(\w+)\]", docstring)
    return [f"{stem}.{match[1]}"] if match else []


def pictures(block, block_vars: dict, gallery_conf: dict) -> str:
    """The figures that the script drew, else those of its results."""
    from sphinx_gallery.scrapers import figure_rst, matplotlib_scraper

    drawn = matplotlib_scraper(block, block_vars, gallery_conf)
    if drawn:
        return drawn
    paths = []
    for figure in of_results(block_vars["example_globals"]):
        paths.append(next(block_vars["image_path_iterator"]))
        figure.savefig(paths[-1])
    return figure_rst(paths, gallery_conf["src_dir"])


def of_results(names: dict) -> list:
    """A figure for each result of another type among the values of ``names``."""
    from emps_design.discrepancy import Diagnosis
    from emps_design.identification import Identification, Observation
    from emps_design.report import before_after_figure, force_figure, observation_figure

    draw = {Identification: force_figure, Observation: observation_figure, Diagnosis: before_after_figure}
    last = {type(value): value for value in names.values() if type(value) in draw}
    return [draw[kind](value) for kind, value in last.items()]


def _get_sg_image_scraper():
    return pictures
