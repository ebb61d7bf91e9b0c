"""Measured records: one reader per format, one check for all."""

from emps_design.records.readers import MAX_BYTES, MAX_BYTES_TO_CUT, read_record, record_from_bytes
from emps_design.records.record import Record

__all__ = ["MAX_BYTES", "MAX_BYTES_TO_CUT", "Record", "read_record", "record_from_bytes"]
