"""The model that is identified: the friction model of the paper, with terms beside it where a machine has more.

All parameters but two are linear. The angle of a weight and the exponent of a bent friction are not: the regression
holds their derivatives at a ``point`` near the solution and yields the difference from it. To first order the
statistics of linear regression hold for them too (delta method).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emps_design.axis import BASELINE, Axis
from emps_design.effects import Motion, known_effects
from emps_design.effects.terms import ANGLE, BENT, GRAVITY, HIGHEST, LOWEST, POWER, TERMS
from emps_design.errors import InputError, nearest_name
from emps_design.messages import Message, grave
from emps_design.quantities import Quantity
from emps_design.units import Units

MODELS: dict[str, tuple[Quantity, ...]] = {
    "symmetric": BASELINE,
    "asymmetric": (
        BASELINE[0],
        Quantity("viscous_positive", "F_v^+", "N/(m/s)", text="viscous friction, velocity > 0"),
        Quantity("viscous_negative", "F_v^-", "N/(m/s)", text="viscous friction, velocity < 0"),
        Quantity("coulomb_positive", "F_c^+", "N", text="Coulomb friction, velocity > 0"),
        Quantity("coulomb_negative", "F_c^-", "N", text="Coulomb friction, velocity < 0"),
    ),
}
# The symmetric model for motion in one direction, where Coulomb friction and constant force are one parameter.
ONE_WAY, LUMP = "one way", Quantity("coulomb_and_offset", "F_c0", "N", text="Coulomb friction and constant force")

# The friction parameters of all models.
FRICTION = tuple(f"{kind}{way}" for kind in ("viscous", "coulomb") for way in ("", "_positive", "_negative"))


def lumped(units: Units) -> Message:
    """The message that motion one way does not separate Coulomb friction from a constant force."""
    text = (
        f"coulomb, constant_force are not determined: the motion has one direction only, in which both are one "
        f"{units.word('force')}, {LUMP.name}; record the other direction too and give both records"
    )
    return grave("one-way", text)


def parameters_of(model: str) -> tuple[Quantity, ...]:
    """The parameters of the friction ``model``; :class:`InputError` names the nearest model otherwise."""
    if model == ONE_WAY:
        return (*MODELS["symmetric"][:2], LUMP)
    if model not in MODELS:
        raise InputError(f"model: found {model!r}, expected {' or '.join(MODELS)}{nearest_name(model, list(MODELS))}")
    return MODELS[model]


@dataclass(frozen=True)
class Model:
    """The model of an identification: its ``friction`` and the ``terms`` beside it.

    ``point`` holds the values of :attr:`names` around which the model is linearised. Only nonlinear terms need it; it
    is empty until known.

    >>> Model("symmetric", ("gravity",)).names
    ('mass', 'viscous', 'coulomb', 'constant_force', 'gravity_torque', 'gravity_angle')
    """

    friction: str = "symmetric"
    terms: tuple[str, ...] = ()
    point: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, model: str | Model) -> Model:
        """``model``, or the friction model of that name."""
        return model if isinstance(model, Model) else cls(model)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """The parameters, in the order of the columns."""
        beside = [quantity for term in self.terms for quantity in TERMS[term].quantities]
        own = parameters_of(self.friction)
        if BENT in self.terms:
            own = tuple(replace(written, unit="N/(m/s)^n") if written.name == "viscous" else written for written in own)
        return (*own, *beside)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters."""
        return tuple(quantity.name for quantity in self.quantities)

    @property
    def curved(self) -> np.ndarray:
        """Mask (p,) of the nonlinear parameters, which need a point to linearise around."""
        return np.array([name in (ANGLE.name, POWER.name) for name in self.names])

    def possible(self, value: np.ndarray) -> bool:
        """Whether a simulation may start from the solution ``value`` (p,): mass, friction and weight are positive."""
        p = self.natural(value)
        positive = all(p.get(name, 1.0) > 0.0 for name in ("mass", *FRICTION, "gravity_torque"))
        return positive and LOWEST <= p.get(POWER.name, 1.0) <= HIGHEST

    def columns(self, motion: Motion) -> Iterator[np.ndarray]:
        """Column (n,) after column of the regressor, in the order of :attr:`names` [N per unit of the parameter].

        >>> still = Motion(*(np.zeros(2) for _ in range(5)), period=1.0)
        >>> [column.tolist() for column in Model("symmetric", ("gravity",)).columns(still)][-2:]
        [[0.0, 0.0], [1.0, 1.0]]
        """
        start = self._start()
        torque, angle, power = start["gravity_torque"], start[ANGLE.name], start[POWER.name]
        for name in self.names:
            if name == "gravity_torque":
                yield motion.smooth(np.sin(motion.q + angle))
            elif name == ANGLE.name:
                yield torque * motion.smooth(np.cos(motion.q + angle))
            elif name == "viscous_difference":
                yield np.abs(motion.v)
            elif name == "viscous" and BENT in self.terms:
                yield powered(motion.v, power)
            elif name == POWER.name:
                logarithm = np.log(np.maximum(np.abs(motion.v), np.finfo(float).tiny))
                yield start["viscous"] * powered(motion.v, power) * logarithm
            else:
                yield column(motion, name)

    def natural(self, value: np.ndarray) -> dict[str, float]:
        """The parameters by name for the solution ``value`` (p,) of the linear regression."""
        start = self._start()
        point = np.array([start.get(name, 0.0) for name in self.names])
        return dict(zip(self.names, np.where(self.curved, value + point, value).tolist(), strict=True))

    def solution(self, parameters: Mapping[str, float]) -> np.ndarray:
        """The solution (p,) of the linear regression for ``parameters`` by name."""
        start = self._start()
        numbers = np.array([parameters[name] for name in self.names], dtype=float)
        return np.where(self.curved, numbers - np.array([start.get(name, 0.0) for name in self.names]), numbers)

    def around(self, value: np.ndarray) -> Model:
        """The model linearised around the solution ``value`` (p,) of the regression at its present point.

        For a weight the step is exact: a sine plus a cosine is a shifted sine, taken with positive torque.
        """
        p, start = self.natural(value), self._start()
        if GRAVITY in self.terms:
            sine, cosine = p["gravity_torque"], start["gravity_torque"] * (p[ANGLE.name] - start[ANGLE.name])
            angle = start[ANGLE.name] + float(np.arctan2(cosine, sine))
            p["gravity_torque"] = float(np.hypot(sine, cosine))
            p[ANGLE.name] = float(np.arctan2(np.sin(angle), np.cos(angle)))
        if BENT in self.terms:
            p[POWER.name] = float(np.clip(p[POWER.name], LOWEST, HIGHEST))
        return replace(self, point=p)

    def baseline(self, p: Mapping[str, float]) -> np.ndarray:
        """Mass, viscous, coulomb and constant force (4,) of the parameters ``p``; of both directions the means.

        A bent viscous friction does not count: that of the baseline is linear.

        >>> two = {"viscous_positive": 5.0, "viscous_negative": 3.0, "coulomb_positive": 8.0, "coulomb_negative": 6.0}
        >>> Model("asymmetric").baseline({"mass": 2.0, **two}).tolist()
        [2.0, 4.0, 7.0, 1.0]
        """
        if self.friction == "asymmetric":
            viscous = 0.5 * (p["viscous_positive"] + p["viscous_negative"])
            coulomb = 0.5 * (p["coulomb_positive"] + p["coulomb_negative"])
            return np.array([p["mass"], viscous, coulomb, 0.5 * (p["coulomb_positive"] - p["coulomb_negative"])])
        viscous = 0.0 if BENT in self.terms else p["viscous"]
        if self.friction == ONE_WAY:
            return np.array([p["mass"], viscous, p[LUMP.name], 0.0])
        return np.array([p["mass"], viscous, p["coulomb"], p["constant_force"]])

    def _start(self) -> Mapping[str, float]:
        return {"viscous": 0.0, "gravity_torque": 1.0, ANGLE.name: 0.0, POWER.name: 1.0, **self.point}


def powered(v: np.ndarray, power: float) -> np.ndarray:
    """``sign(v) |v|^power`` of velocities (n,).

    >>> powered(np.array([-4.0, 0.0, 9.0]), 0.5).tolist()
    [-2.0, 0.0, 3.0]
    """
    return np.sign(v) * np.abs(v) ** power


def column(motion: Motion, name: str) -> np.ndarray:
    """Regressor column (n,) of parameter ``name`` [N per unit of the parameter].

    >>> motion = Motion(*(np.array(x) for x in ([0.0, 1.0], [0.0, 0.0], [2.0, -3.0], [5.0, 7.0], [0.0, 0.0])), 1.0)
    >>> [column(motion, p.name).tolist() for p in MODELS["asymmetric"]][1:3]
    [[2.0, 0.0], [0.0, -3.0]]
    """
    v = motion.v
    if name == "mass":
        return motion.a
    if name == "viscous":
        return v
    if name == "viscous_positive":
        return np.where(v > 0, v, 0.0)
    if name == "viscous_negative":
        return np.where(v < 0, v, 0.0)
    # One byte per sign: small beside the columns of a long record.
    if name in ("coulomb", LUMP.name):
        return motion.smooth(np.sign(v).astype(np.int8))
    if name == "coulomb_positive":
        return motion.smooth((v > 0).astype(np.int8))
    if name == "coulomb_negative":
        return motion.smooth(-(v < 0).astype(np.int8))
    if name == "constant_force":
        return np.broadcast_to(1.0, len(v))
    raise InputError(f"column: found {name!r}, expected a parameter of {' or '.join(MODELS)}")


def baseline_columns(motion: Motion) -> np.ndarray:
    """Columns of mass, viscous, coulomb and constant force, shape (n, 4): ``columns @ b`` is the baseline's force.

    >>> still = Motion(*(np.zeros(3) for _ in range(5)), period=1.0)
    >>> baseline_columns(still)[0].tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    return np.column_stack(list(Model().columns(motion)))


def with_predicted_force(motion: Motion, baseline: np.ndarray) -> Motion:
    """Return ``motion`` with ``tau`` as the baseline array ``b`` (mass, viscous, coulomb, offset) predicts it."""
    return replace(motion, tau=baseline_columns(motion) @ np.asarray(baseline, dtype=float))


def known_part(axis: Axis, model: str | Model) -> Axis:
    """The axis without the effects that ``model`` identifies itself.

    >>> from emps_design.machines import machine
    >>> [len(known_part(machine("emps2018-two-quadrant"), model).effects) for model in ("symmetric", "asymmetric")]
    [1, 0]
    """
    own = _parts(model)
    return axis.replace(
        effects=[entry for entry in axis.effects if not own.intersection(entry.effect.estimation.identified_by)]
    )


def identified_effects(model: str | Model, p: Mapping[str, float]) -> list[dict[str, Any]]:
    """The effects that the parameters ``p`` of ``model`` describe, as tables of an axis.

    >>> identified_effects("asymmetric", {"viscous_positive": 5.0, "viscous_negative": 3.0})
    [{'kind': 'asymmetric_viscous_friction', 'viscous_difference': 1.0}]
    """
    own = _parts(model)
    return [
        {"kind": effect.name, **effect.estimation.identified_by[part](p)}
        for effect in known_effects().values()
        for part in effect.estimation.identified_by
        if part in own
    ]


def _parts(model: str | Model) -> set[str]:
    model = Model.of(model)
    return {model.friction, *model.terms}
