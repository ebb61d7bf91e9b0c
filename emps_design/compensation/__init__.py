"""Feed-forward from the model, tested on the nonlinear machine within the uncertainty of its parameters."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
