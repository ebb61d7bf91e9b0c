"""A studio and a real Chromium for the tests of the page; skipped with a word where one of them is missing."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.browser.steps import BUSY

SCREENSHOTS = os.environ.get("EMPS_DESIGN_SCREENSHOTS", "")
ARGUMENTS = ["--no-sandbox", "--disable-gpu"]
NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


def chromium() -> str:
    """Path of a Chromium: from the environment, or found; empty where there is none."""
    return os.environ.get("EMPS_DESIGN_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), "")


@pytest.fixture(scope="session")
def browser():
    """A running Chromium."""
    pytest.importorskip("panel", reason="the extra 'studio' is not installed")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra 'browser')")
    path = chromium()
    if not path:
        pytest.skip("no Chromium on this machine: install Debian's chromium, or name one in EMPS_DESIGN_CHROMIUM")
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield running
        running.close()


class Studio:
    """A studio in a process of its own."""

    def __init__(self, *arguments: str):
        command = [sys.executable, "-m", "emps_design.cli", "studio", *arguments, "--json"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        lines = ""
        for line in self.process.stdout:
            lines += line
            if line.startswith("}"):
                break
        else:
            raise RuntimeError(self.process.stderr.read())
        self.address = json.loads(lines)["address"]

    def interrupt(self) -> tuple[int, str]:
        """Press Ctrl-C; the exit status and what was said on standard error."""
        self.process.send_signal(signal.SIGINT)
        try:
            _, said = self.process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        return self.process.returncode, said


@pytest.fixture(scope="session")
def studio():
    """One studio on the embedded machine for all tests."""
    pytest.importorskip("panel", reason="the extra 'studio' is not installed")
    running = Studio()
    yield running
    if running.process.poll() is None:
        running.interrupt()


@pytest.fixture
def page(browser, studio, tmp_path):
    """A page on the studio that may speak to nobody else; what it asked for and what it complained about."""
    context = browser.new_context(viewport={"width": 1280, "height": 800}, accept_downloads=True)
    page = context.new_page()
    page.set_default_timeout(BUSY)
    page.outside, page.complaints = [], []

    def only_here(route):
        url = route.request.url
        if url.startswith((studio.address.partition("?")[0], "data:", "blob:")):
            route.continue_()
        else:
            page.outside.append(url)
            route.abort()

    page.route("**/*", only_here)
    page.on("console", lambda message: page.complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    page.goto(studio.address)
    page.get_by_text("this design", exact=True).wait_for()
    yield page
    assert page.outside == []
    assert page.complaints == []
    context.close()


@pytest.fixture
def picture(tmp_path):
    """Where screenshots go: the folder EMPS_DESIGN_SCREENSHOTS names, else a temporary one."""
    folder = Path(SCREENSHOTS) if SCREENSHOTS else tmp_path
    folder.mkdir(parents=True, exist_ok=True)
    return lambda name: str(folder / f"{name}.png")


@pytest.fixture(scope="session")
def practice(tmp_path_factory) -> Path:
    """A simulated record of the embedded machine."""
    from emps_design.machines import machine
    from emps_design.simulation.synthetic import synthetic_record

    path = tmp_path_factory.mktemp("record") / "practice.npz"
    synthetic_record(machine("emps2019"), seed=1).save(path)
    return path
