"""Control laws as code, translated from the law's kernel: C99, Structured Text, FMI and JSON, with test vectors."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
