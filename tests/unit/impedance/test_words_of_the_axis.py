"""What co-manipulation, simulation and observer say, in the units of the axis: nothing of another machine is in it."""

from itertools import chain
from types import SimpleNamespace

import numpy as np
import pytest

from emps_design.axis import Axis
from emps_design.comanipulation.assessment import ImpedanceAssessment, cautions_of
from emps_design.comanipulation.scenario import _poor_fit
from emps_design.comanipulation.study import MismatchStudy, _not_varied
from emps_design.comanipulation.task import fitted_task
from emps_design.comanipulation.wall import push_into_wall
from emps_design.compensation.feedforward import why_not
from emps_design.control.force import design_force_loop
from emps_design.control.impedance.law import impedance_law
from emps_design.control.impedance.robustness import VERDICTS
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.effects import get_effect
from emps_design.errors import InputError
from emps_design.messages import Message, Severity
from emps_design.observer import KalmanForceObserver, smallest_observable_force
from emps_design.simulation.kernels import hold_loop
from emps_design.simulation.plant import Plant
from emps_design.simulation.run import Run
from emps_design.simulation.scenarios import _no_break_away, breakaway, force_ramp, scenario_view
from tests.axes import KINDS, axis_of
from tests.rewriting import rewritten


@pytest.fixture(params=KINDS)
def axis(request):
    """An axis of each kind that its constant force moves."""
    return axis_of(request.param, offset=-30.0)


def refused(call, *arguments, **options) -> str:
    """The message with which ``call`` refuses the arguments."""
    with pytest.raises(InputError) as raised:
        call(*arguments, **options)
    return str(raised.value)


def cautions(axis: Axis) -> list[str]:
    """What is said of a law without damping that swings, creeps, bounces and reaches the limit of the command."""
    law = impedance_law(axis, 30.0, 0.0)
    own = ImpedanceAssessment(axis, law, 0.02, None)
    limit = SimpleNamespace(simulated=1.2e4, push=43.5, linear=2.3e4)
    assessment = SimpleNamespace(
        axis=axis, law=law, plant=own.plant, mismatch=0.02, stable=True, slowest_drift=0.0,
        walls={"exact": limit, "mismatch": limit}, study=SimpleNamespace(warnings=()),
    )  # fmt: skip
    document = {
        "smallest_safe_mass": None, "coulomb_oscillation": {"speed": 0.0123, "frequency": 4.0},
        "passivity": {"continuous": {"active_bands": []}, "sampled": {"passive": False, "active_bands": [(3.0, None)]}},
        "largest_wall_stiffness": 1.23e5,
        "mismatch": {
            "creep_speed": 0.0123, "coulomb_factor_without_creep": 0.9, "worst": {"peak_voltage": 10.0},
        },
    }  # fmt: skip
    above = {"continuous": {"active_bands": [(3.0, None)]}, "sampled": {"passive": True}}
    refused = SimpleNamespace(**{**vars(assessment), "stable": False, "reason": "it swings"})
    return [
        *cautions_of(assessment, document),
        *cautions_of(refused, {**document, "largest_wall_stiffness": None, "passivity": above}),
    ]


def _of_study(values: dict) -> tuple[Message, ...]:
    """The messages of a study with these attributes."""
    return MismatchStudy.warnings.fget(SimpleNamespace(**values))


def verdicts(axis: Axis) -> list[str]:
    """Headlines, reasons and proposals of laws that creep and that swing, and what a study adds."""
    study = SimpleNamespace(verdict=np.array([VERDICTS.index("creeping")]), creep=0.0123)
    creeps = SimpleNamespace(axis=axis, verdict="creeping", study=study, simulated="creeping", mismatch=0.02)
    nearest = {"mass": 50.0, "damping": 100.0, "filter": 500.0}
    proposal = ImpedanceAssessment._proposal.fget(SimpleNamespace(axis=axis, nearest=nearest))
    swings = SimpleNamespace(axis=axis, stable=False, poles_stable=True, headline="limit cycle", _proposal=proposal)
    still = np.array([VERDICTS.index("no_motion"), VERDICTS.index("stable")])
    ran = SimpleNamespace(diverged=np.ones(2), wanders=np.zeros(2, bool), drift=np.zeros(2))
    measures = SimpleNamespace(diverged=np.zeros(2), wanders=np.array([False, True]), drift=np.array([0.0, 1.2e-4]))
    plants = SimpleNamespace(
        axis=axis, task=SimpleNamespace(warnings=()), plants=2, error=np.zeros(2), errors=np.zeros((2, 3)),
        verdict=still, measures=measures, mismatch=0.0, beyond=(),
    )  # fmt: skip
    beyond = [{"what": "another hand", "verdict": verdict} for verdict in ("creeping", "no_motion")]
    worse = [{**vars(plants), "beyond": (change,), "verdict": np.zeros(2, int)} for change in beyond]
    gone = {**vars(plants), "measures": ran, "error": np.full(2, np.nan)}
    return [
        ImpedanceAssessment.headline.fget(creeps),
        ImpedanceAssessment.reason.fget(swings),
        *chain.from_iterable(map(_of_study, (vars(plants), gone, *worse))),
        *_not_varied(axis.units).values(),
        *_poor_fit({"r2": 0.5}, axis.units),
        *fitted_task(axis, impedance_law(axis, 30.0, 50.0), force=1.5).warnings,
    ]


def of_simulations(axis: Axis) -> list[str]:
    """Why a run ends, what a push does, and what is refused."""
    units, plant, law = axis.units, Plant.of(axis), impedance_law(axis, 30.0, 50.0)
    reasons = (hold_loop.DIVERGED, hold_loop.MASSLESS, hold_loop.RUNAWAY)
    return [
        *(hold_loop.reason_of(status, units) for status in reasons),
        _no_break_away(0.0, 12.0, units),
        _no_break_away(1.2e-4, 12.0, units),
        refused(force_ramp, 1e-3, 1e-6, 12.0, units),
        refused(breakaway, axis, rate=-1.0),
        refused(plant.open_loop, np.zeros(3), q0=np.inf),
        refused(plant.open_loop, np.zeros(3), intention=np.zeros(3)),
        refused(plant.numbers, [0.0, 1.0, 1.0, 0.0]),
        refused(push_into_wall, axis, law, 1e4, force=-1.0),
    ]


def of_loops_and_observers(axis: Axis) -> list[str]:
    """What the force loop and the observers say."""
    loop = design_velocity_loop(axis, crossover=100.0, phase_margin_deg=60.0)
    stable, unstable = (design_force_loop(loop, k_e1=gain, environment=1e5) for gain in (1e-6, 1.0))
    alone = design_force_loop(loop, k_e1=0.01)
    return [
        refused(design_force_loop, loop, -1.0),
        refused(design_force_loop, loop, 1.0, hand=-1.0),
        unstable.reason,
        *stable.warnings,
        *unstable.warnings,
        *alone.warnings,
        stable.paper_reading["text"],
        *smallest_observable_force(axis, 3.0, 4.0).to_dict()["reasons"].values(),
        refused(KalmanForceObserver, axis, position_noise=-1.0),
        refused(KalmanForceObserver, axis, force_rate=-1.0),
        why_not(get_effect("encoder_error"), axis.units),
    ]


@pytest.mark.parametrize("said", [cautions, verdicts, of_simulations, of_loops_and_observers])
def test_nothing_has_to_be_rewritten(axis, said):
    messages = said(axis)
    assert [rewritten(axis.units, text) for text in messages] == messages


def test_only_what_moves_by_itself_beyond_the_mismatch_is_grave():
    said = {message.code: message for message in verdicts(axis_of("linear, V")) if isinstance(message, Message)}
    assert said["worse-beyond-mismatch"].severity == Severity.GRAVE
    assert said["other-beyond-mismatch"].severity == Severity.WARNING
    assert {"ran-away", "unstable-plants"} <= said.keys()
    assert {"not-to-run", "active-band-unbounded"} <= {message.code for message in cautions(axis_of("linear, V"))}


def test_a_rotary_axis_with_a_current_has_its_own_units():
    text = " | ".join(cautions(axis_of("rotary, A", offset=-30.0)))
    assert "the constant torque exceeds dry friction by 10 N m" in text
    assert "creep at up to 0.705 deg/s" in text
    assert "the current limit is reached in the task" in text
    assert "the released load" in text


def test_a_linear_axis_has_millimetres_and_newtons():
    text = " | ".join(cautions(axis_of("linear, V", offset=-30.0)))
    assert "the constant force exceeds dry friction by 10 N, and" in text
    assert "makes the released carriage creep at up to 12.3 mm/s; a Coulomb factor of 0.9 prevents it" in text
    assert "of up to 1.2e+04 N/m the carriage comes to rest" in text
    assert "largest_wall_stiffness is unbounded: stable up to 1 GN/m" in text


def test_a_run_and_its_file_have_the_units_of_the_axis(axis, tmp_path):
    run = Plant.of(axis).open_loop(np.zeros(20))
    run.save(tmp_path / "run.npz")
    for one in (run, Run.load(tmp_path / "run.npz")):
        assert one.units == axis.units
        (table,) = one.view()
        words = [text for name, _, unit in table.rows for text in (name, unit)]
        words += [text for signal in one.to_dict()["signals"].values() for text in signal.values()]
        assert [rewritten(axis.units, text) for text in words] == words


def test_a_document_has_the_units_of_its_axis_and_its_view_readable_ones():
    joint = axis_of("rotary, A", offset=-30.0).replace(mechanics={"offset": 0.0})
    found = breakaway(joint, rate=200.0)
    assert found.to_dict()["units"] == {
        "rate": "N m/s",
        **dict.fromkeys(("peak", "forward", "backward", "static_friction", "constant_force"), "N m"),
    }
    followed = {
        "scenario": "reference",
        "axis": "axis",
        "tracking_error": {"rms": 0.012},
        "units": {"tracking_error": "rad"},
    }
    assert scenario_view(followed, joint.units)[-1].rows == [("tracking error rms", "0.687549", "deg")]
