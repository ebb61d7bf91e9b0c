"""The force loop of Fig. 4 around the velocity loop, (10) and (11), and the largest stable force gain.

The limit of the force gain follows from a closed form for the continuous loop, and from a search on the poles for the
sampled loop.

The measured force sets the velocity: r = k_e1 (tau_ref + tau_e). The operator's force is the response to the motion,

    tau_e = -(k_h + K_env / s) qd        k_h: viscous hand [N/(m/s)], K_env: stiffness of a wall [N/m]

positive towards +q, so a passive operator closes a negative feedback. The loop gain is k_e1 (k_h + K_env/s) T_v(s) with
T_v from velocity reference to velocity. The same force also acts on the carriage, where the velocity loop resists it:
qd = T_vc r + T_IP s tau_e / K_v, with T_IP the T_vc of (8) for every structure; the zero of PI is in the first term
only. The paper neglects the second term (``on_carriage=False``).

In the paper's formulation tau_e = +k_c qd with k_c = 1/k_e1 is both reference and result. Then T_eo = T_vc, and the
closed loop T/(1 - T) is positive feedback with a pole at s = 0: it is not stable, and says nothing about an operator.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.advice import where_in_words
from emps_design.control.discretisation import SampledPlant, sample_axis
from emps_design.control.linear_plant import POSITION, VELOCITY, Environment, attached, felt
from emps_design.control.margins import Margins, loop_margins
from emps_design.control.sampled import (
    PLANT_INPUT,
    VELOCITY_LOOP,
    NestedLoop,
    SampledLoop,
    close,
    loop_in_words,
    worst_loop,
)
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.sampled import SampledVelocityLoop, velocity_law
from emps_design.control.velocity.specification import closed_form_in_words
from emps_design.control.view import force_view
from emps_design.errors import InputError
from emps_design.messages import Message, grave, note, warning
from emps_design.request import typed
from emps_design.view import View, Viewed

if TYPE_CHECKING:
    import control

FORCE_LOOP, VELOCITY_REFERENCE = "force loop", "velocity reference"
ROUNDING = 1e-12  # tolerance of a pole for the limit of a gain; verdicts use MARGINAL


def largest_force_gain(
    omega_0v: float,
    z_v: float,
    K_v: float,
    hand: float = 0.0,
    environment: float = 0.0,
    on_carriage: bool = True,
    zero: float = 0.0,
) -> float | None:
    """Return the k_e1 [(m/s)/N] at which the continuous force loop becomes unstable (Routh); None: never.

    ``omega_0v`` [rad/s], ``z_v``, ``K_v`` [N/m] of (8), (9); ``hand`` [N/(m/s)], ``environment`` [N/m]. For a wall
    without a hand it is 2 z_v w_0v / K_env, times (1 + K_env/K_v) if the force also acts on the carriage. ``zero`` [s]
    is that of T_vc, t_v of a PI loop: its lead adds damping, so there may be no limit.

    >>> round(largest_force_gain(141.42, 0.61237, 2.3146e6, environment=1e4, on_carriage=False), 6)
    0.01732
    >>> largest_force_gain(141.42, 0.61237, 2.3146e6, hand=100.0) is None
    True
    """
    share = 1.0 / K_v if on_carriage else 0.0
    # s^3/w0^2 + (second + k zero k_h) s^2 + (first + k (k_h + zero K)) s + k K = 0
    second, first = 2.0 * z_v / omega_0v + hand * share, 1.0 + environment * share
    by_gain = hand + zero * environment
    products = zero * hand * by_gain, second * by_gain + zero * hand * first - environment / omega_0v**2, second * first
    gains = np.roots(products)
    positive = gains.real[(gains.imag == 0.0) & (gains.real > 0.0)]
    return float(positive.min()) if positive.size else None


def first_instability(stable: Callable[[np.ndarray], np.ndarray], start: float) -> float | None:
    """Smallest unstable gain; None if it is above 1e9 ``start``, 0.0 if every gain is unstable.

    ``stable(gains)`` (n,) -> (n,) evaluates many gains at once.
    """
    low, high = 0.0, start
    while bool(np.all(verdicts := stable(grid := high * 1.15 ** np.arange(16.0)))):
        low, high = float(grid[-1]), float(grid[-1]) * 1.15
        if low > 1e9 * start:
            return None
    while True:
        first = int(np.argmin(verdicts))
        low, high = (float(grid[first - 1]) if first else low), float(grid[first])
        if low == 0.0 or high - low <= 1e-12 * high:
            return low
        grid = np.linspace(low, high, 18)[1:]
        verdicts = stable(grid)


@dataclass(frozen=True)
class ForceLoopDesign(Viewed):
    """A force gain around a velocity loop, in contact with an operator: stability, margins and limits.

    ``k_e1`` [(m/s)/N]; ``hand`` [N/(m/s)]; ``environment`` [N/m]; ``sensor_delay`` samples between force and its
    reading; ``on_carriage``: whether the operator's force also acts on the carriage (it does on a real machine).

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> loop = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    >>> wall = design_force_loop(loop, k_e1=1e-3, environment=1e4)
    >>> wall.stable, round(wall.k_e1_max_continuous, 6), round(wall.k_e1_max_sampled, 6)
    (True, 0.017395, 0.017638)
    """

    velocity_loop: VelocityLoopDesign
    k_e1: float
    hand: float = 0.0
    environment: float = 0.0
    sensor_delay: int = 0
    on_carriage: bool = True

    @property
    def k_c(self) -> float:
        """Apparent damping at low frequency, 1/k_e1 [N/(m/s)]."""
        return 1.0 / self.k_e1

    @property
    def apparent_mass(self) -> float:
        """Apparent mass [kg] of the low-frequency match of k_e1 T_vc with 1/(M_a s + B): 2 z_v/(w_0v k_e1) of IP.

        The zero of PI reduces it by k_c t_v.
        """
        return (2.0 * self.velocity_loop.z_v / self.velocity_loop.omega_0v - self._zero) / self.k_e1

    @property
    def _zero(self) -> float:
        """Time constant [s] of the zero of T_vc."""
        return float(self.velocity_loop.structure.zero(self.velocity_loop.t_v))

    @property
    def k_e1_max_continuous(self) -> float | None:
        """Largest k_e1 of the continuous loop [(m/s)/N] by the closed form; None without a limit."""
        loop = self.velocity_loop
        return largest_force_gain(
            loop.omega_0v, loop.z_v, loop.K_v, self.hand, self.environment, self.on_carriage, self._zero
        )

    @property
    def _operator(self) -> Environment:
        return Environment(damping=self.hand, stiffness=self.environment)

    @cached_property
    def _plant(self) -> SampledPlant:
        loop = self.velocity_loop
        plant = sample_axis(loop.axis, loop.velocity, loop.filters)
        if not self.on_carriage:
            return plant
        return plant.sampling(attached(plant.linear, self._operator))

    def sampled_loop(self, k_e1: float | np.ndarray | None = None) -> SampledLoop:
        """The sampled closed loop at ``k_e1`` [(m/s)/N], by default that of the design; its reference is a velocity.

        An array (m,) gives m loops.
        """
        loop, gain = self.velocity_loop, self.k_e1 if k_e1 is None else k_e1
        law = velocity_law(self._plant, loop.k_v1, loop.t_v, loop.structure.as_computed, gain)
        return close(self._plant, law, felt(self._plant.linear, self._operator), self.sensor_delay)

    @property
    def poles(self) -> np.ndarray:
        """Poles of the sampled closed loop in the z plane, largest first."""
        return self.sampled_loop().poles

    @property
    def continuous_poles(self) -> np.ndarray:
        """Poles of the continuous closed loop [rad/s], without the pole of a free position at 0."""
        loop, share = self.velocity_loop, 1.0 / self.velocity_loop.K_v if self.on_carriage else 0.0
        ahead = self.k_e1 * self._zero + share  # of the operator's force, by its rate of change
        cubic = [
            1.0 / loop.omega_0v**2,
            2.0 * loop.z_v / loop.omega_0v + self.hand * ahead,
            1.0 + self.k_e1 * self.hand + self.environment * ahead,
            self.k_e1 * self.environment,
        ]
        poles = np.roots(cubic if self.environment > 0.0 else cubic[:3])
        return poles[np.argsort(-poles.real)]

    @cached_property
    def stable(self) -> bool:
        """Whether the sampled force loop is stable, by its poles; :attr:`worst` covers the whole design."""
        return self.sampled_loop().stable

    @cached_property
    def k_e1_max_sampled(self) -> float | None:
        """Largest k_e1 of the sampled loop [(m/s)/N] by bisection on its poles; None: no limit, 0: always unstable.

        With more than a hundred samples of delay the poles take seconds; then the gain margin gives the limit.
        """
        loop = self.velocity_loop
        start = 1e-3 / (self.hand + self.environment / loop.omega_0v) if self.hand + self.environment > 0.0 else 1.0
        if self._plant.delay + self.sensor_delay <= 100 or self.hand + self.environment == 0.0:
            return first_instability(lambda gains: self.sampled_loop(gains).radius <= 1.0 + ROUNDING, start)
        slow = replace(self, k_e1=start)
        if not slow.stable:
            return 0.0
        factor = slow.margins.gain_margin
        return None if factor is None else start * factor

    @cached_property
    def loops(self) -> tuple[NestedLoop, ...]:
        """The velocity loop without an operator and the force loop in contact; with effects in both directions."""
        directions: list[tuple[ForceLoopDesign, dict[str, float]]] = [(self, {})]
        if self.velocity_loop.axis.effects:
            back = -self.velocity_loop.velocity
            loop = replace(self.velocity_loop, velocity=back)
            directions.append((replace(self, velocity_loop=loop), {"velocity": back}))
        loops = []
        for design, where in directions:
            free = design.velocity_loop.sampled.margins
            loops.append(NestedLoop(VELOCITY_LOOP, PLANT_INPUT, free, where))
            loops.append(NestedLoop(FORCE_LOOP, VELOCITY_REFERENCE, design.margins, where))
        return tuple(loops)

    @property
    def worst(self) -> NestedLoop:
        """The loop with the smallest margins."""
        return worst_loop(self.loops)

    @property
    def nearest_stable(self) -> dict[str, Any]:
        """A stable k_e1 [(m/s)/N] close to the limit, or the gain itself if it is stable; empty if none is stable.

        If the velocity loop itself is unstable, it is the nearest specification of that loop.
        """
        if not self.velocity_loop.sampled.stable:
            return self.velocity_loop.nearest_stable if self.velocity_loop.requested else {}
        if self.stable:
            return {"k_e1": self.k_e1}
        return {"k_e1": 0.99 * self.k_e1_max_sampled} if self.k_e1_max_sampled else {}

    @property
    def reason(self) -> str:
        """The reason why the design must not run, in one line; empty if every loop is stable."""
        worst = self.worst
        if worst.margins.stable:
            return ""
        units = self.velocity_loop.axis.units
        force = units.word("force")
        if worst.name == VELOCITY_LOOP:
            nearest = f"; {self.velocity_loop.nearest_in_words}" if self.nearest_stable and not worst.where else ""
            where = where_in_words(worst.where, units)
            return f"the sampled velocity loop is unstable without contact{where and ' '}{where}{nearest}"
        if worst.where:
            return f"the sampled {force} loop is unstable {where_in_words(worst.where, units)}"
        limit = self.k_e1_max_sampled
        return f"the sampled {force} loop is unstable; " + (
            f"the largest stable k_e1 is {units.quantity(limit, '(m/s)/N', '.5g')}"
            if limit
            else "no k_e1 is stable; reduce the bandwidth of the velocity loop"
        )

    def response(self, w: np.ndarray) -> np.ndarray:
        """Sampled force loop, broken at the velocity reference, at ``w`` [rad/s]."""
        plant, loop = self._plant, self.velocity_loop
        inner = SampledVelocityLoop(plant, loop.k_v1, loop.t_v)
        ahead = 1.0 if loop.structure.as_computed.form == "pi" else 0.0
        by_reference = loop.k_v1 * (ahead + plant.integrator(w) / loop.t_v) * plant.filter_response(w)
        voltage = by_reference / (1.0 + inner.plant_input_response(w))
        states = plant.state_response(w)
        force = self.environment * states[..., POSITION] + self.hand * states[..., VELOCITY]
        return self.k_e1 * force * voltage * np.exp(-1j * w * plant.period * self.sensor_delay)

    @cached_property
    def margins(self) -> Margins:
        """Margins of the sampled force loop broken at the velocity reference."""
        plant = self._plant
        if self.hand + self.environment == 0.0:  # the loop is open
            return Margins(stable=self.stable, period=plant.period)
        return loop_margins(self.response, plant.frequencies(), self.stable, plant.period)

    @property
    def paper_reading(self) -> dict[str, Any]:
        """The loop as the paper writes it, T/(1 - T) with T = T_vc, and its poles [rad/s]."""
        loop = self.velocity_loop
        force = loop.axis.units.word("force")
        return {
            "loop": "T_eo/(1 - T_eo) with T_eo = k_e1 k_c T_vc = T_vc, (11)",
            "static_gain": self.k_e1 * self.k_c,
            "poles": [[0.0, 0.0], [-(2.0 * loop.z_v - self._zero * loop.omega_0v) * loop.omega_0v, 0.0]],
            "text": f"with tau_e = +k_c qd the operator's {force} is reference and result at the same time: positive "
            "feedback with a pole at s = 0, which says nothing about stability in contact",
        }

    @property
    def warnings(self) -> tuple[Message, ...]:
        """Messages on the design, instability first."""
        warnings: list[Message] = []
        force = self.velocity_loop.axis.units.word("force")
        if not self.stable:
            text = f"the sampled {force} loop is unstable: largest pole {abs(self.poles[0]):.4g}"
            warnings.append(grave("force-loop-unstable", text, pole=abs(self.poles[0])))
        if not self.velocity_loop.sampled.stable:
            text = "the inner velocity loop, sampled, is already unstable without contact"
            warnings.append(grave("inner-loop-unstable", text))
        if self.worst.where and not self.worst.margins.stable:
            text = f"the {loop_in_words(self.worst, self.velocity_loop.axis.units)} is unstable"
            warnings.append(grave("other-machine-unstable", text))
        if self.hand + self.environment == 0.0:
            text = f"no operator: without a hand or an environment the {force} loop is open"
            warnings.append(warning("no-operator", text))
        elif self.k_e1_max_continuous is None:
            text = "k_e1_max.continuous is unbounded: the continuous loop has no limit with this operator"
            warnings.append(note("continuous-limit-unbounded", text))
        if self.k_e1_max_sampled is None:
            text = "k_e1_max.sampled is unbounded: the loop is stable up to 1e9 times its characteristic gain"
            # A loop that is stable with every gain is open, or its model lacks the limiting dynamics.
            warnings.append(grave("sampled-limit-unbounded", text))
        warnings += self._plant.linear.warnings
        loop = self.velocity_loop
        warnings += closed_form_in_words(loop.axis, loop.sampled.plant, loop.velocity)
        return tuple(warnings)

    def open_loop(self) -> control.TransferFunction:
        """T_eo(s) = k_e1 k_c T_vc of (10) and (11)."""
        import control

        loop = self.k_e1 * self.k_c * self.velocity_loop.closed_loop()
        return control.tf(loop, inputs=["force_error"], outputs=["force"], name="T_eo")

    def to_dict(self) -> dict[str, Any]:
        """The JSON document, with the limits for a force on the sensor only, and on sensor and carriage."""
        other = replace(self, on_carriage=not self.on_carriage)
        by_place = {place.on_carriage: place for place in (self, other)}
        limits = {
            name: {"continuous": by_place[on].k_e1_max_continuous, "sampled": by_place[on].k_e1_max_sampled}
            for name, on in (("sensor_only", False), ("sensor_and_carriage", True))
        }
        poles = self.poles
        continuous = self.continuous_poles
        return {
            "axis": self.velocity_loop.axis.name,
            "k_e1": self.k_e1,
            "k_c": self.k_c,
            "structure": self.velocity_loop.structure.form,
            "reference_filter": self.velocity_loop.structure.reference_filter,
            "filters": [section.model_dump(exclude_none=True) for section in self.velocity_loop.filters],
            "k_v1": self.velocity_loop.k_v1,
            "t_v": self.velocity_loop.t_v,
            "operator": {
                "hand": self.hand,
                "environment": self.environment,
                "sign": "tau_e = -(hand qd + environment q), positive towards +q",
                "on_carriage": self.on_carriage,
                "sensor_delay": self.sensor_delay,
            },
            "stable": self.worst.margins.stable,
            "worst_loop": self.worst.to_dict(),
            "k_e1_max": {
                "continuous": self.k_e1_max_continuous,
                "sampled": self.k_e1_max_sampled,
                **limits,
            },
            "margins": self.margins.to_dict(),
            "poles": [[float(p.real), float(p.imag)] for p in poles],
            "poles_plane": "z",
            "continuous": {
                "stable": bool(np.max(continuous.real) < 0.0),
                "poles": [[float(p.real), float(p.imag)] for p in continuous],
            },
            "apparent_damping": self.k_c,
            "apparent_mass": self.apparent_mass,
            "paper_reading": self.paper_reading,
            "warnings": list(self.warnings),
        }

    def view(self) -> View:
        """The lines and tables of the command ``force``."""
        return force_view(self.to_dict(), self.velocity_loop.axis.units)


@typed
def design_force_loop(
    velocity_loop: VelocityLoopDesign,
    k_e1: float,
    hand: float = 0.0,
    environment: float = 0.0,
    sensor_delay: int = 0,
    on_carriage: bool = True,
) -> ForceLoopDesign:
    """Return the force loop with gain ``k_e1`` [(m/s)/N] around ``velocity_loop``.

    ``hand`` [N/(m/s)] and ``environment`` [N/m] describe the operator. Raises :class:`InputError` for a gain that is
    not positive, an operator that is not passive, or a negative ``sensor_delay`` [samples].

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> loop = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    >>> design_force_loop(loop, k_e1=0.0)
    Traceback (most recent call last):
        ...
    emps_design.errors.InputError: k_e1: found 0 (m/s)/N, expected a positive number
    """
    units = velocity_loop.axis.units
    if not math.isfinite(k_e1) or k_e1 <= 0.0:
        raise InputError(f"k_e1: found {units.quantity(k_e1, '(m/s)/N', 'g')}, expected a positive number")
    for name, value, unit in (("hand", hand, "N/(m/s)"), ("environment", environment, "N/m")):
        if not math.isfinite(value) or value < 0.0:
            shown = units.quantity(value, unit, "g")
            raise InputError(f"{name}: found {shown}, expected 0 or a positive number: an operator is passive")
        units.check(name, value, unit)
    units.check("k_e1", k_e1, "(m/s)/N", positive=True)
    if not 0 <= sensor_delay <= 1000:
        raise InputError(f"sensor delay: found {sensor_delay} samples, expected 0 to 1000")
    return ForceLoopDesign(velocity_loop, float(k_e1), float(hand), float(environment), sensor_delay, on_carriage)
