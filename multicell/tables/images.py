"""Cells of an image of labels: the pixels of a cell have its number, those of none have 0."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import DataError, SceneError
from multicell.host.extras import needs
from multicell.tables.mapping import ColumnMap, equal_radius, mapped
from multicell.units import unit_factor

TIFF: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")  # what a TIFF file begins with
_LARGEST: Final = 8_000_000_000  # bytes of pixels
_PACKED, _SMALL = 2_000, 2**26
"""Bytes of pixels for each byte of a packed image, and those that any may have: labels pack well,
and a damaged file may state any size."""
_NEAREST: Final = 0.8
"""Distance of two centres over the sum of the radii from which on cells stay where they are: balls
of the volume of cells that are not round overlap."""
_ROUNDS: Final = 500  # of moving overlapping balls apart: some 20 suffice for a tissue


def cells_of_image(
    content: bytes,
    name: str,
    names: ColumnMap,
    frame: int | None,
    image: tuple[bytes, str] | None = None,
) -> tuple[dict[str, NDArray[Any]], str]:
    """Return places and radii of the cells in an image, and a description in words.

    - ``name``: of the file, for errors
    - ``names``: may state ``pixel`` and ``slice``, else they are those of OME's or ImageJ's data;
      its columns may be made of intensities
    - ``frame``: of several; None: the first
    - ``image``: content and name of the image that the labels are of: the mean over each cell is
      the column ``intensity``, of several channels ``intensity_0``, ``intensity_1`` ...

    The radius is that of the ball of a cell's volume, in a plane of the disc of its area. Balls
    that overlap deeply move apart.
    """
    needs("skimage", "tifffile")
    from skimage import measure

    labels, axes, sizes, frames = _read(content, name, frame)
    spacing = _spacing(names, sizes, axes, name)
    if not labels.any():
        raise DataError(name, "has no label: all pixels are 0")
    regions: Any = measure.regionprops_table
    found = regions(labels, properties=("centroid", "area"), spacing=spacing)
    place = np.stack([found[f"centroid-{k}"] for k in reversed(range(len(axes)))], axis=1)
    radius = equal_radius(found["area"], len(axes))
    moved = _relaxed(place, radius)
    way = np.linalg.norm(moved - place, axis=1)
    columns = {f"{axis} / um": x for axis, x in zip("xyz", moved.T, strict=False)}
    said = f"{name} read as labels: {len(place):,} cells"
    said += f" of frame {frame or 0}" if frames > 1 else ""
    said += f"; pixels of {' × '.join(f'{size:.4g}' for size in reversed(spacing))} µm"
    if way.any():
        said += (
            f"; {int((way > 0).sum()):,} cells that overlapped moved by {way[way > 0].mean():.2g} "
            f"µm, at most {way.max():.2g} µm"
        )
    if image is not None:
        brightness = _intensities(labels, axes, *image, frame)
        named = ColumnMap(names.columns)
        where = lambda row, title: f"{image[1]}, label {row + 1}"  # noqa: E731
        columns |= mapped(brightness, named, where, image[1]) if names.columns else {}
        columns |= brightness
        said += f"; mean intensity of {image[1]} in {len(brightness)} channel"
        said += "s" if len(brightness) > 1 else ""
    return columns | {"radius / um": radius}, said


def _intensities(
    labels: NDArray[Any], axes: str, content: bytes, name: str, frame: int | None
) -> dict[str, NDArray[Any]]:
    """Return the mean intensity of each label by channel."""
    from skimage import measure

    pixels, found, _, _ = _pixels(content, name, frame, channels=True)
    if "C" in found:
        pixels, found = np.moveaxis(pixels, found.index("C"), -1), found.replace("C", "")
    if (found, pixels.shape[: len(axes)]) != (axes, labels.shape):
        sizes = (" × ".join(map(str, shape)) for shape in (pixels.shape[: len(axes)], labels.shape))
        problem = f"has {next(sizes)} pixels along {found}, its labels {next(sizes)} along {axes}"
        raise DataError(name, problem)
    regions: Any = measure.regionprops_table
    table = regions(labels, intensity_image=pixels, properties=("intensity_mean",))
    return {
        title.replace("intensity_mean", "intensity").replace("-", "_"): column
        for title, column in table.items()
    }


def _read(
    content: bytes, name: str, frame: int | None
) -> tuple[NDArray[Any], str, Mapping[str, float], int]:
    """Return labels, their axes (``ZYX`` or ``YX``), µm of a pixel by axis, number of frames."""
    pixels, axes, sizes, frames = _pixels(content, name, frame, channels=False)
    if pixels.dtype.kind not in "ui":
        if pixels.dtype.kind != "f" or (pixels != np.floor(pixels)).any():
            raise DataError(name, f"has pixels of {pixels.dtype}, must be whole numbers of cells")
        pixels = pixels.astype(np.int64)
    if pixels.min(initial=0) < 0:
        raise DataError(name, "has labels below 0")
    if len(np.unique(pixels[pixels > 0])) == 1 and pixels.max(initial=0) in (1, 255):
        hint = "Label its regions first, for example by skimage.measure.label."
        raise DataError(name, "is a mask: all cells have one label", hint)
    return pixels, axes, sizes, frames


def _pixels(
    content: bytes, name: str, frame: int | None, *, channels: bool
) -> tuple[NDArray[Any], str, Mapping[str, float], int]:
    """Return pixels of one frame, their axes, µm of a pixel by axis, number of frames.

    - ``channels``: whether there may be several, along an axis ``C``
    """
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            places: set[int] = set()
            for page in file.pages:  # tifffile follows a chain that returns to itself without end
                if page.offset in places:
                    raise DataError(name, "has pages that lead back to one before: it is damaged")
                places.add(page.offset)
            series = file.series[0]
            if series.nbytes > _LARGEST:
                raise DataError(name, f"has {series.nbytes:,} bytes of pixels, which is too much")
            packed = series.keyframe.compression != 1
            most = _SMALL + _PACKED * len(content) if packed else len(content)
            if series.nbytes > most:  # tifffile fills what is not there with zeros
                problem = f"states {series.nbytes:,} bytes of pixels, which its {len(content):,}"
                raise DataError(name, f"{problem} bytes cannot hold: it is cut off or damaged")
            pixels, axes = series.asarray(), series.axes
            sizes = _ome_sizes(file.ome_metadata) or _imagej_sizes(file)
    except DataError:
        raise
    except Exception as error:  # a damaged file fails anywhere in the library
        raise DataError(name, f"is no TIFF image: {error!s:.200}") from None
    frames = 1
    for axis in "TCSQI":
        if axis not in axes:
            continue
        place = axes.index(axis)
        count = pixels.shape[place]
        if axis in "QI" and "Z" not in axes and "T" not in axes:
            axes = axes.replace(axis, "Z")  # a stack whose axis nobody names
            continue
        if channels and axis in "CS" and count > 1 and "C" not in axes.replace(axis, "", 1):
            axes = axes.replace(axis, "C")
            continue
        if axis != "T" and count > 1:
            problem = f"has {count} channels, must have one: the labels of cells"
            raise DataError(name, problem, "Save the labels alone.")
        frames = count if axis == "T" else frames
        number = (frame or 0) if axis == "T" else 0
        if not number < count:
            problem = f"is {number}, which {name} does not have"
            raise SceneError("frame", problem, f"It has frames from 0 to {count - 1}.")
        pixels, axes = np.take(pixels, number, axis=place), axes.replace(axis, "")
    if axes.replace("C", "") not in ("YX", "ZYX"):
        raise DataError(name, f"has the axes {axes}, must have YX or ZYX")
    if "Z" in axes and pixels.shape[axes.index("Z")] == 1:
        pixels, axes = pixels.take(0, axis=axes.index("Z")), axes.replace("Z", "")
    return pixels, axes, sizes, frames


def _ome_sizes(text: str | None) -> dict[str, float]:
    """Return the µm of a pixel by axis that OME's data state."""
    if not text:
        return {}
    from xml.etree import ElementTree

    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return {}  # as good as none: the user is asked for the size
    pixels = next((e for e in root.iter() if e.tag.rpartition("}")[2] == "Pixels"), None)
    found: dict[str, float] = {}
    for axis in "XYZ":
        size = None if pixels is None else pixels.get(f"PhysicalSize{axis}")
        if size is not None and pixels is not None:
            factor = unit_factor(pixels.get(f"PhysicalSize{axis}Unit", "um"), "um")
            if factor is not None:  # "pixel" and "reference frame" say nothing
                found[axis] = float(size) * factor
    return found


def _imagej_sizes(file: Any) -> dict[str, float]:
    """Return the µm of a pixel by axis that ImageJ's data state."""
    about = file.imagej_metadata or {}
    unit = str(about.get("unit", "")).replace("\\u00B5", "u")
    factor = unit_factor(unit, "um") if unit else None
    if factor is None:
        return {}
    found = {}
    for axis, tag in (("X", "XResolution"), ("Y", "YResolution")):
        above, below = file.pages[0].tags[tag].value if tag in file.pages[0].tags else (0, 1)
        if above:
            found[axis] = below / above * factor
    if "spacing" in about:
        found["Z"] = float(about["spacing"]) * factor
    return found


def _spacing(
    names: ColumnMap, sizes: Mapping[str, float], axes: str, name: str
) -> tuple[float, ...]:
    """Return the µm of a pixel along each axis: as stated, else as the file says."""
    found = dict(sizes)
    if names.setting("pixel"):
        across = names.length("pixel", name)[0]
        found = {"X": across, "Y": across, "Z": names.length("slice", name)[0]}
    elif names.setting("slice"):
        found["Z"] = names.length("slice", name)[0]
    absent = [axis for axis in axes if not found.get(axis)]
    if absent:
        flat = "pixel=0.65 um" if absent != ["Z"] else "slice=2 um"
        stack = ", slice=2 um" if "Z" in absent and len(absent) > 1 else ""
        problem = f"does not state the size of its pixels along {', '.join(absent).lower()}"
        raise DataError(name, problem, f'Say it: --columns "{flat}{stack}".')
    if not all(math.isfinite(found[axis]) and found[axis] > 0.0 for axis in axes):
        raise DataError(name, f"states pixels of {found} µm")
    return tuple(found[axis] for axis in axes)


def _relaxed(place: NDArray[np.float64], radius: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return places at which no two balls overlap deeply; those that do not stay."""
    from scipy.spatial import KDTree

    place = place.copy()
    for _ in range(_ROUNDS):
        reach = 2.0 * _NEAREST * float(radius.max())
        first, second = KDTree(place).query_pairs(reach, output_type="ndarray").reshape(-1, 2).T
        apart = place[second] - place[first]
        distance = np.linalg.norm(apart, axis=1)
        least = _NEAREST * (radius[first] + radius[second])
        near = (distance < least * (1.0 - 1e-6)) & (distance > 0.0)
        if not near.any():
            break
        first, second = first[near], second[near]
        push = 0.5 * ((least - distance)[near] / distance[near])[:, None] * apart[near]
        shift = np.zeros_like(place)
        np.subtract.at(shift, first, push)
        np.add.at(shift, second, push)
        counts = np.bincount(np.concatenate([first, second]), minlength=len(place))
        place += shift / np.maximum(counts, 1)[:, None]
    return place
