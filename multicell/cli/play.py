"""The command ``multicell play``: a page with sliders, and a run for where they stand."""

from __future__ import annotations

import webbrowser
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from multicell.cli import options as shared
from multicell.cli.process import complain
from multicell.cli.study import key_values
from multicell.errors import SceneError
from multicell.host.extras import needs

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


@click.command()
@shared.of_scene
@shared.keyed(
    "--key",
    "keys",
    "KEY=LOW:HIGH",
    "A slider, as nutrients.oxygen.boundary='1:21 %' or drag.viscosity='log 0.1:10 kPa s'. "
    "May be given several times.  [default: the keys that matter most]",
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="By default a free one.")
@click.option("--no-browser", is_flag=True, help="Print the address, and do not open it.")
def play(scene: Scene, keys: Sequence[str], port: int, no_browser: bool) -> None:
    """Open a page with sliders for keys of a SCENE, and the view of a run beside them.

    The unchanged scene runs at once. Each move of a slider begins another run in the background,
    with coarse cells where the scene allows that. The page is served to this machine alone, at an
    address with a secret; Ctrl-C ends all of it.
    """
    needs("tornado")
    from multicell.cli.playground import Playground, serve
    from multicell.cli.slider_keys import asked_units, default_ranges
    from multicell.studies.axes import check_ranges, parse_ranges

    texts = key_values(keys, "--key") if keys else default_ranges(scene)
    ranges = parse_ranges(texts, scene)
    check_ranges(scene, ranges)
    factor, note = _factor(scene)
    laws = click.get_current_context().params["laws"]
    with Playground(
        scene, ranges, factor, note, laws, units=asked_units(texts, ranges)
    ) as playground:
        playground.begin()

        def ready(address: str) -> None:
            click.echo(f"{address}\nCtrl-C ends it.")
            # what a browser is called with, every user of this machine may read
            if not no_browser and not webbrowser.open(playground.door(address).as_uri()):
                complain("There is no browser to open it.")

        serve(playground, port, ready)


def _factor(scene: Scene) -> tuple[float, str]:
    """Return how much wider cells are, and why they are not where that is not possible."""
    from multicell.scene.coarsening import coarsen

    try:
        made = coarsen(scene, 2.0)
    except SceneError as error:
        return 1.0, f"Cells of full size, since {error.path} {error.problem}."
    return 2.0, f"Each cell stands for {made.cells.represents:g}."
