"""What an effect is: physics that the baseline ``M qdd + F_v qd + F_c sign(qd) + offset = tau`` lacks.

An effect joins the plant through *hooks*, plain Python functions of numbers that are compiled when a simulation needs
them. All kernels but ``actuator`` and ``rate`` share one argument list::

    kernel(q, v, t, tau, x, p, b) -> float

| argument | meaning | unit |
|---|---|---|
| ``q``, ``v`` | carriage position and velocity on the encoder's side | m, m/s |
| ``t`` | time since the record's first sample | s |
| ``tau`` | motor force that acts, behind delay and lags (of a third lag: what is behind the first two) | N |
| ``x`` | the effect's own states | as declared |
| ``p`` | its parameters, in the order of ``parameters`` | as declared |
| ``b`` | the baseline: mass, viscous, coulomb, offset (``b[0]`` to ``b[3]``) | kg, N/(m/s), N, N |

and the plant is, with ``sum`` over the effects of an axis,

    (M + sum inertia) dv/dt = tau - F_v v - offset - sum force - L S(v),   L = max(0, F_c + sum dry)

where S(v) is the set-valued sign: sign(v) in motion, anything in [-1, 1] at rest. There ``dry`` gets a ``v`` next to 0
of the direction in which the rest of the balance pushes.

Sign convention: ``force`` stands on the left-hand side of the inverse dynamic model, beside the friction; a force that
pushes the carriage towards +q is returned with a minus. Kernels use ``math`` and one another alone, so
that they compile as they stand. A kernel evaluated at its own ``jump_time`` gives the value after the jump:
edges are compared with ``SNAP`` to spare.
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
CHECK_BASELINE = (100.0, 200.0, 20.0, -5.0)  # the baseline of every effect's hand-computed checks
REACH = 1000.0  # times the ordinary axis in length, force or command, up to which an effect's numbers are taken
SNAP = 1e-10  # s, by which an edge in time is seen early, above the rounding of any record's clock

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

    ``linear``: a linear regression gives it, as the coefficient of a column or, with others, through ``from_linear``
    (amplitude and phase); the others are *shape* parameters. There are as many linear parameters as columns.
    ``per_record``: it belongs to one record (the phase of a ripple, the time of an event), not to the machine.
    ``starts``: values worth starting a fit from; a scan of a shape parameter uses them as its grid.
    ``scale``: a typical size, where the starts do not give one. ``discrete``: chosen among the starts, never refined.
    ``default``: what it is where a file does not give it, in the effect's first form; a search tries the other starts
    once the effect is found and structure is left, and refines neither the default nor an end of the range. None: it
    has to be given.
    ``allowed``: lowest and highest that an axis file may give, where the bounds are those of a search alone.
    Starts, bounds and scale are written for an ordinary linear axis; :mod:`.sizes` has those of another.
    """

    linear: bool = False
    per_record: bool = False
    starts: tuple[float, ...] = ()
    scale: float = 0.0
    discrete: bool = False
    default: float | None = None
    allowed: tuple[float, float] | None = None

    def held_at(self, values: np.ndarray) -> bool:
        """Whether a fit leaves ``values`` of the parameter (n,) as they are: a choice, or a form by itself."""
        if self.default is None:
            return self.discrete
        return self.discrete or bool(np.all(np.isin(values, (self.default, self.lower, self.upper))))

    def check(self, value: float) -> float:
        """As of any quantity, within what is ``allowed``, or for an axis up to ``REACH`` times larger or smaller than
        the ordinary one."""
        if self.allowed is not None:
            return Quantity(self.name, self.symbol, self.unit, *self.allowed).check(value)
        sized = len(re.findall(r"\b[mNV]\b", self.unit))
        if self.discrete or not sized:
            return super().check(value)
        reach = REACH**sized  # a weak axis with a long stroke: N/m differ by both
        lower = self.lower / reach if self.lower > 0.0 else self.lower * reach
        return Quantity(self.name, self.symbol, self.unit, lower, self.upper * reach).check(value)


def kind_of(name: str) -> str:
    """The effect that ``name`` is a line of, itself where it is no numbered one.

    >>> kind_of("position_ripple 2"), kind_of("backlash")
    ('position_ripple', 'backlash')
    """
    return name.partition(" ")[0]


@dataclass(frozen=True)
class Motion:
    """Motion of a record or a simulation as a regressor takes it: all signals filtered alike, one row per sample.

    ``q`` [m], ``v`` [m/s], ``a`` [m/s^2], ``t`` [s], ``tau`` [N] (motor force as a model predicts it, never measured:
    a measured one would put the disturbance on both sides), ``voltage`` [V] the recorded one, ``smooth`` the
    zero-phase low-pass that was applied (also to be applied to functions of ``q`` and ``t``, so that both sides are
    filtered alike), ``period`` [s], ``force_gain`` G_tau [N/V], needed where a parameter is a voltage.
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
        """Central difference of ``signal`` over time [unit of signal per s], shape kept."""
        return np.gradient(signal, self.period)


@dataclass(frozen=True)
class Estimation:
    """How an identification gives the parameters.

    ``to_linear``/``from_linear`` translate between parameters and the coefficients of the regressor's columns; by
    default the coefficients are the linear parameters themselves.
    ``identified_by``: for each model or term of ``identify`` that has the effect among its parameters, the function
    that takes those to the effect's own.
    """

    to_linear: Callable[[Parameters], np.ndarray] | None = None
    from_linear: Callable[[np.ndarray, Parameters], dict[str, float]] | None = None
    identified_by: Mapping[str, Callable[[Parameters], dict[str, float]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Solver:
    """What a simulation may know of the hooks: where they are not smooth, and which exact solution they have.

    ``guard``      changes sign where the kernels are not smooth (contact, play); located as an event
    ``jump_time``  s, ``jump_time(..., t, ...)``: the next instant after ``t`` at which a kernel jumps in time
    ``lag``        s, time constant: the effect is a first-order lag of the motor force and nothing else, as ``force``
                   and ``rate`` say too
    ``slopes``     ``slopes(p) -> (to +, to -)`` N/(m/s): the effect is viscous friction by direction and nothing else,
                   as ``force`` says too; the impedance law can model it
    ``affine``     ``affine(p) -> (lower, upper)``: with these parameters ``force`` and ``rate`` are affine in ``q``,
                   ``v``, ``x`` as long as the first own state is within that range [its unit], above it, or below it
                   (infinite: everywhere), and read neither ``t`` nor ``tau``, and ``dry`` and ``inertia`` never
                   change; a simulation steps events only. None: they are not
    ``by_travel``  True: the one own state is a memory of the path: ``rate`` is proportional to ``v``, affine in ``x``
                   for each direction, and reads only ``level`` besides; ``force`` is proportional to ``x``
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

    ``propose(motion, residual, b, away)`` looks at the force residual (n,) [N] of the inverse model, trusted where
    ``away`` (n,) is True (away from reversals), and returns starting points for a fit: dicts of parameters, in which
    linear ones may be left out. None: every combination of the parameters' ``starts``.
    ``plausible(parameters, motion)`` says whether fitted numbers still describe this effect on that motion: a stop that
    acts on most of the stroke is a spring, a ripple longer than a third of it is no ripple. None: they always do.
    ``confused_with``: names of the effects that look alike.
    ``general``: a curve of any shape, which could stand in for other physics: tried after all other effects.
    ``element``: one of several whose sum has any shape; with an unknown effect present it may be part of that.
    ``lines``: how many of it, of different shape, one machine may have; ``after`` is the name of the one before.
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
    """What to tell whoever has the effect: ``where`` a record shows it, the ``experiment`` that tells it from others,
    and the ``remedy``."""

    where: str = ""
    experiment: str = ""
    remedy: str = ""


@dataclass(frozen=True)
class Claims:
    """What the contract tests hold the kernels to.

    ``parity``: of the contribution in ``v``, "odd", "even" or "" for neither.
    ``passive``: over a motion that ends where it began, at rest, the effect never gives back more work than it took.
    """

    parity: str = ""
    passive: bool = False


@dataclass(frozen=True)
class Effect:
    """One physical effect: its physics, then in groups what an identification, a solver, a search and a reader ask.

    ``channel`` is where it acts; ``motion`` is "rotary" of what only an axis that turns has, "" of the others.

    Hooks (None: the effect does not act there):

    ``force``      N, opposes motion like friction does, continuous in ``v`` at 0
    ``dry``        N, added to the Coulomb level that multiplies the set-valued sign
    ``inertia``    kg, added to the mass on the encoder's side
    ``command``    V, added to the controller's output (the recorded ``u`` contains it)
    ``actuator``   ``actuator(u, p) -> V``, static map from the recorded voltage to the one that acts
    ``delay``      s, between the recorded voltage and the one that acts
    ``sensor``     m, added to the position that the encoder reports
    ``rate``       ``rate(q, v, t, tau, x, p, b, level, dx)`` fills ``dx`` with the derivative of the own ``states``;
                   ``level`` is the Coulomb level L of the moment [N]
    ``initial``    ``initial(q0, p, b) -> tuple`` own states at rest at ``q0``. None: all 0

    What else it is:

    ``takes_dry``  True: ``rate`` and ``force`` stand in for the set-valued friction (presliding)
    ``winding``    True: the ``slopes`` are gone where the winding is open, and other effects see the motor force less
                   what they brake. A search needs a record with the motor switched off for a while
    ``play``       the parameter [m] that is the width of a gap within which nothing is transmitted
    ``repeats``    the parameter [m] after which it repeats along the travel; its slope over position then averages out
    ``over``       the variable that it goes by: "v", "q", "t", "tau", "u", a "loop" of position, or after a "step"

    ``regressor(motion, shape, b)`` returns the columns, shape (n_samples, n_linear) [N per unit of the coefficient],
    of the extra force on the left-hand side of the inverse dynamic model; None where measured signals give no column,
    as of own states, and no parameter is linear.
    ``expression(q, v, t, tau, p, b)`` is the SymPy form of :meth:`contribution` (``tau`` stands for the voltage in a
    static actuator map); None where own states are needed.
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
            raise AxisError(f"effect {self.name}: a regressor and linear parameters come together")
        if (self.rate is None) != (not self.states):
            raise AxisError(f"effect {self.name}: states and rate come together")
        if self.solver.by_travel and (len(self.states) != 1 or self.force is None):
            raise AxisError(f"effect {self.name}: a memory of the path is one own state with a force")
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
        """Whether this effect and ``other`` are known to be confused, whichever of the two says so."""
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
        """Names of the parameters that a linear regression gives, one for each column."""
        return tuple(p.name for p in self.parameters if p.linear)

    @property
    def shape(self) -> tuple[str, ...]:
        """Names of the other parameters."""
        return tuple(p.name for p in self.parameters if not p.linear)

    def place(self, name: str) -> int:
        """The place of the parameter ``name`` among all."""
        return [p.name for p in self.parameters].index(name)

    def hook(self, name: str) -> Callable[..., Any] | None:
        """The hook ``name``, of the physics or of the solver."""
        return getattr(self.solver if name in EVENTS else self, name)

    def at_rest(self, q0: float, p: np.ndarray, b: np.ndarray) -> np.ndarray:
        """The own states at rest at ``q0`` [m]."""
        return np.zeros(len(self.states)) if self.initial is None else np.array(self.initial(q0, p, b), dtype=float)

    def completed(self, parameters: Parameters) -> dict[str, float]:
        """``parameters`` with the defaults of those that are not given."""
        defaults = {p.name: p.default for p in self.parameters if p.default is not None and p.name not in parameters}
        return {**parameters, **defaults}

    def values(self, parameters: Parameters) -> np.ndarray:
        """Return ``parameters`` as the array ``p`` of the kernels; unknown, missing or impossible ones are refused."""
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
        """Return what the effect does at one point of the motion, in the unit of its channel.

        Plant and dynamic actuator: extra force [N] on the left-hand side, ``force + dry sign(v)``, or the added mass
        [kg] where there is only that. Static actuator map: voltage that acts [V] for ``u``. Otherwise the voltage
        added [V], the delay [s] or the error of the sensor [m].

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
                    f"effect {self.name}: it has no hook, expected at least one of {', '.join(SCALAR_HOOKS)}"
                )
            return float(hook(*point))
        total = self.force(*point) if self.force is not None else 0.0
        if self.dry is not None:
            total += self.dry(*point) * float(np.sign(v))
        return float(total)

    def coefficients(self, parameters: Parameters) -> np.ndarray:
        """Coefficients of the regressor's columns that belong to ``parameters``."""
        if self.estimation.to_linear is not None:
            return np.asarray(self.estimation.to_linear(parameters), dtype=float)
        return np.array([parameters[name] for name in self.linear])

    def from_coefficients(self, coefficients: np.ndarray, shape: Parameters) -> dict[str, float]:
        """Parameters that belong to the regressor's ``coefficients`` at the given ``shape`` parameters."""
        if self.estimation.from_linear is not None:
            return self.estimation.from_linear(coefficients, shape)
        return {**dict(zip(self.linear, map(float, coefficients), strict=True)), **dict(shape)}

    def to_dict(self) -> dict[str, Any]:
        """Words, units and bounds as plain data, for catalogues and reports."""
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
