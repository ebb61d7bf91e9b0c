"""The control laws this package knows, one file each, in the order they are listed."""

from emps_design.laws.law import LawKind, PlantTables
from emps_design.laws.library import cascade, impedance, ip_velocity, p, position_pd

LAWS: tuple[LawKind[PlantTables], ...] = (position_pd.LAW, ip_velocity.LAW, impedance.LAW, cascade.LAW, p.LAW)
