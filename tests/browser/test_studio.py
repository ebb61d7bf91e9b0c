"""The studio in a real Chromium: controls move the numbers, records go through, nothing leaves the machine."""

import re
import zipfile

import numpy as np
import pytest

from tests.browser.steps import (
    BUSY,
    sampled_margin,
    turn_to,
    type_into,
    upload,
    wait_for_change,
    wait_for_value,
)

pytestmark = [pytest.mark.browser, pytest.mark.slow("a browser, and a studio of its own")]

NAMELESS = """() => {
  const found = [];
  const visit = root => {
    for (const e of root.querySelectorAll('*')) {
      if (e.shadowRoot) visit(e.shadowRoot);
      const control = e.matches('input, select, textarea, [role=slider]') ||
        (e.matches('button') && !e.closest('.noUi-base') && !e.closest('.filepond--root'));
      if (!control || !e.checkVisibility() || e.type === 'hidden') continue;
      const labels = e.labels && e.labels.length ? [...e.labels].map(l => l.textContent).join('') : '';
      const name = e.getAttribute('aria-label') || e.title || labels || (e.matches('button') ? e.textContent : '');
      if (!name.trim()) found.push(e.outerHTML.slice(0, 160));
    }
  };
  visit(document);
  return found;
}"""


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (1920, 1080)])
def test_every_tab_fits_the_screen(page, picture, width, height):
    assert sampled_margin(page) == "39.2°"
    page.set_viewport_size({"width": width, "height": height})
    for tab in ("Design", "Motion", "Simulation", "Data", "Compensation", "Files"):
        turn_to(page, tab)
        page.wait_for_timeout(800)
        page.screenshot(path=picture(f"studio-{tab.lower()}-{width}x{height}"))
        assert page.evaluate("document.documentElement.scrollWidth") <= width, tab


def test_a_frequency_out_of_reach_comes_back_and_the_page_says_why(page):
    type_into(page, "Frequency [rad/s]", "500")
    page.get_by_text("The frequency was moved from 500 to 315 rad/s").wait_for()
    wait_for_value(page.get_by_label("Frequency [rad/s]", exact=True).first, "315")
    page.get_by_role("button", name="bandwidth").click()
    page.get_by_text("At bandwidth 315 rad/s").wait_for()


def test_a_number_outside_the_control_goes_back_to_the_design_shown(page):
    before = sampled_margin(page)
    type_into(page, "Frequency [rad/s]", "2000")
    page.get_by_role("alert").filter(has_text="the design is unchanged").first.wait_for()
    wait_for_value(page.get_by_label("Frequency [rad/s]", exact=True).first, "100")
    assert sampled_margin(page) == before


def test_a_frequency_is_typed_with_its_unit_wherever_one_is_asked_for(page):
    for label, bad, before in (("Frequency", "30 V", "100"), ("Filter of the law", "1 week", "500")):
        field = page.get_by_label(f"{label} [rad/s]", exact=True).first
        type_into(page, f"{label} [rad/s]", "30Hz")
        page.get_by_text(f"{label}: 30Hz is 188.496 rad/s.").wait_for()
        wait_for_value(field, "188.496")
        type_into(page, f"{label} [rad/s]", before)
        page.get_by_text(f"{label}: 30Hz is 188.496 rad/s.").wait_for(state="hidden")
        type_into(page, f"{label} [rad/s]", bad)
        page.get_by_text(f"found '{bad}', expected a number in rad/s, or one such as 30Hz").wait_for()
        wait_for_value(field, before)


def test_a_refused_number_goes_back_in_the_simulation_tab_too(page):
    turn_to(page, "Simulation")
    for value in ("7", "5000", "6000"):
        type_into(page, "Push [N]", value)
        page.wait_for_timeout(600)
        wait_for_value(page.get_by_label("Push [N]", exact=True).first, "7")


def test_keyboard_and_typing_move_slider_and_margin(page):
    before = sampled_margin(page)
    handle = page.get_by_role("slider", name="Phase margin [deg]", exact=True)
    handle.focus()
    page.keyboard.press("ArrowLeft")
    wait_for_change(page, before)
    assert page.get_by_label("Phase margin [deg]", exact=True).first.input_value() == "59.5"
    before = sampled_margin(page)
    type_into(page, "Frequency [rad/s]", "150")
    wait_for_change(page, before)
    assert float(sampled_margin(page).rstrip("°")) < float(before.rstrip("°"))


def test_what_cannot_be_reached_is_out_of_reach_and_says_why(page):
    type_into(page, "Computation delay [samples]", "3")
    page.get_by_text("outside 30.5° to 64° the sampled loop is unstable").wait_for()
    type_into(page, "Phase margin [deg]", "89")
    page.get_by_text("The phase margin was moved from 89° to 64°").wait_for()
    wait_for_value(page.get_by_label("Phase margin [deg]", exact=True).first, "64")
    assert sampled_margin(page).endswith("°")


def test_a_pinned_design_stays_beside_the_new_one(page, picture):
    page.get_by_role("button", name="Pin this design to compare").click()
    page.get_by_text("pinned", exact=True).first.wait_for()
    before = sampled_margin(page)
    type_into(page, "Phase margin [deg]", "45")
    wait_for_change(page, before)
    assert page.locator("b.margin").nth(1).inner_text() == before
    page.screenshot(path=picture("studio-pinned"))


def test_every_control_has_a_name_and_the_tabs_answer_the_keyboard(page):
    page.wait_for_timeout(1500)
    assert page.evaluate(NAMELESS) == []
    for tab in ("Motion", "Simulation", "Data", "Compensation", "Files", "Design"):
        page.get_by_role("button", name=tab, exact=True).focus()
        page.keyboard.press("Enter")
        page.wait_for_timeout(400)
        assert page.evaluate(NAMELESS) == [], tab


def test_a_record_is_refused_observed_identified_and_its_model_designed_on(page, practice, tmp_path, picture):
    turn_to(page, "Data")
    bad = tmp_path / "empty.csv"
    bad.write_text("t,q\n0,0\n")
    upload(page, bad)
    alert = page.get_by_role("alert").filter(has_text="column").first
    alert.wait_for(timeout=BUSY)
    assert "empty.csv" in alert.inner_text()
    assert page.get_by_role("button", name="Identify").is_disabled()

    upload(page, practice)
    page.get_by_text(re.compile("practice: [0-9]+ samples")).wait_for(timeout=BUSY)
    page.get_by_role("button", name="Observe").click()
    page.get_by_text(re.compile("distinguished from errors")).first.wait_for(timeout=BUSY)
    page.get_by_role("button", name="Identify").click()
    page.get_by_text(re.compile("Identified: mass 9[0-9.]+ kg")).wait_for(timeout=BUSY)
    page.wait_for_timeout(500)
    page.screenshot(path=picture("studio-data"), full_page=True)
    upload(page, bad)  # refused: neither the record before nor its results stay under that name
    page.get_by_role("alert").filter(has_text="empty.csv").first.wait_for(timeout=BUSY)
    page.wait_for_timeout(500)
    for name in ("Identify", "Observe", "Diagnose", "Design on this model"):
        assert page.get_by_role("button", name=name).is_disabled(), name
    assert page.get_by_text("Identified: mass").count() == 0
    page.screenshot(path=picture("studio-refused"), full_page=True)
    upload(page, practice)
    page.get_by_text(re.compile("practice: [0-9]+ samples")).wait_for(timeout=BUSY)
    page.get_by_role("button", name="Identify").click()
    page.get_by_text(re.compile("Identified: mass 9[0-9.]+ kg")).wait_for(timeout=BUSY)
    page.get_by_role("button", name="Design on this model").click()
    page.get_by_text("The design tab now uses").wait_for()
    turn_to(page, "Design")
    assert "practice" in page.get_by_label("Axis", exact=True).input_value()


def test_the_columns_of_an_export_are_chosen(page, tmp_path, picture):
    t = np.arange(4000) * 1e-3
    q_ref = 0.1 * (1 - np.cos(3 * t))
    q = np.round((q_ref - 2e-4 * np.sin(3 * t)) / 1e-6) * 1e-6
    u = 2.6 * np.gradient(np.gradient(q_ref, t), t) + 6 * np.gradient(q_ref, t) + 0.6 * np.sign(np.sin(3 * t))
    rows = ["Zeit [ms];Kanal 1 [mm];Kanal 2 [mm];Spannung [V];Status"]
    rows += [
        f"{1e3 * a:.3f};{1e3 * b:.4f};{1e3 * c:.4f};{d:.4f};4663" for a, b, c, d in zip(t, q, q_ref, u, strict=True)
    ]
    (tmp_path / "trace.csv").write_text("\n".join(rows).replace(".", ","))
    turn_to(page, "Data")
    upload(page, tmp_path / "trace.csv")
    page.get_by_role("alert").filter(has_text="trace.csv").first.wait_for(timeout=BUSY)
    for label, title in (("Position", "Kanal 1 [mm]"), ("Reference", "Kanal 2 [mm]")):
        page.get_by_label(label, exact=True).select_option(title)
    page.wait_for_timeout(500)
    page.screenshot(path=picture("studio-columns"), full_page=True)
    page.get_by_role("button", name="Read these columns").click()
    page.get_by_text(re.compile("trace: 4000 samples")).wait_for(timeout=BUSY)
    page.screenshot(path=picture("studio-columns-read"), full_page=True)


def test_figure_twelve_is_simulated_and_a_long_study_cancelled(page, picture):
    turn_to(page, "Simulation")
    page.get_by_role("button", name="Simulate", exact=True).click()
    page.get_by_text(re.compile("the worst of .* is creeping")).wait_for(timeout=90_000)
    page.get_by_text("A push of 40 N into a wall of 10 N/mm, exact estimates: at rest").wait_for()
    page.wait_for_timeout(500)
    page.screenshot(path=picture("studio-simulation"), full_page=True)
    type_into(page, "Random plants", "0")
    page.get_by_label("Wall [N/mm]", exact=True).locator("visible=true").first.select_text()
    page.keyboard.type("200")  # and no Enter
    page.get_by_role("button", name="Simulate", exact=True).click()
    page.get_by_text("into a wall of 200 N/mm, exact estimates: bouncing").wait_for(timeout=BUSY)
    type_into(page, "Random plants", "10000")
    page.get_by_role("button", name="Simulate", exact=True).click()
    cancel = page.get_by_role("button", name="Cancel work").locator("visible=true").first
    page.wait_for_timeout(300)
    cancel.click()
    page.get_by_text("Cancelled; nothing was changed.").wait_for(timeout=BUSY)


def test_structure_filters_and_a_motion_of_ones_own(page, tmp_path, picture):
    before = sampled_margin(page)
    page.get_by_label("Structure", exact=True).select_option("PI")
    wait_for_change(page, before)
    page.get_by_role("button", name="Add a notch").click()
    page.get_by_text("PI, 1 filter").wait_for()
    type_into(page, "Notch [Hz]", "90 V")
    page.get_by_role("alert").filter(has_text="the design is unchanged").first.wait_for()
    wait_for_value(page.get_by_label("Notch [Hz]", exact=True), "127.324")
    type_into(page, "Notch [Hz]", "90Hz")
    page.wait_for_timeout(800)
    wait_for_value(page.get_by_label("Notch [Hz]", exact=True), "90")
    page.screenshot(path=picture("studio-filters"), full_page=True)
    turn_to(page, "Motion")
    page.get_by_label("Motion", exact=True).select_option("A file of mine")
    (tmp_path / "way.csv").write_text("t [s],q_ref [mm]\n0,0\n0.5,40\n1,40\n")
    page.locator("input[type=file]").locator("visible=true").last.set_input_files(str(tmp_path / "way.csv"))
    page.wait_for_timeout(600)
    page.get_by_role("button", name="Move", exact=True).click()
    page.get_by_text(re.compile("way.csv, interpolated linearly, kp 20 1/s")).wait_for(timeout=BUSY)
    page.wait_for_timeout(500)
    page.screenshot(path=picture("studio-motion"), full_page=True)
    type_into(page, "Position gain kp [1/s]", "10")
    page.get_by_text("interpolated linearly, kp 20").wait_for(state="hidden")


def test_files_are_handed_out_and_a_state_comes_back(page, tmp_path, picture):
    type_into(page, "Phase margin [deg]", "50")
    page.get_by_role("button", name="Pin this design to compare").click()
    page.get_by_text("pinned", exact=True).first.wait_for()
    turn_to(page, "Files")
    page.get_by_text("Save the present design").wait_for()
    page.screenshot(path=picture("studio-files"))
    kept = {}
    for label in ("State (TOML)", "Gains (JSON)", "Model (TOML)", "Figures (SVG)", "Figures (PNG)", "Report (HTML)"):
        button = page.get_by_role("button", name=label)
        button.focus()
        with page.expect_download(timeout=BUSY) as download:
            page.keyboard.press("Enter")
        kept[label] = tmp_path / download.value.suggested_filename
        download.value.save_as(kept[label])
    assert "phase_margin_deg = 50" in kept["State (TOML)"].read_text()
    assert '"k_v1"' in kept["Gains (JSON)"].read_text()
    assert 'kind = "ip_velocity"' in kept["Model (TOML)"].read_text()
    assert kept["Report (HTML)"].read_text().startswith("<!DOCTYPE html>")
    assert "nyquist.svg" in zipfile.ZipFile(kept["Figures (SVG)"]).namelist()
    turn_to(page, "Design")
    type_into(page, "Phase margin [deg]", "70")
    turn_to(page, "Files")
    page.locator("input[type=file]").last.set_input_files(str(kept["State (TOML)"]))
    page.get_by_text("is loaded; the design tab shows it").wait_for()
    turn_to(page, "Design")
    assert page.get_by_label("Phase margin [deg]", exact=True).first.input_value() == "50"
    assert page.get_by_role("button", name="Pin this design to compare").get_attribute("class").count("active")
    turn_to(page, "Files")
    (tmp_path / "wrong.toml").write_text("[studio]\nphase_margin_deg = 500\n[axis]\n")
    page.locator("input[type=file]").last.set_input_files(str(tmp_path / "wrong.toml"))
    page.get_by_role("alert").first.wait_for()


def test_interrupt_ends_it_cleanly():
    pytest.importorskip("panel", reason="the extra 'studio' is not installed")
    from tests.browser.conftest import Studio

    status, said = Studio().interrupt()
    assert status == 130
    assert "Traceback" not in said


@pytest.fixture(scope="module")
def rippled(tmp_path_factory):
    """A short simulated record of the embedded machine with a position ripple that its axis file does not have."""
    from emps_design.machines import machine
    from emps_design.simulation.synthetic import synthetic_record

    path = tmp_path_factory.mktemp("ripple") / "rippled.npz"
    ripple = {"kind": "position_ripple", "amplitude": 4.0, "period": 5e-3, "phase": 0.3}
    synthetic_record(machine("emps2019").replace(effects=[ripple]), seed=2).save(path)
    return path


def test_a_record_is_diagnosed_and_the_work_can_be_cancelled(page, rippled, picture):
    turn_to(page, "Data")
    upload(page, rippled)
    page.get_by_text(re.compile("rippled: [0-9]+ samples")).wait_for(timeout=BUSY)
    page.get_by_role("button", name="Diagnose").click()
    cancel = page.get_by_role("button", name="Cancel work").locator("visible=true").first
    page.get_by_text("Diagnose is running").wait_for()
    cancel.click()
    page.get_by_text("Cancelled; nothing was changed.").wait_for(timeout=BUSY)
    page.get_by_role("button", name="Diagnose").click()
    page.get_by_text(re.compile("Position ripple, amplitude")).first.wait_for(timeout=200_000)
    page.wait_for_timeout(500)
    page.screenshot(path=picture("studio-diagnosis"), full_page=True)
    page.get_by_role("button", name="Design on this model").click()
    turn_to(page, "Design")
    from playwright.sync_api import expect

    expect(page.get_by_label("Axis", exact=True)).to_have_value(re.compile("diagnosed on rippled"), timeout=BUSY)
    assert sampled_margin(page).endswith("°")


def test_the_folder_for_the_drive_is_handed_out(page, picture):
    page.get_by_label("Axis", exact=True).first.select_option("emps2019")
    turn_to(page, "Compensation")
    page.get_by_role("button", name="Test them").click()
    page.get_by_text("tracking error, rms").wait_for(timeout=120_000)
    page.wait_for_timeout(500)
    page.screenshot(path=picture("studio-compensation-tried"))
    with page.expect_download() as download:
        page.get_by_text("Download the folder", exact=True).click()
    with zipfile.ZipFile(download.value.path()) as folder:
        assert {"axis.toml", "compensation.json", "code/Makefile", "code/vectors.csv"} <= {*folder.namelist()}
