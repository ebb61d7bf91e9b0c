"""Write a controller as code into a folder: C99, Structured Text, units of FMI 3.0, JSON, with its proof."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.codegen.ahead import Ahead
from emps_design.codegen.block import Block
from emps_design.codegen.fmu import binary_for, in_fmu
from emps_design.codegen.operations import operations_of
from emps_design.codegen.pages import Files, block_name, hash_of
from emps_design.codegen.targets import in_c, in_json, in_st
from emps_design.codegen.vectors import Vectors, vectors_of
from emps_design.compensation.feedforward import FeedForward, terms_of
from emps_design.compensation.study import digest_of
from emps_design.control.loop.sampled_loop import axis_loop
from emps_design.errors import AxisError, InputError, UnstableError
from emps_design.files import write_text, write_together
from emps_design.laws.drives import drive_settings, gains_of

if TYPE_CHECKING:
    from pathlib import Path

    from emps_design.axis import Axis

UNTOLD = "whether the loop is stable was not checked: the law is not linear while the carriage slides"
NOTHING_KEPT = "the compensation keeps no term: the law alone was written"
LEAST = float(np.finfo(np.float32).tiny)  # speed that single precision divides by
NO_COMPILER = "no C compiler was found: the units hold their source alone, for the importing tool to compile"


@dataclass(frozen=True)
class Exported:
    """What was exported: the ``files`` by name with their text, and the ``vectors`` they were proved with.

    ``checked``: whether the loop was found stable; ``bare``: a compensation was given, and keeps nothing.
    """

    name: str
    target: str
    block: Block
    vectors: Vectors = field(repr=False)
    files: Files = field(repr=False)
    checked: bool = True
    bare: bool = False

    def write(self, folder: Path) -> None:
        """Write the files into ``folder``, which exists, all of them or none."""
        with write_together(folder) as aside:
            for name, text in self.files.items():
                write_text(aside / name, text) if isinstance(text, str) else (aside / name).write_bytes(text)

    def to_dict(self) -> dict[str, Any]:
        """Names of the files and what the vectors are."""
        bound = [one for one in self.vectors.bound.tolist() if math.isfinite(one)]
        return {
            "name": self.name,
            "target": self.target,
            "axis": self.block.axis.name,
            "law": self.block.kind.name,
            "compensation": list(self.block.ahead.feedforward.terms) if self.block.ahead is not None else [],
            "files": list(self.files),
            "sha256": {name: hash_of(text) for name, text in self.files.items()},
            "vectors": {
                "rows": int(self.vectors.q.size),
                "inputs": list(self.vectors.titles),
                "states": int(self.vectors.answers[1].shape[1]),
                "single_precision_bound": max(bound, default=None),
                "rows_without_bound": int(self.vectors.q.size - len(bound)),
                "rows_that_rounding_decides": int(self.vectors.undecided.sum()),
            },
            "operations": operations_of(self.block),
            "drives": drive_settings(self.block.axis, {} if self.block.observes else gains_of(self.block.axis)),
            "units": {"single_precision_bound": self.block.axis.units.unit("N" if self.block.observes else "V")},
            "binary": (binary_for() or None) if self.target == "fmu" else None,
            "warnings": [UNTOLD] * (not self.checked)
            + [NOTHING_KEPT] * self.bare
            + [NO_COMPILER] * (self.target == "fmu" and not binary_for()),
        }


def export_observer(axis: Axis, target: str, cutoff_hz: float, origin: str = "") -> Exported:
    """Return the on-line force observer of ``axis``, low-passed at ``cutoff_hz``, as the files of a ``target``.

    Any target but ``fmu``; the page says the ``origin`` of the axis. Raises :class:`InputError` for that target, for
    another, and for effects that have a part in the force.

    >>> from emps_design.machines import machine
    >>> list(export_observer(machine("emps2018"), "st", 20.0).files)
    ['emps2018_observer.st', 'emps2018_observer.toml', 'vectors.csv', 'README.md']
    """
    possible = [name for name in TARGETS if name != "fmu"]
    if target not in possible:
        raise InputError(f"`target`: found {target!r} for an observer, expected one of {', '.join(possible)}")
    block, name = replace(Block.observer(axis, cutoff_hz), origin=origin), block_name(f"{axis.name} observer")
    vectors = vectors_of(block)
    return Exported(name, target, block, vectors, TARGETS[target](name, block, vectors))


def export_controller(
    axis: Axis, target: str, compensation: Mapping[str, Any] | None = None, origin: str = ""
) -> Exported:
    """Return the controller of ``axis`` as the files of a ``target``: one of ``TARGETS``.

    ``compensation`` is what :func:`~emps_design.compensation.compensate` found, as plain data; the page says the
    ``origin`` of the axis. The same axis gives the same bytes. Raises :class:`InputError` for another target, for an
    axis without a controller, for a law that has no translation and for a compensation of another axis, and
    :class:`UnstableError` for a controller whose loop on the axis is unstable.

    >>> from emps_design.machines import machine
    >>> list(export_controller(machine("emps2019"), "c").files)
    ['emps2019.c', 'emps2019.h', 'emps2019_check.c', 'Makefile', 'emps2019.toml', 'vectors.csv', 'README.md']
    """
    if target not in TARGETS:
        raise InputError(f"`target`: found {target!r}, expected one of {', '.join(TARGETS)}")
    block = replace(Block.of(axis, None if compensation is None else _ahead(axis, compensation)), origin=origin)
    checked = _checked(axis)
    name, vectors = block_name(axis.name), vectors_of(block)
    bare = compensation is not None and block.ahead is None
    return Exported(name, target, block, vectors, TARGETS[target](name, block, vectors), checked, bare)


def _checked(axis: Axis) -> bool:
    """Whether the loop of ``axis`` is stable; False where a law is not linear, :class:`UnstableError` where not."""
    try:
        loop = axis_loop(axis)
    except AxisError:
        return False
    if not loop.stable:
        raise UnstableError(
            f"axis {axis.name}: its loop is unstable, largest pole {loop.radius:.4g}: no code for a drive is written"
        )
    return True


def _ahead(axis: Axis, found: Mapping[str, Any]) -> Ahead | None:
    """The feed-forward of a ``compensation`` for this ``axis``, checked; None where nothing was worth it."""
    kept, reversal, taken = found.get("kept"), found.get("reversal"), found.get("law_taken_off")
    if not isinstance(kept, list) or not isinstance(reversal, int | float) or not isinstance(taken, bool):
        raise InputError("compensation: found no kept, reversal and law_taken_off, expected what compensate writes")
    speed = math.nan if isinstance(reversal, bool) else float(reversal)
    if not (math.isfinite(speed) and (speed == 0.0 or speed >= LEAST)):
        raise InputError(f"compensation: found a reversal of {speed:g}, expected a speed that compensate writes")
    unknown = [str(term) for term in kept if term not in terms_of(axis)[0]]
    if unknown or found.get("axis") != axis.name:
        raise InputError(
            f"compensation: found the terms {', '.join(map(str, kept))} of the axis {found.get('axis')}, expected "
            f"those of {axis.name}; run compensate on this axis"
        )
    if found.get("axis_sha256") != digest_of(axis):
        raise InputError(
            f"compensation: found one of {axis.name} with other numbers or another controller, expected one of this "
            "axis; run compensate on it"
        )
    if not kept:
        return None
    if not taken:
        raise InputError(
            "compensation: found one beside a law that answers on its own reference, expected one beside the law on "
            "its error; run compensate on this axis again"
        )
    return Ahead.of(replace(FeedForward.of(axis, kept), reversal=speed))


TARGETS: dict[str, Callable[[str, Block, Vectors], Files]] = {
    "c": in_c, "st": in_st, "fmu": in_fmu, "json": in_json,
}  # fmt: skip
