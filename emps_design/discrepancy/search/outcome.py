"""What a search found, on what it was judged by, and what it tried besides."""

from __future__ import annotations

from dataclasses import dataclass, field

from emps_design.discrepancy import rules
from emps_design.discrepancy.model.fit import Fit
from emps_design.discrepancy.model.unknown_force import Kind
from emps_design.discrepancy.search.calibration import Calibration

FitsBySet = dict[frozenset[str], Fit]


def set_of(fitted: Fit) -> frozenset[str]:
    """The effects of ``fitted``, whatever their order."""
    return frozenset(fitted.model.names)


@dataclass(frozen=True)
class Outcome:
    """The ``path`` of best models, baseline first, found under a ``calibration``.

    ``tried`` are all admissible models fitted in full, by their sets of effects; ``alone`` is what each effect gained
    alone in the first round [whitened cost]; ``interrupted``: by the user, before the search had ended; ``warnings``
    are those of this search and of the ones that it took the place of; ``of_a_kind`` is an unknown force that explains
    what a few effects leave, where there is one.
    """

    calibration: Calibration
    path: tuple[Fit, ...]
    tried: FitsBySet = field(repr=False)
    alone: dict[str, float] = field(default_factory=dict, repr=False)
    interrupted: bool = False
    warnings: tuple[str, ...] = ()
    of_a_kind: OfAKind | None = None

    @property
    def best(self) -> Fit:
        """The model accepted last."""
        return self.path[-1]

    @property
    def ended_early(self) -> bool:
        """Whether it was not gone on with, for an unknown force that explains what a few effects leave."""
        return self.of_a_kind is not None and self.of_a_kind.is_plain

    @property
    def stopped(self) -> bool:
        """Whether it stopped at an unknown force and is to be gone on with."""
        return self.of_a_kind is not None and not self.of_a_kind.is_plain


@dataclass(frozen=True)
class OfAKind:
    """An unknown force of one ``kind`` of ``unknown_force.KINDS``.

    ``outcome`` is that of a search beside it, and ``found`` its best model, maybe without effects, fitted to all of the
    records that may be used with the force in the loop: the two leave next to nothing of what the model ``start`` does.
    """

    kind: Kind
    start: Fit
    outcome: Outcome
    found: Fit

    @property
    def is_plain(self) -> bool:
        """Whether it explains so much, with few effects, that what else could be said would stand in for it.

        What takes many effects and a force may as well be effects only.
        """
        few = len(self.found.model.effects) - len(self.outcome.path[0].model.effects) <= rules.FEW_BESIDE
        return few and self.start.excess() >= rules.PLAIN * self.start.problem.samples("used")
