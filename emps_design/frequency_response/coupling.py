"""Chains of one to three masses fitted to a measured response, and the response beside the model of its axis.

The force acts on the first mass, whose velocity is measured; springs k and dampers c connect it to the next ones:

    G(s) = e^{-s delay} / (F_v + Z_1),    Z_i = m_i s + 1 / (1/(k_i/s + c_i) + 1/Z_{i+1}),    Z_n = m_n s.

Without damping Z_1 is M s times a product of (1 + s^2/p^2)/(1 + s^2/z^2), antiresonances z and resonances p in turn,
and a continued fraction gives masses and springs from these (W. Cauer, 1926). A fit starts from the resonances of the
response and from some further pairs; the delay starts at the one that turns the phase. The residual is the logarithm
of model over measurement, weighted by the deviations of the data. A further mass is accepted where the information
criterion of Schwarz (1978) falls clearly, its resonance lies among the lines, and its mass and spring are certain.
Standard deviations are raised where the residuals exceed the deviations of the data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.control.linear_plant import VELOCITY, linear_plant
from emps_design.control.margins import transfer
from emps_design.effects.two_mass import linear_coupling
from emps_design.errors import InputError
from emps_design.frequency_response.response import BAND, FrequencyResponse, neighbours, resonances, turning_delay
from emps_design.messages import Message, warning
from emps_design.stretches import stretches
from emps_design.units import LINEAR, Units
from emps_design.view import Line, Table, View, Viewed

MISSED = 5.0  # deviations of misfit above which a chain does not describe the response
VAGUE = 10.0  # relative deviation from which on a parameter is not determined
CERTAINLY = 3.0  # deviations below 0 beyond which a friction or a delay is impossible

MOST = 3  # masses
SYSTEMATIC = 1e-3  # relative difference of model and response that is always allowed
CLEARLY = 10.0  # fall of the criterion that one more mass requires
CERTAIN = 0.25  # relative deviation above which a spring or a mass is not determined
INSIDE = 0.95  # share of the highest line below which a resonance has to lie
UNKNOWN = 100.0  # deviation of the logarithm of a parameter without influence on the response
STARTS = 6  # places besides the resonances found
MANY = 400  # lines that a fit takes, evenly among more
NEAR = 4  # lines on either side whose median deviation replaces a line's own
ALIKE = 2.0  # largest factor between the two
FIRST_STEPS, MOST_STEPS = 30, 200  # of a fit: from every start, and of the best among them
SMALL = np.finfo(float).eps ** 0.5  # step of a parameter for its slope
APART = 1.15  # of a resonance to its antiresonance, where a fit starts without knowing

ROOM = 0.05  # relative difference that does not matter, however certain


@dataclass(frozen=True, eq=False)
class MassChain:
    """Masses [kg] (n,), springs [N/m] and dampers [N/(m/s)] (n - 1,), viscous friction [N/(m/s)], delay [s].

    ``covariance`` is that of the logarithms of masses, springs and dampers, then of friction and delay; ``misfit`` the
    rms of the residuals over the deviations of the data; ``criterion`` that of Schwarz for each number of masses tried.
    """

    masses: np.ndarray
    springs: np.ndarray
    dampers: np.ndarray
    viscous: float
    delay: float
    covariance: np.ndarray
    misfit: float
    criterion: tuple[float, ...] = ()
    units: Units = field(default=LINEAR, repr=False)

    @cached_property
    def theta(self) -> np.ndarray:
        """Logarithms of masses, springs and dampers, then friction and delay."""
        logs = np.log(np.concatenate([self.masses, self.springs, self.dampers]))
        return np.concatenate([logs, [self.viscous, self.delay]])

    def response(self, w: np.ndarray) -> np.ndarray:
        """Force to velocity at ``w`` (n,) [rad/s]."""
        return chain_response(self.theta, self.masses.size, 1j * np.asarray(w))

    @property
    def label(self) -> str:
        """The number of masses in words."""
        count = self.masses.size
        return f"{('one', 'two', 'three')[count - 1]} {self.units.word('mass' if count == 1 else 'masses')}"

    @property
    def effect(self) -> dict[str, Any] | None:
        """The ``[[effects]]`` table of the coupling between two masses; None for another number."""
        if self.masses.size != 2:
            return None
        values = self.parameters
        return linear_coupling(values["frequency"][0], values["damping"][0], values["share"][0])

    def on(self, axis: Axis) -> Axis:
        """``axis`` with the mass and viscous friction of the chain, and of two masses the coupling.

        The drive stays, with its delay and back-EMF; its electrical braking is subtracted from the viscous friction.
        """
        values, coupling = self.parameters, self.effect
        kept = [effect for effect in axis.effects if coupling is None or effect.kind != coupling["kind"]]
        mechanics = {"mass": values["mass"][0], "viscous": max(values["viscous"][0] - axis.drive.braking, 0.0)}
        return axis.replace(mechanics=mechanics, effects=[*kept, *([coupling] if coupling else [])])

    @property
    def parameters(self) -> dict[str, tuple[float, float, str]]:
        """Value, standard deviation and unit by name; of two masses also the parameters of the coupling effect."""
        n = self.masses.size
        parameters = {
            "mass": (*self._of(lambda theta: float(np.sum(np.exp(theta[:n])))), "kg"),
            "viscous": (*self._of(lambda theta: theta[-2]), "N/(m/s)"),
            "delay": (*self._of(lambda theta: theta[-1]), "s"),
        }
        if n == 2:
            for i, name in enumerate(("frequency", "damping", "share")):
                parameters[name] = (*self._of(lambda theta, i=i: coupling_of(theta)[i]), ("Hz", "", "")[i])
        if n > 2:
            units = ("kg", "N/m", "N/(m/s)")
            for start, name, unit in zip((0, n, 2 * n - 1), ("mass", "spring", "damper"), units, strict=True):
                for i in range(n if name == "mass" else n - 1):
                    parameters[f"{name}_{i + 1}"] = (
                        *self._of(lambda theta, k=start + i: float(np.exp(theta[k]))),
                        unit,
                    )
            for i in range(n - 1):
                parameters[f"resonance_{i + 1}"] = (*self._of(lambda theta, i=i: float(natural(theta, n, 0)[i])), "Hz")
                parameters[f"antiresonance_{i + 1}"] = (
                    *self._of(lambda theta, i=i: float(natural(theta, n, 1)[i])),
                    "Hz",
                )
        return parameters

    def determines(self, name: str) -> bool:
        """Whether the response determines a parameter: a positive one to within ten times its size."""
        value, std, _ = self.parameters[name]
        return bool(np.isfinite(std)) and (name in ("viscous", "delay") or std < VAGUE * value)

    def _of(self, quantity: Callable[..., float]) -> tuple[float, float]:
        """A function of ``theta`` and its standard deviation, to first order."""
        steps = np.sqrt(np.diag(self.covariance)) * 1e-3 + 1e-300
        units = np.eye(steps.size)
        slope = np.array(
            [
                (quantity(self.theta + h * e) - quantity(self.theta - h * e)) / (2.0 * h)
                for h, e in zip(steps, units, strict=True)
            ]
        )
        with np.errstate(over="ignore", invalid="ignore"):
            std = float(np.sqrt(slope @ self.covariance @ slope))
        return float(quantity(self.theta)), std if np.isfinite(std) else np.inf

    @property
    def warnings(self) -> tuple[Message, ...]:
        """Messages where the chain does not fit the response, or where its friction or delay is negative."""
        messages = []
        if self.misfit > MISSED:
            text = (
                f"{self.label} with a delay do not fit the response: residuals {self.misfit:.2g} standard deviations, "
                "expected about 1; their values and intervals are not valid"
            )
            messages.append(warning("chain-misses-response", text, misfit=self.misfit))
        values = self.parameters
        causes = {
            "viscous": "friction that falls with speed",
            "delay": f"a {self.units.word('force')} before its command",
        }
        for name, what in causes.items():
            value, std, _ = values[name]
            if value < -CERTAINLY * std:
                text = (
                    f"{self.label}: found a {name} {-value / std:.3g} standard deviations below 0, expected at least "
                    f"0: {what}; check sign and unit of the command, and the computation delay of the axis"
                )
                messages.append(warning("negative-parameter", text, parameter=name, value=value, std=std))
        return tuple(messages)

    def table(self) -> Table:
        """The parameters with their deviations."""
        units = self.units
        rows = [
            (units.words(name.replace("_", " ")), f"{value:.6g}", f"{std:.3g}", units.unit(of))
            if self.determines(name)
            else (units.words(name.replace("_", " ")), "not determined", "", "")
            for name, (value, std, of) in self.parameters.items()
        ]
        title = f"Fitted, {units.words(self.label)}; residuals {self.misfit:.2g} standard deviations"
        return Table(("", "value", "std", "unit"), rows, title)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "masses": self.masses.size,
            "effect": self.effect,
            "parameters": {
                name: {"value": value, "std": std, "unit": self.units.unit(unit)}
                for name, (value, std, unit) in self.parameters.items()
            },
            "misfit": self.misfit,
            "criterion": list(self.criterion),
            "warnings": list(self.warnings),
        }


def chain_response(theta: np.ndarray, n: int, s: np.ndarray) -> np.ndarray:
    """Force to velocity (..., m) at ``s`` (m,) [rad/s] of ``n`` masses; ``theta`` (..., p) as in :class:`MassChain`."""
    masses, springs, dampers = (np.moveaxis(part, -1, 0)[..., None] for part in split(theta, n))
    impedance = masses[-1] * s
    for mass, spring, damper in zip(masses[-2::-1], springs[::-1], dampers[::-1], strict=True):
        impedance = mass * s + 1.0 / (1.0 / (spring / s + damper) + 1.0 / impedance)
    return np.exp(-s * theta[..., -1:]) / (theta[..., -2:-1] + impedance)


def split(theta: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, springs and dampers of ``theta`` (..., p)."""
    values = np.exp(np.clip(theta[..., :-2], -200.0, 200.0))
    return values[..., :n], values[..., n : 2 * n - 1], values[..., 2 * n - 1 :]


def coupling_of(theta: np.ndarray) -> tuple[float, float, float]:
    """Resonance [Hz] and damping of two free masses, and the share of the second."""
    masses, springs, dampers = split(theta, 2)
    total = float(np.sum(masses))
    reduced = float(np.prod(masses)) / total
    w = float(np.sqrt(springs[0] / reduced))
    return w / (2.0 * np.pi), float(dampers[0]) / (2.0 * reduced * w), float(masses[1]) / total


def natural(theta: np.ndarray, n: int, held: int) -> np.ndarray:
    """Natural frequencies [Hz] of the free chain, ``held`` 0, without the rigid mode; of the chain with its first mass
    ``held``, 1, which are the antiresonances."""
    masses, springs, _ = split(theta, n)
    stiffness = np.zeros((n, n))
    for i, spring in enumerate(springs):
        stiffness[i : i + 2, i : i + 2] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
    root = 1.0 / np.sqrt(masses[held:])
    squares = np.linalg.eigvalsh(stiffness[held:, held:] * root[:, None] * root)
    return np.sqrt(np.maximum(squares[1 - held :], 0.0)) / (2.0 * np.pi)


def fit_chain(response: FrequencyResponse, most: int = MOST, units: Units = LINEAR) -> MassChain:
    """Return the chain of one up to ``most`` masses that describes ``response`` best, in the words of ``units``.

    Raises :class:`InputError` for fewer lines than parameters.

    >>> f = np.arange(3.0, 120.0)
    >>> two = MassChain(np.array([60.0, 40.0]), np.array([4e6]), np.array([500.0]), 200.0, 0.0, np.eye(6), 0.0)
    >>> chain = fit_chain(FrequencyResponse.of(f, two.response(2.0 * np.pi * f), np.full(f.size, 0.01)))
    >>> {name: round(value, 3) for name, (value, _, _) in chain.parameters.items() if name != "delay"}
    {'mass': 100.0, 'viscous': 200.0, 'frequency': 64.975, 'damping': 0.026, 'share': 0.4}
    """
    response = response.every(-(-len(response) // MANY))
    mass = np.array([1.0 / np.median(response.w * response.magnitude)])
    candidate = _best_fit(response, [(mass, (), ())], turning_delay(response))
    if candidate is None:
        raise InputError(
            f"{response.name}: found {len(response)} lines, expected more than a {units.word('mass')} has parameters"
        )
    best, criterion = candidate, [_criterion(candidate, len(response))]
    lowest = criterion[0]
    for _ in range(1, most):  # a second mass may show only together with a third: each number is tried
        candidate = _best_fit(response, _starts(candidate, response), candidate.delay)
        if candidate is None:
            break
        criterion.append(_criterion(candidate, len(response)))
        if criterion[-1] < lowest - CLEARLY and _is_determined(candidate, response):
            best, lowest = candidate, criterion[-1]
    return replace(best, criterion=tuple(criterion), units=units)


def _starts(chain: MassChain, response: FrequencyResponse) -> list[tuple[np.ndarray, Any, Any]]:
    """Start values of one mass more: the pairs of ``chain`` and one further pair, from the response or a grid."""
    n = chain.masses.size
    own = list(zip(natural(chain.theta, n, 1), natural(chain.theta, n, 0), strict=True)) if n > 1 else []
    roots = resonances(response)
    pairs = [
        (low.frequency, high.frequency)
        for low, high in pairwise(roots)
        if (low.kind, high.kind) == ("antiresonance", "resonance")
    ]
    places = np.geomspace(response.frequency[0], response.frequency[-1], STARTS + 2)[1:-1]
    pairs += [(float(f), APART * float(f)) for f in places]
    several = [[*own, pair] for pair in pairs]
    several.append(pairs[: len(pairs) - STARTS])  # all pairs of the response, if there are n of them
    return [
        _cauer(float(np.sum(chain.masses)), in_turn)
        for in_turn in map(sorted, several)
        if len(in_turn) == n and all(low[1] < high[0] for low, high in pairwise(in_turn))
    ]


def _cauer(total: float, pairs: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, springs and light dampers of the chain with these antiresonances and resonances [Hz].

    >>> masses, springs, _ = _cauer(100.0, [(30.0, 50.0)])
    >>> masses.round(6).tolist(), round(float(springs[0] / masses[1]) ** 0.5 / (2.0 * np.pi), 6)
    ([36.0, 64.0], 30.0)
    """
    z, p = ((2.0 * np.pi * np.array(side)) ** 2 for side in zip(*pairs, strict=True))
    above, below = total * np.prod(z / p) * np.poly(-p), np.poly(-z)
    masses, springs = [], []
    while below.size > 1:
        masses.append(above[0] / below[0])
        rest = (above - masses[-1] * below)[1:]
        springs.append(rest[0] / below[0])
        above, below = rest, (below - np.append(rest, 0.0) / springs[-1])[1:]
    masses.append(above[0] / below[0])
    dampers = 0.05 * np.array(springs) / np.sqrt(p)
    return np.array(masses), np.array(springs), dampers


def _best_fit(response: FrequencyResponse, starts: Sequence[tuple[Any, Any, Any]], delay: float) -> MassChain | None:
    """The best fit from several starts with ``delay`` [s]; None without a valid start, or with too few lines."""
    s = 1j * response.w
    weight = np.sqrt(2.0) / np.hypot(_smoothed_std(response.std), SYSTEMATIC)
    best: Any = None
    for masses, springs, dampers in starts:
        n = len(masses)
        values = np.concatenate([masses, springs, dampers])
        if 2 * len(response) <= values.size + 2 or np.any(values <= 0.0):
            continue
        scale = np.concatenate([np.ones(values.size), [float(np.sum(masses)) * response.w[0], 1.0 / response.w[-1]]])

        def residual(x: np.ndarray, n: int = n, scale: np.ndarray = scale) -> np.ndarray:
            gap = np.log(chain_response(x * scale, n, s) / response.response) * weight
            return np.concatenate([gap.real, gap.imag], axis=-1)

        def slopes(x: np.ndarray, residual: Callable[..., np.ndarray] = residual) -> np.ndarray:
            step = SMALL * np.maximum(np.abs(x), 1.0)  # of all parameters at once
            return (residual(x + np.diag(step)) - residual(x)).T / step

        start = np.concatenate([np.log(values), [0.0, delay / scale[-1]]])
        solution = scipy.optimize.least_squares(residual, start, slopes, x_scale="jac", max_nfev=FIRST_STEPS)
        if best is None or solution.cost < best[0].cost:
            best = solution, residual, slopes, scale, n
    if best is None:
        return None
    solution, residual, slopes, scale, n = best
    if solution.status == 0:  # the steps ran out
        solution = scipy.optimize.least_squares(residual, solution.x, slopes, x_scale="jac", max_nfev=MOST_STEPS)
    theta, count = solution.x * scale, 2 * len(response)
    misfit = float(np.sqrt(2.0 * solution.cost / (count - theta.size)))
    jacobian = solution.jac / scale
    size = np.sqrt(np.sum(jacobian**2, axis=0))
    identifiable = size > 1e-9 * weight.min()  # a damper that vanished is not
    inverse = np.linalg.pinv(jacobian[:, identifiable] / size[identifiable]) / size[identifiable, None]
    covariance = np.diag(np.where(identifiable, 0.0, UNKNOWN**2))
    covariance[np.ix_(identifiable, identifiable)] = max(1.0, misfit) ** 2 * (inverse @ inverse.T)
    hardly = np.diag(covariance) > UNKNOWN**2
    hardly[-2:] = False  # friction and delay are no logarithms
    covariance[hardly] = covariance[:, hardly] = 0.0
    covariance[hardly, hardly] = UNKNOWN**2
    return MassChain(*split(theta, n), float(theta[-2]), float(theta[-1]), covariance, misfit)


def _smoothed_std(std: np.ndarray) -> np.ndarray:
    """Standard deviations (n,) smoothed: the median of the neighbours, within a factor of two of the line's own.

    The relative deviation of a line that is too large by chance is too small; with that weight the masses would come
    out too small.
    """
    return np.clip(np.median(std[neighbours(std.size, NEAR)], axis=1), std / ALIKE, std * ALIKE)


def _criterion(chain: MassChain, lines: int) -> float:
    """The information criterion of Schwarz with the scale of the deviations unknown."""
    count, parameters = 2 * lines, chain.theta.size
    return count * math.log(max(chain.misfit, 1e-3) ** 2 * (count - parameters) / count) + parameters * math.log(count)


def _is_determined(chain: MassChain, response: FrequencyResponse) -> bool:
    """Whether all masses and springs are determined and all resonances lie among the lines."""
    n = chain.masses.size
    known = np.sqrt(np.diag(chain.covariance))[: 2 * n - 1]
    places = natural(chain.theta, n, 0)
    low, high = response.frequency[0], INSIDE * response.frequency[-1]
    return bool(np.all(known < CERTAIN) and np.all(places > low) and np.all(places < high))


def axis_response(axis: Axis, frequency: np.ndarray, velocity: float = 0.1) -> np.ndarray:
    """Return force to velocity (n,) of ``axis`` at ``frequency`` (n,) [Hz].

    Its effects are linearised at ``velocity`` [m/s]. A lag of the current loop is included, as in a measured response;
    hold and computation delay are not.

    >>> from emps_design.machines import machine
    >>> round(float(abs(axis_response(machine("emps2019"), np.array([50.0]))[0])) * 100 * np.pi, 6)  # 1/mass
    0.010514
    """
    plant = linear_plant(axis, velocity)
    s = 2j * np.pi * np.asarray(frequency)
    force_to_velocity = transfer(plant.A, plant.B, np.eye(plant.C.size)[VELOCITY], 0.0, s) / axis.drive.gain
    return force_to_velocity * np.exp(-s * plant.delay)


@dataclass(frozen=True)
class Agreement:
    """Agreement of a model with a response: of ``lines`` lines ``inside`` lie within the 95 % circle of the data.

    ``largest`` is the largest relative difference, at ``frequency`` [Hz]; in ``bands`` [Hz] the difference exceeds the
    deviations of the data and 5 %.
    """

    lines: int
    inside: int
    largest: float
    frequency: float
    bands: tuple[tuple[float, float], ...]

    @property
    def sentence(self) -> str:
        """The agreement in one line."""
        inside = f"within the 95 % circle of the data at {self.inside} of {self.lines} lines"
        if not self.bands:
            return f"the model is {inside}, and nowhere more than 5 % beyond it"
        where = ", ".join(f"{low:.4g} Hz" if low == high else f"{low:.4g} to {high:.4g} Hz" for low, high in self.bands)
        return f"the model is {inside}; it differs at {where}, most at {self.frequency:.4g} Hz, by {self.largest:.0%}"

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "lines": self.lines,
            "inside": self.inside,
            "largest": {"difference": self.largest, "frequency_hz": self.frequency},
            "bands_hz": [list(band) for band in self.bands],
        }


def agreement(response: FrequencyResponse, model: np.ndarray) -> Agreement:
    """Compare ``response`` with the ``model`` (n,) at its lines.

    >>> f = np.arange(1.0, 9.0)
    >>> measured = FrequencyResponse.of(f, 1.0 / (1j * f), np.full(8, 0.01))
    >>> agreement(measured, measured.response * np.where(f == 4.0, 2.0, 1.0)).sentence
    'the model is within the 95 % circle of the data at 7 of 8 lines; it differs at 4 Hz, most at 4 Hz, by 100%'
    """
    apart = np.abs(model / response.response - 1.0)
    circle = np.maximum(BAND * response.std, ROOM)
    beyond = apart > circle
    # One line in twenty is outside by chance; two neighbours, or one far outside, are not.
    beyond &= (apart > 2.0 * circle) | np.append(beyond[1:], False) | np.append(False, beyond[:-1])
    lines = response.frequency
    bands = [(float(lines[start]), float(lines[stop - 1])) for start, stop in stretches(beyond)]
    widest = sorted(sorted(bands, key=lambda band: band[1] / band[0])[-3:])
    worst = int(np.argmax(apart))
    inside = int(np.count_nonzero(apart <= BAND * response.std))
    return Agreement(len(response), inside, float(apart[worst]), float(response.frequency[worst]), tuple(widest))


@dataclass(frozen=True, eq=False)
class ResponseComparison(Viewed):
    """A measured ``response`` beside the model of its ``axis`` and beside the chain of masses that fits it."""

    response: FrequencyResponse
    axis: Axis

    @cached_property
    def model(self) -> np.ndarray:
        """The response of the axis's model at the lines (n,)."""
        return axis_response(self.axis, self.response.frequency)

    @cached_property
    def agreement(self) -> Agreement:
        """Where the model and the response differ."""
        return agreement(self.response, self.model)

    @cached_property
    def chain(self) -> MassChain:
        """The masses, springs and dampers that fit the response."""
        return fit_chain(self.response, units=self.axis.units)

    def view(self) -> View:
        """The masses that fit the response, and where the model differs from it."""
        return self.chain.table(), Line(f"{self.axis.name}: {self.agreement.sentence}", "prose")

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {"coupling": self.chain.to_dict(), "model": {"axis": self.axis.name, **self.agreement.to_dict()}}
