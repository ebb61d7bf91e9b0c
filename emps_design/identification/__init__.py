"""Parameters of an axis from records: filters, inverse model, statistics, estimators."""

import lazy_loader

from emps_design.identification.identify import identify as identify  # its module has the name too

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
