"""The velocity loop as implemented: hold, delays, current loop, effects and velocity estimator.

Stability is read from the closed-loop poles first; an unstable loop has no margins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.control.loop.margins import Margins, further_down, loop_margins
from emps_design.control.loop.sampled_loop import SampledLoop, close
from emps_design.control.loop.steps import step_answer
from emps_design.control.plant.discretisation import SampledPlant
from emps_design.control.velocity.structure import IP, Structure
from emps_design.laws import LawKind
from emps_design.laws.law import TWO_TAP, LawTable
from emps_design.laws.library import cascade, ip_velocity
from emps_design.laws.linear import LinearLaw, linear_law

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class SampledVelocityLoop:
    """Given gains in the loop as implemented: poles first, then margins at both places, then what they cost.

    ``k_v1`` [V/(m/s)], ``t_v`` [s]; arrays of them give as many responses, and nothing else. The filters are those of
    ``plant``.

    >>> from emps_design.control.plant.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> loop = SampledVelocityLoop(plant, 556.766, 8.45505e-3)
    >>> loop.stable, round(loop.margins.gain_margin, 2), round(loop.margins.delay_margin_samples, 2)
    (True, 4.73, 3.39)
    """

    plant: SampledPlant
    k_v1: Any
    t_v: Any
    structure: Structure = IP

    @cached_property
    def loop(self) -> SampledLoop:
        """The closed loop from velocity reference to voltage and velocity."""
        return close(self.plant, velocity_law(self.plant, self.k_v1, self.t_v, self.structure), plant_input=True)

    @property
    def poles(self) -> np.ndarray:
        """Closed-loop poles in the z plane, largest first."""
        return self.loop.poles

    @property
    def stable(self) -> bool:
        """Whether the sampled closed loop is stable, by its poles."""
        return self.loop.stable

    def plant_input_response(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the plant input at ``w`` [rad/s]."""
        return self.controller_response(w) * self.plant.response(w)

    def delayed_response(self, w: np.ndarray, delay: np.ndarray) -> np.ndarray:
        """Open loop at the plant input at ``w`` [rad/s] with ``delay`` [s] more, arrays alike."""
        return self.controller_response(w) * self.plant.delayed_response(w, delay)

    def controller_response(self, w: np.ndarray) -> np.ndarray:
        """From minus the velocity estimate to the voltage at ``w`` [rad/s], before the filters."""
        return self.k_v1 * (1.0 + self.plant.integrator(w) / self.t_v)

    def velocity_error_response(self, w: np.ndarray) -> np.ndarray:
        """Open loop broken at the velocity error at ``w`` [rad/s], the sampled T_vo."""
        if self.structure.form == "pi":
            return self.plant_input_response(w)
        inner = self.k_v1 * self.plant.response(w)
        return inner * self.plant.integrator(w) / self.t_v / (1.0 + inner)

    def closed_loop_response(self, w: np.ndarray) -> np.ndarray:
        """From velocity reference to the velocity estimate at ``w`` [rad/s], the sampled T_vc."""
        forward = self.velocity_error_response(w)
        closed = forward / (1.0 + forward)
        if self.structure.reference_filter:
            integral = self.plant.integrator(w) / self.t_v
            closed = closed * integral / (1.0 + integral)
        return closed

    @cached_property
    def margins(self) -> Margins:
        """Margins of the loop broken at the plant input."""
        return loop_margins(
            self.plant_input_response,
            self.plant.frequencies(),
            self.stable,
            self.plant.period,
            self.delayed_response,
        )

    @cached_property
    def velocity_error(self) -> Margins:
        """Margins of the loop broken at the velocity error; undefined while the inner proportional path is unstable.

        A "pi" has no inner path: there they are those at the plant input.
        """
        if self.structure.form == "pi":
            return self.margins
        return loop_margins(self.velocity_error_response, self.plant.frequencies(), self.stable, self.plant.period)

    @cached_property
    def bandwidth(self) -> float | None:
        """First frequency where the velocity estimate has fallen to -3 dB [rad/s]; None if unstable."""
        if not self.stable:
            return None
        from emps_design.control.velocity.gains import MINUS_3_DB

        grid = self.plant.frequencies()
        if abs(self.closed_loop_response(grid[:1])[0]) < MINUS_3_DB:
            grid = further_down(grid)
        below = np.nonzero(np.abs(self.closed_loop_response(grid)) < MINUS_3_DB)[0]
        if not below.size or below[0] == 0:
            return None
        low, high = float(grid[below[0] - 1]), float(grid[below[0]])
        while high - low > 1e-10 * high:
            middle = 0.5 * (low + high)
            if abs(self.closed_loop_response(np.array(middle))) < MINUS_3_DB:
                high = middle
            else:
                low = middle
        return 0.5 * (low + high)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Instability first, then what the linear loop leaves out and what is unbounded."""
        warnings = (
            []
            if self.stable
            else [f"the sampled loop is unstable: largest pole {abs(self.poles[0]):.4g}, outside the unit circle"]
        )
        warnings += self.plant.linear.warnings
        if self.stable and self.margins.gain_margin is None:
            warnings.append("the sampled loop's gain margin is unbounded")
        return tuple(warnings)

    def step_response(self, samples: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time [s], true velocity [m/s] and voltage [V] after a unit step of the reference, dry friction left out.

        Of more than :data:`~emps_design.control.loop.steps.EVERY` samples the later ones have gaps.

        >>> from emps_design.control.plant.discretisation import sample_axis
        >>> from emps_design.machines import machine
        >>> t, v, u = SampledVelocityLoop(sample_axis(machine("emps2018")), 556.766, 8.45505e-3).step_response()
        >>> round(float(v[-1]), 6)
        1.0
        """
        computed = replace(self, structure=self.structure.as_computed) if self.structure.reference_filter else self
        k, found, _ = step_answer(computed.loop, "reference", samples)
        return k * self.plant.period, found[:, 0], found[:, 3]

    def transfer_function(self) -> control.TransferFunction:
        """The open loop at the plant input as a discrete ``control.TransferFunction`` in z."""
        import control

        numerator, denominator = self.plant.polynomials
        T = self.plant.period
        return control.tf(
            self.k_v1 * np.polymul(numerator, [1.0 + T / self.t_v, -1.0]), np.polymul(denominator, [1.0, -1.0]), T
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data: margins at the plant input, those at the velocity error beside them, and the poles."""
        return {
            **self.margins.to_dict(),
            "bandwidth": self.bandwidth,
            "velocity_error": self.velocity_error.to_dict(),
            "poles": [[float(p.real), float(p.imag)] for p in self.poles],
            "period": self.plant.period,
        }


def velocity_law(
    plant: SampledPlant, k_v1: float, t_v: float, structure: Structure = IP, k_e1: float | np.ndarray = 0.0
) -> LinearLaw:
    """The law of a velocity loop with the estimator and the filters of ``plant`` in its linear form.

    ``k_e1`` [(m/s)/N]: the measured force adds to the velocity reference; an array (m,) makes m laws.
    """
    kind, table = velocity_table(k_v1, t_v, structure, plant.filters, plant.estimator)
    law = linear_law(kind.law(table, None, plant.period), plant.period)
    reference, force = law.inputs.index("reference"), law.inputs.index("f_ext")
    A, B, C, D = (np.broadcast_to(x, (*np.shape(k_e1), *x.shape)).copy() for x in (law.A, law.B, law.C, law.D))
    B[..., force] += np.multiply.outer(k_e1, law.B[..., reference])
    D[..., force] += np.multiply.outer(k_e1, law.D[..., reference])
    return replace(law, A=A, B=B, C=C, D=D)


def velocity_table(
    k_v1: float,
    t_v: float,
    structure: Structure = IP,
    filters: tuple[cascade.Filter, ...] = (),
    estimator: Any = TWO_TAP,
    in_a_cascade: bool = False,
) -> tuple[LawKind, LawTable]:
    """The kind of law that a velocity loop is, and its table: the paper's own where that has all of it, or a cascade.

    ``in_a_cascade`` asks for the latter.
    """
    own: dict[str, Any] = {"velocity_estimator": estimator}
    if structure.form == "ip" and not filters and not in_a_cascade:
        return ip_velocity.LAW, ip_velocity.Table(k_v1=k_v1, t_v=t_v, **own)
    loop = cascade.VelocityLoop.model_validate({"kp": k_v1, "ti": t_v, "form": structure.form})
    return cascade.LAW, cascade.Table(velocity=loop, filters=filters, **own)
