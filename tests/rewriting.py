"""What is put into the units of an axis where it is said for a linear one: an oracle, for nothing says so any more.

A sentence of the library is made in the units and words of its axis. Rewriting it as one of a linear axis with a
voltage command then changes nothing, which the tests of every room ask of its messages.
"""

import re

from emps_design.units import _RPM, _UNIT, Units

_NUMBER = r"[-+−]?(?:\d+\.?\d*|\.\d+)(?:e[-+−]?\d+)?"
_QUANTITY = re.compile(rf"(?<![\w.])({_NUMBER}(?:(?: \+- | ± | to |–|, | and ){_NUMBER})*) ({_UNIT})")
_BEFORE = r"(?<=[\])] )|(?<=unbounded )|(?<=per )|(?<=\bin )"
_AFTER = re.compile(rf"(?:{_BEFORE}|(?<=, )(?={_UNIT}$)|^(?={_UNIT}(?:$| rms)))({_UNIT})")
# Not prose: drawings, styles, code, text of others and quotations, tags, arguments and commands.
_CODE = re.compile(
    r"(<svg\b.*?</svg>|<style\b.*?</style>|<pre\b.*?</pre>|<code\b.*?</code>"
    r"|(?<!\w)'[^'\n]{1,80}'(?!\w)|<span translate=\"no\">.*?</span>|</?[a-z][^<>]*>"
    r"|\x60[^\x60]*\x60|emps-design \w+)",
    re.DOTALL,
)


def rewritten(units: Units, text: str) -> str:
    """``text`` of a linear axis in the words of another, with numbers in its units.

    >>> rewritten(Units("rotary", "current", "A"), "force error 1.20 N rms, below 12 mm/s; at most 10.0 V")
    'torque error 1.20 N m rms, below 0.69 deg/s; at most 10.0 A'
    >>> rewritten(Units(command="torque", command_unit="%"), "12.3 mV of noise, mass 60.5 kg")
    '0.0123 % of noise, mass 60.5 kg'
    """
    if units.plain:
        return text
    return "".join(part if i % 2 else _prose(units, part) for i, part in enumerate(_CODE.split(text)))


def _prose(units: Units, text: str) -> str:
    if re.fullmatch(_UNIT, text):
        return units._with_prefix(text)
    text = _QUANTITY.sub(lambda match: _quantity(units, match), text)
    text = _AFTER.sub(lambda match: units._with_prefix(match[1]), text)
    return units.label(text)


def _quantity(units: Units, match: re.Match[str]) -> str:
    numbers, base = match[1], match[2]
    unit, factor = units.read(base)
    if factor != 1.0:
        numbers = re.sub(_NUMBER, lambda number: _scaled(number[0], factor), numbers)
    turning = units.rotary and base == "m/s" and re.fullmatch(_NUMBER, numbers)
    rpm = f" ({_scaled(numbers, 1.0 / _RPM)} rpm)" if turning and abs(_float(numbers)) >= 0.1 else ""
    return f"{numbers} {unit}".rstrip() + rpm


def _float(number: str) -> float:
    return float(number.replace("−", "-"))


def _scaled(number: str, factor: float) -> str:
    """``number`` times ``factor`` as text, with the same number of significant digits, at least two."""
    digits = len(re.sub(r"e.*|[^\d]", "", number).lstrip("0"))
    value = _float(number) * factor
    text = f"{value:.{max(2, digits)}g}"
    return text.replace("-", "−") if "−" in number else text
