"""Make the film of the README, the section of the first page and the stills of docs/pictures.md.

``python docs/programs/moving_pictures.py [--run FOLDER]`` runs the built-in scene ``spheroid``
(about ten seconds on one core) unless FOLDER holds that run already, and writes
``figures/spheroid.webp`` by ``multicell movie`` and ``figures/section.png`` by ``multicell plot``.
The number of cells at the end and the size of the run are recorded beside them
(picture_origins.py): pages quote them from there. Playwright takes the stills
``figures/view-light.png`` and ``figures/view-dark.png`` of the run's page in Chromium; without
either they are left as they are.
"""

from __future__ import annotations

import argparse
import io
import shutil
import tempfile
from pathlib import Path

from picture_origins import FIGURES, record
from PIL import Image

import multicell as mc
from multicell.report.plots.movie import movie
from multicell.report.plots.style import save_figure
from multicell.studies.runs import MODEL_VERSION

SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
COMMAND = "python docs/programs/moving_pictures.py"


def draw_run(result: mc.Result) -> None:
    """Write the film and the section, and what pages say of the run."""
    end = result.summary()
    facts = {
        "days": round(end["time"] / 86400.0, 3),
        "cells": end["cells"],
        "diameter in um": round(end["diameter"], 1),
        "necrotic cells": end["states"]["necrotic"],
    }
    film, section = FIGURES / "spheroid.webp", FIGURES / "section.png"
    movie(result, film, space=True, turn=100.0, rate=10.0, transparent=True)
    save_figure(result.plot.section(), section)
    reduce_colours(Image.open(section)).save(section, optimize=True)
    for picture in (film, section):
        print(picture, f"{picture.stat().st_size / 1e6:.2f} MB")
        record(picture, COMMAND, model=MODEL_VERSION, facts=facts)


def reduce_colours(picture: Image.Image) -> Image.Image:
    """Return a picture with 256 colours, of a third of the size in a file."""
    return picture.convert("RGB").quantize(256, dither=Image.Dither.NONE)


def stills(page: Path) -> None:
    """Take the view, cut across x and coloured by the state of the cells."""
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
            few = reduce_colours(Image.open(io.BytesIO(shot)))
            picture = FIGURES / f"view-{scheme}.png"
            few.save(picture, optimize=True)
            record(picture, COMMAND, model=MODEL_VERSION)
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
        draw_run(result)
        stills(result.report(place))


if __name__ == "__main__":
    main()
