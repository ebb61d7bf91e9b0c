"""The same replay by others: C compiled here, and python-control with the same exact step as one nlsys."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
import warnings
from pathlib import Path

import numpy as np

from emps_design.laws import table_of
from emps_design.laws.library.cascade import coefficients


def compiled_c():
    """The C yardsticks of position_pd and of a cascade, callables of (q_ref, axis, q0), or why there are none."""
    compiler = next((name for name in ("gcc", "cc", "clang") if shutil.which(name)), None)
    if compiler is None:
        return "no C compiler here"
    folder = Path(tempfile.mkdtemp(prefix="emps-bench-"))
    library = folder / "replay.so"
    source = Path(__file__).with_name("replay.c")
    command = [compiler, "-O3", "-march=native", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True)
    if built.returncode:
        return f"{compiler} failed: {built.stderr.splitlines()[0]}"
    functions, pointer = ctypes.CDLL(str(library)), ctypes.POINTER(ctypes.c_double)
    number, count = ctypes.c_double, ctypes.c_long
    functions.replay.argtypes = [count, pointer, pointer, *[number] * 6, *[pointer] * 5]
    functions.replay_cascade.argtypes = [
        count, pointer, pointer, *[number] * 4, count, *[number] * 5, count, pointer, number, *[pointer] * 5
    ]  # fmt: skip
    functions.replay.restype = functions.replay_cascade.restype = count

    def address(array: np.ndarray):
        return array.ctypes.data_as(pointer)

    def run(function, law, q_ref: np.ndarray, axis, q0: float) -> dict[str, np.ndarray]:
        n, drive = q_ref.size, axis.drive
        position, encoder, velocity, u = np.empty((4, n))
        events, baseline = np.empty((n + 1000, 3)), axis.mechanics.array()
        found = function(
            n, address(q_ref), address(baseline), axis.sampling.period, drive.force_gain, drive.command_limit, *law, q0,
            address(position), address(encoder), address(velocity), address(u), address(events),
        )  # fmt: skip
        return {"position": position, "u": u, "events": events[:found]}

    def position_pd(q_ref: np.ndarray, axis, q0: float) -> dict[str, np.ndarray]:
        return run(functions.replay, (axis.controller.kp, axis.controller.kv), q_ref, axis, q0)

    def cascade(q_ref: np.ndarray, axis, q0: float) -> dict[str, np.ndarray]:
        p, period = table_of(axis), axis.sampling.period
        numbers = np.array([coefficients(one, period) for one in p.filters]).ravel()
        velocity, ahead = p.velocity, p.feedforward
        law = (
            p.position.kp, p.position.every, velocity.kp, velocity.kp * period / velocity.ti, ahead.velocity,
            ahead.acceleration, ahead.coulomb, len(p.filters), address(numbers),
        )  # fmt: skip
        return run(functions.replay_cascade, law, q_ref, axis, q0)

    return position_pd, cascade


def python_control():
    """python-control's input_output_response of the exact step as one discrete nlsys, or why there is none."""
    try:
        import control
    except ImportError:
        return "python-control is not installed"

    def replay(q_ref: np.ndarray, axis, q0: float) -> dict[str, np.ndarray]:
        mass, viscous, dry, offset = axis.mechanics.array()
        a, period, gain = viscous / mass, axis.sampling.period, axis.drive.force_gain
        limit, kp, kv = axis.drive.command_limit, axis.controller.kp, axis.controller.kv
        decay = np.exp(-a * period)
        g1 = -np.expm1(-a * period) / a
        g2 = (period - g1) / a

        def volts(x, wanted):
            return min(max(kp * kv * (wanted - x[0]) - kv * (x[0] - x[3]) / (2.0 * period), -limit), limit)

        def update(t, x, inputs, parameters):
            q, v, last, _ = x
            net = gain * volts(x, inputs[0]) - offset
            if v == 0.0 and abs(net) <= dry:
                return np.array([q, 0.0, q, last])
            if v != 0.0:
                f = (net - dry if v > 0 else net + dry) / mass
                new = v * decay + f * g1
                if new * v > 0.0:
                    return np.array([q + v * g1 + f * g2, new, q, last])
                at = np.log1p(-a * v / f) / a
                part = -np.expm1(-a * at) / a
                stop = q + v * part + f * (at - part) / a
            else:
                at, stop = 0.0, q
            if abs(net) <= dry:
                return np.array([stop, 0.0, q, last])
            f = (net - dry if net > 0 else net + dry) / mass
            part = -np.expm1(-a * (period - at)) / a
            return np.array([stop + f * (period - at - part) / a, f * part, q, last])

        system = control.nlsys(
            update, lambda t, x, u, p: np.array([x[0], volts(x, u[0])]), inputs=1, outputs=2, states=4, dt=period
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            t = np.arange(q_ref.size) * period
            answer = control.input_output_response(system, t, q_ref, np.array([q0, 0.0, q0, q0]))
        return {"position": answer.outputs[0], "u": answer.outputs[1]}

    return replay
