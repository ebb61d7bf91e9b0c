"""Where simulation and machine disagree: locate it, name the missing effect, add it, show the gap shrink."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
