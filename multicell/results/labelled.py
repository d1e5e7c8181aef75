"""Histories and frames as arrays with labelled axes and units; xarray is loaded for them only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from multicell.host.extras import needs
from multicell.results.folder import versions
from multicell.results.quantities import known_unit
from multicell.results.tables import NAMED, cell_columns

if TYPE_CHECKING:
    from xarray import Dataset

    from multicell.results.frame import Field, Frame

_AXES: Final = ("x", "y", "z")


def history_arrays(history: Mapping[str, NDArray[np.float64]], scene: str) -> Dataset:
    """Return the history of a run as a data set along ``time``, with units, scene and versions.

    - ``history``, column name -> (m,): as that of :class:`multicell.Result`
    - ``scene``: as TOML
    """
    needs("xarray")
    import xarray

    columns = {
        name: ("time", values, {"units": unit} if (unit := known_unit(name)) else {})
        for name, values in history.items()
    }
    known = {"scene": scene}
    known |= {f"version_of_{name}": version for name, version in versions().items()}
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
            attributes |= {"flag_values": np.arange(len(words), dtype=values.dtype),
                           "flag_meanings": " ".join(words)}  # fmt: skip
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
