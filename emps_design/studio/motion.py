"""What the motion tab runs: a motion of one's own under the design's cascade, beside the axis's own controller."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from emps_design.advice import SAFE, advise
from emps_design.errors import EmpsError, InputError
from emps_design.progress import Progress
from emps_design.report.advice import LEVELS
from emps_design.report.display import quantity, sentence_of
from emps_design.studio.state import State

if TYPE_CHECKING:
    from emps_design.axis import Axis
    from emps_design.control.position import PositionLoopDesign
    from emps_design.records import Record
    from emps_design.simulation.scenarios import Followed

DESIGN, OWN = "this design", "the axis's own controller"


@dataclass(frozen=True)
class Motion:
    """Runs along one reference by the names of their controllers; ``notes`` say what is not there, and why."""

    state: State
    about: str
    loop: PositionLoopDesign
    runs: dict[str, Followed]
    notes: tuple[str, ...]

    def verdict(self) -> tuple[str, str]:
        """How good it is, and the sentence that says it."""
        found, own = self.runs[DESIGN].to_dict(), self.runs.get(OWN)
        error, rate = found["tracking_error"], f"{self.loop.every}. " if self.loop.every > 1 else ""
        text = (
            f"{self.about}, kp {self.loop.kp:g} 1/s in every {rate}sample: tracking error "
            f"{quantity(error['rms'], 'm')} rms, {quantity(error['largest'], 'm')} at most"
        )
        clipped = found["saturated_share"]
        text = f"{text}; at the limit of the command {100.0 * clipped:.3g} %."
        if not self.loop.stable:
            return "stop", f"The cascade of this design is unstable. {text}"
        in_place = {} if own is None else own.to_dict()["tracking_error"]
        worse = any(error[name] > in_place[name] for name in ("rms", "largest") if in_place)
        if worse:
            text += (
                f" The axis's own controller follows more closely: {quantity(in_place['rms'], 'm')} rms, "
                f"{quantity(in_place['largest'], 'm')} at most."
            )
        advice = advise("simulate", found)
        if advice.level != SAFE:
            text = f"{sentence_of(advice.text)} {text}"
        return ("warning" if worse and advice.level == SAFE else LEVELS[advice.level][0]), text

    def rows(self) -> list[tuple[str, ...]]:
        """Numbers of each run, a row each, after the row of heads."""
        rows: list[tuple[str, ...]] = [
            ("", "error, rms", "error, largest", "velocity, largest", "command, largest", "at its limit")
        ]
        for name, found in self.runs.items():
            said = found.to_dict()
            error, most = said["tracking_error"], said["largest"]
            numbers = ((error["rms"], "m"), (error["largest"], "m"), (most["velocity"], "m/s"), (most["voltage"], "V"))
            share = f"{100.0 * said['saturated_share']:.3g} %"
            rows.append((name, *(quantity(value, unit) for value, unit in numbers), share))
        return rows


def design_loop(state: State) -> PositionLoopDesign:
    """The cascade of the design of ``state``: the position loop around it, at the rate that the axis has for it."""
    from emps_design.control.position import PositionLoopDesign
    from emps_design.studio.exports import velocity_design

    design = velocity_design(state)
    every = (state.axis.controller.position or {}).get("every", 1)
    computed = replace(design, structure=design.structure.as_computed)
    return PositionLoopDesign(computed, state.position_kp, every, {})


def design_axis(state: State, loop: PositionLoopDesign) -> Axis:
    """The axis of ``state`` under the cascade ``loop``, with the feed-forward that was chosen."""
    tables = {"of the axis": state.axis.controller.feedforward or {}, **loop.feedforwards}
    return loop.axis(**tables[state.feedforward])


def reference_of(
    state: State, file: tuple[str, bytes] | None, record: Record | None
) -> tuple[str, np.ndarray, np.ndarray | None]:
    """What the motion of ``state`` is in words, its positions (n,) [m], and a force (n,) [N] on the axis or None.

    ``file`` is a name and a content: columns t, q_ref, and f_ext where a force acts.
    """
    from emps_design.simulation.reference_file import reference_from_bytes
    from emps_design.simulation.synthetic import there_and_back

    period = state.axis.sampling.period
    if state.motion == "file":
        if file is None:
            raise InputError("motion: found no file, expected one with the columns t and q_ref")
        q_ref, f_ext, _ = reference_from_bytes(file[1], file[0], period, state.axis.units)
        return f"{file[0]}, straight between its rows", q_ref, f_ext
    if state.motion == "record":
        if record is None or not record.q_ref_recorded:
            raise InputError("motion: found no record with a reference, expected one in the data tab")
        recorded = record.t - record.t[0]
        t = np.arange(int(recorded[-1] / period * (1.0 + 1e-12)) + 1) * period
        return f"the reference of {record.name}", np.interp(t, recorded, record.q_ref), None
    way = there_and_back(period, state.stroke, state.speed, state.acceleration, state.pause)
    return "there and back", np.concatenate([np.zeros(round(state.pause / period)), way]), None


def move(state: State, file: tuple[str, bytes] | None, record: Record | None, progress: Progress) -> Motion:
    """Simulate the motion of ``state`` under the design, and under the axis's own controller where that follows it."""
    from emps_design.simulation.scenarios import follow
    from emps_design.studio.exports import follows

    about, q_ref, f_ext = reference_of(state, file, record)
    loop = design_loop(state)
    progress("the design", 0.1)
    runs, notes = {DESIGN: follow(design_axis(state, loop), q_ref, f_ext)}, []
    progress(OWN, 0.5)
    axis = state.axis
    try:
        if follows(axis) != "position":
            raise InputError(f"the axis's controller is {axis.controller.kind}, which follows no position")
        runs[OWN] = follow(axis, q_ref, f_ext)
    except EmpsError as error:
        notes.append(f"No second run: {error}.")
    progress("drawing", 0.9)
    return Motion(state, about, loop, runs, tuple(notes))
