"""External force from motor force and motion; used off-line and inside a loop."""

from __future__ import annotations

from typing import TYPE_CHECKING

from emps_design.exports import on_first_use

if TYPE_CHECKING:
    from emps_design.observer.external_force import (
        acting_voltage as acting_voltage,
        as_driven as as_driven,
        given_back as given_back,
        motor_force as motor_force,
        motor_share as motor_share,
        sampled_with as sampled_with,
    )
    from emps_design.observer.external_force import (
        DEFAULT_CUTOFF_HZ as DEFAULT_CUTOFF_HZ,
        REST_VELOCITY as REST_VELOCITY,
        ForceObserver as ForceObserver,
        OnlineObserver as OnlineObserver,
        SmallestForce as SmallestForce,
        effects_force as effects_force,
        force_from_current as force_from_current,
        left_out as left_out,
        model_force as model_force,
        observe_offline as observe_offline,
        observe_online as observe_online,
        smallest_observable_force as smallest_observable_force,
    )
    from emps_design.observer.kalman import (
        KalmanForceObserver as KalmanForceObserver,
        kalman_trade_off as kalman_trade_off,
    )
else:
    __getattr__, __dir__, __all__ = on_first_use(__name__)
