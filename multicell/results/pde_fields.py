"""Fields of a frame as py-pde's grids and fields; py-pde is loaded with this file only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pde.fields.collection import FieldCollection
from pde.fields.scalar import ScalarField
from pde.grids.cartesian import CartesianGrid
from pde.grids.spherical import SphericalSymGrid

from multicell.errors import SceneError

if TYPE_CHECKING:
    from pde.grids.base import GridBase

    from multicell.results.frame import Field


def box_grid(
    origin: Sequence[float],
    shape: Sequence[int],
    spacing: float,
    *,
    flat: bool,
    repeats: Sequence[bool] = (False, False, False),
) -> CartesianGrid:
    """Return py-pde's grid of a box of cubes; of squares where it is flat.

    - ``origin``, (3,), µm: corner with the smallest coordinates
    - ``shape``, (3,) int
    - ``spacing``, float, µm
    - ``flat``: whether the third axis is left out
    - ``repeats``, (3,) bool: along which axes space repeats
    """
    axes = 2 if flat else 3
    bounds = [
        (float(low), float(low) + count * spacing) for low, count in zip(origin, shape, strict=True)
    ]
    return CartesianGrid(bounds[:axes], list(shape)[:axes], periodic=list(repeats)[:axes])


def grid_of(field: Field) -> GridBase:
    """Return py-pde's grid of a field."""
    if field.kind == "radial":
        return SphericalSymGrid(field.spacing * field.values.size, field.values.size)
    return box_grid(
        list(field.origin),
        field.values.shape,
        field.spacing,
        flat=field.height > 0.0,
        repeats=field.repeats,
    )


def scalar_field(field: Field) -> ScalarField:
    """Return a field as py-pde's, with its name as label."""
    grid = grid_of(field)
    return ScalarField(grid, field.values.reshape(grid.shape), label=field.name)


def collection(fields: Mapping[str, Field], names: Iterable[str] | None) -> FieldCollection:
    """Return fields that share a grid as py-pde's collection, their names as labels."""
    wanted = list(fields) if names is None else list(names)
    if isinstance(names, str) or not wanted:
        held = "the frame holds none" if names is None else f"are {names!r}"
        raise SceneError("fields", f"{held}, expected a list of names")
    grids: dict[Any, list[str]] = {}
    for name in wanted:
        if name not in fields:
            raise SceneError("fields", f"has {name!r}, the frame holds {', '.join(fields)}")
        field = fields[name]
        place = (field.kind, tuple(field.origin), field.spacing, field.values.shape, field.height)
        grids.setdefault(place, []).append(name)
    if len(grids) > 1:
        lists = " and ".join(map(str, grids.values()))
        problem = f"live on different grids, and one equation has one grid: {lists}"
        hint = "Ask for one of these lists, or give the fields one spacing, margin and geometry."
        raise SceneError("fields", problem, hint)
    return FieldCollection([scalar_field(fields[name]) for name in wanted])
