"""Control design for a one-axis electromechanical drive, from a measured record to gains and to the missing physics."""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
