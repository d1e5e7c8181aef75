"""A run as a moving picture: the section of every frame in one window, in one range of colours."""

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
from multicell.results.folder import file_errors, write_bytes

if TYPE_CHECKING:
    from collections.abc import Callable

    from multicell.report.result import Result
    from multicell.results.frame import Frame

KINDS: Final = (".gif", ".mp4")
_DPI: Final = 80  # 800 x 500 pixels
_REST: Final = 1.5  # s for which the last picture stays
_GROUPS: Final = (None, "state", "type", "phase", "clone")


def movie(
    result: Result,
    path: str | Path,
    *,
    plane: str | None = None,
    colour: str | None = None,
    rate: float = 8.0,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the sections of all frames of a run as a moving picture.

    Parameters
    ----------
    result
        The run.
    path
        File that ends in ``.gif``, or ``.mp4`` where ``multicell[movie]`` is installed.
    plane, colour
        As for ``result.plot.section``.
    rate
        Frames in a second.
    progress
        Called with the number of pictures drawn and of all.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    OutputError
        For a file of another kind or one that cannot be written, a plane that cuts no cell of a
        frame, a colour that is none, and a run without cells.
    MissingPackage
        If the encoder of mp4 is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in KINDS:
        raise OutputError(f"'{path}' is no movie: its name must end in {' or '.join(KINDS)}")
    if not 0.0 < rate <= 60.0:
        raise OutputError(f"the rate is {rate:g} frames in a second, must be above 0, at most 60")
    if path.suffix.lower() == ".mp4":
        needs("imageio_ffmpeg")
    numbers = [k for k, frame in enumerate(result.frames) if len(frame.cells)]
    if not numbers:
        raise OutputError("no frame of the run has cells: there is nothing to show")
    pictures = _pictures(result, numbers, plane, colour, progress)
    with file_errors("write", path):
        if path.suffix.lower() == ".gif":
            write_bytes(path, _gif(pictures, rate))
        else:
            write_bytes(path, _mp4(pictures, rate))
    return path


def _pictures(
    result: Result,
    numbers: list[int],
    plane: str | None,
    colour: str | None,
    progress: Callable[[int, int], None] | None,
) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures as pixels, (500, 800, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    scene = result.scene
    half = max(window(result.frames[k], scene) for k in numbers)
    limits = _limits(result, numbers, colour)
    where = None if plane is None else Plane.parse(plane)
    for done, number in enumerate(numbers, start=1):
        figure = section(
            result.frames[number], scene, plane=where, colour=colour, lineage=result.lineage,
            half=half, limits=limits,
        )  # fmt: skip
        figure.set_dpi(_DPI)
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
        if progress is not None:
            progress(done, len(numbers))


def _limits(result: Result, numbers: list[int], colour: str | None) -> tuple[float, float] | None:
    """Return one range of colours for all frames, or None where groups are shown."""
    if colour in _GROUPS:
        return None
    frames: list[Frame] = [result.frames[k] for k in numbers]
    known = colourings(frames[0])
    values = [quantity(frame, str(colour))[0] for frame in frames]
    return limits_of(values, from_zero=colour in known and colour in frames[0].concentrations)


def _gif(pictures: Iterator[NDArray[np.uint8]], rate: float) -> bytes:
    """Return an animated GIF, all pictures in the colours of the last."""
    from PIL import Image

    images = [Image.fromarray(pixels) for pixels in pictures]
    # the last picture has the most cells; a palette of its own for each would flicker
    palette = images[-1].quantize(256)
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    step = round(1000.0 / rate)
    rests = [step] * (len(small) - 1) + [round(1000.0 * _REST)]
    file = io.BytesIO()
    small[0].save(
        file, format="GIF", save_all=True, append_images=small[1:], duration=rests, loop=0,
        optimize=True,
    )  # fmt: skip
    return file.getvalue()


def _mp4(pictures: Iterator[NDArray[np.uint8]], rate: float) -> bytes:
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
        for _ in range(math.ceil(_REST * rate)):
            film.send(last.tobytes())
        film.close()
        return path.read_bytes()
