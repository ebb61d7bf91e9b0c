"""A page: a title, a summary, and sections of views and pictures, as one self-contained HTML file.

A page is reproducible: it states the versions of the software and the SHA-256 of every input, but no time. The advice
on the result comes first.

Numbers are stored in SI units and converted to display units on output.
"""

from __future__ import annotations

import math
import platform
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.metadata import version
from itertools import count
from typing import TYPE_CHECKING, Any, TypeGuard

from emps_design import view
from emps_design.advice import CAUTION, DO_NOT_RUN, SAFE, Advice
from emps_design.errors import printable
from emps_design.report.style import labelled, svg
from emps_design.units import LINEAR, Units
from emps_design.view import Html as Html, Line as Line, Table as Table

if TYPE_CHECKING:
    from jinja2 import Template
    from matplotlib.figure import Figure

PACKAGES = ("emps-design", "numpy", "scipy", "control", "sympy", "matplotlib")

LEVELS = {SAFE: ("good", "Safe."), CAUTION: ("warning", "Caution."), DO_NOT_RUN: ("bad", "Do not run this.")}

NOTHING = "—"


def inline(value: Any) -> str:
    """Return one cell or phrase as HTML: numbers with four digits, None as a dash, text escaped.

    >>> inline(556.766), inline("a < b"), inline(Html("<i>k</i>")), inline(None)
    ('556.8', 'a &lt; b', '<i>k</i>', '—')
    """
    if value is None:
        return NOTHING
    if isinstance(value, Html):
        return str(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float) or hasattr(value, "dtype"):
        return number(float(value))
    return escape(printable(str(value)), quote=False)


def html(template: str, *values: Any) -> Html:
    """Return ``template``, which is HTML, with its braces replaced by ``values``, each formatted by :func:`inline`.

    >>> html("<b>{}</b>", "a < b")
    '<b>a &lt; b</b>'
    """
    return Html(template.format(*map(inline, values)))


@dataclass(frozen=True)
class Facts:
    """The main numbers of the page in large type: (label, value, remark) each."""

    items: tuple[tuple[str, str, str], ...]

    def html(self) -> str:
        """The facts as HTML."""
        facts = []
        for fact in self.items:
            label, value, remark = map(inline, fact)
            small = f"<small>{remark}</small>" if remark else ""
            facts.append(f"<div><dt>{label}</dt><dd>{value}{small}</dd></div>")
        return f'<dl class="facts">{"".join(facts)}</dl>'


@dataclass(frozen=True)
class Picture:
    """A matplotlib figure with a caption that says what to see."""

    figure: Figure
    caption: str
    title: str = ""

    def html(self, units: Units, counted: str = "") -> str:
        """The picture as HTML in ``units``; ``counted``, such as Figure 2, stands before its title."""
        drawing = svg(labelled(self.figure, units), counted.replace("Figure ", "f"))
        label = escape(re.sub(r"<[^>]+>", "", inline(self.title or self.caption)), quote=True)
        drawing = drawing.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)
        title = " ".join(f"{words}." for words in (counted, inline(self.title)) if words)
        caption = f"<figcaption><b>{title}</b> {inline(self.caption)}</figcaption>"
        return f'<figure class="picture">\n{drawing}\n{caption}\n</figure>'

    def _repr_html_(self) -> str:
        return self.html(LINEAR)


Block = Line | Table | Facts | Picture


@dataclass(frozen=True)
class Section:
    """A heading of the contents list and its blocks."""

    title: str
    blocks: tuple[Block, ...]

    def __init__(self, title: str, *blocks: Block | None):
        object.__setattr__(self, "title", title)
        object.__setattr__(self, "blocks", tuple(block for block in blocks if block is not None))

    @property
    def key(self) -> str:
        """The anchor of the heading."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


@dataclass(frozen=True)
class Page:
    """A whole document; ``html()`` is one self-contained file, the same bytes for the same content.

    Its text is in the units of the axis where it is made; ``units`` are those of the labels in its pictures.

    >>> page = Page("Velocity loop", "emps2018", (Line("meets the specification", "good"),),
    ...             (Section("Gains", Table(["gain", "value"], [["k", 1.5]])),))
    >>> "meets the specification" in page.html() and page.html() == page.html()
    True
    """

    title: str
    subtitle: str
    summary: tuple[Block, ...]
    sections: tuple[Section, ...]
    units: Units = field(default_factory=Units)

    def html(self) -> str:
        """Return the document as HTML text."""
        numbers = Numbered(self.units)
        parts = [("summary", "Summary", self.summary)] if self.summary else []
        parts += [(section.key, section.title, section.blocks) for section in self.sections]
        rendered = [(key, inline(title), numbers.html(blocks)) for key, title, blocks in parts]
        title, subtitle = inline(self.title), inline(self.subtitle)
        return _template().render(title=title, subtitle=subtitle, sections=rendered)

    def pictures(self) -> tuple[Picture, ...]:
        """Return every picture of the page in order, its labels in the units of the axis."""
        blocks = [*self.summary, *(block for section in self.sections for block in section.blocks)]
        pictures = tuple(block for block in blocks if isinstance(block, Picture))
        for picture in pictures:
            labelled(picture.figure, self.units)
        return pictures

    def _repr_html_(self) -> str:
        source = escape(self.html(), quote=True)
        return (
            f'<iframe srcdoc="{source}" title="{escape(self.title)}" style="width:100%;height:800px;border:0"></iframe>'
        )


class Numbered:
    """Renders blocks as HTML in ``units``, and numbers their pictures and tables."""

    def __init__(self, units: Units):
        self.units = units
        self._pictures, self._tables = count(1), count(1)

    def html(self, blocks: Iterable[Block]) -> str:
        """``blocks`` as HTML, without a page around them."""
        return view.html(blocks, self._block)

    def _block(self, block: Facts | Table | Picture) -> str:
        if isinstance(block, Picture):
            return block.html(self.units, f"Figure {next(self._pictures)}")
        if isinstance(block, Facts):
            return block.html()
        counted = f"Table {next(self._tables)}" if block.title else ""
        return f'<div class="scroll">{view.table_html(block, counted)}</div>'


@cache
def _template() -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("emps_design.report"),
        autoescape=False,  # what it gets is HTML
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html.j2")


def versions() -> str:
    """Return the versions of Python and of the packages that computed and drew the page, in one line."""
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES[1:])
    return f"Made by {PACKAGES[0]} {version(PACKAGES[0])} with Python {platform.python_version()}, {packages}."


def inputs_table(inputs: Mapping[str, str | None]) -> Table:
    """Return the SHA-256 of every input by name."""
    rows = [[name, html("<code>{}</code>", digest) if digest else "built in"] for name, digest in inputs.items()]
    return Table(["input", "SHA-256"], rows, "Every input of this page; the same inputs give the same bytes.")


def advice_line(advice: Advice) -> Line:
    """Return the advice on a result, and what to do next, as a line."""
    level, title = LEVELS[advice.level]
    further = html(" Next: <code>{}</code>", advice.next) if advice.next else ""
    return Line(html("<b>{}</b> {}{}", title, sentence_of(advice.text), further), level)


def _known(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def number(value: float | None, digits: int = 4) -> str:
    """Return ``value`` with ``digits`` significant digits, without an exponent where it reads well.

    >>> number(556.7661), number(0.000123456), number(1e7), number(None)
    ('556.8', '0.0001235', '1.000e7', '—')
    """
    if not _known(value):
        return NOTHING
    value = float(value)
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if exponent >= 6 or exponent < -4:
        mantissa, power = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa}e{int(power)}".replace("-", "−")
    rounded = float(f"{value:.{digits}g}")
    exponent = math.floor(math.log10(abs(rounded)))
    return f"{rounded:.{max(0, digits - 1 - exponent)}f}".replace("-", "−")


def quantity(value: float | None, unit: str, digits: int = 4, units: Units = LINEAR) -> str:
    """Return ``value`` [SI of ``unit``] in the units of an axis, in ms, mm, mm/s or mV where it is below 1.

    >>> quantity(0.00845505, "s"), quantity(115.73, "kg"), quantity(None, "s")
    ('8.455 ms', '115.7 kg', '—')
    >>> quantity(0.02, "m", units=Units("rotary")), quantity(1.5, "m/s", 3, Units("rotary"))
    ('1.146 deg', '1.50 rad/s (14.3 rpm)')
    """
    if not _known(value):
        return NOTHING
    name, factor = units.readable(value, unit)
    if factor == 1.0:
        return units.quantity(value, unit, lambda shown: number(shown, digits))
    return f"{number(value * factor, digits)} {name}".rstrip()


def frequency(omega: float | None, digits: int = 4) -> str:
    """Return an angular frequency [rad/s] with its value in Hz.

    >>> frequency(100.0)
    '100.0 rad/s (15.92 Hz)'
    """
    if not _known(omega):
        return NOTHING
    return f"{number(omega, digits)} rad/s ({number(omega / (2 * math.pi), digits)} Hz)"


def angle(degrees: float | None) -> str:
    """Return an angle [deg] with one decimal.

    >>> angle(60.0)
    '60.0°'
    """
    return f"{degrees:.1f}°".replace("-", "−") if _known(degrees) else NOTHING


def ratio(gain: float | None) -> str:
    """Return a gain margin as ratio with dB; None or infinite reads unbounded.

    >>> ratio(2.0), ratio(None)
    ('2.00 (6.0 dB)', 'unbounded')
    """
    if not _known(gain):
        return "unbounded"
    if gain <= 0:
        return number(gain)
    return f"{gain:.2f} ({20 * math.log10(gain):.1f} dB)".replace("-", "−")


def delay(seconds: float | None, period: float | None = None) -> str:
    """Return a delay margin [s] in ms, and in samples of ``period`` [s] where that is given.

    >>> delay(0.00533, 1e-3)
    '5.330 ms (5.33 samples)'
    """
    if not _known(seconds):
        return "unbounded"
    samples = f" ({seconds / period:.2f} samples)" if period else ""
    return f"{quantity(seconds, 's')}{samples}"


def with_std(value: float | None, std: float | None, unit: str = "", units: Units = LINEAR) -> str:
    """Return ``value ± std`` [SI of ``unit``] in the units of an axis, to two digits of the standard deviation.

    >>> with_std(95.1089, 0.1085, "kg"), with_std(0.0081, 0.0004, "m/s"), with_std(3.0, None, "N")
    ('95.11 ± 0.11 kg', '8.10 ± 0.40 mm/s', '3.000 N')
    """
    if not _known(value):
        return NOTHING
    if not _known(std) or std <= 0:
        return quantity(value, unit, units=units)
    unit, factor = units.readable(value, unit)
    value, std = value * factor, std * factor
    places = max(0, 1 - math.floor(math.log10(std)))
    if places > 6:
        return f"{number(value, 6)} ± {number(std, 2)} {unit}".rstrip()
    return f"{value:.{places}f} ± {std:.{places}f} {unit}".rstrip().replace("-", "−")


def interval(value: float | None, std: float | None, unit: str = "", units: Units = LINEAR) -> str:
    """Return the 95 % interval of a normal estimate, ``value`` ± 1.96 ``std``, with the digits that differ.

    >>> interval(95.1089, 0.1085, "kg"), interval(0.005, 1.5e-7, "m"), interval(1.0, 0.0)
    ('94.90 to 95.32 kg', '4.99971 to 5.00029 mm', '—')
    """
    if not _known(value) or not _known(std) or std <= 0:
        return NOTHING
    unit, factor = units.readable(value, unit)
    low, high = factor * (value - 1.96 * std), factor * (value + 1.96 * std)
    places = min(6, max(0, 1 - math.floor(math.log10(factor * std))))
    return f"{low:.{places}f} to {high:.{places}f} {unit}".rstrip().replace("-", "−")


def probability(p: float | None) -> str:
    """Return a p-value as a reader quotes it.

    >>> probability(0.0004), probability(0.03)
    ('< 0.001', '0.030')
    """
    if not _known(p):
        return NOTHING
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def symbol(name: str) -> str:
    """Return a name like ``k_v1`` as HTML with its subscript, italic.

    >>> symbol("k_v1")
    '<i>k</i><sub>v1</sub>'
    """
    head, _, tail = name.partition("_")
    greek = {"tau": "τ", "omega": "ω", "phi": "φ", "sigma": "σ"}
    tail = greek.get(tail, tail)
    return f"<i>{escape(greek.get(head, head))}</i>" + (f"<sub>{escape(tail)}</sub>" if tail else "")


def words(name: str) -> str:
    """Return a parameter or effect name as words.

    >>> words("viscous_positive")
    'viscous positive'
    """
    return name.replace("_", " ")


def sentence_of(text: str) -> str:
    """Return ``text`` with a capital and a full stop, empty text as it is.

    >>> sentence_of("no gain is stable")
    'No gain is stable.'
    """
    return f"{text[0].upper()}{text[1:]}".rstrip(".") + "." if text else ""
