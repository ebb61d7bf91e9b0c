"""A drive with hidden physics, in fixed 20 us sub-steps with a stick test in every one.

Written apart from ``emps_design.simulation`` and sharing nothing with it, so that the two can disagree: semi-implicit
Euler steps, friction by a test of sign, no events. Numbers come as one flat array, named by ``NAMES``; a size of zero
leaves an effect out.
"""

from __future__ import annotations

import math

import numba
import numpy as np

STEP = 20e-6  # s

NAMES = (
    "asymmetric",  # N/(m/s), times |v|
    "quadratic",  # N/(m/s)^2, times v |v|
    "stribeck_excess",  # N
    "stribeck_velocity",  # m/s
    "dahl_stiffness",  # N/m
    "load_share",  # of |tau - offset|
    "travel_amplitude",  # N, Coulomb level over position
    "travel_length",  # m
    "travel_phase",  # rad
    "drift_change",
    "drift_time",  # s
    "ripple_amplitude",  # N
    "ripple_period",  # m
    "ripple_phase",  # rad
    "spring",  # N/m
    "spring_rest",  # m
    "stop_stiffness",  # N/m
    "stop_position",  # m
    "stop_side",  # +1 or -1
    "mass_change",
    "mass_time",  # s
    "pulse_force",  # N, towards +q
    "pulse_start",  # s
    "pulse_length",  # s
    "pulse_every",  # s, 0: once
    "hum_amplitude",  # N, towards +q
    "hum_frequency",  # Hz
    "hum_phase",  # rad
    "load_part",  # share of the mass behind a coupling
    "coupling_frequency",  # Hz
    "coupling_damping",
    "gap",  # m
    "delay",  # s
    "lag",  # s
    "clip",  # V
    "dead",  # V
    "encoder_amplitude",  # m
    "encoder_period",  # m
    "encoder_phase",  # rad
    "wave_voltage",  # V
    "wave_frequency",  # Hz
    "wave_duty",
    "wave_start",  # s
    # physics that no library has
    "ageing",  # N, dry friction that grows at rest and goes with sliding
    "cross",  # N/(m m/s), viscous friction that grows along the travel
    "wake",  # N, drags towards where the carriage was heading in the last 0.3 s
    "middle",  # m, where the cross term is zero
    "arm_torque",  # N m, weight of an arm, of an axis that turns
    "arm_angle",  # rad, from hanging at the encoder's zero
    "slip_share",  # of the dry friction, added as an element that lags behind reversals
    "slip_travel",  # m
    "rub_amplitude",  # N, dry friction that repeats along the travel
    "rub_period",  # m
    "rub_phase",  # rad
    "map_start",  # m, of the curves over the travel that follow
    "map_end",  # m
    *(f"pull_{i}" for i in range(1, 7)),  # N, against +q
    *(f"wear_{i}" for i in range(1, 7)),  # N, of the dry friction
    # more physics that no library has
    "crank",  # share of the mass that comes and goes along the travel
    "crank_length",  # m
    "magnet",  # N/(m/s), a brake in one zone of the travel, moving forwards
    "magnet_width",  # m
    "thixotropy",  # N, dry friction that a speed held for a while takes away
    # and of what the library has
    "load_before",  # share of viscous and Coulomb friction that the motor overcomes before the gear
    "far_rub",  # share of viscous and Coulomb friction on the mass behind the coupling
    "winding",  # N/(m/s), what the closed winding brakes
    "off_from",  # s, in which the winding is open
    "off_to",  # s
    "load_carried",  # N, what of the offset the gear carries: a weight
)
PLACE = {name: index for index, name in enumerate(NAMES)}


def numbers(**values: float) -> np.ndarray:
    """The flat array of ``simulate`` with ``values`` by name, everything else zero."""
    unknown = set(values) - set(NAMES)
    if unknown:
        raise KeyError(f"no such number of the plant: {', '.join(sorted(unknown))}")
    return np.array([float(values.get(name, 0.0)) for name in NAMES])


@numba.njit(cache=True)
def curve(q, start, end, heights):
    """Smooth curve through 0 and six ``heights`` at even distances, flat outside: Bernstein form, piece by piece."""
    x = min(max(6.0 * (q - start) / (end - start), 0.0), 6.0)
    i = min(int(x), 5)
    s = x - i
    knots = np.zeros(7)
    knots[1:] = heights
    rise_a = (knots[i + 1] - knots[i - 1]) / 6.0 if i > 0 else 0.0
    rise_b = (knots[i + 2] - knots[i]) / 6.0 if i < 5 else 0.0
    a, d = knots[i], knots[i + 1]
    r = 1.0 - s
    return a * r**3 + 3.0 * (a + rise_a) * r * r * s + 3.0 * (d - rise_b) * r * s * s + d * s**3


@numba.njit(cache=True)
def simulate(q_ref, period, drive, resolution, law, p, voltage_noise, force_noise):
    """Run the closed loop along ``q_ref`` (n,) [m]; returns encoder position (n,) [m] and recorded voltage (n,) [V].

    ``drive``: mass [kg], viscous [N/(m/s)], coulomb [N], offset [N], G_tau [N/V], voltage limit [V].
    ``law``: kp [1/s], kv [V/(m/s)]. Noise: (n,) [V] after the controller, (n,) [N] on the carriage.
    """
    (
        asymmetric, quadratic, excess, v_stribeck, dahl, load_share, travel_a, travel_l, travel_p, drift, drift_t,
        ripple_a, ripple_l, ripple_p, spring, spring_rest, stop_k, stop_q, stop_s, mass_change, mass_t,
        pulse_a, pulse_t, pulse_d, pulse_e, hum_a, hum_f, hum_p, part, f_c, zeta, gap, delay, lag, clip, dead,
        enc_a, enc_l, enc_p, wave_u, wave_f, wave_d, wave_t, ageing, cross, wake, middle,
        arm_torque, arm_angle, slip_share, slip_l, rub_a, rub_l, rub_p, map_start, map_end,
    ) = (
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10],
        p[11], p[12], p[13], p[14], p[15], p[16], p[17], p[18], p[19], p[20],
        p[21], p[22], p[23], p[24], p[25], p[26], p[27], p[28], p[29], p[30], p[31], p[32], p[33], p[34], p[35],
        p[36], p[37], p[38], p[39], p[40], p[41], p[42], p[43], p[44], p[45], p[46],
        p[47], p[48], p[49], p[50], p[51], p[52], p[53], p[54], p[55],
    )  # fmt: skip
    mass, viscous, coulomb, offset, gain, limit = drive[0], drive[1], drive[2], drive[3], drive[4], drive[5]
    kp, kv = law[0], law[1]
    n, tau_2 = len(q_ref), 2.0 * math.pi
    pull, wear = p[56:62], p[62:68]
    crank, crank_length, magnet, magnet_width, thixotropy = p[68], p[69], p[70], p[71], p[72]
    load_before, far_rub, winding, off_from, off_to, carried = p[73], p[74], p[75], p[76], p[77], p[78]
    mapped, slipped = map_end > map_start, 0.0
    steps = round(period / STEP)
    h = period / steps
    late = round(delay / h)
    whole, rest = late // steps, late % steps
    q_out, u_out, forces = np.zeros(n), np.zeros(n), np.zeros(n)
    q, v, q2, v2, z, acting, old, aged, thin = q_ref[0], 0.0, q_ref[0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    before, filtered_before = 0.0, 0.0
    for k in range(n):
        seen = q
        if enc_a != 0.0:
            seen += enc_a * math.sin(tau_2 * q / enc_l + enc_p)
        if resolution > 0.0:
            seen = round(seen / resolution) * resolution
        if k == 0:
            before, filtered_before = seen, seen
        filtered = 0.5 * (seen + before)
        u = kp * kv * (q_ref[k] - seen) - kv * (filtered - filtered_before) / period
        before, filtered_before = seen, filtered
        if wave_u != 0.0:
            turns = (k * period - wave_t) * wave_f + 1e-9
            if turns - math.floor(turns) < wave_d:
                u += wave_u
        u = min(limit, max(-limit, u + voltage_noise[k]))
        q_out[k], u_out[k] = seen, u
        if clip > 0.0:
            u = min(clip, max(-clip, u))
        if dead > 0.0:
            u = math.copysign(max(0.0, abs(u) - dead), u)
        closed = not off_from <= k * period < off_to
        forces[k] = gain * u if closed else 0.0
        for s in range(steps):
            t = k * period + (s + 0.5) * h
            place = k - whole - (1 if s < rest else 0)
            tau = forces[place] if place >= 0 else 0.0
            if lag > 0.0:
                acting += (tau - acting) * (1.0 - math.exp(-h / lag))
                tau = acting
            m = mass
            if mass_change != 0.0 and t > mass_t:
                m = mass * (1.0 + mass_change)
            if crank != 0.0:  # the force of a mass that depends on position: m a + m' v^2 / 2
                turn = tau_2 * (q - middle) / crank_length
                m *= 1.0 + crank * math.sin(turn)
            warm = 1.0
            if drift != 0.0:
                warm = 1.0 + drift * (1.0 - math.exp(-t / drift_t))
            f = tau - offset - warm * viscous * v + force_noise[k]
            if closed:
                f -= winding * v
            f -= asymmetric * abs(v) + quadratic * v * abs(v) + spring * (q - spring_rest)
            f -= arm_torque * math.sin(q + arm_angle)
            if mapped:
                f -= curve(q, map_start, map_end, pull)
            if slip_share != 0.0:
                slipped = math.copysign(1.0, v) + (slipped - math.copysign(1.0, v)) * math.exp(-abs(v) * h / slip_l)
                f -= slip_share * coulomb * slipped
            if ripple_a != 0.0:
                f -= ripple_a * math.sin(tau_2 * q / ripple_l + ripple_p)
            if stop_k > 0.0 and stop_s * (q - stop_q) > 0.0:
                f -= stop_k * (q - stop_q)
            if pulse_a != 0.0 and t >= pulse_t:
                since = t - pulse_t
                if pulse_e > 0.0:
                    since -= pulse_e * math.floor(since / pulse_e)
                if since < pulse_d:
                    f += pulse_a
            if hum_a != 0.0:
                f += hum_a * math.sin(tau_2 * hum_f * t + hum_p)
            f -= cross * (q - middle) * v
            if crank != 0.0:
                f -= 0.5 * mass * crank * tau_2 / crank_length * math.cos(turn) * v * v
            if magnet != 0.0 and v > 0.0:
                f -= magnet * v * math.exp(-(((q - middle) / magnet_width) ** 2))
            if wake != 0.0:
                old += (math.tanh(v / 0.02) - old) * h / 0.3
                f += wake * old
            level = warm * coulomb
            if excess != 0.0:
                level += excess * math.exp(-abs(v) / v_stribeck)
            if load_share != 0.0:
                heading = v if v != 0.0 else f
                lost = load_before * (viscous * v + math.copysign(coulomb, heading))
                level += load_share * abs(tau - offset + carried - lost)
            if travel_a != 0.0:
                level += travel_a * math.sin(tau_2 * q / travel_l + travel_p)
            if rub_a != 0.0:
                level += rub_a * math.sin(tau_2 * q / rub_l + rub_p)
            if mapped:
                level += curve(q, map_start, map_end, wear)
            if ageing != 0.0:
                aged += ((0.0 if abs(v) > 1e-4 else 1.0) - aged) * h / (0.6 if abs(v) > 1e-4 else 0.05)
                level += ageing * aged
            if thixotropy != 0.0:
                thin += (abs(v) / (abs(v) + 0.05) - thin) * h / 0.4
                level += thixotropy * (1.0 - thin)
            if far_rub != 0.0:
                f += far_rub * viscous * v
                level -= far_rub * coulomb
            level = max(0.0, level)
            inertia = m
            if part > 0.0:
                w = tau_2 * f_c
                reduced = m * part * (1.0 - part)
                inertia, other = m * (1.0 - part), m * part
                d, contact = q - q2, 0.0
                if gap == 0.0 or abs(d) > 0.5 * gap:
                    bite = d - math.copysign(0.5 * gap, d)
                    contact = reduced * w * w * bite + 2.0 * zeta * reduced * w * (v - v2)
                f -= contact
                far, far_level = contact - far_rub * viscous * v2, far_rub * coulomb
                if v2 == 0.0:
                    v2 = h * math.copysign(max(0.0, abs(far) - far_level), far) / other
                else:
                    after = v2 + h * (far - math.copysign(far_level, v2)) / other
                    v2 = 0.0 if after * v2 < 0.0 and far_level > 0.0 else after
                q2 += h * v2
            if dahl > 0.0:
                # exact over the sub-step for its speed: the bristle relaxes to L sign(v) over L / stiffness of travel
                end = math.copysign(level / dahl, v)
                z = end + (z - end) * math.exp(-dahl * abs(v) * h / max(level, 1e-9))
                v += h * (f - dahl * z) / inertia
            elif v == 0.0:
                if abs(f) > level:
                    v = h * (f - math.copysign(level, f)) / inertia
            else:
                moved = v + h * (f - math.copysign(level, v)) / inertia
                v = 0.0 if moved * v < 0.0 else moved
            q += h * v
    return q_out, u_out
