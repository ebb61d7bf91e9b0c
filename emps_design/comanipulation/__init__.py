"""A hand guides the carriage under an impedance law: tasks, measures, verdicts."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
