"""Design of velocity, force and impedance loops: gains, margins, sampled loops."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
