"""Every formula of the pages can be drawn: one that cannot ends the build of all of them."""

import importlib
import re
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = sorted(page for page in DOCS.rglob("*.md") if "_build" not in page.parts)
CODE = re.compile(r"^```(?!\{math\}).*?^```|(?<!`)`[^`\n]+`(?!`)", re.MULTILINE | re.DOTALL)
FORMULA = re.compile(r"\$\$(.+?)\$\$|\$([^$\n]+?)\$|^```\{math\}\n(?::.*\n)*(.+?)^```", re.MULTILINE | re.DOTALL)


def formulas(text: str) -> list[str]:
    found = FORMULA.findall(CODE.sub("", text))
    return [line for one in found for line in re.split(r"\\\\", "".join(one)) if line.strip()]


def test_every_formula_of_a_page_is_drawn(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    mathtext = importlib.import_module("mathtext")
    for page in PAGES:
        for formula in formulas(page.read_text(encoding="utf-8")):
            drawn = mathtext.simplified(formula)
            assert mathtext.PARSER.parse(f"${drawn}$", dpi=72, prop=mathtext.FONT)[0] > 0, (page.name, formula)


def test_formulas_are_found():
    assert formulas("`$no$` and $a$\n```text\n$no$\n```\n$$b \\\\ c$$\n```{math}\n:label: x\nd\n```\n") == [
        "a", "b ", " c", "d\n",
    ]  # fmt: skip
    assert sum(len(formulas(page.read_text(encoding="utf-8"))) for page in PAGES) > 100
