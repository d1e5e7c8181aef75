"""Frame rate of the view in space and time in headless Chromium, which draws in software.

``python tests/benchmarks/viewer_frame_rate.py`` prints pictures per second while the view turns,
and processor time per picture, for balls of 1,000 and 10,000 cells in windows 1280 and 390 px wide.
The processor time holds on a busy machine too; the rate does not. With ``--page A --page B`` these
pages are measured instead, in turns, and the ratio to the first is printed.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import tempfile
from pathlib import Path

import numpy as np

import multicell as mc
from multicell.cells import Cells
from multicell.report.page import write_report
from multicell.report.result import Result
from multicell.results.frame import Frame

SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
TURNING = """async (seconds) => {
  const view = window.multicellViewer, begin = performance.now(), before = view.draws();
  while (performance.now() - begin < 1000 * seconds) {
    view.orbit(0.03, 0);
    await new Promise(requestAnimationFrame);
  }
  return [view.draws() - before, (performance.now() - begin) / 1000];
}"""


def ball(count: int) -> Frame:
    """Return a ball of cells about as dense as tissue."""
    rng = np.random.default_rng(1)
    steps = np.arange(-30, 31) * 8.0
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    inner = np.argsort(np.linalg.norm(grid, axis=1), kind="stable")[:count]
    place = grid[inner] + rng.normal(0.0, 1.5, (count, 3))
    state = np.digitize(-np.linalg.norm(place, axis=1), [-80.0, -45.0])
    cells = Cells(
        id=np.arange(count), parent=np.full(count, -1), position=place,
        radius=rng.uniform(4.0, 5.0, count), young=np.ones(count), poisson=np.full(count, 0.5),
        state=state, age=np.zeros(count), cycle_time=np.ones(count), pressure=np.zeros(count),
    )  # fmt: skip
    return Frame(0.0, 0, cells)


def page_of(count: int, folder: Path) -> Path:
    result = Result(None, (ball(count),), {}, {}, mc.load_scene("settle"))
    return write_report(result, folder)


def processor_time() -> float:
    """Return the processor time of all processes that this one has started, s (Linux)."""
    parents, used = {}, {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = entry.read_text()
        except OSError:
            continue
        after = text[text.rindex(")") + 2 :].split()
        number = int(entry.parent.name)
        parents[number], used[number] = int(after[1]), int(after[11]) + int(after[12])
    ours = {os.getpid()}
    while True:
        more = {n for n, parent in parents.items() if parent in ours} - ours
        if not more:
            break
        ours |= more
    return sum(used[n] for n in ours - {os.getpid()} if n in used) / os.sysconf("SC_CLK_TCK")


def measure(browser, page: Path, wide: int, seconds: float) -> tuple[float, float]:
    """Return pictures per second and processor time per picture, s."""
    context = browser.new_context(viewport={"width": wide, "height": 900})
    tab = context.new_page()
    tab.goto(page.resolve().as_uri())
    tab.wait_for_selector("#viewer.ready", timeout=60_000)
    tab.locator('[data-part="canvas"]').scroll_into_view_if_needed()
    tab.evaluate(TURNING, 0.5)
    before = processor_time()
    pictures, took = tab.evaluate(TURNING, seconds)
    used = processor_time() - before
    context.close()
    return pictures / took, used / pictures


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--page", action="append", type=Path, help="a report that is there")
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--seconds", type=float, default=2.0)
    options.add_argument("--wide", type=int, action="append", help="of the window, px")
    asked = options.parse_args()
    from playwright.sync_api import sync_playwright

    program = next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome")))
    )
    with tempfile.TemporaryDirectory() as place, sync_playwright() as tools:
        pages = asked.page or [page_of(n, Path(place) / str(n)) for n in (1_000, 10_000)]
        names = list(map(str, asked.page or ("1,000 cells", "10,000 cells")))
        browser = tools.chromium.launch(executable_path=program, args=SOFTWARE)
        for wide in asked.wide or (1280, 390):
            found = [
                [measure(browser, page, wide, asked.seconds) for page in pages]
                for _ in range(asked.repeats)
            ]
            first = None
            for k, name in enumerate(names):
                rate, cost = (statistics.median(turn[k][q] for turn in found) for q in (0, 1))
                first = first or cost
                ratio = f", {cost / first:.2f} of the first" if asked.page else ""
                print(f"{wide} px, {name}: {rate:.0f}/s, {1e3 * cost:.0f} ms of processor{ratio}")
        browser.close()


if __name__ == "__main__":
    main()
