"""Measured records: one check at the door, one reader per format."""

from emps_design.records.readers import read_record
from emps_design.records.record import Record

__all__ = ["Record", "read_record"]
