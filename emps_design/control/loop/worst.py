"""The worst of several loops: a design is as good as that one, whichever loop and on whichever machine it is.

A velocity loop runs inside a position loop, both inside a drive, and all of them may have to hold over a range of
loads, under a mismatch of the model or on a plant that was measured. Each is one :class:`~.nested.NestedLoop`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from emps_design.advice.loops import SAFE_GAIN_MARGIN as SAFE_GAIN_MARGIN
from emps_design.advice.loops import SAFE_PHASE_MARGIN_DEG as SAFE_PHASE_MARGIN_DEG
from emps_design.advice.loops import where_in_words as where_in_words

if TYPE_CHECKING:
    from emps_design.control.loop.margins import Margins
    from emps_design.control.loop.nested import NestedLoop


def safety(margins: Margins) -> float:
    """Return the lesser of phase margin over 30 deg and gain margin in octaves: from 1 on a loop is safe.

    An unstable loop has minus infinity, one whose margins are both unbounded plus infinity.

    >>> from emps_design.control.loop.margins import Margins
    >>> safety(Margins(stable=True, phase_margin_deg=60.0, gain_margin=2.0)), safety(Margins(stable=False))
    (1.0, -inf)
    """
    if not margins.stable:
        return -math.inf
    phase, gain = margins.phase_margin_deg, margins.gain_margin
    return min(
        math.inf if phase is None else phase / SAFE_PHASE_MARGIN_DEG,
        math.inf if gain is None else math.log(gain) / math.log(SAFE_GAIN_MARGIN),
    )


def worst_loop(loops: Iterable[NestedLoop]) -> NestedLoop:
    """Return the one of ``loops``, at least one, with the least :func:`safety`; the first of those that are alike.

    So an unstable loop comes before any stable one, and of several unstable ones the first, which is the innermost.

    >>> from emps_design.control.loop.margins import Margins
    >>> from emps_design.control.loop.nested import NestedLoop
    >>> inner = NestedLoop("velocity loop", "plant input", Margins(stable=True, phase_margin_deg=60.0))
    >>> outer = NestedLoop("position loop", "position error", Margins(stable=True, phase_margin_deg=6.4))
    >>> worst_loop([inner, outer]).name
    'position loop'
    """
    return min(loops, key=lambda loop: safety(loop.margins))


def margins_in_words(margins: Margins) -> str:
    """Phase and gain margin of a stable loop.

    >>> from emps_design.control.loop.margins import Margins
    >>> margins_in_words(Margins(stable=True, phase_margin_deg=6.41, gain_margin=1.234))
    '6.4 deg of phase margin and a gain margin of 1.23'
    """
    phase = "unbounded" if margins.phase_margin_deg is None else f"{margins.phase_margin_deg:.1f} deg of"
    gain = "an unbounded gain margin" if margins.gain_margin is None else f"a gain margin of {margins.gain_margin:.3g}"
    return f"{phase} phase margin and {gain}"


def loop_in_words(loop: NestedLoop) -> str:
    """Name a loop and its machine.

    >>> from emps_design.control.loop.margins import Margins
    >>> from emps_design.control.loop.nested import NestedLoop
    >>> loop_in_words(NestedLoop("whole loop", "plant input", Margins(stable=False), {"inertia": 3.0}))
    'whole loop with 3 times the inertia'
    """
    return " ".join(filter(None, (loop.name, where_in_words(loop.where))))
