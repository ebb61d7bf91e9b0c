"""External force from motor force and motion; used off-line and inside a loop."""

from emps_design.observer.actuation import acting_voltage, motor_force, motor_share
from emps_design.observer.external_force import (
    DEFAULT_CUTOFF_HZ,
    REST_VELOCITY,
    ForceObserver,
    OnlineObserver,
    SmallestForce,
    effects_force,
    force_from_current,
    left_out,
    model_force,
    observe_offline,
    observe_online,
    smallest_observable_force,
)
from emps_design.observer.kalman import KalmanForceObserver, kalman_trade_off

__all__ = [
    "DEFAULT_CUTOFF_HZ",
    "REST_VELOCITY",
    "ForceObserver",
    "KalmanForceObserver",
    "OnlineObserver",
    "SmallestForce",
    "acting_voltage",
    "effects_force",
    "force_from_current",
    "kalman_trade_off",
    "left_out",
    "model_force",
    "motor_force",
    "motor_share",
    "observe_offline",
    "observe_online",
    "smallest_observable_force",
]
