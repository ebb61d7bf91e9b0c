"""Effects: physics that the baseline ``M qdd + F_v qd + F_c sign(qd) + offset = tau`` lacks.

An effect acts on the plant through *hooks*, plain Python functions of numbers that are compiled when a simulation needs
them. All kernels except ``actuator`` and ``rate`` have the same arguments::

    kernel(q, v, t, tau, x, p, b) -> float

| argument | meaning | unit |
|---|---|---|
| ``q``, ``v`` | carriage position and velocity on the encoder's side | m, m/s |
| ``t`` | time since the first sample of the record | s |
| ``tau`` | acting motor force, after delay and lags (for a third lag: after the first two) | N |
| ``x`` | the states of the effect | as declared |
| ``p`` | its parameters, in the order of ``parameters`` | as declared |
| ``b`` | the baseline: mass, viscous, coulomb, offset (``b[0]`` to ``b[3]``) | kg, N/(m/s), N, N |

and the plant is, with ``sum`` over the effects of an axis,

    (M + sum inertia) dv/dt = tau - F_v v - offset - sum force - L S(v),   L = max(0, F_c + sum dry)

where S(v) is the set-valued sign: sign(v) in motion, any value in [-1, 1] at rest. At rest, ``dry`` gets a ``v`` close
to 0 with the sign of the sum of the other forces.

Sign convention: ``force`` is on the left-hand side of the inverse dynamic model, like the friction; a force that pushes
the carriage towards +q is returned as negative. Kernels use only ``math`` and one another, so that they can be
compiled. At its own ``jump_time`` a kernel returns the value after the jump: edges in time are compared with a
tolerance of ``SNAP``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.errors import AxisError, nearest_name
from emps_design.quantities import Quantity

if TYPE_CHECKING:
    import sympy

MASS, VISCOUS, COULOMB, OFFSET = range(4)  # places in the baseline array ``b``
CHECK_BASELINE = (100.0, 200.0, 20.0, -5.0)  # baseline of the hand-computed checks of every effect
REACH = 1000.0  # largest ratio of length, force or command to the ordinary axis for which parameters are accepted
SNAP = 1e-10  # s, tolerance of an edge in time, above the rounding error of the clock of a record

CHANNELS = ("controller", "actuator", "plant", "sensor")
VIEWS = ("v", "q", "t", "tau", "u", "loop", "step")
ADDED = ("force", "dry", "inertia")  # hooks that add force [N], dry friction [N] and mass [kg] to the axis
EVENTS = ("guard", "jump_time")  # hooks of the solver
SCALAR_HOOKS = (*ADDED, "command", "sensor", "delay", *EVENTS)

Kernel = Callable[..., float]
Parameters = Mapping[str, float]


@dataclass(frozen=True)
class Parameter(Quantity):
    """A parameter of an effect.

    ``linear``: a linear regression gives it, as the coefficient of a column or, together with others, through
    ``from_linear`` (amplitude and phase); the others are *shape* parameters. There are as many linear parameters as
    columns.
    ``per_record``: it belongs to one record (the phase of a ripple, the time of an event), not to the machine.
    ``starts``: starting values of a fit; a scan of a shape parameter uses them as its grid.
    ``scale``: a typical size, if the starts do not give one. ``discrete``: chosen among the starts, never refined.
    ``default``: the value if a file does not give one. A search tries the other starts once the effect is found and
    structure remains, and refines neither the default nor an end of the range. None: it must be given.
    ``allowed``: lowest and highest value in an axis file, if these differ from the bounds of a search.
    Starts, bounds and scale are those of an ordinary linear axis; :mod:`.sizes` scales them to another.
    """

    linear: bool = False
    per_record: bool = False
    starts: tuple[float, ...] = ()
    scale: float = 0.0
    discrete: bool = False
    default: float | None = None
    allowed: tuple[float, float] | None = None

    def held_at(self, values: np.ndarray) -> bool:
        """Whether a fit does not change ``values`` (n,): a discrete parameter, its default, or an end of its range."""
        if self.default is None:
            return self.discrete
        return self.discrete or bool(np.all(np.isin(values, (self.default, self.lower, self.upper))))

    def check(self, value: float) -> float:
        """Return ``value`` if it is within ``allowed``, or within bounds that are wider by ``REACH`` per dimension.

        Raises as :meth:`Quantity.check`.
        """
        if self.allowed is not None:
            return Quantity(self.name, self.symbol, self.unit, *self.allowed).check(value)
        sized = len(re.findall(r"\b[mNV]\b", self.unit))
        if self.discrete or not sized:
            return super().check(value)
        reach = REACH**sized  # N/m of a weak axis with a long stroke differs by both factors
        lower = self.lower / reach if self.lower > 0.0 else self.lower * reach
        return Quantity(self.name, self.symbol, self.unit, lower, self.upper * reach).check(value)


def kind_of(name: str) -> str:
    """The effect of which ``name`` is a numbered line, or ``name`` itself.

    >>> kind_of("position_ripple 2"), kind_of("backlash")
    ('position_ripple', 'backlash')
    """
    return name.partition(" ")[0]


@dataclass(frozen=True)
class Motion:
    """Motion of a record or a simulation for a regressor: all signals with the same filter, one row per sample.

    ``q`` [m], ``v`` [m/s], ``a`` [m/s^2], ``t`` [s]; ``tau`` [N] is the motor force predicted by a model, never the
    measured one, which would put the disturbance on both sides; ``voltage`` [V] is the recorded one; ``smooth`` is the
    zero-phase low-pass that was applied (to be applied to functions of ``q`` and ``t`` as well, so that both sides have
    the same filter); ``period`` [s]; ``force_gain`` G_tau [N/V], needed if a parameter is a voltage.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    period: float
    voltage: np.ndarray | None = None
    smooth: Callable[[np.ndarray], np.ndarray] = field(default=lambda signal: signal, repr=False)
    force_gain: float = math.nan

    def derivative(self, signal: np.ndarray) -> np.ndarray:
        """Time derivative of ``signal`` by central differences [unit of signal per s], same shape."""
        return np.gradient(signal, self.period)


@dataclass(frozen=True)
class Estimation:
    """Conversions between the parameters of an effect and those of an identification.

    ``to_linear``/``from_linear`` convert between parameters and the coefficients of the regressor's columns; by
    default the coefficients are the linear parameters themselves.
    ``identified_by``: for each model or term of ``identify`` that includes the effect, the function from its parameters
    to those of the effect.
    """

    to_linear: Callable[[Parameters], np.ndarray] | None = None
    from_linear: Callable[[np.ndarray, Parameters], dict[str, float]] | None = None
    identified_by: Mapping[str, Callable[[Parameters], dict[str, float]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Solver:
    """Properties of the hooks that a simulation uses: where they are not smooth, and which exact solution they have.

    ``guard``      changes sign where the kernels are not smooth (contact, play); located as an event
    ``jump_time``  s, ``jump_time(..., t, ...)``: the next instant after ``t`` at which a kernel jumps in time
    ``lag``        s, time constant: the effect is only a first-order lag of the motor force; ``force`` and ``rate``
                   must agree
    ``slopes``     ``slopes(p) -> (to +, to -)`` N/(m/s): the effect is only viscous friction by direction; ``force``
                   must agree; the impedance law can model it
    ``affine``     ``affine(p) -> (lower, upper)``: with these parameters ``force`` and ``rate`` are affine in ``q``,
                   ``v``, ``x`` while the first state is within that range [its unit], above it, or below it (infinite:
                   everywhere); they do not depend on ``t`` or ``tau``, and ``dry`` and ``inertia`` are constant. A
                   simulation then needs steps at events only. None: not affine
    ``by_travel``  True: the only state depends on the path: ``rate`` is proportional to ``v``, affine in ``x`` for each
                   direction, and otherwise depends on ``level`` only; ``force`` is proportional to ``x``
    """

    guard: Kernel | None = None
    jump_time: Kernel | None = None
    lag: Kernel | None = None
    slopes: Callable[[np.ndarray], tuple[float, float]] | None = None
    affine: Callable[[np.ndarray], tuple[float, float] | None] | None = None
    by_travel: bool = False


@dataclass(frozen=True)
class Search:
    """How a diagnosis looks for the effect.

    ``propose(motion, residual, b, away)`` takes the force residual (n,) [N] of the inverse model, valid where ``away``
    (n,) is True (away from reversals), and returns starting points for a fit: dicts of parameters, linear ones
    optional. None: every combination of the parameters' ``starts``.
    ``plausible(parameters, motion)`` returns whether fitted parameters still describe this effect on that motion: a
    stop that acts on most of the stroke is a spring, and a ripple longer than a third of it is not a ripple. None:
    always.
    ``confused_with``: names of similar effects.
    ``general``: a curve of any shape, which could imitate other physics: tried after all other effects.
    ``element``: one of several whose sum has any shape; if an unknown effect is present, it may be part of that.
    ``lines``: how many of it, of different shape, one machine may have; ``after`` is the name of the previous one.
    """

    propose: Callable[..., list[dict[str, float]]] | None = None
    plausible: Callable[[Parameters, Motion], bool] | None = None
    confused_with: tuple[str, ...] = ()
    general: bool = False
    element: bool = False
    lines: int = 1
    after: str = ""


@dataclass(frozen=True)
class Words:
    """Texts for the user: ``where`` a record shows the effect, the ``experiment`` that separates it from others, and
    the ``remedy``."""

    where: str = ""
    experiment: str = ""
    remedy: str = ""


@dataclass(frozen=True)
class Claims:
    """Properties of the kernels that the contract tests check.

    ``parity``: of the contribution in ``v``, "odd", "even" or "" for neither.
    ``passive``: over a closed motion, from rest to rest, the effect does not deliver work.
    """

    parity: str = ""
    passive: bool = False


@dataclass(frozen=True)
class Effect:
    """One physical effect: its physics, and groups of data for identification, solver, search and reader.

    ``channel`` is where it acts; ``motion`` is "rotary" for effects of rotary axes only, else "".

    Hooks (None: the effect does not act there):

    ``force``      N, opposes motion like friction does, continuous in ``v`` at 0
    ``dry``        N, added to the Coulomb level that multiplies the set-valued sign
    ``inertia``    kg, added to the mass on the encoder's side
    ``command``    V, added to the controller's output (the recorded ``u`` contains it)
    ``actuator``   ``actuator(u, p) -> V``, static map from the recorded to the acting voltage
    ``delay``      s, between the recorded and the acting voltage
    ``sensor``     m, added to the position that the encoder reports
    ``rate``       ``rate(q, v, t, tau, x, p, b, level, dx)`` fills ``dx`` with the derivative of the ``states``;
                   ``level`` is the present Coulomb level L [N]
    ``initial``    ``initial(q0, p, b) -> tuple`` states at rest at ``q0``. None: all 0

    Further properties:

    ``takes_dry``  True: ``rate`` and ``force`` replace the set-valued friction (presliding)
    ``winding``    True: the ``slopes`` are zero while the winding is open, and other effects see the motor force minus
                   this braking. A search needs a record with the motor switched off for some time
    ``play``       the parameter [m] that is the width of a gap within which no force is transmitted
    ``repeats``    the parameter [m] that is the period in position; the mean slope over position is then zero
    ``over``       the variable it depends on: "v", "q", "t", "tau", "u", a "loop" of position, or after a "step"

    ``regressor(motion, shape, b)`` returns the columns, shape (n_samples, n_linear) [N per unit of the coefficient],
    of the extra force on the left-hand side of the inverse dynamic model; None if measured signals determine no column,
    as with states, and no parameter is linear.
    ``expression(q, v, t, tau, p, b)`` is the SymPy form of :meth:`contribution` (``tau`` is the voltage in a static
    actuator map); None if states are needed.
    ``checks``: points computed by hand for ``CHECK_BASELINE``, (parameters, arguments of :meth:`contribution`, value).
    """

    name: str
    label: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    channel: str = "plant"
    motion: str = ""
    force: Kernel | None = None
    dry: Kernel | None = None
    inertia: Kernel | None = None
    command: Kernel | None = None
    actuator: Kernel | None = None
    delay: Kernel | None = None
    sensor: Kernel | None = None
    states: tuple[Quantity, ...] = ()
    rate: Callable[..., None] | None = None
    initial: Callable[..., tuple[float, ...]] | None = None
    takes_dry: bool = False
    winding: bool = False
    play: str = ""
    repeats: str = ""
    over: str = "v"
    regressor: Callable[[Motion, Parameters, np.ndarray], np.ndarray] | None = None
    expression: Callable[..., sympy.Expr] | None = None
    estimation: Estimation = Estimation()
    solver: Solver = Solver()
    search: Search = Search()
    words: Words = Words()
    claims: Claims = Claims()
    checks: tuple[tuple[dict[str, float], dict[str, Any], float], ...] = ()

    def __post_init__(self) -> None:
        if self.channel not in CHANNELS:
            raise AxisError(f"effect {self.name}: channel {self.channel!r}, expected one of {', '.join(CHANNELS)}")
        if self.over not in VIEWS:
            raise AxisError(f"effect {self.name}: over {self.over!r}, expected one of {', '.join(VIEWS)}")
        if (self.regressor is None) != (not self.linear):
            raise AxisError(f"effect {self.name}: expected both a regressor and linear parameters, or neither")
        if (self.rate is None) != (not self.states):
            raise AxisError(f"effect {self.name}: expected both states and a rate, or neither")
        if self.solver.by_travel and (len(self.states) != 1 or self.force is None):
            raise AxisError(f"effect {self.name}: by_travel needs exactly one state and a force")
        names = [p.name for p in self.parameters]
        for length in filter(None, (self.play, self.repeats)):
            if length not in names:
                raise AxisError(
                    f"effect {self.name}: found no parameter {length!r}, expected one of {', '.join(names)}"
                )

    def acts_on(self, motion: str) -> bool:
        """Whether an axis of this ``motion``, "linear" or "rotary", can have the effect."""
        return self.motion in ("", motion)

    def confusable(self, other: Effect) -> bool:
        """Whether either of this effect and ``other`` names the other in ``confused_with``."""
        return other.name in self.search.confused_with or self.name in other.search.confused_with

    def several(self) -> tuple[Effect, ...]:
        """Return the effect and its further lines, numbered.

        >>> from emps_design.effects import get_effect
        >>> [line.name for line in get_effect("position_ripple").several()][:2]
        ['position_ripple', 'position_ripple 2']
        """
        effects = [self]
        for number in range(2, self.search.lines + 1):
            name, label = f"{self.name} {number}", f"{self.label}, line {number}"
            effects.append(replace(self, name=name, label=label, search=replace(self.search, after=effects[-1].name)))
        return tuple(effects)

    @property
    def linear(self) -> tuple[str, ...]:
        """Names of the linear parameters, one for each column of the regressor."""
        return tuple(p.name for p in self.parameters if p.linear)

    @property
    def shape(self) -> tuple[str, ...]:
        """Names of the shape parameters, which are not linear."""
        return tuple(p.name for p in self.parameters if not p.linear)

    def place(self, name: str) -> int:
        """The index of the parameter ``name``."""
        return [p.name for p in self.parameters].index(name)

    def hook(self, name: str) -> Callable[..., Any] | None:
        """The hook ``name``, of the physics or of the solver."""
        return getattr(self.solver if name in EVENTS else self, name)

    def at_rest(self, q0: float, p: np.ndarray, b: np.ndarray) -> np.ndarray:
        """The states at rest at ``q0`` [m]."""
        return np.zeros(len(self.states)) if self.initial is None else np.array(self.initial(q0, p, b), dtype=float)

    def completed(self, parameters: Parameters) -> dict[str, float]:
        """``parameters`` with the defaults of missing ones."""
        defaults = {p.name: p.default for p in self.parameters if p.default is not None and p.name not in parameters}
        return {**parameters, **defaults}

    def values(self, parameters: Parameters) -> np.ndarray:
        """Return ``parameters`` as the array ``p`` of the kernels.

        Raises :class:`AxisError` for unknown, missing or impossible ones.
        """
        parameters = self.completed(parameters)
        known = [p.name for p in self.parameters]
        for name in parameters:
            if name not in known:
                raise AxisError(
                    f"effect {self.name}: unknown parameter {name!r}{nearest_name(name, known)} "
                    f"(has {', '.join(known)})"
                )
        missing = [name for name in known if name not in parameters]
        if missing:
            raise AxisError(f"effect {self.name}: missing parameter {', '.join(missing)}")
        return np.array([p.check(parameters[p.name]) for p in self.parameters])

    def contribution(
        self,
        parameters: Parameters,
        b: np.ndarray,
        *,
        q: float = 0.0,
        v: float = 0.0,
        t: float = 0.0,
        tau: float = 0.0,
        u: float = 0.0,
        x: tuple[float, ...] = (),
    ) -> float:
        """Return the contribution of the effect at one point of the motion, in the unit of its channel.

        Plant and dynamic actuator: extra force [N] on the left-hand side, ``force + dry sign(v)``, or the added mass
        [kg] if that is all. Static actuator map: acting voltage [V] for ``u``. Otherwise the added voltage [V], the
        delay [s] or the error of the sensor [m].

        >>> from emps_design.effects import get_effect
        >>> get_effect("nonlinear_viscous_friction").contribution({"amount": 9.0, "exponent": 1.0}, np.zeros(4), v=-0.1)
        -9.0
        """
        p = self.values(parameters)
        if self.actuator is not None:
            return float(self.actuator(u, p))
        point = (q, v, t, tau, x, p, b)
        if self.force is None and self.dry is None:
            hook = self.inertia or self.command or self.sensor or self.delay
            if hook is None:
                raise AxisError(
                    f"effect {self.name}: found no hook, expected at least one of {', '.join(SCALAR_HOOKS)}"
                )
            return float(hook(*point))
        total = self.force(*point) if self.force is not None else 0.0
        if self.dry is not None:
            total += self.dry(*point) * float(np.sign(v))
        return float(total)

    def coefficients(self, parameters: Parameters) -> np.ndarray:
        """Coefficients of the regressor's columns for ``parameters``."""
        if self.estimation.to_linear is not None:
            return np.asarray(self.estimation.to_linear(parameters), dtype=float)
        return np.array([parameters[name] for name in self.linear])

    def from_coefficients(self, coefficients: np.ndarray, shape: Parameters) -> dict[str, float]:
        """Parameters for the regressor's ``coefficients`` and the given ``shape`` parameters."""
        if self.estimation.from_linear is not None:
            return self.estimation.from_linear(coefficients, shape)
        return {**dict(zip(self.linear, map(float, coefficients), strict=True)), **dict(shape)}

    def to_dict(self) -> dict[str, Any]:
        """Texts, units and bounds as plain data, for catalogues and reports."""
        return {
            "name": self.name,
            "label": self.label,
            "channel": self.channel,
            "equation": self.equation,
            "source": self.source,
            "where": self.words.where,
            "confused_with": list(self.search.confused_with),
            "experiment": self.words.experiment,
            "remedy": self.words.remedy,
            "parameters": [
                {
                    "name": p.name,
                    "symbol": p.symbol,
                    "unit": p.unit,
                    "lower": p.lower if math.isfinite(p.lower) else None,
                    "upper": p.upper if math.isfinite(p.upper) else None,
                    "text": p.text,
                    "linear": p.linear,
                    "per_record": p.per_record,
                }
                for p in self.parameters
            ],
        }
