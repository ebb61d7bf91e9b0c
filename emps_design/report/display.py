"""Numbers as a reader sees them: SI inside, display units at the border."""

from __future__ import annotations

import math
from html import escape
from typing import TypeGuard

from emps_design.quantities import display_unit

NOTHING = "—"


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


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """Return ``value`` with its unit, in ms, mm, mm/s or mV where it is below 1.

    >>> quantity(0.00845505, "s"), quantity(115.73, "kg"), quantity(None, "s")
    ('8.455 ms', '115.7 kg', '—')
    """
    if not _known(value):
        return NOTHING
    unit, factor = display_unit(value, unit)
    value = value * factor
    return f"{number(value, digits)} {unit}".rstrip()


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


def with_std(value: float | None, std: float | None, unit: str = "") -> str:
    """Return ``value ± std unit``, rounded to two digits of the standard deviation.

    >>> with_std(95.1089, 0.1085, "kg"), with_std(0.0081, 0.0004, "m/s"), with_std(3.0, None, "N")
    ('95.11 ± 0.11 kg', '8.10 ± 0.40 mm/s', '3.000 N')
    """
    if not _known(value):
        return NOTHING
    if not _known(std) or std <= 0:
        return quantity(value, unit)
    unit, factor = display_unit(value, unit)
    value, std = value * factor, std * factor
    places = max(0, 1 - math.floor(math.log10(std)))
    if places > 6:
        return f"{number(value, 6)} ± {number(std, 2)} {unit}".rstrip()
    return f"{value:.{places}f} ± {std:.{places}f} {unit}".rstrip().replace("-", "−")


def interval(value: float | None, std: float | None, unit: str = "") -> str:
    """Return the 95 % interval of a normal estimate, ``value`` ± 1.96 ``std``, with the digits that differ.

    >>> interval(95.1089, 0.1085, "kg"), interval(0.005, 1.5e-7, "m"), interval(1.0, 0.0)
    ('94.90 to 95.32 kg', '4.99971 to 5.00029 mm', '—')
    """
    if not _known(value) or not _known(std) or std <= 0:
        return NOTHING
    unit, factor = display_unit(value, unit)
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
