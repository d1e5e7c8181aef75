"""Style of all pictures: layout, colours, headings."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable, Mapping, Sized
from functools import wraps
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from multicell.cells import FloatArray
from multicell.errors import OutputError
from multicell.report.colours import STATE_COLOURS as STATE_COLOURS
from multicell.report.colours import TYPE_COLOURS
from multicell.report.letters import readable_from
from multicell.report.wording import TimeUnit, cell_count, time_unit
from multicell.results.folder import write_bytes
from multicell.results.frame import Frame
from multicell.scene.scene import Scene

History = Mapping[str, NDArray[np.float64]]  # columns of a run's history by name, (m,) each

INK, QUIET, BLUE, RED = "#22303c", "#6b7a86", "#2f6fb0", "#b5432f"
DPI: Final = 160  # dots per inch of pictures on pages and in files
TITLE: Final = "title"
SUBTITLE: Final = "subtitle"
"""The ``gid`` of a figure's title, which pages leave out, and of what is said below it."""
HEADING: Final[dict[str, Any]] = {"weight": "bold", "fontsize": 13, "parse_math": False}
SIZE: Final = (10.0, 6.25)  # inches: 1600 x 1000 pixels
_TITLE_HEIGHT: Final = 0.4  # inches, what the title takes
_STYLE: Final[dict[Any, Any]] = {
    "font.size": 12,
    "axes.titlesize": 13,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 9,
    "axes.labelsize": 12,
    "axes.edgecolor": "#9aa7b1",
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e9ed",
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "text.parse_math": False,  # a dollar sign or an underscore in a name is no formula
}


def draw_style(points: Sized) -> str:
    """Return a line, or a point where one moment makes no line."""
    return "-" if len(points) > 1 else "o"


def draw_line(axes: Any, x: FloatArray, y: FloatArray, colour: str, **options: Any) -> None:
    """Draw a curve, or a point where one moment makes no line."""
    axes.plot(x, y, draw_style(x), **{"color": colour, "lw": 2, **options})


def time_axes(axes: Iterable[Any], time: FloatArray, unit: TimeUnit) -> None:
    """Let axes span times in a unit, and name it."""
    for one in axes:
        one.set_xlim(*span(time))
        one.set_xlabel(f"time ({unit.name})")


def span(time: FloatArray) -> tuple[float, float]:
    """Return the range of times to show, which has a width even for one moment."""
    first, last = float(time[0]), float(time[-1])
    return (first, last) if last > first else (first - 0.5, first + 0.5)


def counts(axis: Any) -> None:
    """Write whole numbers with commas on an axis."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))


def few_decades(axis: Any) -> None:
    """Label a logarithmic axis by plain numbers where it spans little, and no minor tick ever.

    Labels of minor ticks run into each other where an axis spans little more than a decade.
    """
    low, high = axis.get_view_interval()
    if high < 15.0 * low:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def moment(frame: Frame) -> str:
    """Return the number of cells and the time of a frame in words."""
    return f"{cell_count(len(frame.cells))} after {time_unit(frame.time).text(frame.time)}"


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Run a drawing function under this module's style."""

    @wraps(draw)
    def drawn(*args: Any, **kwargs: Any) -> Figure:
        with mpl.rc_context(_STYLE):
            figure = draw(*args, **kwargs)
            # labels such as 10² are formulas: ticks made under the style would show their source
            for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
                for formatter, ticks in (
                    (axis.get_major_formatter(), axis.get_major_ticks()),
                    (axis.get_minor_formatter(), axis.get_minor_ticks()),
                ):
                    for tick in ticks if isinstance(formatter, LogFormatter) else ():
                        tick.label1.set_parse_math(True)
                        tick.label2.set_parse_math(True)
            return figure

    return drawn


@final
class Picture(Figure):
    """A figure that a notebook shows where it is the value of a cell, without pyplot's help."""

    def _repr_png_(self) -> bytes:
        return render(self, "png")


def blank(title: str, subtitle: str, size: tuple[float, float] = SIZE) -> Figure:
    """Return an empty figure of a size in inches with its heading."""
    figure = Picture(figsize=size, dpi=DPI)
    shown = title if len(title) <= 70 else title[:69] + "…"
    # a dollar sign in a title is not a formula
    look: dict[str, Any] = {"va": "center", "parse_math": False}
    top, below = (1.0 - inches / size[1] for inches in (0.3125, 0.59375))
    figure.text(0.04, top, shown, gid=TITLE, fontsize=16, weight="bold", **look)
    figure.text(0.04, below, subtitle, gid=SUBTITLE, fontsize=12, color=QUIET, **look)
    return figure


def headed(scene: Scene, subtitle: str) -> Figure:
    """Return an empty figure headed by the scene's title."""
    return blank(scene.title or "Untitled run", subtitle)


def panel_grid(
    figure: Figure,
    count: int,
    columns: int,
    edges: tuple[float, float, float, float],
    gaps: tuple[float, float],
) -> list[Axes]:
    """Return so many axes in rows of a number of columns.

    - ``edges``: left, bottom, right and top of all, as parts of the figure
    - ``gaps``: between columns and between rows, as parts of the mean width and height of the axes
    """
    place = dict(zip(("left", "bottom", "right", "top"), edges, strict=True))
    place |= dict(zip(("wspace", "hspace"), gaps, strict=True))
    grid = figure.add_gridspec(-(-count // columns), columns, **place)
    return [figure.add_subplot(grid[k]) for k in range(count)]


PICTURE_FORMATS: Final = {".png": "png", ".svg": "svg", ".pdf": "pdf"}
"""Formats of pictures by the endings of their files."""


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF, as its file's name ends."""
    format = PICTURE_FORMATS.get(path.suffix.lower())
    if format is None:
        raise OutputError(
            f"'{path}' is no picture: its name must end in {', '.join(PICTURE_FORMATS)}"
        )
    # drawn in memory: a picture is either complete or not there
    write_bytes(path, render(figure, format))


def render(figure: Figure, format: str) -> bytes:
    """Render a figure in one of ``PICTURE_FORMATS``; the same figure is the same file."""
    picture = io.BytesIO()
    by = {"pdf": "Creator", "svg": "Creator", "png": "Software"}[format]
    metadata: dict[str, Any] = {by: "multicell"}
    metadata |= {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(format, {})
    with mpl.rc_context({"svg.hashsalt": "multicell", "svg.fonttype": "none"}):
        figure.savefig(picture, format=format, dpi=DPI, metadata=metadata)
    return picture.getvalue()


class InlinePicture(NamedTuple):
    """A picture as a page shows it."""

    png: str  # in base64
    dark: str  # the same in dark mode
    wide: int  # pixels
    high: int
    least: int  # width in pixels of a page, 1/96 inch, from which all letters can be read
    subtitle: str  # what the picture says of itself


def inline_picture(figure: Figure, path: Path | None = None) -> InlinePicture:
    """Return a figure for a page; afterwards it has no title and the colours of dark mode.

    - ``path``: PNG file to write it to as well, with its title
    """
    from multicell.report.plots.dark import darken

    figure.set_dpi(DPI)
    titles = [text for text in figure.texts if text.get_gid() == TITLE]
    for title in titles:
        title.set_visible(False)
    canvas = _drawn(figure)
    # in whole pixels, as Matplotlib rounds
    wide, high = figure.get_size_inches()
    size = int(wide * DPI), int((high - _TITLE_HEIGHT * len(titles)) * DPI)
    png = _packed(canvas, size)
    if path is not None:  # the same drawing, with the title on it
        for title in titles:
            title.set_visible(True)
            title.draw(canvas.get_renderer())
            title.set_visible(False)
        whole, known = io.BytesIO(), {"Software": "multicell"}  # as :func:`render` makes it
        imsave(whole, canvas.buffer_rgba(), format="png", dpi=DPI, metadata=known)
        write_bytes(path, whole.getvalue())
    least = readable_width(figure)
    darken(figure)
    dark = _packed(_drawn(figure), size)
    subtitles = [text.get_text() for text in figure.texts if text.get_gid() == SUBTITLE]
    return InlinePicture(png, dark, *size, least, subtitle="".join(subtitles))


def _drawn(figure: Figure) -> Any:
    canvas: Any = FigureCanvasAgg(figure)  # whose methods have no types
    canvas.draw()
    return canvas


def readable_width(figure: Figure) -> int:
    """Return the width from which all letters of a drawn figure can be read, px of 1/96 inch."""
    texts = [text for text in figure.findobj(Text) if isinstance(text, Text)]
    sizes = [float(t.get_fontsize()) for t in texts if t.get_visible() and t.get_text().strip()]
    return readable_from(min(sizes), figure.get_figwidth()) if sizes else 0


def _packed(canvas: Any, size: tuple[int, int]) -> str:
    """Return the lower part of a drawn canvas, of a size in pixels, as a PNG in base64."""
    from PIL import Image

    packed = io.BytesIO()
    pixels = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[-size[1] :])
    flat = pixels.view("<u4").reshape(-1)
    # a palette makes it a third as large; harder packing saves a tenth in ten times the time. Made
    # of the colours that there are, not of all pixels, it takes a fifth of the time.
    first = np.flatnonzero(np.append(True, flat[1:] != flat[:-1]))
    colours, which = np.unique(flat[first], return_inverse=True)
    swatch = Image.frombytes("RGB", (len(colours), 1), colours.tobytes(), "raw", "RGBX")
    few = swatch.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    places = np.repeat(np.asarray(few)[0][which], np.diff(first, append=len(flat)))
    image = Image.fromarray(places.reshape(pixels.shape[:2]), "P")
    image.putpalette(few.getpalette() or [])
    image.save(packed, format="PNG", compress_level=6)
    return base64.b64encode(packed.getvalue()).decode("ascii")


def type_colours(names: Iterable[str]) -> dict[str, str]:
    """Return a colour for each cell type; more than seven take theirs from a scale."""
    from matplotlib.colors import to_hex

    names = list(names)
    if len(names) <= len(TYPE_COLOURS):
        return dict(zip(names, TYPE_COLOURS, strict=False))
    # the darkest end is left to necrotic cells
    shades = mpl.colormaps["cividis"](0.15 + 0.85 * np.arange(len(names)) / (len(names) - 1))
    return {name: to_hex(shade) for name, shade in zip(names, shades, strict=True)}


def type_label(name: str, most: int = 22) -> str:
    """Return a name as a legend shows it: of few letters, and never taken for a hidden label."""
    short = name if len(name) <= most else name[: most - 1] + "…"
    return f"\u200b{short}" if short.startswith("_") else short
