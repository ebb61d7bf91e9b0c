"""An option that the mode asked for would not read is refused in one line, before anything is done."""

import json
import math

import pytest

from emps_design.cli import app
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record
from tests.studies import quick

IGNORED = {
    "gains --crossover 100 --at velocity-error": "--at: requires --retune",
    "gains --crossover 100 --reference-filter": "--reference-filter: requires --structure pi",
    "gains --crossover 100 --position-every 4": "--position-every: requires --position-overshoot",
    "gains --crossover 100 --force": "--force: requires an output file",
    "gains --crossover 100 --sensitivity-peak-below 6dB": "--sensitivity-peak-below: requires --frf",
    "gains --crossover 100 --sensitivity-peak-above 2": "--sensitivity-peak-above: requires --frf",
    "force {designed} --k-e1 0.001 --phase-margin 70": "--phase-margin: requires --crossover or --bandwidth",
    "force --k-e1 0.001 --force": "--force: requires an output file",
    "impedance --mass 50 --damping 100 --plants 50": "--plants: requires --mismatch",
    "impedance --mass 50 --damping 100 --seed 1 --workers 2": "--seed, --workers: requires --mismatch",
    "impedance --mass 50 --damping 100 --two-quadrant": "--two-quadrant: requires --mismatch",
    "impedance --mass 50 --damping 100 --force-sensor --unfiltered-current": "--unfiltered-current: cannot be combined",
    "simulate --scenario breakaway --force": "--force: requires an output file",
    "simulate --scenario breakaway --plants 5": "--plants: requires --scenario comanipulation",
    "identify {record} --seed 0": "--seed: requires --bootstrap",
    "identify {record} --estimator oe --filter hold": "--filter: requires --estimator ls",
    "identify {record} --estimator iv --bootstrap 0 --holdout {record}": "--bootstrap, --holdout: requires",
    "identify {record} {record} --holdout {record}": "--holdout: requires a single record",
    "identify {record} --force": "--force: requires an output file",
    "observe {record} --force": "--force: requires an output file",
    "import {record} --force": "--force: requires an output file",
    "frf {record} --force": "--force: requires an output file",
    "excite --stroke 0.5 --speed 0.05 --force": "--force: requires an output file",
    "excite --stroke 0.5 --speed 0.05 --steps 20 --seed 1": "--seed: cannot be combined with --steps",
    "diagnose {record} --force": "--force: requires an output file",
    "export {designed} --to c --out {out} --observer 20 --compensation x": "--compensation: cannot be combined",
    "derive --latex --json": "--latex: cannot be combined with --json",
    "report --out {out} --model asymmetric": "--model: requires --record",
    "report --out {out} --design-on axis": "--design-on: requires --record",
    "report --out {out} --record-filter hold": "--record-filter: requires --record",
    "report --out {out} --filter 30Hz": "--filter: requires the impedance law: --mass and --damping",
    "report --out {out} --mismatch 0.02": "--mismatch: requires the impedance law: --mass and --damping",
    "report {designed} --out {out} --mismatch 0.1 --filter 100": "--filter, --mismatch: requires the impedance law",
    "report --out {out} --damping 100": "impedance law: found one of mass and damping, expected both",
}
READ = (
    "gains --crossover 40 --retune --at velocity-error",
    "gains --crossover 40 --structure pi --reference-filter --filter notch:90Hz",
    "force --k-e1 0.001 --phase-margin 70",
    "force {designed} --k-e1 0.001 --crossover 50 --phase-margin 70",
    "impedance --mass 50 --damping 100 --mismatch 0.02 --plants 2 --seed 1 --workers 2",
    "impedance --mass 50 --damping 100 --unfiltered-current",
    "identify {record} --bootstrap 2 --seed 1",
    "derive --latex",
    "excite --stroke 0.5 --speed 0.05 --steps 8 --resolution 2 --slope 1 --passes 2",
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("options")
    synthetic_record(machine("emps2019"), laps=1, stroke=0.1).save(folder / "record.npz")
    designed = machine("emps2018").replace(controller={"kind": "ip_velocity", "k_v1": 300.0, "t_v": 0.02})
    (folder / "designed.toml").write_text(designed.to_toml())
    return {"record": folder / "record.npz", "designed": folder / "designed.toml", "out": folder / "out.html"}


@pytest.mark.parametrize("line", IGNORED)
def test_what_would_be_ignored_is_refused(line, files, capsys):
    assert app.run(line.format(**files).split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"emps-design: {IGNORED[line]}")
    assert len(err.splitlines()) == 1
    assert not files["out"].exists()


@pytest.mark.parametrize(
    "line", quick(READ, lambda line: not line.startswith(("impedance", "derive")), "long commands")
)
def test_what_is_read_is_taken(line, files, capsys):
    assert app.run(line.format(**files).split()) in (0, 4)


@pytest.mark.study("a whole report")
def test_a_report_on_an_axis_with_an_impedance_law_takes_the_options_of_the_law(tmp_path, capsys, sketched):
    law = {"kind": "impedance", "mass": 50.0, "damping": 100.0, "filter": 500.0}
    (tmp_path / "law.toml").write_text(machine("emps2018").replace(controller=law).to_toml())
    line = f"report {tmp_path}/law.toml --mismatch 0.01 --filter 80Hz --out {tmp_path}/out.html --json"
    assert app.run(line.split()) in (0, 4)
    found = json.loads(capsys.readouterr().out)["impedance"]
    assert found["law"]["filter"] == pytest.approx(160 * math.pi)
    assert found["mismatch"]["mismatch"] == 0.01
