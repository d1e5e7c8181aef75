"""A run as a moving picture: every frame in one window, in one range of colours."""

from __future__ import annotations

import io
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.extras import needs
from multicell.report.plots.colouring import colourings, limits_of, quantity
from multicell.report.plots.plane import Plane
from multicell.report.plots.section import section, window
from multicell.report.plots.space import film_picture, room
from multicell.report.plots.spheres import View
from multicell.results.folder import file_errors, write_bytes

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

    from multicell.report.result import Result
    from multicell.results.frame import Frame

KINDS: Final = (".gif", ".webp", ".mp4")
TURN: Final = 90.0
"""Degrees between the outermost places of an eye that swings round cells in space."""
_DPI: Final = 80  # 800 x 500 pixels
_REST: Final = 1.5  # s for which the last picture stays
_QUALITY: Final = 80  # of WebP, per cent
_GROUPS: Final = (None, "state", "type", "phase", "clone")


def movie(
    result: Result,
    path: str | Path,
    *,
    plane: str | None = None,
    colour: str | None = None,
    rate: float = 8.0,
    progress: Callable[[int, int], None] | None = None,
    space: bool = False,
    cut: str = "quarter",
    turn: float = TURN,
    transparent: bool = False,
) -> Path:
    """Write all frames of a run as a moving picture: their sections, or the cells in space.

    Parameters
    ----------
    result
        The run.
    path
        File that ends in ``.gif`` or ``.webp``, or in ``.mp4`` where ``multicell[movie]`` is
        installed.
    plane, colour
        As for ``result.plot.section``.
    rate
        Frames in a second.
    progress
        Called with the number of pictures drawn and of all.
    space
        Show whole cells in space, of which a part is cut away, instead of a section.
    cut
        What is cut away in space: ``"none"``, ``"half"`` or ``"quarter"``.
    turn
        Degrees between the outermost places of the eye in space, which swings to one side and to
        the other in the course of the film; at its beginning and end it looks straight at the cut.
    transparent
        Leave the background out, for ``.webp`` in space only; the letters can be read on light and
        on dark pages.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    OutputError
        For a file of another kind or one that cannot be written, a plane that cuts no cell of a
        frame, a colour or a cut that is none, a run without cells, and options that do not go
        together.
    MissingPackage
        If the encoder of mp4 is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in KINDS:
        raise OutputError(f"'{path}' is no movie: its name must end in {' or '.join(KINDS)}")
    if not 0.0 < rate <= 60.0:
        raise OutputError(f"the rate is {rate:g} frames in a second, must be above 0, at most 60")
    if transparent and not (space and path.suffix.lower() == ".webp"):
        raise OutputError("a background can be left out of a .webp of cells in space only")
    if space and plane is not None:
        raise OutputError("cells in space are cut through their centre: name a cut, or a section")
    if path.suffix.lower() == ".mp4":
        needs("imageio_ffmpeg")
    numbers = [k for k, frame in enumerate(result.frames) if len(frame.cells)]
    if not numbers:
        raise OutputError("no frame of the run has cells: there is nothing to show")
    if space:
        rest = max(1, round(_REST * rate))  # pictures for which it turns on after the last frame
        views = [View(float(angle), cut) for angle in _angles(turn, len(numbers) + rest)]
        numbers += rest * numbers[-1:]
        pictures = _in_space(result, numbers, views, colour, transparent)
    else:
        pictures = _sections(result, numbers, plane, colour)
    told = _told(pictures, len(numbers), progress)
    write = {".gif": _gif, ".webp": _webp, ".mp4": _mp4}[path.suffix.lower()]
    with file_errors("write", path):
        write_bytes(path, write(told, rate, 0.0 if space else _REST))
    return path


def _angles(turn: float, count: int) -> NDArray[np.float64]:
    """Return where the eye stands in each picture: it swings to one side, to the other and back."""
    if not math.isfinite(turn):
        raise OutputError(f"a turn of {turn} degrees is none")
    return 0.5 * turn * np.sin(np.linspace(0.0, 2.0 * np.pi, count))


def _told(
    pictures: Iterator[NDArray[np.uint8]], count: int, progress: Callable[[int, int], None] | None
) -> Iterator[NDArray[np.uint8]]:
    """Tell of each picture that is drawn."""
    for done, picture in enumerate(pictures, start=1):
        yield picture
        if progress is not None:
            progress(done, count)


def _sections(
    result: Result, numbers: list[int], plane: str | None, colour: str | None
) -> Iterator[NDArray[np.uint8]]:
    """Yield sections as pixels, (500, 800, 3)."""
    scene = result.scene
    half = max(window(result.frames[k], scene) for k in numbers)
    limits = _limits(result, numbers, colour)
    where = None if plane is None else Plane.parse(plane)
    for number in numbers:
        figure = section(
            result.frames[number], scene, plane=where, colour=colour, lineage=result.lineage,
            half=half, limits=limits,
        )  # fmt: skip
        figure.set_dpi(_DPI)
        yield _pixels(figure)[:, :, :3].copy()


def _in_space(
    result: Result, numbers: list[int], views: list[View], colour: str | None, transparent: bool
) -> Iterator[NDArray[np.uint8]]:
    """Yield cells in space as pixels, (480, 640, 3), or with opacity (480, 640, 4)."""
    half = max(room(result.frames[k]) for k in dict.fromkeys(numbers))
    limits = _limits(result, list(dict.fromkeys(numbers)), colour)
    for number, view in zip(numbers, views, strict=True):
        figure = film_picture(
            result.frames[number], result.scene, view=view, half=half, dpi=_DPI, colour=colour,
            lineage=result.lineage, limits=limits, transparent=transparent,
        )  # fmt: skip
        yield _pixels(figure)[:, :, : 4 if transparent else 3].copy()


def _pixels(figure: Figure) -> NDArray[np.uint8]:
    """Return a figure as pixels with their opacity."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def _limits(result: Result, numbers: list[int], colour: str | None) -> tuple[float, float] | None:
    """Return one range of colours for all frames, or None where groups are shown."""
    if colour in _GROUPS:
        return None
    frames: list[Frame] = [result.frames[k] for k in numbers]
    known = colourings(frames[0])
    values = [quantity(frame, str(colour))[0] for frame in frames]
    return limits_of(values, from_zero=colour in known and colour in frames[0].concentrations)


def _gif(pictures: Iterator[NDArray[np.uint8]], rate: float, rest: float) -> bytes:
    """Return an animated GIF, all pictures in the colours of the last."""
    from PIL import Image

    images = [Image.fromarray(pixels) for pixels in pictures]
    # the last picture has the most cells; a palette of its own for each would flicker
    palette = images[-1].quantize(256)
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    file = io.BytesIO()
    small[0].save(
        file, format="GIF", save_all=True, append_images=small[1:], loop=0, optimize=True,
        duration=_durations(len(small), rate, rest),
    )  # fmt: skip
    return file.getvalue()


def _durations(count: int, rate: float, rest: float) -> list[int]:
    """Return for how long each picture stays, ms: the last as long as ``rest`` (s) at least."""
    step = round(1000.0 / rate)
    return [step] * (count - 1) + [max(step, round(1000.0 * rest))]


def _webp(pictures: Iterator[NDArray[np.uint8]], rate: float, rest: float) -> bytes:
    """Return an animated WebP."""
    from PIL import Image

    images = [Image.fromarray(pixels) for pixels in pictures]
    file = io.BytesIO()
    images[0].save(
        file, format="WEBP", save_all=True, append_images=images[1:], loop=0, quality=_QUALITY,
        method=4, duration=_durations(len(images), rate, rest),
    )  # fmt: skip
    return file.getvalue()


def _mp4(pictures: Iterator[NDArray[np.uint8]], rate: float, rest: float) -> bytes:
    """Return a film in H.264."""
    import imageio_ffmpeg

    first = next(pictures)
    high, wide = first.shape[:2]
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "movie.mp4"
        options: dict[str, Any] = {"fps": rate, "quality": 8, "macro_block_size": 2}
        film = imageio_ffmpeg.write_frames(str(path), (wide, high), **options)
        film.send(None)
        last = first
        film.send(first.tobytes())
        for last in pictures:
            film.send(last.tobytes())
        for _ in range(math.ceil(rest * rate)):
            film.send(last.tobytes())
        film.close()
        return path.read_bytes()
