"""The box with the advice on a result: the first on its page."""

from __future__ import annotations

from emps_design.advice import CAUTION, DO_NOT_RUN, SAFE, Advice
from emps_design.report.display import sentence_of
from emps_design.report.page import Callout, html

LEVELS = {SAFE: ("good", "Safe."), CAUTION: ("warning", "Caution."), DO_NOT_RUN: ("stop", "Do not run this.")}


def advice_callout(advice: Advice) -> Callout:
    """The box that says what to do with a result."""
    level, title = LEVELS[advice.level]
    further = (html("Next: <code>{}</code>", advice.next),) if advice.next else ()
    return Callout(level, title, sentence_of(advice.text), further)
