"""Parameters of an axis from records: filters, inverse model, statistics, estimators."""

from emps_design.identification.identify import Estimate, Identification, identify

__all__ = ["Estimate", "Identification", "identify"]
