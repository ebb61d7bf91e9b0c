"""Feed-forward of what the model knows, tried on the nonlinear machine within the uncertainty of its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

if TYPE_CHECKING:
    from emps_design.compensation.feedforward import FeedForward as FeedForward
    from emps_design.compensation.study import Compensation as Compensation, compensate as compensate
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
