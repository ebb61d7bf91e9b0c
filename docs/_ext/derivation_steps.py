"""The ``derivation`` directive: the steps of a derivation as ``derive`` finds them, numbered as in the paper."""

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList

VERDICTS = {None: "", True: ", as printed", False: ", **not as printed**"}


class Derivation(Directive):
    """``{derivation} cascade`` or ``{derivation} impedance``: a title, a sentence and an equation for each step."""

    required_arguments = 1

    def run(self):
        import sympy

        lines: list[str] = []
        for step in steps(self.arguments[0]):
            number = f" ({step.number})" if step.number else ""
            lines += [f"**{step.title}**{number}{VERDICTS[step.agrees]}: {plain(step.text)}", ""]
            lines += ["$$", sympy.latex(step.equation), "$$", ""]
            if step.agrees is False and step.printed is not None:
                lines += ["printed:", "", "$$", sympy.latex(step.printed), "$$", ""]
        contents = nodes.container()
        self.state.nested_parse(StringList(lines), self.content_offset, contents)
        return contents.children


def steps(name: str) -> list:
    """The steps of the derivation ``name``."""
    from emps_design.paper import derive_cascade, impedance_derivation

    return list({"cascade": derive_cascade, "impedance": impedance_derivation}[name]())


def plain(text: str) -> str:
    """``text`` with what Markdown would take for marks made harmless."""
    for mark in ("\\", "*", "_", "|", "<"):
        text = text.replace(mark, f"\\{mark}")
    return text


def setup(app):
    """Register the directive."""
    app.add_directive("derivation", Derivation)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
