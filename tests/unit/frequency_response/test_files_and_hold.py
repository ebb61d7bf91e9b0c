"""Files of a response, python-control at the border, and the algebra of hold and aliases."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from emps_design.control.discretisation import sample_axis
from emps_design.errors import InputError
from emps_design.frequency_response import FrequencyResponse, read_response, write_response
from emps_design.frequency_response.measured_plant import sampled_position, without_aliases
from emps_design.frequency_response.response import BAND
from emps_design.machines import machine
from tests.unit.frequency_response.cases import exact

F = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
MASS = FrequencyResponse.of(F, 1.0 / (2j * np.pi * F * 90.0), np.full(5, 0.01), np.full(5, 0.99))


@pytest.mark.parametrize("name", ["r.csv", "r.mat"])
def test_written_and_read_again(tmp_path, name):
    write_response(tmp_path / name, MASS)
    found = read_response(tmp_path / name)
    assert np.allclose(found.response, MASS.response, rtol=1e-9)
    assert np.allclose(found.std, MASS.std)
    assert np.allclose(found.coherence, MASS.coherence)


def test_v73_file_and_file_of_three_columns(tmp_path):
    with h5py.File(tmp_path / "new.mat", "w") as file:
        for key, values in MASS.to_dict().items():
            file[key] = np.asarray(values)[None]
    assert np.allclose(read_response(tmp_path / "new.mat").response, MASS.response)
    columns = {key: MASS.to_dict()[key] for key in ("frequency_hz", "magnitude", "phase_deg")}
    savemat(tmp_path / "three.mat", columns)
    found = read_response(tmp_path / "three.mat")
    assert found.warnings == ("three: no standard deviations, so margins have no bands",)


def test_python_control():
    frd = MASS.to_frd()
    assert np.allclose(FrequencyResponse.from_frd(frd, MASS.std).response, MASS.response)
    assert complex(frd(2j * np.pi * 4.0)) == pytest.approx(complex(MASS.response[2]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frequency;magnitude;phase_deg\n1;1;1", r"missing frequency_hz.*did you mean 'frequency'"),
        ("frequency_hz,magnitude,phase_deg\n", "found a header and no lines"),
        ("frequency_hz,magnitude,phase_deg\n1,1,-90\n2,1,-90\n3,1,-90", "found 3 lines, expected at least 4"),
        ("frequency_hz,magnitude,phase_deg\n1,1,-90\n2,x,-90", "could not convert"),
        ("frequency_hz,magnitude,phase_deg\n2,1,-90\n1,1,-90\n3,1,-90\n4,1,-90", "frequency, line 2: found 1 Hz"),
        ("frequency_hz,magnitude,phase_deg\n0,1,-90\n1,1,-90\n3,1,-90\n4,1,-90", "frequency, line 1: found 0 Hz"),
        ("frequency_hz,magnitude,phase_deg\n1,nan,-90\n2,1,-90\n3,1,-90\n4,1,-90", "response, line 1: found"),
        ("frequency_hz,magnitude,phase_deg,std\n1,1,1,-1\n2,1,1,0\n3,1,1,0\n4,1,1,0", "std, line 1: found -1"),
        ("frequency_hz,magnitude,phase_deg\n1,1\n2,1", "found 2 columns below 3 titles"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_response(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_bad_input(tmp_path):
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="not a text table"):
        read_response(tmp_path / "bytes.csv")
    with pytest.raises(InputError, match=r"found suffix '.txt', expected .csv or .mat"):
        write_response(tmp_path / "r.txt", MASS)
    with pytest.raises(InputError, match="found 2 numbers, expected 5"):
        FrequencyResponse.of(F, MASS.response, std=[0.1, 0.1])
    savemat(tmp_path / "odd.mat", {"frequency_hz": F, "magnitude": F[:4], "phase_deg": F})
    with pytest.raises(InputError, match="found columns of 4, 5 numbers"):
        read_response(tmp_path / "odd.mat")
    with pytest.raises(InputError, match="found 1 lines from 3 to 5 Hz"):
        MASS.between(3.0, 5.0)
    import control

    with pytest.raises(InputError, match="found 2 inputs and 1 outputs"):
        FrequencyResponse.from_frd(control.frd(np.ones((1, 2, 3), complex), [1.0, 2.0, 3.0]))


@pytest.mark.parametrize("delay", [0.0, 0.3e-3, 1.7e-3])
def test_aliases_of_a_mass_are_exact(delay):
    axis = machine("emps2019").replace(mechanics={"viscous": 0.0})
    plant, w = sample_axis(axis), 2 * np.pi * np.linspace(5.0, 480.0, 60)
    z = np.exp(1j * w * 1e-3)
    estimate = (0.5 + 0.5 / z) * (1.0 - 1.0 / z) / 1e-3
    truth = plant.delayed_response(w, np.full(w.size, delay)) / estimate / axis.drive.force_gain
    found = sampled_position(w, exact(axis, w / (2 * np.pi)), 1e-3, delay, 1.0 / axis.mechanics.mass)
    assert np.max(np.abs(found / truth - 1.0)) < 1e-6


def test_aliases_are_taken_off():
    axis = machine("emps2019")
    plant, w = sample_axis(axis), 2 * np.pi * np.linspace(5.0, 400.0, 80)
    z = np.exp(1j * w * 1e-3)
    position = plant.response(w) / ((0.5 + 0.5 / z) * (1.0 - 1.0 / z) / 1e-3) / axis.drive.force_gain
    raw = position * 1j * w * 1j * w * 1e-3 / (1.0 - 1.0 / z)
    truth = exact(axis, w / (2 * np.pi))
    found, left = without_aliases(w, raw, np.full(w.size, 1e-3), 1e-3)
    assert np.max(np.abs(raw / truth - 1.0)) > 0.2
    assert np.max(np.abs(found / truth - 1.0)) < 2e-3
    assert np.max(left) < 5e-3


def test_aliases_that_a_lag_turns_are_in_the_deviations():
    axis = machine("emps2019").replace(drive={"current_time_constant": 0.5e-3})
    plant, w = sample_axis(axis), 2 * np.pi * np.linspace(5.0, 200.0, 80)
    z = np.exp(1j * w * 1e-3)
    position = plant.response(w) / ((0.5 + 0.5 / z) * (1.0 - 1.0 / z) / 1e-3) / axis.drive.force_gain
    raw = position * 1j * w * 1j * w * 1e-3 / (1.0 - 1.0 / z)
    found, left = without_aliases(w, raw, np.full(w.size, 1e-3), 1e-3)
    error = np.abs(found / exact(axis, w / (2 * np.pi)) - 1.0)
    assert np.all(error <= BAND * left)
    assert np.all(BAND * left <= 4.0 * error)
    _, unknown = without_aliases(w, 1.0 / w, np.full(w.size, 1e-3), 1e-3)  # ends in no mass
    assert np.all(unknown >= left)


@pytest.mark.parametrize("unit", ["Hz", "rad/TimeUnit", "rad/s", ""])
@pytest.mark.parametrize("version", ["v5", "v7.3"])
def test_the_fields_of_an_frd_object(tmp_path, unit, version):
    path = tmp_path / "sys.mat"
    frequency = F if unit == "Hz" else 2.0 * np.pi * F
    if version == "v5":
        fields = {"ResponseData": MASS.response[None, None], "Frequency": frequency[:, None], "Ts": 0.0}
        savemat(path, {"s": {**fields, **({"FrequencyUnit": unit} if unit else {})}})
    else:
        import h5py

        pairs = np.array([(one.real, one.imag) for one in MASS.response], dtype=[("real", "f8"), ("imag", "f8")])
        with h5py.File(path, "w", userblock_size=512) as file:
            group = file.create_group("s")
            group["ResponseData"], group["Frequency"] = pairs[:, None, None], frequency[None]
            if unit:
                group["FrequencyUnit"] = np.array([[ord(letter)] for letter in unit], dtype="u2")
    found = read_response(path)
    assert np.allclose(found.frequency, F)
    assert np.allclose(found.response, MASS.response)


def test_what_is_written_for_matlab_has_the_fields_of_an_frd_object(tmp_path):
    from scipy.io import loadmat

    path = tmp_path / "mass.mat"
    write_response(path, MASS)
    written = loadmat(path)["response"][0, 0]
    assert written["ResponseData"].shape == (1, 1, F.size)
    assert np.allclose(written["ResponseData"][0, 0], MASS.response)
    assert (str(written["FrequencyUnit"][0]), float(written["Ts"][0, 0])) == ("Hz", 0.0)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"ResponseData": np.ones((2, 1, 5), complex), "Frequency": F},
            "s: found 10 numbers in ResponseData, expected 5",
        ),
        (
            {"ResponseData": np.ones((1, 1, 5), complex), "Frequency": F, "FrequencyUnit": "furlong"},
            "found FrequencyUnit 'furlong', expected one of 'rad/s'",
        ),
        ({"Frequency": F}, "missing frequency_hz"),
    ],
)
def test_a_structure_that_is_no_frd_object(tmp_path, fields, message):
    savemat(tmp_path / "s.mat", {"s": fields})
    with pytest.raises(InputError, match=message):
        read_response(tmp_path / "s.mat")
