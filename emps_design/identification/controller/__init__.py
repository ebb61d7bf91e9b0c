"""Which controller made a record: structure and gains from its reference, position and command alone."""

from emps_design.identification.controller.identify_law import identify_law
from emps_design.identification.controller.wording import AMBIGUOUS, NOT_TOLD, TOLD, LawEstimate

__all__ = ["AMBIGUOUS", "NOT_TOLD", "TOLD", "LawEstimate", "identify_law"]
