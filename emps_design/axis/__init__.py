"""The axis: what is known about one machine, in a TOML file and in Python."""

from emps_design.axis.axis import MAX_BYTES as MAX_BYTES
from emps_design.axis.axis import Axis as Axis
from emps_design.axis.axis import record_toml as record_toml
from emps_design.axis.tables import NO_LIMIT as NO_LIMIT
from emps_design.axis.tables import TABLES as TABLES
from emps_design.axis.tables import AxisEffect as AxisEffect
from emps_design.axis.tables import Controller as Controller
from emps_design.axis.tables import Drive as Drive
from emps_design.axis.tables import Mechanics as Mechanics
from emps_design.axis.tables import Sampling as Sampling
