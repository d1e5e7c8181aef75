"""Makes the film of the README and the stills of the view that docs/pictures.md shows.

``python docs/moving_pictures.py [--run FOLDER]`` runs the built-in scene ``spheroid`` (about ten
seconds on one core) unless FOLDER holds that run already, and writes ``figures/spheroid.webp`` by
``multicell movie``. The stills ``figures/view-light.png`` and ``figures/view-dark.png`` are taken
of the run's page in Chromium, by playwright; without either they are left as they are.
"""

from __future__ import annotations

import argparse
import io
import shutil
import tempfile
from pathlib import Path

import multicell as mc
from multicell.report.plots.movie import movie

FIGURES = Path(__file__).parent / "figures"
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def film(result: mc.Result) -> None:
    """Write the film."""
    path = FIGURES / "spheroid.webp"
    movie(result, path, space=True, turn=100.0, rate=10.0, transparent=True)
    print(path, f"{path.stat().st_size / 1e6:.2f} MB")


def stills(page: Path) -> None:
    """Take the view, cut across x and coloured by the state of the cells."""
    from PIL import Image
    from playwright.sync_api import sync_playwright

    names = ("chromium", "chromium-browser", "google-chrome")
    program = next(filter(None, map(shutil.which, names)), None)
    if program is None:
        raise SystemExit("there is no Chromium: the stills of the view stay as they are")
    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=program, args=SOFTWARE)
        for scheme in ("light", "dark"):
            window = {"width": 1100, "height": 900}
            tab = browser.new_context(viewport=window, color_scheme=scheme).new_page()
            tab.goto(page.resolve().as_uri())
            tab.wait_for_selector("#viewer.ready", timeout=60_000)
            tab.select_option('[data-part="axis"]', "y")
            tab.wait_for_timeout(1500)  # it is drawn finely when it rests
            shot = tab.locator("#viewer").screenshot()
            few = Image.open(io.BytesIO(shot)).convert("RGB").quantize(256, dither=0)
            few.save(FIGURES / f"view-{scheme}.png", optimize=True)
        browser.close()


def main() -> None:
    """Make all pictures."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--run", type=Path, help="a finished run of the scene spheroid")
    given = options.parse_args().run
    with tempfile.TemporaryDirectory() as place:
        if given is None:
            result = mc.run("spheroid", output=Path(place) / "run", report=False)
        else:
            result = mc.load_result(given)
        film(result)
        stills(result.report(place))


if __name__ == "__main__":
    main()
