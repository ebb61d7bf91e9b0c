"""The studio in a real Chromium, where it could mislead: words are of what stands beside them, and no tab waits."""

import re
import time
import tomllib
import zipfile

import pytest

from tests.browser.steps import sampled_margin, turn_to, type_into, upload, wait_for_change, wait_for_value

pytestmark = [pytest.mark.browser, pytest.mark.slow("a browser, and a studio of its own")]


@pytest.fixture(scope="module")
def fast(tmp_path_factory):
    """A folder with an axis file of twice the rate of the embedded machines, and two of its records."""
    from emps_design.machines import machine
    from emps_design.simulation.synthetic import synthetic_record

    folder = tmp_path_factory.mktemp("fast")
    axis = machine("emps2019").replace(name="fast", sampling={"period": 5e-4})
    (folder / "fast.toml").write_text(axis.to_toml())
    for seed, name in ((1, "first"), (2, "second")):
        synthetic_record(axis, laps=1, seed=seed).save(folder / f"{name}.npz")
    return folder


def test_an_axis_file_and_two_records_are_opened_and_the_model_leaves_the_specification(page, fast, picture):
    type_into(page, "Filter of the law [rad/s]", "400")
    open_axis(page, fast / "fast.toml")
    page.get_by_text("Changed with fast: sampling period 0.5 ms").wait_for()
    page.screenshot(path=picture("studio-axis-file"))
    turn_to(page, "Data")
    wait_for_value(page.get_by_label("Axis of the record", exact=True), "fast")
    upload(page, fast / "first.npz")
    page.get_by_text(re.compile("first: [0-9]+ samples")).wait_for()
    page.locator(".filepond--browser").nth(1).set_input_files(str(fast / "second.npz"))
    page.get_by_text(re.compile("held out second: [0-9]+ samples")).wait_for()
    page.get_by_role("button", name="Identify").click()
    page.get_by_text(re.compile("Identified: mass 9[0-9.]+ kg.* on second")).wait_for()
    page.screenshot(path=picture("studio-two-records"), full_page=True)
    page.get_by_role("button", name="Design on this model").click()
    turn_to(page, "Design")
    wait_for_value(page.get_by_label("Axis", exact=True).first, "fast from first")
    for label, value in (("Frequency [rad/s]", "100"), ("Filter of the law [rad/s]", "400")):
        assert page.get_by_label(label, exact=True).first.input_value() == value, label


def open_axis(page, path) -> None:
    page.locator("input[type=file]").locator("visible=true").first.set_input_files(str(path))
    wait_for_value(page.get_by_label("Axis", exact=True).first, path.stem)


def test_the_curve_of_the_worst_plant_is_of_its_verdict(page, tmp_path, picture):
    from emps_design.machines import machine

    # Pushed the other way round its worst plant swings; this way round it comes to rest.
    tilted = machine("emps2018").replace(name="tilted", mechanics={"offset": -6.0})
    (tmp_path / "tilted.toml").write_text(tilted.to_toml())
    open_axis(page, tmp_path / "tilted.toml")
    type_into(page, "Apparent mass M_a [kg]", "25")
    type_into(page, "Filter of the law [rad/s]", "300")
    turn_to(page, "Simulation")
    page.get_by_label("Task", exact=True).select_option("Pushes to and fro (Fig. 12)")
    type_into(page, "Random plants", "0")
    page.get_by_role("button", name="Simulate", exact=True).click()
    page.get_by_text("0 random plants is in a limit cycle, with velocities from").wait_for()
    page.get_by_text("Worst estimates: limit cycle.").wait_for()
    page.screenshot(path=picture("studio-worst"), full_page=True)


def test_a_design_that_follows_less_closely_than_the_controller_in_place_is_not_green(page, picture):
    page.get_by_label("Axis", exact=True).first.select_option("emps2019")
    turn_to(page, "Motion")
    page.get_by_role("button", name="Move", exact=True).click()
    said = page.get_by_text("The axis's own controller follows more closely")
    said.wait_for()
    page.screenshot(path=picture("studio-motion-worse"), full_page=True)
    assert "warning" in page.locator("div.message").filter(has=said).get_attribute("class")


def test_the_folder_for_the_drive_holds_the_design(page, picture):
    page.get_by_label("Axis", exact=True).first.select_option("emps2019")
    turn_to(page, "Compensation")
    page.get_by_role("button", name="Test them").click()
    page.get_by_text("controller: the design's, ip velocity").wait_for()
    page.screenshot(path=picture("studio-compensation-of-the-design"))
    with page.expect_download() as download:
        page.get_by_text("Download the folder", exact=True).click()
    with zipfile.ZipFile(download.value.path()) as folder:
        held = tomllib.loads(folder.read("axis.toml").decode())["controller"]
    turn_to(page, "Files")
    with page.expect_download() as download:
        page.get_by_text("Model (TOML)", exact=True).click()
    with open(download.value.path(), "rb") as file:
        assert held == tomllib.load(file)["controller"]
    assert held["kind"] == "ip_velocity"


def test_every_tab_answers_while_the_report_is_made(page, picture):
    turn_to(page, "Files")
    with page.expect_download():
        page.get_by_text("Gains (JSON)", exact=True).click()
    page.get_by_text("gains.json is in the browser").wait_for()
    page.get_by_text("Report (HTML)", exact=True).click()
    page.get_by_text("report.html is being made").wait_for()
    assert page.get_by_text("is in the browser").count() == 0
    cancel = page.get_by_role("button", name="Cancel work").locator("visible=true")
    cancel.wait_for()
    page.screenshot(path=picture("studio-report-at-work"))
    begun = time.monotonic()
    turn_to(page, "Design")
    before = sampled_margin(page)
    type_into(page, "Phase margin [deg]", "50")
    wait_for_change(page, before)
    assert time.monotonic() - begun < 10.0
    turn_to(page, "Files")
    cancel.wait_for()  # the report is not done
    cancel.click()
    page.get_by_text("Cancelled; nothing was changed.").wait_for()
