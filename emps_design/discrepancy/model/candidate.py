"""A candidate model: the baseline and a set of effects with their numbers, the free ones as one vector."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from emps_design.axis import Axis
from emps_design.effects import Effect, Parameter, kind_of
from emps_design.effects.effect import COULOMB, OFFSET
from emps_design.effects.sizes import sized_parameter
from emps_design.quantities import Quantity

# Of an ordinary axis; the scales are the least sizes by which a fit measures its steps.
BASELINE = (
    Parameter("mass", "M", "kg", lower=1e-6, scale=1.0),
    Parameter("viscous", "F_v", "N/(m/s)", lower=0.0, scale=10.0),
    Parameter("coulomb", "F_c", "N", lower=0.0, scale=1.0),
    Parameter("constant_force", "c", "N", scale=1.0),
)
LEAST_MASS = 0.01  # of the axis file's: with next to no mass the plant is all friction, and takes for ever to simulate


@dataclass(frozen=True)
class Slot:
    """Where one free number lives: ``effect`` -1 is the baseline; ``record`` None means shared by all records.

    ``magnitude`` is the size by which a fit measures its steps.
    """

    effect: int
    place: int
    record: int | None
    quantity: Quantity
    magnitude: float


@dataclass(frozen=True)
class Candidate:
    """Baseline (4,) and one array (n_records, n_parameters) per effect; rows differ in what belongs to one record.

    ``sizes`` are the bounds and least sizes of the baseline's numbers; those at the places ``held`` are never free.
    """

    baseline: np.ndarray
    effects: tuple[Effect, ...] = ()
    values: tuple[np.ndarray, ...] = ()
    sizes: tuple[Parameter, ...] = BASELINE
    held: tuple[int, ...] = ()

    @classmethod
    def of(cls, axis: Axis, factors: Mapping[str, float], held: tuple[int, ...] = ()) -> Candidate:
        """The baseline of ``axis``, sized by its ``factors`` of :func:`~emps_design.effects.sizes.sizes`."""
        _, *rest = (sized_parameter(parameter, factors) for parameter in BASELINE)
        least = LEAST_MASS * axis.mechanics.mass
        return cls(axis.mechanics.array(), sizes=(replace(BASELINE[0], lower=least, scale=least), *rest), held=held)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(effect.name for effect in self.effects)

    def with_effect(self, effect: Effect, values: np.ndarray) -> Candidate:
        """Add ``effect`` with parameters ``values`` (n_records, n_parameters)."""
        return replace(self, effects=(*self.effects, effect), values=(*self.values, np.atleast_2d(values)))

    def without(self, index: int) -> Candidate:
        """Drop effect number ``index``."""
        keep = [i for i in range(len(self.effects)) if i != index]
        return replace(self, effects=tuple(self.effects[i] for i in keep), values=tuple(self.values[i] for i in keep))

    def without_named(self, names: Iterable[str]) -> Candidate:
        """Drop the effects called ``names``."""
        model = self
        for name in names:
            model = model.without(model.names.index(name))
        return model

    def slots(self, frozen: bool = False) -> tuple[Slot, ...]:
        """The free numbers; with ``frozen`` only those that belong to a record.

        What acts on the controller's output is known from the controller's law alone and never free here.
        """
        slots = []
        if not frozen:
            # A constant force may have to grow to the size of the friction before a spring fits.
            magnitudes = np.maximum(np.abs(self.baseline), [parameter.scale for parameter in self.sizes])
            magnitudes[OFFSET] = max(magnitudes[OFFSET], self.baseline[COULOMB])
            numbers = enumerate(zip(self.sizes, magnitudes, strict=True))
            slots += [Slot(-1, i, None, q, s) for i, (q, s) in numbers if i not in self.held]
        for index, (effect, values) in enumerate(zip(self.effects, self.values, strict=True)):
            for place, parameter in enumerate(effect.parameters):
                held = parameter.held_at(values[:, place]) or (frozen and not parameter.per_record)
                if held or effect.channel == "controller":
                    continue
                rows = range(len(values)) if parameter.per_record else (None,)
                for row in rows:
                    value = abs(values[row or 0, place])
                    typical = parameter.scale or max((abs(s) for s in parameter.starts), default=0.0)
                    slots.append(Slot(index, place, row, parameter, max(value, 0.1 * typical, 1e-12)))
        return tuple(slots)

    def with_row(self, index: int, row: np.ndarray) -> Candidate:
        """The same model with parameters ``row`` (n_parameters,) of effect number ``index`` on one record."""
        values = [*self.values[:index], np.atleast_2d(row), *self.values[index + 1 :]]
        return replace(self, values=tuple(values))

    def only(self, record: int) -> Candidate:
        """The same model with the numbers of one record."""
        return replace(self, values=tuple(row[None] for row in self.parameters(record)))

    def vector(self, slots: tuple[Slot, ...]) -> np.ndarray:
        """The numbers in ``slots``."""
        return np.array(
            [self.baseline[s.place] if s.effect < 0 else self.values[s.effect][s.record or 0, s.place] for s in slots]
        )

    def with_vector(self, slots: tuple[Slot, ...], vector: np.ndarray) -> Candidate:
        """The same model with other numbers in ``slots``, each held within its bounds."""
        baseline, values = self.baseline.copy(), [v.copy() for v in self.values]
        for slot, number in zip(slots, vector, strict=True):
            held = min(max(float(number), slot.quantity.lower), slot.quantity.upper)
            if slot.effect < 0:
                baseline[slot.place] = held
            elif slot.record is None:
                values[slot.effect][:, slot.place] = held
            else:
                values[slot.effect][slot.record, slot.place] = held
        return replace(self, baseline=baseline, values=tuple(values))

    def parameters(self, record: int) -> tuple[np.ndarray, ...]:
        """Kernel parameters of ``record``, one array per effect."""
        return tuple(v[min(record, len(v) - 1)] for v in self.values)

    def to_axis(self, axis: Axis, record: int = 0) -> Axis:
        """``axis`` with this baseline and these effects as seen by ``record``."""
        mass, viscous, coulomb, offset = map(float, self.baseline)
        effects = [
            {"kind": kind_of(e.name), **{p.name: float(x) for p, x in zip(e.parameters, row, strict=True)}}
            for e, row in zip(self.effects, self.parameters(record), strict=True)
        ]
        return axis.replace(
            mechanics={"mass": mass, "viscous": viscous, "coulomb": coulomb, "offset": offset}, effects=effects
        )
