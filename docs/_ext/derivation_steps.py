"""Directives of the paper: the steps of a derivation as ``derive`` finds them, the errata, the page line by line."""

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList


class Derivation(Directive):
    """``{derivation} cascade``: of each step a title, its equation, what it assumes and what was checked."""

    required_arguments = 1

    def run(self):
        from emps_design.paper.errata import derivation
        from emps_design.paper.written import latex

        lines: list[str] = []
        for step in derivation()[self.arguments[0]][1]:
            number = f" ({step.number})" if step.number else ""
            verdict = f", {marked(step)}" if step.verdict else ""
            lines += [f"**{step.title}**{number}{verdict}: {plain(step.text)}", ""]
            lines += ["$$", latex(step.equation), "$$", ""]
            if step.agrees is False:
                lines += ["printed:", "", "$$", latex(step.printed), "$$", ""]
            notes = [f"Assumes: {plain('; '.join(step.assumes))}."]
            if step.checks:
                claims = "; ".join(plain(claim) + ("" if true else " **(found false)**") for claim, true in step.checks)
                notes.append(f"Checked: {claims}.")
            lines += [" ".join(notes), ""]
        return parsed(self, lines)


class Errata(Directive):
    """``{errata}``: what is printed, what is derived, and why, a paragraph for each place."""

    def run(self):
        from emps_design.paper.errata import find_errata

        lines: list[str] = []
        for one in find_errata():
            about = "" if one.place == one.title else f", {one.title[0].lower()}{one.title[1:]}"
            lines += [f"**{one.place}**{about}: {plain(one.text)}", ""]
            if one.step is not None:
                lines += ["$$", rf"{one.printed} \qquad \to \qquad {one.derived}", "$$", ""]
        return parsed(self, lines)


class PaperEquations(Directive):
    """``{paper-equations} 1 11``: of each equation what is printed, what is derived, where it stands in the package."""

    required_arguments = 2

    def run(self):
        from emps_design.paper.errata import PLACES, derivation
        from emps_design.paper.written import EQUATIONS, latex

        steps = [step for _, steps in derivation().values() for step in steps]
        lines: list[str] = []
        for number in map(str, range(int(self.arguments[0]), int(self.arguments[1]) + 1)):
            of_it = [step for step in steps if step.number == number]
            told: dict[str, str] = {}  # the first step of each verdict speaks for it
            for step in of_it:
                told.setdefault(marked(step), step.title)
            verdicts = "; ".join(f"{title}: {verdict}" for verdict, title in told.items())
            where = ", ".join(f"`{name.removeprefix('emps_design.')}`" for name in PLACES[number])
            lines += [f"**({number})** {verdicts}. In {where}.", ""]
            for printed in EQUATIONS[number]:
                lines += ["$$", latex(printed), "$$", ""]
            for step in of_it:
                if step.agrees is False and step.difference != 0:
                    lines += [f"derived: {plain(step.text)}", "", "$$", latex(step.equation), "$$", ""]
        return parsed(self, lines)


def marked(step) -> str:
    """The verdict of a step, in bold where it is not as printed."""
    return plain(step.verdict) if step.agrees is not False else f"**{plain(step.verdict)}**"


def plain(text: str) -> str:
    """``text`` with what Markdown would take for marks made harmless."""
    for mark in ("\\", "*", "_", "|", "<", "$"):
        text = text.replace(mark, f"\\{mark}")
    return text


def parsed(directive: Directive, lines: list[str]) -> list[nodes.Node]:
    """The nodes that Markdown ``lines`` stand for."""
    contents = nodes.container()
    directive.state.nested_parse(StringList(lines), directive.content_offset, contents)
    return contents.children


def setup(app):
    """Register the directives."""
    app.add_directive("derivation", Derivation)
    app.add_directive("errata", Errata)
    app.add_directive("paper-equations", PaperEquations)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
