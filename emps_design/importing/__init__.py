"""A drive's export read as an axis file says: columns, units, clock, and whether it can be of that axis."""

from emps_design.importing.read import import_bytes, import_record, layout_of

__all__ = ["import_bytes", "import_record", "layout_of"]
