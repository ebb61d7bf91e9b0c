"""The control laws this package knows, one file each, in the order they are listed."""

from emps_design.laws.law import LawKind
from emps_design.laws.library import impedance, ip_velocity, position_pd

LAWS: tuple[LawKind, ...] = (position_pd.LAW, ip_velocity.LAW, impedance.LAW)
