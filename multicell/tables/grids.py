"""Values on a regular grid from a NumPy array, an image of grey values, or a table of places."""

from __future__ import annotations

import io
import math
import struct
import tokenize
import warnings
import zlib
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from multicell.errors import DataError
from multicell.host.extras import needs
from multicell.tables.columns import from_bytes
from multicell.tables.images import TIFF

_NPY: Final = b"\x93NUMPY"
_PNG: Final = b"\x89PNG"
_MOST: Final = 256**3
"""Values of a file: as many as the largest grid of a field has nodes."""
_UNEVEN: Final = 1e-3
"""Part of a spacing by which places may be off a regular grid: text has few digits."""
_DAMAGED: Final = (
    ArithmeticError,
    AttributeError,
    LookupError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,
    zlib.error,
)
"""What readers of arrays and images raise for damaged files."""


class GridValues(NamedTuple):
    """Values at the centres of equal boxes.

    - ``values``, (nx, ny) or (nx, ny, nz) float
    - ``ends``: the lower and the upper end of the grid along each axis in µm, where the file has
      them; else None
    """

    values: NDArray[np.float64]
    ends: tuple[tuple[float, float], ...] | None = None


def grid_values(content: bytes, name: str, column: str) -> GridValues:
    """Return the values that a file holds.

    Of an array the axes are x, y, z; of an image each row is one y, the first the lowest, as of
    images of labels, and of a stack each page one z. A table has columns x, y, z and of values; in
    one plane z may be absent.

    - ``name``: of the file, for errors
    - ``column``: title of the values in a table

    Raises DataError for other content, and for values that are not finite or below zero.
    """
    if content.startswith(_NPY):
        found = GridValues(_array(content, name))
    elif content.startswith(TIFF):
        found = GridValues(_of_image(_tiff(content, name)))
    elif content.startswith(_PNG):
        found = GridValues(_of_image(_png(content, name)))
    else:
        found = _places(content, name, column)
    wrong = np.argwhere(~((found.values >= 0.0) & (found.values < math.inf)))
    if len(wrong):
        value, where = found.values[tuple(wrong[0])], ", ".join(map(str, wrong[0]))
        more = f", and {len(wrong) - 1:,} more" if len(wrong) > 1 else ""
        problem = f"has {value:g} at ({where}){more}"
        raise DataError(name, problem, "A concentration is finite and not below zero.")
    return found


def _counted(shape: tuple[int, ...], name: str) -> None:
    """Refuse arrays without values, and those of more than the largest grid has."""
    words = " x ".join(map(str, shape))
    if len(shape) not in (2, 3) or math.prod(shape) == 0:
        raise DataError(name, f"has the shape ({words}), must have two or three axes with values")
    if math.prod(shape) > _MOST:
        raise DataError(name, f"has {words} values, must have at most {_MOST:,}")


def _array(content: bytes, name: str) -> NDArray[np.float64]:
    """Return the array of a NumPy file, whose header is compared with its size first."""
    file, header = io.BytesIO(content), np.lib.format
    try:
        version = header.read_magic(file)
        read = header.read_array_header_1_0 if version == (1, 0) else header.read_array_header_2_0
        shape, by_columns, kind = read(file)
    except _DAMAGED as error:
        raise DataError(name, f"is no NumPy array: {error}") from None
    if kind.kind not in "biuf":
        raise DataError(name, f"holds values of type {kind}, must hold numbers")
    _counted(shape, name)
    held = len(content) - file.tell()
    if held != math.prod(shape) * kind.itemsize:
        problem = f"holds {held:,} bytes of values, must hold {math.prod(shape) * kind.itemsize:,}"
        raise DataError(name, problem, "It is cut, or was not written whole.")
    values = np.frombuffer(content, kind, offset=file.tell())
    return values.reshape(shape, order="F" if by_columns else "C").astype(np.float64)


def _of_image(pixels: NDArray[Any]) -> NDArray[np.float64]:
    """Return pixels, with axes (z,) y, x, as values with axes x, y (, z)."""
    return np.ascontiguousarray(pixels.T, dtype=np.float64)


def _tiff(content: bytes, name: str) -> NDArray[Any]:
    needs("tifffile")
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            series = file.series[0]
            sizes = dict(zip(series.axes, series.shape, strict=True))
            kept = {axis: n for axis, n in sizes.items() if axis in "YX" or n > 1}
            order = "".join(kept)
            if order not in ("YX", "ZYX", "QYX", "IYX"):  # a stack whose axis nobody names
                problem = f"has the axes {order}, must have YX or ZYX"
                raise DataError(name, problem, "Each pixel has one grey value, of one moment.")
            _counted(tuple(kept.values()), name)
            pixels = series.asarray().reshape(tuple(kept.values()))
    except (tifffile.TiffFileError, *_DAMAGED) as error:
        raise DataError(name, f"is no TIFF image: {error}") from None
    if pixels.dtype.kind not in "biuf":
        raise DataError(name, f"holds pixels of type {pixels.dtype}, must hold numbers")
    return pixels


def _png(content: bytes, name: str) -> NDArray[Any]:
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(io.BytesIO(content), formats=["PNG"])
        _counted(image.size, name)
        pixels = np.asarray(image) if image.mode in ("1", "L", "I", "I;16", "I;16B") else None
    except (Image.DecompressionBombError, *_DAMAGED) as error:
        raise DataError(name, f"is no PNG image: {error}") from None
    if pixels is None:
        raise DataError(name, "has colours, must have one grey value in each pixel")
    return pixels


def _places(content: bytes, name: str, column: str) -> GridValues:
    """Return the values of a table whose places are the centres of a regular grid."""
    table = from_bytes(content, name)
    titles = {
        title.lower() if title in ("X", "Y", "Z") else title: title for title in table.columns
    }
    there = ", ".join(table.columns)
    for title in ("x", "y", column):
        if title not in titles:
            problem = f"has no column {title!r}, only {there}"
            raise DataError(name, problem, "The first line holds titles: x, y, z and the fields.")
        if table.columns[titles[title]].dtype == object:
            raise DataError(name, f"has texts in column {title!r}, must have numbers")
    axes = "xyz" if "z" in titles else "xy"
    found = [_regular(table.columns[titles[axis]], name, axis) for axis in axes]
    if len(found) == 3 and found[2][0].max(initial=0) == 0:  # a plane, at whatever height
        found.pop()
    shape = tuple(int(index.max()) + 1 for index, *_ in found)
    _counted(shape, name)
    for axis, n in zip("xyz", shape, strict=False):
        if n == 1:
            problem = f"has one place along {axis}, so nothing says how far it reaches"
            raise DataError(name, problem, "A grid has two places along each axis at least.")
    flat = np.ravel_multi_index(tuple(index for index, *_ in found), shape)
    times = np.bincount(flat, minlength=math.prod(shape))
    if (times != 1).any():
        words = " x ".join(map(str, shape))
        wrong = np.unravel_index(int(np.argmax(times != 1)), shape)
        where = ", ".join(
            f"{low + (k + 0.5) * step:g}" for k, (_, low, step) in zip(wrong, found, strict=True)
        )
        said = "no row" if times[times != 1][0] == 0 else "several rows"
        problem = f"has {said} for ({where}) um: its places are no grid of {words}"
        raise DataError(name, problem, "Each place of a regular grid has one row.")
    values = np.empty(shape)
    values.reshape(-1)[flat] = table.columns[titles[column]]
    ends = tuple((low, low + n * step) for (_, low, step), n in zip(found, shape, strict=True))
    return GridValues(values, ends)


def _regular(places: NDArray[Any], name: str, axis: str) -> tuple[NDArray[np.int64], float, float]:
    """Return the number of each place along an axis, the lower end of the grid, and its spacing."""
    if places.dtype == object or not np.isfinite(places).all() or not len(places):
        raise DataError(name, f"has a column {axis!r} that is no number in each row")
    known = np.unique(places.astype(np.float64))
    span = float(known[-1] - known[0])
    steps = np.diff(known)
    steps = steps[steps > 1e-6 * span]  # digits of one place
    if not len(steps):
        return np.zeros(len(places), np.int64), float(known[0]), 0.0
    step = span / len(steps)
    if not (np.abs(steps - step) <= _UNEVEN * step).all():
        problem = f"has places along {axis} {steps.min():g} to {steps.max():g} um apart"
        raise DataError(name, problem, "The places are the centres of a regular grid.")
    number = np.rint((places - known[0]) / step).astype(np.int64)
    return number, float(known[0]) - 0.5 * step, step
