"""The axis: what is known about one machine, in a TOML file and in Python."""

from emps_design.axis.axis import MAX_BYTES as MAX_BYTES, Axis as Axis, record_toml as record_toml
from emps_design.axis.tables import (
    NO_LIMIT as NO_LIMIT,
    TABLES as TABLES,
    AxisEffect as AxisEffect,
    Controller as Controller,
    Drive as Drive,
    Mechanics as Mechanics,
    Sampling as Sampling,
)
