"""What every effect promises, run over all of them: units, bounds, kernels, regressors, symbols, recovery."""

import inspect
import math
import pkgutil

import numpy as np
import pytest

from emps_design.effects import EFFECTS, Motion, library as package
from emps_design.effects.effect import CHECK_BASELINE, MASS, SCALAR_HOOKS, VISCOUS
from tests.inverse_model import states_along

B = np.array(CHECK_BASELINE)
UNITS = {"", "N", "N/m", "N/(m/s)", "N/(m/s)^2", "m", "m/s", "s", "Hz", "rad", "V"}
ARGUMENTS = ["q", "v", "t", "tau", "x", "p", "b"]
all_effects = pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)


def typical(effect):
    """The parameters of the effect's first check."""
    return effect.checks[0][0]


def points(effect, count=40):
    """Random points of the motion, some of them at rest and at exact zeros."""
    rng = np.random.default_rng(len(effect.name))
    for k in range(count):
        yield {
            "q": rng.uniform(-0.3, 0.4),
            "v": 0.0 if k % 10 == 9 else rng.uniform(-0.4, 0.4),
            "t": 0.0 if k == 0 else rng.uniform(0, 20),
            "tau": rng.uniform(-200, 200),
            "x": tuple(rng.uniform(-1e-4, 1e-4, len(effect.states))),
        }


def stroke_motion(count=4000, period=1e-3):
    """A smooth motion with reversals, and the force a 100 kg axis would need for it."""
    t = np.arange(count) * period
    w = 2 * math.pi * 0.7
    q, v, a = 0.1 * (1 - np.cos(w * t)), 0.1 * w * np.sin(w * t), 0.1 * w**2 * np.cos(w * t)
    tau = B[MASS] * a + B[VISCOUS] * v + 20.0 * np.sign(v) - 5.0
    return Motion(t=t, q=q, v=v, a=a, tau=tau, period=period, force_gain=35.0)


def test_the_list_is_the_folder():
    files = {module.name for module in pkgutil.iter_modules(package.__path__)}
    assert files == {effect.name for effect in EFFECTS}
    assert len(EFFECTS) == len(files) >= 21


@all_effects
def test_words_units_and_bounds(effect):
    for text in (
        effect.label,
        effect.equation,
        effect.source,
        effect.words.where,
        effect.words.experiment,
        effect.words.remedy,
    ):
        assert text
        assert "TODO" not in text
    hook = next(effect.hook(name) for name in (*SCALAR_HOOKS, "actuator") if effect.hook(name) is not None)
    assert len(inspect.getdoc(inspect.getmodule(hook)).splitlines()) >= 3
    assert len({p.name for p in effect.parameters}) == len(effect.parameters) > 0
    for p in effect.parameters:
        assert p.unit in UNITS
        assert p.symbol
        assert p.text
        assert p.lower < p.upper
        assert all(p.lower <= start <= p.upper for start in p.starts)
        assert p.starts or p.scale > 0, f"{p.name} has neither starts nor a scale"
        assert not p.discrete or p.starts
        assert p.linear or p.starts or p.per_record or effect.search.propose or p.scale


@all_effects
def test_confused_with_names_effects_and_not_itself(effect):
    names = {other.name for other in EFFECTS}
    assert set(effect.search.confused_with) <= names - {effect.name}
    assert effect.search.confused_with


@all_effects
def test_kernels_have_the_common_arguments(effect):
    for name in SCALAR_HOOKS:
        kernel = effect.hook(name)
        if kernel is not None:
            assert list(inspect.signature(kernel).parameters) == ARGUMENTS
    if effect.actuator is not None:
        assert list(inspect.signature(effect.actuator).parameters) == ["u", "p"]
    if effect.rate is not None:
        assert list(inspect.signature(effect.rate).parameters) == [*ARGUMENTS, "level", "dx"]
        assert effect.at_rest(0.1, effect.values(typical(effect)), B).shape == (len(effect.states),)


@all_effects
def test_points_computed_by_hand(effect):
    assert len(effect.checks) >= 2
    for parameters, point, value in effect.checks:
        assert effect.contribution(parameters, B, **point) == pytest.approx(value, rel=1e-12, abs=1e-12)


@all_effects
def test_finite_everywhere_and_at_rest(effect):
    p = effect.values(typical(effect))
    for point in [*points(effect), {"q": 0.0, "v": 0.0, "t": 0.0, "tau": 0.0, "x": (0.0,) * len(effect.states)}]:
        for name in SCALAR_HOOKS:
            kernel = effect.hook(name)
            if kernel is not None:
                value = kernel(*(point[key] for key in ARGUMENTS[:5]), p, B)
                assert isinstance(value, float)
                assert math.isfinite(value) or (name == "jump_time" and value == math.inf)
        if effect.actuator is not None:
            assert math.isfinite(effect.actuator(point["v"] * 20, p))
        if effect.rate is not None:
            dx = [math.nan] * len(effect.states)
            effect.rate(*(point[key] for key in ARGUMENTS[:5]), p, B, 20.0, dx)
            assert all(math.isfinite(d) for d in dx)


def having(*hooks):
    """Run over the effects that have one of ``hooks``."""
    chosen = [effect for effect in EFFECTS if any(effect.hook(hook) is not None for hook in hooks)]
    return pytest.mark.parametrize("effect", chosen, ids=lambda effect: effect.name)


@having("force")
def test_continuous_in_velocity_at_rest_but_for_the_dry_part(effect):
    p = effect.values(typical(effect))
    for point in points(effect, 10):
        q, t, tau, x = point["q"], point["t"], point["tau"], point["x"]
        up, down = (effect.force(q, v, t, tau, x, p, B) for v in (1e-9, -1e-9))
        assert up == pytest.approx(down, abs=1e-4)


@all_effects
def test_declared_parity(effect):
    parameters = typical(effect)
    if not effect.claims.parity:
        assert effect.channel != "plant" or effect.states or effect.inertia, "a plain force should declare its parity"
        return
    sign = {"odd": -1.0, "even": 1.0}[effect.claims.parity]
    for point in points(effect):
        mirrored = {**point, "v": -point["v"]}
        assert effect.contribution(parameters, B, **mirrored) == pytest.approx(
            sign * effect.contribution(parameters, B, **point), abs=1e-12
        )


@all_effects
def test_what_is_said_to_repeat_repeats(effect):
    """A force or an error of the reading that repeats along the travel says so: its slope is then no spring."""
    parameters = typical(effect)
    if not effect.repeats:
        assert not any(p.unit == "m" and p.text.startswith("travel after which") for p in effect.parameters)
        return
    assert parameters[effect.repeats] > 0.0
    for point in points(effect):
        later = {**point, "q": point["q"] + parameters[effect.repeats]}
        assert effect.contribution(parameters, B, **later) == pytest.approx(
            effect.contribution(parameters, B, **point), rel=1e-9, abs=1e-12
        )


@all_effects
def test_declared_passivity(effect):
    """Work taken over motions that end where they began, at rest; a spring may lend, nothing may give."""
    if effect.channel != "plant":
        assert not effect.claims.passive
        return
    rng = np.random.default_rng(11)
    least = math.inf
    for trial in range(4):
        t = np.linspace(0.0, 3.0, 1501)
        amplitude = rng.uniform(-1, 1, 4) * (0.1 if trial % 2 else 0.01)
        basis = np.array([np.sin(math.pi * t / 3.0) ** 2 * np.sin(math.pi * k * t / 3.0) for k in (1, 2, 3, 5)])
        q = 0.1 + amplitude @ basis
        v = np.gradient(q, t)
        tau = np.gradient(v, t) * B[MASS] + 20 * np.sign(v)
        for parameters, _, _ in effect.checks:
            p = effect.values(parameters)
            x = states_along(effect, p, B, (), q, v, t)
            force = np.array(
                [
                    (effect.force(*now, own, p, B) if effect.force else 0.0)
                    + (effect.dry(*now, own, p, B) * np.sign(now[1]) if effect.dry else 0.0)
                    for *now, own in zip(q, v, t, tau, x, strict=True)
                ]
            )
            taken = float(np.trapezoid(force * v, t))
            if effect.inertia is not None:  # the load's own motion holds the rest of the energy
                mass = np.array([effect.inertia(*now, own, p, B) for *now, own in zip(q, v, t, tau, x, strict=True)])
                taken += float(np.trapezoid(mass * np.gradient(v, t) * v, t))
            scale = float(np.trapezoid(np.abs(force * v), t)) + 1e-12
            least = min(least, taken / scale)
    if effect.claims.passive:
        assert least > -1e-3
    else:
        assert least < 1e-3, "it never gave work back: declare it passive, or give a check that shows it"


@all_effects
def test_regressor_times_coefficients_is_the_kernel(effect):
    # Differences of a measured position stand for derivatives in the check of a sensor, and want short steps.
    motion = stroke_motion(40000, 1e-4) if effect.sensor is not None else stroke_motion()
    if effect.regressor is None:
        assert not effect.linear
        return
    every = {tuple(parameters.items()): parameters for parameters, *_ in effect.checks}
    for parameters in every.values() if effect.channel == "plant" else (typical(effect),):
        assert_regressor_gives_the_kernel(effect, parameters, motion)


def assert_regressor_gives_the_kernel(effect, parameters, motion):
    shape = {name: parameters[name] for name in effect.shape}
    columns = effect.regressor(motion, shape, B)
    assert columns.shape == (motion.t.size, len(effect.linear))
    coefficients = effect.coefficients(parameters)
    extra = columns @ coefficients
    back = effect.from_coefficients(coefficients, shape)
    assert back.keys() == set(parameters)
    assert all(back[name] == pytest.approx(parameters[name], abs=1e-12) for name in parameters)
    p = effect.values(parameters)
    if effect.channel == "plant":
        rows = zip(motion.q.tolist(), motion.v.tolist(), motion.t.tolist(), motion.tau.tolist(), strict=True)
        kernel = np.array([effect.contribution(parameters, B, q=q, v=v, t=t, tau=tau) for q, v, t, tau in rows])
        if effect.force is None and effect.dry is None:
            kernel = kernel * motion.a
        np.testing.assert_allclose(extra, kernel, atol=1e-9)
        return
    # The others by what they do to the force balance, away from the jumps of the Coulomb friction.
    smooth = np.abs(np.gradient(np.sign(motion.v))) == 0
    smooth[:5] = smooth[-5:] = False
    if effect.sensor is not None:
        error = np.array([effect.sensor(q, 0.0, 0.0, 0.0, (), p, B) for q in motion.q])
        rate = motion.derivative(error)
        expected = -(B[MASS] * motion.derivative(rate) + B[VISCOUS] * rate)
    elif effect.actuator is not None:
        gain = motion.force_gain
        expected = motion.tau - gain * np.array([effect.actuator(u, p) for u in motion.tau / gain])
        smooth &= np.abs(motion.tau) > gain * parameters["width"]
    else:  # a delay looks ahead; a lag holds tau - f, with f the force of the motion
        late = parameters.get("delay", parameters.get("time_constant"))
        expected = np.interp(motion.t + late, motion.t, motion.tau) - motion.tau
        smooth &= np.abs(np.interp(motion.t + late, motion.t, np.sign(motion.v)) - np.sign(motion.v)) == 0
    assert smooth.sum() > 3000
    size = np.abs(expected[smooth]).max() + 1e-9
    np.testing.assert_allclose(extra[smooth], expected[smooth], atol=0.02 * size)


@all_effects
def test_symbols_equal_the_kernel(effect):
    sympy = pytest.importorskip("sympy")
    if effect.expression is None:
        assert effect.states, "only own states excuse a missing expression"
        return
    names = [sympy.Symbol(name, real=True) for name in ("q", "v", "t", "tau")]
    symbols = {p.name: sympy.Symbol(p.name, real=True) for p in effect.parameters}
    b = [sympy.Symbol(name, positive=True) for name in ("M", "F_v", "F_c", "offset")]
    given = effect.expression(*names, symbols, b)
    function = sympy.lambdify([*names, *symbols.values(), *b], given, "math", cse=False)
    for parameters, _, _ in effect.checks:
        for point in points(effect, 20):
            u = 0.05 * point["tau"]
            fourth = u if effect.actuator is not None else point["tau"]
            value = function(point["q"], point["v"], point["t"], fourth, *(parameters[n] for n in symbols), *B)
            assert float(value) == pytest.approx(effect.contribution(parameters, B, u=u, **point), abs=1e-9)


@having("jump_time")
def test_jumps_in_time_are_where_the_kernel_says(effect):
    for parameters, _, _ in effect.checks:
        p, t, kernel = effect.values(parameters), 0.0, effect.force or effect.inertia
        jumps = []
        while t < 20.0 and math.isfinite(t):
            t = effect.solver.jump_time(0.0, 0.1, t, 0.0, (), p, B)
            jumps.append(t)
        assert np.all(np.diff(jumps[:-1]) > 0)
        for jump in jumps[:-1]:
            before, at, after = (kernel(0.0, 0.1, jump + d, 0.0, (), p, B) for d in (-1e-6, 0.0, 1e-6))
            assert at == after != before


@all_effects
def test_plain_data(effect):
    import json

    table = json.loads(json.dumps(effect.to_dict(), allow_nan=False))
    assert table["name"] == effect.name
    assert [row["name"] for row in table["parameters"]] == [p.name for p in effect.parameters]
