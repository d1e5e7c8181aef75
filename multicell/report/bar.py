"""The bar of ``progress=True``, in terminals and notebooks alike."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from multicell.errors import SceneError
from multicell.report.wording import cell_count, time_unit
from multicell.units import shown

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.simulation import Simulation

Progress = Callable[["Simulation"], None]


@contextmanager
def progress_callback(scene: Scene, progress: Progress | bool | None) -> Iterator[Progress | None]:
    """Yield a callback for the end of coupling steps: the one given, or for True a bar's."""
    if progress is not None and not isinstance(progress, bool) and not callable(progress):
        raise SceneError("progress", f"is {shown(progress)}, must be a function, True or False")
    if not isinstance(progress, bool):
        yield progress
        return
    if not progress:
        yield None
        return
    from tqdm import TqdmWarning

    with warnings.catch_warnings():
        # without ipywidgets a notebook gets the bar of a terminal
        warnings.simplefilter("ignore", TqdmWarning)
        from tqdm.auto import tqdm
    unit = time_unit(scene.duration)
    total = scene.duration / unit.seconds
    words = (
        f"{{percentage:3.0f}} %|{{bar}}| {{n:.2f}} of {total:g} {unit.name}{{postfix}}, {{elapsed}}"
    )
    with tqdm(total=total, unit=unit.name, bar_format=words, dynamic_ncols=True) as bar:
        bar.set_postfix_str("preparing")

        def advance(simulation: Simulation) -> None:
            bar.set_postfix_str(cell_count(len(simulation.state.cells)), refresh=False)
            bar.update(simulation.time / unit.seconds - bar.n)

        yield advance
