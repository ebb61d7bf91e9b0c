"""Where simulation and machine disagree: locate it, name the missing effect, add it, show the gap shrink."""

from emps_design.discrepancy.diagnose import diagnose
from emps_design.discrepancy.result import Diagnosis, Finding

__all__ = ["Diagnosis", "Finding", "diagnose"]
