"""A picture of the tissue that renews itself during a run, and the page that shows it.

It is drawn by Pillow alone within milliseconds: matplotlib takes a second to load and to draw. The
time between two pictures is a hundred times what one takes, so that they take a hundredth of the
run. They read the state and change nothing of it.
"""

from __future__ import annotations

import io
import math
import time as clock
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from multicell.cells import Cells, IntArray, State
from multicell.errors import OutputError
from multicell.population.extents import centre
from multicell.report.colours import STATE_COLOURS, TYPE_COLOURS
from multicell.report.letters import readable_from
from multicell.report.wording import cell_count, time_unit
from multicell.results.folder import LIVE, file_errors, remove, write_bytes, write_text
from multicell.results.tables import NAMED

if TYPE_CHECKING:
    from multicell.scene.scene import Scene
    from multicell.simulation import Simulation

PICTURE, PAGE = LIVE
WIDE, HIGH = 960, 600  # pixels of the picture
_LETTERS: Final = 18  # pixels of its letters
_FINER: Final = 2  # as many times it is drawn larger, for smooth edges
_SHARE: Final = 0.01  # of a run's time that pictures may take
_LEAST: Final = 2.0  # s between two of them
_FIRST: Final = 2000  # cells up to which those of the start are placed for a picture of their own
_TEXT, _QUIET, _PAPER = "#22303c", "#6b7a86", "#ffffff"


@final
class LivePage:
    """The page of a run in its folder, and when its picture is due.

    - ``folder``: of the run, which the caller has locked
    """

    def __init__(self, folder: Path, scene: Scene) -> None:
        self._folder, self._scene = folder, scene
        self._last, self._took = -math.inf, 0.0
        self.works = True  # False where the folder has no room for a picture

    def open(self, simulation: Simulation | None = None) -> None:
        """Write the page and the first picture.

        - ``simulation``: absent where it is not ready yet. Then the cells of the start are shown,
          before they push each other apart, unless it would take long to place them.
        """
        try:
            write_text(self._folder / PAGE, _page(self._scene))
        except OutputError:  # the files of the run meet the same disk, and say so
            self.works = False
        if simulation is not None:
            self.note(simulation)
        elif self._scene.initial.count <= _FIRST:
            from multicell.biology.initial import initial_cells

            self._draw(initial_cells(self._scene), 0.0)

    def note(self, simulation: Simulation) -> None:
        """Draw the tissue after a coupling step, if a picture is due."""
        pause = max(_LEAST, self._took / _SHARE)
        if self.works and clock.perf_counter() - self._last >= pause:
            self._draw(simulation.state.cells, simulation.time)

    def close(self) -> None:
        """Remove the page and its picture."""
        with file_errors("read", self._folder):
            if self._folder.is_dir():  # a user may have removed all of it
                remove(self._folder, LIVE)

    def _draw(self, cells: Cells, time: float) -> None:
        from PIL import Image, ImageDraw, ImageFont  # noqa: F401  # loaded once, and not timed

        begin = clock.perf_counter()
        try:
            write_bytes(self._folder / PICTURE, drawn(cells, self._scene, time))
        except OutputError:
            # the files of the run meet the same disk, and say so: a picture must not end it
            self.works = False
        self._last = clock.perf_counter()
        self._took = self._last - begin


def drawn(cells: Cells, scene: Scene, time: float) -> bytes:
    """Return a PNG of the cells that the plane through their centre cuts, as :mod:`section` does.

    In a plane they are all shown. Colours are those of types where there are several, else of
    states.
    """
    from PIL import Image, ImageDraw

    if scene.domain is not None and scene.domain.periodic:
        cells = cells.changed(position=scene.domain.inside(cells.position))
    group, palette = _groups(cells, scene)
    picture = Image.new("RGB", (_FINER * WIDE, _FINER * HIGH), _PAPER)
    pen = ImageDraw.Draw(picture)
    scale = _discs(pen, cells, group, list(palette.values()), scene.dimensions)
    picture = picture.reduce(_FINER)
    pen = ImageDraw.Draw(picture)
    present = set(group.tolist())
    shown = {name: colour for k, (name, colour) in enumerate(palette.items()) if k in present}
    _explain(pen, _words(cells, scene, time), shown, scale)
    packed = io.BytesIO()
    picture.save(packed, format="PNG", compress_level=1)
    return packed.getvalue()


def _words(cells: Cells, scene: Scene, time: float) -> str:
    unit = time_unit(scene.duration)
    of = f"{time / unit.seconds:.2f} of {scene.duration / unit.seconds:.4g} {unit.name}"
    plane = "" if scene.dimensions == 2 else ", section through the centre"
    return f"{of}, {cell_count(len(cells))}{plane}"


def _groups(cells: Cells, scene: Scene) -> tuple[IntArray, Mapping[str, str]]:
    """Return the group of each cell, (n,), and colours by the names of the groups."""
    if not 1 < len(scene.types) <= len(TYPE_COLOURS):
        return cells.state.astype(np.int64), {name: STATE_COLOURS[name] for name in NAMED["state"]}
    palette = dict(zip(scene.types, TYPE_COLOURS, strict=False))
    dead = np.where(cells.state == State.NECROTIC, len(palette), cells.kind)
    return dead.astype(np.int64), {**palette, "dead (necrotic)": STATE_COLOURS["necrotic"]}


def _discs(pen: Any, cells: Cells, group: IntArray, colours: list[str], dimensions: int) -> float:
    """Draw the cuts of cells about their centre, and return the pixels of a micrometre."""
    if len(cells) == 0:
        return 0.0
    middle = centre(cells, dimensions)
    offset = cells.position - middle
    square = cells.radius**2 - (offset[:, 2] ** 2 if dimensions == 3 else 0.0)
    cut = np.flatnonzero(square > 0.0)
    reach = float((np.abs(offset[:, :2]).max(axis=1) + cells.radius).max())
    scale = 0.42 * HIGH / reach
    size = _FINER * scale
    at = np.array([WIDE, HIGH]) * 0.5 * _FINER + offset[cut, :2] * np.array([size, -size])
    radius = np.sqrt(square[cut]) * size
    edge = 1 if len(cut) > 400 else 2
    boxes = np.hstack([at - radius[:, None], at + radius[:, None]]).tolist()
    for box, kind in zip(boxes, group[cut].tolist(), strict=True):
        pen.ellipse(box, fill=colours[kind], outline=_PAPER, width=edge)
    return scale


def _explain(pen: Any, words: str, palette: Mapping[str, str], scale: float) -> None:
    """Write the title, a bar of a round length, and the meaning of colours."""
    from PIL import ImageFont

    font = ImageFont.load_default(size=_LETTERS)
    pen.text((20, 14), words, fill=_TEXT, font=font)
    for k, (name, colour) in enumerate(palette.items()):
        top = 54 + 28 * k
        pen.ellipse((20, top + 4, 34, top + 18), fill=colour)
        pen.text((44, top), name[:24], fill=_QUIET, font=font)
    if scale > 0.0:
        longest = 0.25 * WIDE / scale
        power = 10.0 ** math.floor(math.log10(longest))
        length = max(n * power for n in (1.0, 2.0, 5.0) if n * power <= longest)
        right = WIDE - 20
        pen.line((right - length * scale, HIGH - 24, right, HIGH - 24), fill=_TEXT, width=3)
        label = f"{length:g} micrometres"  # the font has no Greek letters
        pen.text((right - pen.textlength(label, font), HIGH - 52), label, fill=_TEXT, font=font)


def _page(scene: Scene) -> str:
    from multicell.report.html import rendered, script

    return rendered(
        "live.html",
        title=scene.title or "Untitled run",
        picture=PICTURE,
        wide=WIDE,
        high=HIGH,
        least=readable_from(_LETTERS, WIDE / 72.0),
        **script("live.js"),
    )
