"""Readers of axes and records for the commands, and the request fields that take an axis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from emps_design.axis import Axis
from emps_design.records import Record
from emps_design.request import option


def read_axis(name_or_path: str | Path, axis: Axis | None = None) -> Axis:
    """The embedded machine or the axis file of that name; ``axis``, which every reader takes, is not used.

    >>> read_axis("emps2018").name
    'emps2018'
    """
    from emps_design.machines import load_axis

    return load_axis(name_or_path)


def read_record(path: str | Path, axis: Axis) -> Record:
    """The record at ``path``, read by the ``[record]`` table, the units and the period of ``axis``."""
    from emps_design.importing import import_record

    return import_record(Path(path), axis)


def axis_argument(default: Any, help: str = "TOML file or embedded machine") -> Any:
    """The axis as the argument of a command."""
    return option(default, help, argument=True, typed=str, read=read_axis)


def axis_option(help: str) -> Any:
    """The axis as an option of a command that takes records."""
    return option("emps2019", help, typed=str, read=read_axis)
