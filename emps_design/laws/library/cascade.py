"""Cascade of a servo drive: a position loop around a velocity loop, with feed-forward, filters and a limit.

Sample k, period T, reference r, position q, everything at rest before the first sample:

    v = (q[k] - q[k-1]) / T,   vr = (r[k] - r[k-1]) / T,   ar = (r[k] - 2 r[k-1] + r[k-2]) / T^2
    vc = kp (r - q) in every n-th sample, including the first, held in between
    e = vc + share vr - v,   J = I + kp_v T / ti e
    w = kp_v e + J (form "pi")  or  J - kp_v v (form "ip"),   + acceleration ar + coulomb sign(vr)

Other estimators of v: :mod:`~emps_design.laws.estimators`. ``source = "profile"`` feeds forward the velocity and
acceleration of the reference generator at the sample, which are vr half a period later and ar a period later:
``vr + T ar / 2`` and ``(2 r[k] - 5 r[k-1] + 4 r[k-2] - r[k-3]) / T^2``, with an error proportional to T^2.

Then the filters in their order, each by the bilinear transform ``s = 2/T (z - 1)/(z + 1)`` without prewarping:
``w0/(s + w0)``, and for a notch ``(s^2 + 2 depth damping w0 s + w0^2)/(s^2 + 2 damping w0 s + w0^2)``; then the limit.
I is set to J, with ``anti_windup = "hold"`` only while the limit does not act. Without a position loop the reference is
a velocity: ``vr = r``, ``ar = (r[k] - r[k-1]) / T``, ``vc = 0``, share 1. Source: the usual cascade of servo drives.
"""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from emps_design.errors import InputError
from emps_design.laws.estimators import BACKWARD, WORDS, VelocityEstimator, coefficients as of_estimator, states, taps
from emps_design.laws.law import LawKind, LawTable, velocity_in_words
from emps_design.tables import AxisTable, Finite, NonNegative, Positive, parameter

# Places in the kernel's gains; five coefficients b0, b1, b2, a1, a2 follow for each filter, then those of a velocity
# estimator with a filter.
RATE, TAPS, POSITION, EVERY, PROPORTIONAL, INTEGRAL, IP, SHARE, ACCELERATION, COULOMB = range(10)
PROFILE, FOLLOWS_VELOCITY, HOLD, FILTERS, COEFFICIENTS = range(10, 15)
# Places in its memory; two numbers follow for each filter, then the states of the estimator.
Q1, Q2, R1, R2, R3, VELOCITY_COMMAND, INTEGRATOR, FILTERED = range(8)


def cascade(k, reference, q, f_ext, limit, gains, memory):
    """Command of the law at sample k."""
    if k == 0:
        memory[Q1] = memory[Q2] = q
        # At rest before the first sample: a position reference is constant, a velocity reference is 0.
        memory[R1] = memory[R2] = memory[R3] = 0.0 if gains[FOLLOWS_VELOCITY] > 0.0 else reference
        memory[VELOCITY_COMMAND] = memory[INTEGRATOR] = 0.0
    rate = gains[RATE]
    if gains[TAPS] > 0.0:
        v = 0.5 * (q - memory[Q2]) * rate
    elif gains[TAPS] < 0.0:
        order = int(-gains[TAPS])
        first = COEFFICIENTS + 5 * int(gains[FILTERS])
        state = FILTERED + 2 * int(gains[FILTERS])
        step = (q - memory[Q1]) * rate
        v = gains[first] * step + memory[state]
        for j in range(order):
            memory[state + j] = gains[first + 1 + j] * step - gains[first + 1 + order + j] * v + memory[state + j + 1]
    else:
        v = (q - memory[Q1]) * rate
    memory[Q2] = memory[Q1]
    memory[Q1] = q
    if gains[FOLLOWS_VELOCITY] > 0.0:
        vr = reference
        direction = vr
        ar = (reference - memory[R1]) * rate
    else:
        vr = (reference - memory[R1]) * rate
        direction = vr
        ar = (reference - 2.0 * memory[R1] + memory[R2]) * rate * rate
        if gains[PROFILE] > 0.0:
            vr += 0.5 * (reference - 2.0 * memory[R1] + memory[R2]) * rate
            ar += (reference - 3.0 * memory[R1] + 3.0 * memory[R2] - memory[R3]) * rate * rate
        if k % int(gains[EVERY]) == 0:
            memory[VELOCITY_COMMAND] = gains[POSITION] * (reference - q)
    memory[R3] = memory[R2]
    memory[R2] = memory[R1]
    memory[R1] = reference
    e = memory[VELOCITY_COMMAND] + gains[SHARE] * vr - v
    integral = memory[INTEGRATOR] + gains[INTEGRAL] * e
    w = integral + gains[ACCELERATION] * ar
    if gains[IP] > 0.0:
        w -= gains[PROPORTIONAL] * v
    else:
        w += gains[PROPORTIONAL] * e
    if direction > 0.0:
        w += gains[COULOMB]
    elif direction < 0.0:
        w -= gains[COULOMB]
    for i in range(int(gains[FILTERS])):
        at = COEFFICIENTS + 5 * i
        s = FILTERED + 2 * i
        y = gains[at] * w + memory[s]
        memory[s] = gains[at + 1] * w - gains[at + 3] * y + memory[s + 1]
        memory[s + 1] = gains[at + 2] * w - gains[at + 4] * y
        w = y
    u = min(max(w, -limit), limit)
    if gains[HOLD] == 0.0 or (w <= limit and w >= -limit):
        memory[INTEGRATOR] = integral
    return u


class PositionLoop(AxisTable):
    kp: Positive = parameter("gain of the position loop", "1/s")
    every: Annotated[int, Field(ge=1, le=1000, strict=True)] = parameter(
        "the position loop runs in every n-th sample", "samples", 1
    )


class VelocityLoop(AxisTable):
    kp: Positive = parameter("gain of the velocity loop", "V/(m/s)")
    ti: Positive | None = parameter("integral time of the velocity loop, left out: no integral", "s", None)
    form: Literal["pi", "ip"] = parameter("pi: proportional to the error; ip: to the measured velocity", "", "pi")


class Feedforward(AxisTable):
    velocity: Finite = parameter("share of the reference velocity that the velocity loop is given", "", 0.0)
    acceleration: Finite = parameter("feed-forward of the acceleration", "V/(m/s^2)", 0.0)
    coulomb: Finite = parameter("feed-forward of the Coulomb friction", "V", 0.0)
    source: Literal["profile"] | None = parameter(
        "profile: velocity and acceleration of its generator, at the sample; left out: of the reference's steps",
        "",
        None,
    )


class Filter(AxisTable):
    kind: Literal["lowpass", "notch"] = parameter("lowpass or notch", "")
    frequency: Positive = parameter("corner or centre frequency", "Hz")
    damping: Positive | None = parameter("damping of a notch, half its relative width", "", None)
    depth: Annotated[NonNegative, Field(le=1.0)] | None = parameter("gain of a notch at its centre", "", None)

    @model_validator(mode="after")
    def _complete(self):
        for name in ("damping", "depth"):
            if (getattr(self, name) is None) == (self.kind == "notch"):
                expected = f"a number: a notch has {name}" if self.kind == "notch" else f"no {name} of a low-pass"
                raise ValueError(f"{name}: found {getattr(self, name)}, expected {expected}")
        return self


class Table(LawTable):
    position: PositionLoop | None = parameter("position loop, left out: the reference is a velocity", "", None)
    velocity: VelocityLoop = parameter("velocity loop", "")
    feedforward: Feedforward | None = parameter("feed-forward of the reference", "", None)
    filters: tuple[Filter, ...] = parameter("filters of the command, in this order", "", ())
    anti_windup: Literal["hold", "none"] = parameter("hold: no integration while the limit acts", "", "hold")
    velocity_estimator: VelocityEstimator = parameter(WORDS, "", BACKWARD)

    @model_validator(mode="after")
    def _velocity_share(self):
        if self.position is None and self.feedforward is not None and self.feedforward.source is not None:
            raise ValueError(
                'feedforward.source: found "profile", expected none: without a position loop it is a velocity'
            )
        if self.position is None and self.feedforward is not None and self.feedforward.velocity not in (0.0, 1.0):
            raise ValueError(
                f"feedforward.velocity: found {self.feedforward.velocity:g}, expected 1: without a position loop the "
                "reference is the velocity"
            )
        return self


def coefficients(stage, period):
    """Coefficients b0, b1, b2, a1, a2 of a filter at a sampling ``period`` [s], by the bilinear transform.

    >>> [round(value, 4) for value in coefficients(Filter(kind="lowpass", frequency=350.0), 0.25e-3)]
    [0.2156, 0.2156, 0.0, -0.5688, 0.0]
    """
    c = math.pi * stage.frequency * period  # w0 T / 2
    if stage.kind == "lowpass":
        return c / (1.0 + c), c / (1.0 + c), 0.0, (c - 1.0) / (1.0 + c), 0.0
    if stage.frequency * period >= 0.5:
        raise InputError(
            f"filters: found a notch at {stage.frequency:g} Hz, expected one below the Nyquist frequency, "
            f"{0.5 / period:g} Hz"
        )
    wide, deep = 2.0 * stage.damping * c, 2.0 * stage.depth * stage.damping * c
    first, whole = 2.0 * (c * c - 1.0), 1.0 + wide + c * c
    return (
        (1.0 + deep + c * c) / whole, first / whole, (1.0 - deep + c * c) / whole, first / whole,
        (1.0 - wide + c * c) / whole,
    )  # fmt: skip


def filter_polynomials(stage, period):
    """Numerator and denominator in z, highest power first, of a filter at a sampling ``period`` [s].

    >>> numerator, denominator = filter_polynomials(Filter(kind="lowpass", frequency=350.0), 0.25e-3)
    >>> [round(value, 4) for value in numerator], [round(value, 4) for value in denominator]
    ([0.2156, 0.2156], [1.0, -0.5688])
    """
    b0, b1, b2, a1, a2 = coefficients(stage, period)
    return ([b0, b1], [1.0, a1]) if stage.kind == "lowpass" else ([b0, b1, b2], [1.0, a1, a2])


def gains(p, axis, period):
    ahead, integral = p.feedforward or Feedforward(), p.velocity.kp * period / p.velocity.ti if p.velocity.ti else 0.0
    return (
        1.0 / period, taps(p.velocity_estimator),
        p.position.kp if p.position else 0.0, p.position.every if p.position else 1,
        p.velocity.kp, integral, float(p.velocity.form == "ip"),
        ahead.velocity if p.position else 1.0, ahead.acceleration, ahead.coulomb,
        float(ahead.source == "profile"), float(p.position is None), float(p.anti_windup == "hold"), len(p.filters),
        *(number for stage in p.filters for number in coefficients(stage, period)),
        *of_estimator(p.velocity_estimator, period),
    )  # fmt: skip


def _terms(*terms):
    """A sum in words of the ``terms``, pairs of a factor and what it multiplies, without those whose factor is 0."""
    texts = [f"{factor:.10g} * {what}" if factor != 1.0 else what for factor, what in terms if factor != 0.0]
    return " + ".join(texts).replace("+ -", "- ")


def equations(p, axis, period):
    g, limit = gains(p, axis, period), f"{axis.drive.command_limit:.10g}"
    lines, follows_velocity = [velocity_in_words(p, period)], p.position is None
    reference, direction = "0", "vr[k]"
    if follows_velocity:
        lines += ["vr[k] = v_ref[k]", f"ar[k] = (v_ref[k] - v_ref[k-1]) / {period:.10g}"]
    else:
        velocity, acceleration = "q_ref[k] - q_ref[k-1]", "q_ref[k] - 2 * q_ref[k-1] + q_ref[k-2]"
        if g[PROFILE]:
            velocity = "1.5 * q_ref[k] - 2 * q_ref[k-1] + 0.5 * q_ref[k-2]"
            acceleration = "2 * q_ref[k] - 5 * q_ref[k-1] + 4 * q_ref[k-2] - q_ref[k-3]"
            direction = "q_ref[k] - q_ref[k-1]"
        lines += [f"vr[k] = ({velocity}) / {period:.10g}", f"ar[k] = ({acceleration}) / {period**2:.10g}"]
        every = f"if k % {p.position.every} == 0: " if p.position.every > 1 else ""
        lines.append(f"{every}vc[k] = {g[POSITION]:.10g} * (q_ref[k] - q[k])")
        lines += ["else: vc[k] = vc[k-1]"] if every else []
        reference = "vc[k]"
    command_term = [(1.0, reference)] if reference != "0" else []
    lines.append(f"e[k] = {_terms(*command_term, (g[SHARE], 'vr[k]'))} - v[k]")
    if p.velocity.ti:
        lines.append(f"j[k] = i[k-1] + {g[INTEGRAL]:.10g} * e[k]")
    proportional = (-g[PROPORTIONAL], "v[k]") if g[IP] else (g[PROPORTIONAL], "e[k]")
    integral = [(1.0, "j[k]")] if p.velocity.ti else []
    ahead = (g[ACCELERATION], "ar[k]"), (g[COULOMB], f"sign({direction})")
    lines.append(f"w0[k] = {_terms(proportional, *integral, *ahead)}")
    for i, stage in enumerate(p.filters):
        b0, b1, b2, a1, a2 = coefficients(stage, period)
        terms = (b0, f"w{i}[k]"), (b1, f"w{i}[k-1]"), (b2, f"w{i}[k-2]")
        lines.append(f"w{i + 1}[k] = {_terms(*terms, (-a1, f'w{i + 1}[k-1]'), (-a2, f'w{i + 1}[k-2]'))}")
    last = f"w{len(p.filters)}[k]"
    lines += [f"u[k] = {last}", f"if u[k] >  {limit}: u[k] =  {limit}", f"if u[k] < -{limit}: u[k] = -{limit}"]
    if p.velocity.ti:
        lines.append(f"i[k] = j[k]{f' if u[k] == {last} else i[k-1]' if g[HOLD] else ''}")
    return tuple(lines)


def loops(p):
    inner = p.model_copy(update={"position": None, "feedforward": None})
    if p.position is None:
        return (("velocity loop", inner),)
    return ("velocity loop", inner), ("position loop", p.model_copy(update={"feedforward": None}))


LAW: LawKind[object] = LawKind(
    name="cascade",
    label="cascade of a position and a velocity loop",
    source="servo drives",
    table=Table,
    kernel=cascade,
    gains=gains,
    memory=lambda p, axis: FILTERED + 2 * len(p.filters) + states(taps(p.velocity_estimator)),
    equations=equations,
    follows=lambda p: "velocity" if p.position is None else "position",
    cycle=lambda p: 1 if p.position is None else p.position.every,
    loops=loops,
    gain="velocity.kp",
    integral=lambda p: INTEGRATOR if p.velocity.ti and p.anti_windup == "hold" else None,
)
