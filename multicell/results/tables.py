"""Frames as tables, labelled arrays and VTK's grids; pandas, xarray, pyvista load where asked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import HAZARDS, Phase, State
from multicell.host.extras import needs
from multicell.results.folder import versions
from multicell.results.quantities import known_unit, unit_of
from multicell.tables.titles import titled

if TYPE_CHECKING:
    from pandas import DataFrame
    from pyvista import MultiBlock
    from xarray import Dataset

    from multicell.results.frame import Field, Frame

_AXES = ("x", "y", "z")
NAMED: Final[Mapping[str, list[str]]] = {
    "state": [s.name.lower() for s in sorted(State)],
    "phase": [p.name for p in sorted(Phase)],
}


def cell_columns(frame: Frame) -> Iterator[tuple[str, NDArray[Any], str]]:
    """Yield name, values and unit of what is known of the cells, concentrations last.

    Without the integrals of rates, which say nothing without the draws that they are compared with.
    """
    for name, values in frame.cells.columns():
        if name not in (*HAZARDS, "inside"):
            yield name, values, unit_of(f"cells.{name}")
    for name, values in frame.inside.items():
        yield name, values, ""
    for name, values in frame.concentrations.items():
        title = f"concentration_{name}"
        yield title, values, unit_of(f"cells.{title}")


def cells_table(
    frame: Frame, *, kinds: NDArray[Any] | None = None, phases: bool = True
) -> dict[str, NDArray[Any]]:
    """Return the cells of a frame, one row each, with what is stored of them.

    - ``kinds``: names of the types by number; absent: the numbers
    - ``phases``: whether there are phases of the cycle, whose columns are left out otherwise
    """
    table: dict[str, NDArray[Any]] = {}
    for name, column, unit in cell_columns(frame):
        if name in ("phase", "progress", "phase_length") and not phases:
            continue
        if name == "kind" and kinds is not None:
            column = kinds[column]
        elif name in NAMED:
            column = np.array(NAMED[name], dtype=object)[column]
        if column.ndim == 1:
            table[titled(name, unit)] = column
        else:
            axes = _AXES if column.shape[1] == len(_AXES) else range(column.shape[1])
            for axis, values in zip(axes, column.T, strict=True):
                table[titled(f"{name}_{axis}", unit)] = values
    return table


def data_frame(table: Mapping[str, NDArray[Any]]) -> DataFrame:
    """Return a table as pandas' ``DataFrame``; raises MissingPackage if pandas is not installed.

    States, phases and types are categories, so that tables by group have all of them in order.
    """
    needs("pandas")
    import pandas

    frame = pandas.DataFrame(dict(table))
    for name in {*NAMED, "kind"} & set(frame):
        if frame[name].dtype.kind == "O":
            words = NAMED.get(name, list(dict.fromkeys(frame[name])))
            frame[name] = pandas.Categorical(frame[name], words)
    return frame


def history_dataset(history: Mapping[str, NDArray[np.float64]], scene: str) -> Dataset:
    """Return the history of a run as a data set along ``time``, with units, scene and versions.

    - ``history``, column name -> (m,): as that of :class:`multicell.Result`
    - ``scene``: as TOML
    """
    needs("xarray")
    import xarray

    units = {name: {"units": unit} if (unit := known_unit(name)) else {} for name in history}
    columns = {name: ("time", values, units[name]) for name, values in history.items()}
    known = {"scene": scene, **{f"version_of_{n}": version for n, version in versions().items()}}
    return xarray.Dataset(columns, attrs=known).set_coords("time")


def frame_arrays(frame: Frame, types: Sequence[str] = ()) -> Dataset:
    """Return cells along ``cell`` and each field along axes of its own, with units.

    - ``types``: names of the types by their numbers
    """
    needs("xarray")
    import xarray

    parts: dict[str, Any] = {}
    for name, values, unit in cell_columns(frame):
        attributes: dict[str, Any] = {"units": unit} if unit else {}
        words = list(types) if name == "kind" else NAMED.get(name)
        if words:  # as the conventions of CF have it
            attributes |= {
                "flag_values": np.arange(len(words), dtype=values.dtype),
                "flag_meanings": " ".join(words),
            }
        parts[name] = (("cell", "axis") if values.ndim == 2 else "cell", values, attributes)
    places: dict[str, Any] = {"axis": list(_AXES)}
    for field in frame.fields.values():
        parts[field.name] = _field(field, places)
    data: Dataset = xarray.Dataset(parts, coords=places, attrs={"step": frame.step})
    return data.assign_coords(time=((), frame.time, {"units": "s"}))


def _field(field: Field, places: dict[str, Any]) -> tuple[Sequence[str], Any, dict[str, Any]]:
    """Return the axes, values and attributes of a field; its axes are added to ``places``."""
    attributes = {"units": field.unit, "spacing": field.spacing, "origin": field.origin}
    if field.kind == "radial":
        name = f"r_{field.name}"
        middles = (np.arange(field.values.size) + 0.5) * field.spacing
        places[name] = (name, middles, {"units": "um", "long_name": "distance from origin"})
        return [name], field.values.ravel(), attributes
    flat = field.height > 0.0
    names = [f"{axis}_{field.name}" for axis in _AXES[: 2 if flat else 3]]
    for direction, name in enumerate(names):
        places[name] = (name, field.axis(direction), {"units": "um"})
    return names, field.values[:, :, 0] if flat else field.values, attributes


_LATITUDES, _LONGITUDES = 12, 24  # of the boxes that a shell is cut into


def frame_blocks(frame: Frame, types: Sequence[str] = ()) -> MultiBlock:
    """Return the cells of a frame as points, ``"cells"``, and its fields by name, in µm.

    Quantities are named with their units (``radius_um``). States, phases and types are numbers,
    as ParaView colours by numbers; ``state_names`` and so on give their meaning.

    - ``types``: names of the types by their numbers
    """
    needs("pyvista")
    import pyvista

    points = pyvista.PolyData(np.array(frame.cells.position))
    for name, values, unit in cell_columns(frame):
        if name != "position":
            points.point_data[titled(name, unit)] = np.array(values)
    for name, words in {**NAMED, "kind": list(types)}.items():
        if words:
            points.field_data[f"{name}_names"] = words
    points.field_data["time_s"] = [frame.time]
    fields = {name: field_grid(field) for name, field in frame.fields.items()}
    return pyvista.MultiBlock({"cells": points, **fields})


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
