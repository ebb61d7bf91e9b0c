"""The controller on its own: does the recorded voltage follow the law of the axis file, computed from the record?

The law needs only ``q_ref`` and ``q``, both recorded, so a gap in its equation is seen here without any plant, and is
explained here and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from emps_design.axis import NO_LIMIT, Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.model.partition import START_UP
from emps_design.effects import Effect, Motion
from emps_design.errors import InputError
from emps_design.laws import get_law, law_of, unit_of
from emps_design.records import Record

BLOCK_TIME = 0.02  # s, of the means in which structure shows


@dataclass(frozen=True)
class LawCheck:
    """``gap`` (n,) [V] is u minus the law; ``noise`` [V] its deviation where nothing is wrong; ``structured`` says
    whether it is more than noise; ``addition`` is what explains it: an effect, and its parameters (n_parameters,)."""

    gap: np.ndarray
    noise: float
    structured: bool
    addition: tuple[Effect, np.ndarray] | None = None

    @property
    def added(self) -> str:
        """Name of the effect that the controller adds, or ""."""
        return "" if self.addition is None else self.addition[0].name

    @property
    def unexplained(self) -> bool:
        """Whether the controller does something that no effect explains."""
        return self.structured and self.addition is None


def check_law(record: Record, axis: Axis, library: tuple[Effect, ...]) -> LawCheck:
    """Check the law of ``axis`` on ``record`` and name a gap with one of the ``library``'s controller effects.

    Raises :class:`InputError` where the law holds nowhere: the axis file then has another controller than the drive.
    """
    limit = axis.drive.command_limit
    gap = record.u - law_voltage(record, axis)
    gap[:START_UP] = 0.0
    free = np.abs(record.u) < rules.AT_LIMIT * limit
    centre = np.median(np.abs(gap[free]))
    swing = float(np.std(record.u))
    low = float(np.quantile(np.abs(gap[free] - np.median(gap[free])), 0.25))
    if min(centre, low) > rules.LAW_HOLDS * swing:
        raise InputError(_wrong_law(record, axis, swing, float(np.std(gap))))
    noise = _noise(gap)
    width = max(2, round(BLOCK_TIME / record.period))
    blocks = gap[: gap.size // width * width].reshape(-1, width).mean(axis=1)
    varying = float(np.var(blocks)) * width > rules.LAW_STRUCTURE * noise**2
    if not (varying and float(np.std(blocks)) > rules.LAW_VISIBLE * swing):
        return LawCheck(gap, noise, False)
    proposed = [(effect, propose_command(effect, record, gap)) for effect in library if effect.channel == "controller"]
    additions = [(effect, values) for effect, values in proposed if values is not None]
    left = [float(np.var(gap - command_of(*addition, record))) for addition in additions]
    if not left or min(left) > (1 - rules.LAW_NAMED) * float(np.var(gap)):
        return LawCheck(gap, noise, True)
    return LawCheck(gap, noise, True, additions[left.index(min(left))])


def beside_the_law(record: Record, law: LawCheck | None) -> Record:
    """``record`` with what its controller does beside its ``law``, and no effect explains, as an excitation: known.

    The plant is then judged under the command that it got.
    """
    if law is None or not law.unexplained:
        return record
    return replace(record, excitation=law.gap + (0.0 if record.excitation is None else record.excitation))


def law_voltage(record: Record, axis: Axis) -> np.ndarray:
    """What the law of ``axis`` gives (n,) [V] for recorded reference and position, limited; 0 while switched off."""
    law = law_of(axis, record.period, record.extra)
    limit = axis.drive.command_limit
    voltage = law.commands(law.followed(record), record.q, limit, record.f_ext)
    added = 0.0 if record.excitation is None else record.excitation
    on = 1.0 if record.enable is None else record.enable != 0.0
    return np.clip(voltage + added, -limit, limit) * on


def propose_command(effect: Effect, record: Record, gap: np.ndarray) -> np.ndarray | None:
    """Parameters of a controller effect that explain ``gap`` (n,) [V] best, or None."""
    if effect.propose is None:
        return None
    nothing = np.zeros(len(record))
    motion = Motion(record.t, record.q, nothing, nothing, nothing, record.period, record.u)
    tried = []
    for table in effect.propose(motion, gap, np.zeros(4), np.ones(len(record), bool)):
        values = np.array([min(max(table[p.name], p.lower), p.upper) for p in effect.parameters])
        tried.append((float(np.var(gap - command_of(effect, values, record))), values))
    return min(tried, key=lambda pair: pair[0])[1] if tried else None


def command_of(effect: Effect, values: np.ndarray, record: Record) -> np.ndarray:
    """Voltage (n,) [V] that a controller effect adds over ``record``."""
    command, none = effect.command, np.zeros(0)
    if command is None:
        return np.zeros(len(record))
    return np.array(
        [command(q, 0.0, t, 0.0, none, values, np.zeros(4)) for t, q in zip(record.t, record.q, strict=True)]
    )


def _noise(gap: np.ndarray) -> float:
    """Deviation of white noise in ``gap``, from first differences, deaf to levels and edges."""
    return 1.4826 * float(np.median(np.abs(np.diff(gap)))) / np.sqrt(2) + 1e-9


def _wrong_law(record: Record, axis: Axis, swing: float, miss: float) -> str:
    """Say with which parameters the law of ``axis`` fits the record, where it does."""
    text = (
        f"{record.name}: the voltage follows the axis file's {axis.controller.kind} law nowhere "
        f"(misses it by {miss:.3g} V rms of {swing:.3g} V)"
    )
    kind = get_law(axis.controller.kind)
    if kind.propose is not None:
        wanted = np.where(np.arange(len(record)) < START_UP, np.nan, record.u)
        followed = law_of(axis, record.period, record.extra).followed(record)
        proposed = kind.propose(followed, record.q, wanted, axis.controller, record.period)
        if proposed is not None:
            free = axis.replace(controller=proposed, drive={"command_limit": NO_LIMIT})
            left = float(np.std((record.u - law_voltage(record, free))[START_UP:]))
            if left < rules.LAW_HOLDS * swing:
                fields = kind.table.model_fields
                fitting = " and ".join(f"{name} = {v:.5g} {unit_of(fields[name])}" for name, v in proposed.items())
                return f"{text}; {fitting} fit it, correct the axis file"
    from emps_design.identification.controller import TOLD, identify_law

    found = identify_law(record, axis.drive.command_unit)
    if found.verdict == TOLD:
        return f"{text}; {found.in_words} does and leaves {found.residual_rms:.3g}, correct the axis file"
    return f'{text}; give the controller that made this record, or kind = "none"'
