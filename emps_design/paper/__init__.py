"""The paper of 2018: its printed equations, their derivations, the errata, and section III on a virtual bench."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
