"""Formulas as inline SVG, drawn by matplotlib's mathtext: no LaTeX, no script, no network."""

import io
import re
from html import escape

from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser

SIZE = 12.0  # points
PARSER = MathTextParser("path")
FONT = FontProperties(size=SIZE, math_fontfamily="cm")


def simplified(source: str) -> str:
    """``source`` in the part of LaTeX that mathtext knows."""
    text = " ".join(source.split())
    for old, new in (
        (r"\tfrac", r"\frac"), (r"\operatorname", r"\mathrm"), (r"\text", r"\mathrm"),
        (r"\left", ""), (r"\right", ""), (r"\lVert", r"\Vert"), (r"\rVert", r"\Vert"), (r"\begin{aligned}", ""),
        (r"\lvert", "|"), (r"\rvert", "|"),
        (r"\end{aligned}", ""), ("&", ""), (r"\!", ""), (r"\le ", r"\leq "), (r"\ge ", r"\geq "), (r"\top", "T"),
        (r"\bmod", r"\ \mathrm{mod}\ "),
    ):  # fmt: skip
        text = text.replace(old, new)
    return re.sub(r"\\mathrm\{([^}]*)\}", lambda m: r"\mathrm{" + m[1].replace(" ", r"\ ") + "}", text)


def svg(source: str) -> tuple[str, float]:
    """SVG of one line of mathematics, and how far it reaches below the line [points]."""
    text = f"${simplified(source)}$"
    width, height, depth, _, _ = PARSER.parse(text, dpi=72, prop=FONT)
    figure = Figure(figsize=(max(width, 1) / 72, max(height + depth, 1) / 72))
    figure.text(0, depth / max(height + depth, 1), text, fontproperties=FONT, color="#111")
    stream = io.StringIO()
    figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    drawing = stream.getvalue()
    return drawing[drawing.index("<svg") :].strip().replace("#111111", "currentColor"), depth


def picture(source: str) -> str:
    """The formula as an HTML element that says in words what it draws."""
    drawing, depth = svg(source)
    style = f"vertical-align:-{depth:.1f}pt"
    return (
        f'<span role="img" aria-label="{escape(source, quote=True)}" style="{style}" class="formula">{drawing}</span>'
    )


def visit_inline(self, node):
    """A formula in a line of text."""
    from docutils.nodes import SkipNode

    self.body.append(picture(node.astext()))
    raise SkipNode


def visit_display(self, node):
    """A formula on lines of its own, with its number."""
    from docutils.nodes import SkipNode

    lines = [line for line in re.split(r"\\\\", node.astext()) if line.strip()]
    body = "<br>".join(picture(re.sub(r"\\frac", r"\\dfrac", line)) for line in lines)
    number = f'<span class="number">({node["number"]})</span>' if node.get("number") else ""
    self.body.append(f'<div class="math"><div class="lines">{body}</div>{number}</div>')
    raise SkipNode


def setup(app):
    """Register the renderer and its colour in dark mode."""
    app.add_html_math_renderer("mathtext", (visit_inline, None), (visit_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
