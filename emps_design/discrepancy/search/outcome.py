"""What the search, and the confirming record, leave for the words."""

from __future__ import annotations

from dataclasses import dataclass

from emps_design.discrepancy.checks.controller_law import LawCheck
from emps_design.discrepancy.model.problem import Problem
from emps_design.discrepancy.search.acceptance import Judge
from emps_design.discrepancy.search.beam_search import Search
from emps_design.discrepancy.search.noise_floor import Floor
from emps_design.discrepancy.search.null_distribution import Healthy
from emps_design.discrepancy.search.starts import Start
from emps_design.discrepancy.validation.gap import Asked
from emps_design.effects import Effect
from emps_design.records import Record


@dataclass(frozen=True)
class Work:
    """The problem, the rules, all fits, the noise, the checks of the law, the ``library`` of the plant."""

    problem: Problem
    judge: Judge
    found: Search
    floor: Floor
    checks: tuple[LawCheck, ...]
    healthy: Healthy
    screened: list[list[Start]]
    warnings: tuple[str, ...]
    library: tuple[Effect, ...] = ()
    holdout_law: LawCheck | None = None

    @property
    def unnamed_law(self) -> bool:
        """Whether the controller's law has a gap with structure that no effect explains."""
        return any(check.structured and check.effect is None for check in self.checks)


@dataclass(frozen=True)
class Confirmation:
    """What the confirming record did besides judging: the names it fitted anew, the effects it refuted, and what its
    own controller added: the effect's name, or that nothing explains it."""

    record: Record
    refitted: tuple[str, ...]
    refuted: tuple[Asked, ...]
    own: str = ""
    unnamed_law: bool = False
