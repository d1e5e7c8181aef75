"""Sections through a population: its cells with the nutrient around them, and every field."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from multicell.cells import Cells, FloatArray, State
from multicell.errors import OutputError, SceneError
from multicell.population.extents import centre, uniform_radius
from multicell.report.plots import style
from multicell.report.plots.colouring import SCALE, Colouring
from multicell.report.plots.dark import GROUND
from multicell.report.wording import cell_count
from multicell.results.frame import Field, Frame
from multicell.scene.responses import shared_threshold
from multicell.scene.scene import Scene
from multicell.units import to_base

_MIN_LEVEL = 1e-9  # part of the highest concentration of a field below which it is not drawn
_LEAST_RANGE: Final = 1e-3  # of the shades of a field, as a part of its highest concentration
_DEPTH_DIAMETERS: Final = 3.0  # mean diameters behind a plane within which cells are drawn
_SMOOTHING: Final = 1.5  # mean radii, the standard deviation: a bell about two diameters wide
_FINE: Final = 4  # points of the grid to a smoothing length
_MAX_POINTS: Final = 2000  # points along a side
_MIN_DENSITY: Final = 1e-9  # of the largest density, below which there is no tissue
LABEL: Final = "most cells are necrotic"
_WATER: Final = LinearSegmentedColormap.from_list("water", ["#ffffff", "#8fbce0"])
"""Shades of a field behind cells: white to a light blue, against which cells stand out."""
_TEXT: Final = re.compile(r"([xyz])(?:=(.+))?")
_ORDERS: Final = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}


@final
@dataclass(frozen=True)
class Plane:
    """A plane across an axis.

    - ``axis``: ``"x"``, ``"y"`` or ``"z"``
    - ``at``, float or None, µm: where on it; None for the centre of the cells
    """

    axis: str = "z"
    at: float | None = None

    @classmethod
    def parse(cls, text: str) -> Plane:
        """Return the plane that a text such as ``"x"``, ``"x=0"`` or ``"z=12 um"`` names."""
        match = _TEXT.fullmatch(text.strip())
        if match is None:
            raise OutputError(f"{text!r} is no plane: write x, y or z, or for example z='12 um'")
        if match[2] is None:
            return cls(match[1])
        with suppress(ValueError):
            return cls(match[1], float(match[2]))
        try:
            return cls(match[1], to_base(match[2], "um", text))
        except SceneError as error:
            raise OutputError(f"{text!r} is no plane: {error.problem}. {error.hint}") from None


def turn_frame(frame: Frame, plane: Plane) -> Frame:
    """Return a frame with its axes in another order, so that the plane lies across the third.

    The order is cyclic: nothing is mirrored.
    """
    if plane.axis == "z":
        return frame
    order = list(_ORDERS[plane.axis])
    cells = frame.cells.shared()
    cells.position = np.ascontiguousarray(frame.cells.position[:, order])
    fields = {}
    for name, field in frame.fields.items():
        values = field.values if field.kind == "radial" else field.values.transpose(order)
        fields[name] = replace(field, origin=field.origin[order], values=values)
    return replace(frame, cells=cells, fields=fields)


def section_height(frame: Frame, plane: Plane, middle: FloatArray) -> float:
    """Return where the plane cuts a frame that was turned, µm on its third axis."""
    if plane.at is None:
        return float(middle[2])
    place, radius = frame.cells.position[:, 2], frame.cells.radius
    low, high = float((place - radius).min()), float((place + radius).max())
    if not (np.abs(place - plane.at) < radius).any():
        raise OutputError(
            f"the plane {plane.axis} = {plane.at:g} um cuts no cell: they lie between "
            f"{low:.4g} and {high:.4g} um"
        )
    return plane.at


@style.styled
def section(
    frame: Frame, scene: Scene, shade: Colouring, plane: Plane | None = None, half: float = 0.0
) -> Figure:
    """Draw the cells that a plane cuts, each with the radius of its cut, and those behind it.

    Cells behind the plane are the paler the deeper they lie. Two or three cells without a field are
    cut by the plane that holds their centres, unless one is named. Behind the cells is the scene's
    first field, with a line where cells begin to rest; a dashed line goes round where most cells
    are necrotic, averaged over about a cell's diameter. Where colours show the values of a
    quantity, phases or clones there is neither.

    - ``shade``: colours of the cells
    - ``plane``: absent: z = centre of the cells
    - ``half``: half the height of the window, µm; absent: as the cells need it
    """
    dimensions, where = scene.dimensions, plane or Plane()
    if dimensions == 2 and where.axis != "z":
        raise OutputError(f"the cells lie in the plane z = 0: a plane {where.axis} is none of them")
    ahead = turn_frame(frame, where)
    middle = centre(ahead.cells, dimensions)
    place, level = ahead.cells.position, section_height(ahead, where, middle)
    if plane is None and 1 < len(frame.cells) <= 3 and not frame.fields:
        # turned about the centre so that the last axis is their thinnest one
        _, _, turn = np.linalg.svd(place - middle)
        place = middle + (place - middle) @ turn.T
    square = frame.cells.radius**2 - (place[:, 2] - level) ** 2
    inside = square > 0.0
    cut = ""
    if dimensions == 3:
        across = "" if where.axis == "z" else f" across {where.axis}"
        at = f" at {where.axis} = {where.at:g} µm" if where.at is not None else None
        cut = f": section{at or f'{across} through the centre'} ({cell_count(int(inside.sum()))})"
    figure = style.headed(scene, style.moment(frame) + cut)
    axes = figure.add_axes((0.03, 0.04, 0.66, 0.83))
    half = half or window(frame, scene)
    frame_window(axes, middle, half, half * (0.66 * style.SIZE[0]) / (0.83 * style.SIZE[1]))
    axes.spines[["top", "right"]].set_visible(True)
    _draw_deep(axes, place, frame.cells.radius, level, shade.rgb)
    draw_discs(axes, place[inside, :2], np.sqrt(square[inside]), shade.rgb[inside])
    fields = ahead.fields
    name = next((name for name in scene.nutrients if name in fields), "")
    if shade.title in ("state", "type"):
        dead = draw_necrotic(axes, frame.cells, place, level) if fields else False
        _draw_behind(figure, axes, fields.get(name), level, scene, dead)
    scale_bar(axes, middle, half)
    explain_colours(figure, shade, "Cells in this section" if dimensions == 3 else "Cells", inside)
    return figure


@style.styled
def field_maps(frame: Frame, scene: Scene) -> Figure:
    """Draw a map of every field in the plane z = centre.

    A line shows where cells begin to rest, a dashed one where most are necrotic.
    """
    shown = [name for name in scene.nutrients if name in frame.fields]
    if not shown:
        raise ValueError("the frame has no fields: there is nothing to map")
    cells, middle = frame.cells, centre(frame.cells, scene.dimensions)
    half = window(frame, scene)
    figure = style.headed(
        scene, f"{style.moment(frame)}: section through the centre, {2 * half:.0f} µm wide"
    )
    columns = max((len(shown) + 1) // 2, min(len(shown), 2))
    grid = style.panel_grid(figure, len(shown), columns, (0.04, 0.06, 0.93, 0.81), (0.34, 0.26))
    words = [style.type_label(name.replace("_", " "), 15).capitalize() for name in shown]
    for axes, name, word in zip(grid, shown, words, strict=True):
        axes.set_title(f"{word} (mM)")
        frame_window(axes, middle, half)
        axes.grid(False)
        nutrient, field = scene.nutrients[name], frame.fields[name]
        resting = shared_threshold(scene, name, "quiescence")
        # of a finite medium what was left
        ledger = {} if frame.progress is None else frame.progress.ledger.get(name, {})
        medium = float(ledger.get("level", nutrient.medium(frame.time)))
        viridis = mpl.colormaps["viridis"]
        shades, _ = draw_field(axes, field, float(middle[2]), resting, medium, None, viridis)
        if nutrient.necrosis is not None:
            draw_necrotic(axes, cells, cells.position, float(middle[2]))
        scale_bar(axes, middle, half, edge=1.5)
        bar = figure.colorbar(shades, cax=axes.inset_axes((1.03, 0.0, 0.05, 1.0)))
        bar.outline.set_visible(False)
        bar.locator = MaxNLocator(5, prune="both")  # two bars may stand one above the other
        bar.formatter = ScalarFormatter(useOffset=False)
        bar.ax.tick_params(labelsize=9)
        bar.ax.grid(False)
    return figure


def window(frame: Frame, scene: Scene) -> float:
    """Return half the height of a window that shows all cells of a frame, µm."""
    middle = centre(frame.cells, scene.dimensions)
    size = uniform_radius(frame.cells, middle, scene.dimensions)
    return 1.22 * size + 2.0 * float(frame.cells.radius.max())


def _draw_deep(
    axes: Axes, place: FloatArray, radius: FloatArray, level: float, rgb: FloatArray
) -> None:
    """Draw cells behind the plane, the deepest first, fading within some cells' widths."""
    depth = level - place[:, 2]
    reach = _DEPTH_DIAMETERS * 2.0 * float(radius.mean())
    behind = np.flatnonzero((depth >= radius) & (depth < reach))
    order = behind[np.argsort(-depth[behind])]
    if len(order) == 0:
        return
    paler = (0.45 + 0.45 * depth[order] / reach)[:, None]
    pale = rgb[order] * (1.0 - paler) + paler
    draw_discs(axes, place[order, :2], radius[order], pale, edge=0.0)


def frame_window(axes: Axes, middle: FloatArray, half: float, width: float | None = None) -> None:
    """Give axes one scale about the centre and no ticks; ``width`` is half of it, as ``half``."""
    across = half if width is None else width
    axes.set_xlim(middle[0] - across, middle[0] + across)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set(xticks=[], yticks=[], aspect="equal", gid=GROUND)


def draw_discs(
    axes: Axes, position: FloatArray, radius: FloatArray, rgb: FloatArray, edge: float | None = None
) -> None:
    """Draw circles of true size, each in its colour; ``edge`` is the width of their white line."""
    size = 2.0 * radius
    if edge is None:
        edge = 0.5 if len(size) > 200 else 1.2
    discs = EllipseCollection(
        size,
        size,
        np.zeros(len(size)),
        units="xy",
        offsets=position,
        offset_transform=axes.transData,
        facecolors=rgb,
        edgecolors="white",
        linewidths=edge,
        zorder=2,
    )
    axes.add_collection(discs)


def slice_at(field: Field, z: float) -> FloatArray:
    """Return the field on the plane at height z (µm), interpolated linearly: (nx, ny)."""
    if field.kind == "radial":
        field = field.in_plane(z)
    heights = field.axis(2)
    if len(heights) == 1:
        return np.asarray(field.values[:, :, 0])
    if not heights[0] <= z <= heights[-1]:
        raise ValueError(f"the plane z = {z:g} um lies outside the grid of {field.name}")
    below = min(int(np.searchsorted(heights, z, side="right")), len(heights) - 1) - 1
    part = (z - heights[below]) / (heights[below + 1] - heights[below])
    return np.asarray((1.0 - part) * field.values[..., below] + part * field.values[..., below + 1])


def refine(field: Field, z: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x, y and the field on the plane at z, four points to a grid spacing.

    Cubic polynomials are for the eye only: lines through the bare grid would look like polygons.
    """
    plane = slice_at(field, z)
    x, y = (np.linspace(0, n - 1, 4 * (n - 1) + 1) for n in plane.shape)
    fine = _quarters(_quarters(plane).T).T
    at = [field.axis(k)[0] + index * field.spacing for k, index in enumerate((x, y))]
    return at[0], at[1], fine.T


def _quarters(values: FloatArray) -> FloatArray:
    """Return values at four points to a spacing along the first axis, by Catmull–Rom polynomials.

    - ``values``: (n, m)

    Returns (4 n - 3, m). SciPy's splines would take as long to load as all else to draw.
    """
    if len(values) == 1:
        return values
    ends = 2.0 * values[:1] - values[1:2], 2.0 * values[-1:] - values[-2:-1]
    around = np.vstack([ends[0], values, ends[1]])[:, None]
    a, b, c, d = (around[k : k + len(values) - 1] for k in range(4))
    t = np.arange(4.0)[:, None] / 4.0
    bend = 2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)
    fine = b + 0.5 * t * (c - a + t * bend)
    return np.vstack([fine.reshape(-1, values.shape[1]), values[-1:]])


def draw_field(
    axes: Axes,
    field: Field,
    z: float,
    resting: float | None,
    medium: float,
    low: float | None,
    colours: Colormap,
) -> tuple[AxesImage, float | None]:
    """Draw a field on the plane at z as shades, with a line at the threshold of quiescence.

    There is no line at the threshold of necrosis: see :func:`necrotic_share`.

    - ``resting``: threshold of quiescence that all cells have, mM, or None
    - ``medium``: concentration around the grid, mM
    - ``low``: where the colours begin, mM; None for the lowest value

    Returns shades; resting: threshold of quiescence, if there is a line for it.
    """
    x, y, plane = refine(field, z)
    low = min(float(plane.min()), medium) if low is None else low
    top = max(float(plane.max()), medium)
    top = top if top > low else low + 1.0
    low = min(low, top - _LEAST_RANGE * abs(top))
    axes.set_facecolor(colours((medium - low) / (top - low)))
    window = axes.axis()
    half = 0.5 * (x[1] - x[0])
    extent = (x[0] - half, x[-1] + half, y[0] - half, y[-1] + half)
    shades = axes.imshow(
        plane,
        extent=extent,
        origin="lower",
        cmap=colours,
        vmin=low,
        vmax=top,
        zorder=0,
        interpolation="bilinear",
    )
    axes.axis(window)
    if resting is None or not plane.min() < resting < plane.max():
        return shades, None
    line: dict[str, Any] = {"levels": [resting], "zorder": 3}
    axes.contour(x, y, plane, colors="white", linewidths=3.6, **line)
    axes.contour(x, y, plane, colors=style.RED, linewidths=1.8, **line)
    return shades, resting


def necrotic_share(
    cells: Cells, place: FloatArray, level: float
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return which part of the nearby cells is necrotic, on a grid over a plane.

    "Nearby" is a Gaussian in space whose standard deviation is 1.5 mean radii of the cells: a
    line through this field says where the core ends as far as the cells show. An isoline of the
    nutrient cannot: dead cells take up nothing, so that the concentration in the core levels off
    close to the threshold itself.

    - ``cells``: radii and states
    - ``place``, (n, 3) µm: positions in the axes of the picture
    - ``level``: height of the plane on the third axis, µm

    Returns x, (nx,), y, (ny,) µm; share, (ny, nx): 0 to 1, NaN away from cells; None if no cell
    is necrotic.
    """
    dead = cells.state == State.NECROTIC
    if not dead.any():
        return None
    width = _SMOOTHING * float(cells.radius.mean())
    low, high = place[:, :2].min(axis=0) - 2.0 * width, place[:, :2].max(axis=0) + 2.0 * width
    pixel = max(width / _FINE, float((high - low).max()) / _MAX_POINTS)
    edges = [np.arange(a, b + pixel, pixel) for a, b in zip(low, high, strict=True)]
    weight = np.exp(-0.5 * ((place[:, 2] - level) / width) ** 2)
    flat = place[:, 0], place[:, 1], edges
    whole, part = (
        _smooth(np.histogram2d(*flat, weights=w)[0], width / pixel) for w in (weight, weight * dead)
    )
    known = whole > _MIN_DENSITY * whole.max()
    share = np.divide(part, whole, out=np.full_like(whole, np.nan), where=known)
    x, y = (0.5 * (edge[1:] + edge[:-1]) for edge in edges)
    return x, y, share.T


def _smooth(values: FloatArray, width: float) -> FloatArray:
    """Return the convolution of a grid with a Gaussian, (nx, ny), with zeros beyond its edges.

    - ``width``: its standard deviation, in points
    """
    shape = [n + int(9.0 * width) + 1 for n in values.shape]  # it repeats only there
    away = [np.minimum(np.arange(n), n - np.arange(n)) / width for n in shape]
    x, y = (np.fft.fft(bell / bell.sum()).real for bell in (np.exp(-0.5 * k**2) for k in away))
    bell = x[:, None] * y[: shape[1] // 2 + 1]
    nx, ny = values.shape
    return np.asarray(np.fft.irfft2(bell * np.fft.rfft2(values, shape), shape)[:nx, :ny])


def draw_necrotic(axes: Axes, cells: Cells, place: FloatArray, level: float) -> bool:
    """Draw a line round where most cells are necrotic, and return whether there is such a place."""
    found = necrotic_share(cells, place, level)
    if found is None or not np.nanmax(found[2]) > 0.5:
        return False
    x, y, share = found
    filled = np.nan_to_num(share)
    line: dict[str, Any] = {"levels": [0.5], "zorder": 3}
    axes.contour(x, y, filled, colors="white", linewidths=3.6, **line)
    axes.contour(x, y, filled, colors=style.RED, linewidths=1.8, linestyles="--", **line)
    return True


def _draw_behind(
    figure: Figure, axes: Axes, field: Field | None, z: float, scene: Scene, dead: bool
) -> None:
    """Draw a field behind the cells of a section, and explain its shades and all lines.

    What is left of one that has been used up or has decayed is not: shades of it would be rounding.
    """
    line: dict[str, Any] = {"color": style.RED, "lw": 1.8}
    handles = [Line2D([], [], ls="--", label=LABEL, **line)] if dead else []
    nutrient = None if field is None else scene.nutrients.get(field.name)
    if (
        field is not None
        and nutrient is not None
        and max(field.values.max(), nutrient.boundary) > _MIN_LEVEL * nutrient.highest
    ):
        own = shared_threshold(scene, field.name, "quiescence")
        shades, resting = draw_field(axes, field, z, own, nutrient.boundary, 0.0, _WATER)
        bar = _draw_bar(figure, shades, f"{field.name.capitalize()} ({field.unit})", 0.27)
        if resting is not None:
            bar.ax.axhline(resting, **line)
            label = f"below {resting:.3g}: quiescence"
            handles.insert(0, Line2D([], [], label=label, **line))
    if handles:
        figure.legend(handles=handles, loc="upper left", bbox_to_anchor=(0.713, 0.25))


def _draw_bar(
    figure: Figure, shades: ScalarMappable, title: str, high: float, **options: Any
) -> Colorbar:
    place = figure.add_axes((0.73, 0.28, 0.018, high))
    bar = figure.colorbar(shades, cax=place, **options)
    bar.outline.set_visible(False)
    bar.ax.grid(False)
    figure.text(0.725, 0.28 + high + 0.035, title, **style.HEADING)
    return bar


def scale_bar(
    axes: Axes, middle: FloatArray, half: float, edge: float = 0.0, size: float = 12.0
) -> None:
    """Draw a bar of a round length in the lower left corner.

    - ``edge``: width of a white edge, points, by which it stands out from a dark ground
    - ``size``: of its letters, points
    """
    lengths = (n * 10**k for k in range(4) for n in (1, 2, 5))
    length = max(n for n in lengths if n <= 0.6 * half)
    left = axes.get_xlim()[0] + 0.07 * half
    low = middle[1] - 0.93 * half
    around = [withStroke(linewidth=2.0 * edge, foreground="white")] if edge else []
    axes.plot(
        [left, left + length],
        [low, low],
        color=style.INK,
        lw=5,
        solid_capstyle="butt",
        zorder=5,
        path_effects=[withStroke(linewidth=5.0 + 2.0 * edge, foreground="white")] if edge else [],
    )
    axes.text(
        left + 0.5 * length,
        low + 0.035 * half,
        f"{length} µm",
        ha="center",
        fontsize=size,
        zorder=5,
        path_effects=around,
    )


def explain_colours(figure: Figure, shade: Colouring, title: str, shown: Any = slice(None)) -> None:
    """Explain the colours: of values by a bar, of groups with the number of cells of each.

    - ``title``: of states and types
    - ``shown``: rows of the cells that are counted
    """
    if shade.group is None:
        assert shade.range is not None
        assert shade.values is not None
        low, high = shade.range
        below, above = bool((shade.values < low).any()), bool((shade.values > high).any())
        beyond = ("neither", "min", "max", "both")[below + 2 * above]
        # names of networks are as they are written
        first = shade.title[0] if "." in shade.title else shade.title[0].upper()
        words = first + shade.title[1:]
        _draw_bar(figure, ScalarMappable(Normalize(low, high), SCALE), words, 0.5, extend=beyond)
        return
    palette = shade.palette or {}
    title = title if shade.title in ("state", "type") else shade.title.capitalize()
    if not palette:
        figure.text(0.725, 0.84, title, **style.HEADING)
        return
    counts = np.bincount(shade.group[shown], minlength=len(palette)).tolist()
    groups = [(name, palette[name], n) for name, n in zip(palette, counts, strict=True) if n]
    handles = [Line2D([], [], ls="", marker="o", ms=11, color=colour) for _, colour, _ in groups]
    labels = [f"{style.type_label(name)} ({n:,})" for name, _, n in groups]
    bold = {"weight": "bold", "size": 13}
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (0.71, 0.87)}
    place |= {"title": title, "title_fontproperties": bold, "alignment": "left"}
    figure.legend(handles, labels, **place)
