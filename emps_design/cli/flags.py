"""The arguments that the library's messages name, as the flags of this command line."""

from __future__ import annotations

import re

# The library writes an argument between backquotes, with or without a value: `chain='hold'`.
FLAGS = {
    "bootstrap": "--bootstrap",
    "confirm_time": "--confirm-time",
    "cutoff": "--cutoff",
    "cutoff_hz": "--cutoff",
    "design_on": "--design-on",
    "estimator": "--estimator",
    "external_force='known'": "--external-force known",
    "external_force=": "--external-force",
    "filter": "--filter",
    "fit_time": "--fit-time",
    "holdout": "--holdout",
    "identify": "--estimator ls",
    "mismatch": "--mismatch",
    "model": "--model",
    "peak": "--peak",
    "phase_deg": "--phase",
    "position_kp": "--position-kp",
    "rate": "--rate",
    "record": "--record",
    "retune": "--retune",
    "target": "--to",
    "window": "--time",
    "with_": "--with",
}
# A report identifies too; its own --filter is that of the impedance law.
FLAGS_OF = {
    "report": {
        "cutoff": "--cutoff of 'identify'",
        "external_force='known'": "--external-force known of 'identify'",
        "filter": "--record-filter",
        "with_": "--with of 'identify'",
    }
}


def in_flags(text: str, command: str = "") -> str:
    """Return ``text`` with every argument of the library as the flag of ``command`` that sets it.

    >>> in_flags("too slow for a cut-off; give `cutoff`, or use `filter='report'`")
    'too slow for a cut-off; give --cutoff, or use --filter report'
    >>> in_flags("use `filter='hold'`", "report")
    'use --record-filter hold'
    """
    flags = FLAGS | FLAGS_OF.get(command, {})

    def flag(argument: re.Match[str]) -> str:
        name, _, value = argument[1].partition("=")
        if argument[1] in flags:
            return flags[argument[1]]
        return f"{flags[name]} {value.strip(chr(39))}".rstrip() if name in flags else argument[0]

    return re.sub(r"`([^`]+)`", flag, text)
