"""Simulation of the nonlinear axis: exact where the physics is, event-driven everywhere."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
