"""Parameters of an axis from records: filters, inverse model, statistics, estimators."""

from emps_design.identification.identify import identify
from emps_design.identification.result import Estimate, Identification

__all__ = ["Estimate", "Identification", "identify"]
