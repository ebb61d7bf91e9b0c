"""The paper of 2018: what it prints, the derivations, where they differ, and its section III on a virtual bench."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
