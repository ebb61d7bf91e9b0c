"""How fast the studio answers: a turn of a knob without a browser, and from a key to the picture in a real one."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.rows import add, skip
from emps_design.machines import machine, machine_names

SLOWEST = 0.15  # s, up to which an answer seems immediate

# Milliseconds from a key on the slider to the frame after the one in which the margin has changed: what the server
# sends is applied in order, the curves before the margin.
TURNS = """async () => {
  const find = (root, test) => {
    for (const e of root.querySelectorAll('*')) {
      if (test(e)) return e;
      const inside = e.shadowRoot && find(e.shadowRoot, test);
      if (inside) return inside;
    }
    return null;
  };
  const handle = find(document, e => e.matches('.noUi-handle[aria-label="Phase margin [deg]"]'));
  const margin = () => find(document, e => e.matches('b.margin')).textContent;
  const frame = () => new Promise(requestAnimationFrame);
  const took = [];
  for (let k = 0; k < 13; k++) {
    const before = margin(), start = performance.now();
    const key = k % 4 < 2 ? 'ArrowLeft' : 'ArrowRight';
    handle.dispatchEvent(new KeyboardEvent('keydown', {key, bubbles: true}));
    while (margin() === before && performance.now() - start < 5000) await frame();
    await frame();
    took.push(performance.now() - start);
    await new Promise(done => setTimeout(done, 200));
  }
  return took;
}"""


def studio(rows: list[dict]) -> None:
    """Measure both; what is not installed is left out with a note."""
    try:
        import panel  # noqa: F401
    except ImportError:
        skip("studio", "the extra 'studio' is not installed")
        return
    add(rows, "studio, a turn of a knob answered, median", _turn(), "s", SLOWEST)
    work = "studio, from key to picture in a browser, lower quartile"
    try:
        from playwright.sync_api import sync_playwright

        from tests.browser.conftest import ARGUMENTS, Studio, chromium
    except ImportError as error:
        skip(work, str(error))
        return
    if not chromium():
        skip(work, "no Chromium on this machine")
        return
    running = Studio()
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium(), args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(running.address)
        page.get_by_text("this design", exact=True).wait_for(timeout=60_000)
        page.wait_for_timeout(1500)
        took = sorted(page.evaluate(TURNS))
        browser.close()
    running.interrupt()
    # Other work on the machine makes some of them late, never a quarter early.
    add(rows, work, 1e-3 * took[len(took) // 4], "s", SLOWEST)


def _turn() -> float:
    """Median time of a turn of the frequency [s]."""
    from emps_design.studio.design_view import DesignView
    from emps_design.studio.state import State

    machines = {name: machine(name) for name in machine_names()}
    view = DesignView(State.of(machine("emps2018")), machines, lambda state: None)
    took = []
    for frequency in np.linspace(60.0, 140.0, 9):
        start = time.perf_counter()
        view.knobs["frequency"].field.value = f"{frequency:g}"
        took.append(time.perf_counter() - start)
    return float(np.median(took))
