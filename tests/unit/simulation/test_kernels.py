"""Kernels by address: compiled one by one, cached by content, a user's own as good as the package's."""

import hashlib
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from emps_design.effects import Effect, Parameter, effect, get_effect, register
from emps_design.errors import SimulationError
from emps_design.machines import machine
from emps_design.simulation import Plant
from emps_design.simulation.kernels.compile import address


@pytest.fixture
def registry(monkeypatch):
    """Effects registered in a test are forgotten after it."""
    import emps_design.effects as effects

    monkeypatch.setattr(effects.REGISTRY, "added", {})


def spring(**hooks):
    return Effect(
        name="test_spring",
        label="Spring of a test",
        equation="k q",
        source="this test",
        parameters=(Parameter("stiffness", "k", "N/m", lower=0.0),),
        **hooks,
    )


def positions(effects, n=400):
    axis = machine("emps2019").replace(effects=effects, sampling={"encoder_resolution": 0.0})
    return Plant.of(axis).open_loop(np.full(n, 2.0)).position


def test_a_users_effect_from_a_session_compiles_and_acts(registry):
    space = {}
    exec("def force(q, v, t, tau, x, p, b):\n    return p[0] * q\n", space)  # has no file, so no cache
    register(spring(force=space["force"]))
    own = positions([{"kind": "test_spring", "stiffness": 300.0}])
    packaged = positions([{"kind": "elastic_force", "stiffness": 300.0, "rest_position": 0.0}])
    np.testing.assert_array_equal(own, packaged)


def helper(q, k):
    return k * q


def force_with_helper(q, v, t, tau, x, p, b):
    return helper(q, p[0])


def test_a_kernel_may_call_functions_of_its_own_file(registry):
    register(spring(force=force_with_helper))
    own = positions([{"kind": "test_spring", "stiffness": 300.0}])
    assert np.abs(own - positions([])).max() > 1e-4


def broken(q, v, t, tau, x, p, b):
    return open("no such thing")


def test_a_kernel_that_is_not_arithmetic_is_refused_by_name():
    with pytest.raises(SimulationError, match="test_kernels.broken does not compile"):
        address(broken)


def test_every_kernel_has_one_address_that_stays():
    kernel = get_effect("stribeck_friction").dry
    assert address(kernel) == address(kernel) != 0


PROGRAM = """
    import sys
    sys.dont_write_bytecode = True  # Python's own cache goes by size and second
    sys.path.insert(0, {folder!r})
    import numpy as np
    import mine
    from emps_design.effects import register
    from emps_design.machines import machine
    from emps_design.simulation import Plant
    from emps_design.simulation.kernels.hold_loop import run
    register(mine.EFFECT)
    axis = machine("emps2019").replace(effects=[{{"kind": "mine", "stiffness": 300.0}}])
    print(Plant.of(axis).open_loop(np.full(400, 2.0)).position[-1].hex())
    print(sum(run.stats.cache_misses.values()))
"""
EFFECT_FILE = """
    from emps_design.effects import Effect, Parameter
    def force(q, v, t, tau, x, p, b):
        return {factor} * p[0] * q
    EFFECT = Effect(name="mine", label="Mine", equation="k q", source="test", force=force,
                    parameters=(Parameter("stiffness", "k", "N/m"),))
"""


@pytest.mark.slow("compiles in three processes")
def test_editing_an_effects_file_renews_its_cache_and_no_other(tmp_path):
    """Same size, same second: only the content tells."""
    file = tmp_path / "mine.py"

    def run(factor):
        file.write_text(textwrap.dedent(EFFECT_FILE).format(factor=factor))
        os.utime(file, (1_700_000_000, 1_700_000_000))
        code = textwrap.dedent(PROGRAM).format(folder=str(tmp_path))
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        position, steppers_compiled = done.stdout.split()
        return position, int(steppers_compiled)

    first, _ = run("1.0")  # may be the first to need the stepper
    second, steppers_compiled = run("2.0")
    assert second != first
    assert steppers_compiled == 0
    assert run("1.0") == (first, 0)


def test_the_steppers_cache_depends_on_every_file_it_is_built_from():
    from emps_design.comanipulation import run as side_by_side
    from emps_design.simulation.kernels import baseline, hold_loop, lanes
    from emps_design.simulation.kernels.compile import source_files

    assert Path(lanes.__file__) in source_files(side_by_side.run_lanes.py_func)
    files = {
        hold_loop.run: {
            "baseline",
            "compile",
            "friction_period",
            "hold_loop",
            "linear_period",
            "motion",
            "smooth_period",
        },
        baseline.run_folded: {"baseline", "compile", "friction_period"},
        baseline.run_lanes: {"baseline", "compile", "friction_period", "lanes"},
        side_by_side.run_lanes: {
            "compile",
            "environment",
            "friction_period",
            "impedance",
            "lanes",
            "task",
            "motion",
            "run",
        },
    }
    for dispatcher, names in files.items():
        assert {path.stem for path in source_files(dispatcher.py_func)} == names
        content = b"".join(path.read_bytes() for path in sorted(source_files(dispatcher.py_func)))
        assert dispatcher._cache._cache_file._source_stamp == hashlib.sha256(content).digest()


@pytest.mark.study("compiles in a process of its own")
def test_nowhere_to_write_a_cache_is_no_obstacle():
    code = """
        import numpy as np
        from numba.core.caching import CacheImpl
        CacheImpl._locator_classes = []
        from emps_design.machines import machine
        from emps_design.simulation import Plant
        print(Plant.of(machine("emps2019")).closed_loop(np.linspace(0.0, 0.01, 200)).q[-1])
    """
    answer = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=True)
    assert float(answer.stdout) > 0.009


def test_hooks_of_the_effect_module_are_those_of_the_stepper():
    from emps_design.simulation.plant import HOOKS

    assert set(HOOKS) == {*effect.SCALAR_HOOKS, "actuator", "rate"}


def dry_by_other_names(place, speed, since, drive, own, numbers, base):
    return numbers[0] * abs(place)


def test_a_kernel_may_call_its_arguments_what_it_likes(registry):
    register(spring(dry=dry_by_other_names))
    own = positions([{"kind": "test_spring", "stiffness": 300.0}])
    assert np.abs(own - positions([{"kind": "test_spring", "stiffness": 0.0}])).max() > 1e-4
