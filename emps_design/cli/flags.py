"""The arguments that the library's messages name, as the flags of this command line."""

from __future__ import annotations

import re

# The library writes an argument between backquotes, with or without a value: `chain='hold'`.
FLAGS = {
    "bootstrap": "--bootstrap",
    "chain": "--filter",
    "confirm_time": "--confirm-time",
    "cutoff_hz": "--cutoff",
    "design_on": "--design-on",
    "external_force_known=True": "--external-force known",
    "fit_time": "--fit-time",
    "identify": "--estimator ls",
    "mismatch": "--mismatch",
    "peak": "--peak",
    "phase_deg": "--phase",
    "record": "--record",
    "retune": "--retune",
    "target": "--to",
    "window": "--time",
}


def in_flags(text: str) -> str:
    """Return ``text`` with every argument of the library as the flag that sets it.

    >>> in_flags("too slow for a cut-off; give `cutoff_hz`, or use `chain='report'`")
    'too slow for a cut-off; give --cutoff, or use --filter report'
    """
    return re.sub(r"`([^`]+)`", _flag, text)


def _flag(argument: re.Match[str]) -> str:
    name, _, value = argument[1].partition("=")
    if argument[1] in FLAGS:
        return FLAGS[argument[1]]
    return f"{FLAGS[name]} {value.strip(chr(39))}".rstrip() if name in FLAGS else argument[0]
