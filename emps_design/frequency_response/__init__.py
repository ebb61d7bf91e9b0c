"""Frequency responses from records: estimated in closed loop, with deviations; files of them; experiments for them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
