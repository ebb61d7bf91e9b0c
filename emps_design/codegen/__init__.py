"""Control laws as code for a drive, translated from the law's own kernel: C99, Structured Text, and proof with it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
