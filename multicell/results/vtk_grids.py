"""Cells and fields of a frame as VTK's points and grids; pyvista is loaded when one is made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multicell.host.extras import needs
from multicell.results.tables import NAMED, cell_columns
from multicell.tables.titles import titled

if TYPE_CHECKING:
    from pyvista import MultiBlock, PolyData

    from multicell.results.frame import Field, Frame

_LATITUDES, _LONGITUDES = 12, 24  # of the boxes that a shell is cut into


def blocks(frame: Frame, types: Sequence[str] = ()) -> MultiBlock:
    """Return the cells and the fields of a frame by name: ``"cells"``, then those of the fields."""
    parts: dict[str, Any] = {"cells": cells_points(frame, types)}
    parts |= {name: field_grid(field) for name, field in frame.fields.items()}
    import pyvista

    return pyvista.MultiBlock(parts)


def cells_points(frame: Frame, types: Sequence[str] = ()) -> PolyData:
    """Return the cells of a frame as points with all that is known of them, in µm.

    Quantities are named with their units (``radius_um``). States, phases and types are numbers,
    as ParaView colours by numbers; what they mean stands in ``state_names`` and so on.

    - ``types``: names of the types by their numbers
    """
    needs("pyvista")
    import pyvista

    points: PolyData = pyvista.PolyData(np.array(frame.cells.position))
    for name, values, unit in cell_columns(frame):
        if name != "position":
            points.point_data[titled(name, unit)] = np.array(values)
    names = {**NAMED, "kind": list(types)}
    for name, words in names.items():
        if words:
            points.field_data[f"{name}_names"] = words
    points.field_data["time_s"] = [frame.time]
    return points


def field_grid(field: Field) -> Any:
    """Return a field on VTK's grid, with its values as those of the grid's cells, in mM and µm.

    Cubes (and squares, as high as their layer) are those of the field; a shell is cut into boxes
    along latitudes and longitudes that all have its value.

    Returns pyvista.ImageData or pyvista.UnstructuredGrid.
    """
    needs("pyvista")
    import pyvista

    title = titled(field.name, field.unit)
    if field.kind == "radial":
        return _shells(pyvista, field, title)
    shape = field.values.shape
    high = field.height if field.height > 0.0 else field.spacing
    grid = pyvista.ImageData(
        dimensions=[n + 1 for n in shape],
        spacing=(field.spacing, field.spacing, high),
        origin=field.origin,
    )
    grid.cell_data[title] = field.values.ravel(order="F")
    return grid


def _shells(pyvista: Any, field: Field, title: str) -> Any:
    """Return shells as boxes between radii, latitudes and longitudes."""
    values: NDArray[np.float64] = field.values.ravel()
    radii = np.arange(len(values) + 1) * field.spacing
    polar = np.linspace(0.0, np.pi, _LATITUDES + 1)
    round_about = np.linspace(0.0, 2.0 * np.pi, _LONGITUDES + 1)
    r, theta, phi = np.meshgrid(radii, polar, round_about, indexing="ij")
    around = r * np.sin(theta)
    place = (around * np.cos(phi), around * np.sin(phi), r * np.cos(theta))
    grid = pyvista.StructuredGrid(*(x + o for x, o in zip(place, field.origin, strict=True)))
    boxes = np.broadcast_to(values[:, None, None], (len(values), _LATITUDES, _LONGITUDES))
    grid.cell_data[title] = boxes.ravel(order="F")
    return grid.cast_to_unstructured_grid()
