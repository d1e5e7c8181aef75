"""Fields of runs and frames as py-pde's grids and fields; py-pde is loaded with this file only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from pde.fields.collection import FieldCollection
from pde.fields.scalar import ScalarField
from pde.grids.cartesian import CartesianGrid
from pde.grids.spherical import SphericalSymGrid

from multicell.errors import SceneError

if TYPE_CHECKING:
    from pde.grids.base import GridBase

    from multicell.cells import FloatArray
    from multicell.results.frame import Field

_GRIDS: Final = 16  # that are there again without being made anew: those of a run's fields


class _View:
    """Fields of py-pde's whose values are an array that others own.

    py-pde stores values in an array with one cell more beyond each face. Here that array is made,
    with the values of the moment, where an operator asks for it.
    """

    grid: GridBase
    _data_valid: FloatArray
    _padded: FloatArray | None = None

    @property
    def _data_full(self) -> FloatArray:
        if self._padded is None:
            shape = self._data_valid.shape[: -self.grid.num_axes]
            self._padded = np.full((*shape, *self.grid._shape_full), np.nan)
        self._padded[self._inside] = self._data_valid
        return self._padded

    @_data_full.setter
    def _data_full(self, value: FloatArray) -> None:
        # a collection that takes the field in gives it a part of its own array
        self._padded, self._data_valid = value, value[self._inside]

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Let another process have a copy."""
        return self.copy().__reduce_ex__(protocol)  # type: ignore[attr-defined]

    @property
    def _inside(self) -> tuple[Any, ...]:
        return ..., *self.grid._idx_valid


@final
class FieldView(_View, ScalarField):  # type: ignore[misc, no-untyped-call]
    """A ``ScalarField`` whose ``data`` are an array of a run; what is made of it holds its own.

    - ``values``: of the shape of the grid, or with axes of length one more
    """

    # to py-pde, which makes fields of the class of those that they come from
    __class__ = property(lambda _: ScalarField)

    def __init__(self, grid: GridBase, values: FloatArray, label: str) -> None:
        self._grid, self._label = grid, label
        self._data_valid = values.reshape(grid.shape)


@final
class FieldsView(_View, FieldCollection):  # type: ignore[misc, no-untyped-call]
    """A ``FieldCollection`` whose ``data`` are an array of a run, (m, ...).

    Grid and single fields are made when someone asks for them: a run's own solvers do not.

    - ``equation``: has the ``grid``, and the ``names`` of the fields where they are not given
    """

    __class__ = property(lambda _: FieldCollection)

    def __init__(self, equation: Any, data: FloatArray, names: Sequence[str] | None = None) -> None:
        self.equation, self._data_valid, self._label = equation, data, None
        self._names = equation.names if names is None else names
        self.data_shape = (len(data),)

    def __getattr__(self, name: str) -> Any:
        """Make what py-pde's constructor would have set."""
        found: Any
        if name == "_grid":
            found = self.equation.grid
        elif name == "_fields":
            parts = zip(self._data_valid, self._names, strict=True)
            found = [FieldView(self.grid, part, label) for part, label in parts]
        elif name == "_slices":
            found = [slice(row, row + 1) for row in range(len(self._data_valid))]
        else:
            raise AttributeError(name)
        setattr(self, name, found)
        return found


@lru_cache(_GRIDS)
def _cartesian(
    origin: tuple[float, ...], shape: tuple[int, ...], spacing: float, repeats: tuple[bool, ...]
) -> CartesianGrid:
    bounds = [(low, low + count * spacing) for low, count in zip(origin, shape, strict=True)]
    return CartesianGrid(bounds, list(shape), periodic=list(repeats))


@lru_cache(_GRIDS)
def shell_grid(spacing: float, count: int) -> SphericalSymGrid:
    """Return py-pde's grid of a ball of shells so thick, µm; the same one for the same shells."""
    return SphericalSymGrid(spacing * count, count)


def box_grid(
    origin: Sequence[float],
    shape: Sequence[int],
    spacing: float,
    *,
    flat: bool,
    repeats: Sequence[bool] = (False, False, False),
) -> CartesianGrid:
    """Return py-pde's grid of a box of cubes; of squares where it is flat.

    For the same box it is the same object.

    - ``origin``, (3,), µm: corner with the smallest coordinates
    - ``shape``, (3,) int
    - ``spacing``, float, µm
    - ``flat``: whether the third axis is left out
    - ``repeats``, (3,) bool: along which axes space repeats
    """
    axes = 2 if flat else 3
    corner, counts = tuple(map(float, origin[:axes])), tuple(map(int, shape[:axes]))
    return _cartesian(corner, counts, float(spacing), tuple(map(bool, repeats[:axes])))


def grid_of(field: Field) -> GridBase:
    """Return py-pde's grid of a field."""
    if field.kind == "radial":
        return shell_grid(field.spacing, field.values.size)
    return box_grid(
        list(field.origin),
        field.values.shape,
        field.spacing,
        flat=field.height > 0.0,
        repeats=field.repeats,
    )


def scalar_field(field: Field, *, copy: bool = True) -> ScalarField:
    """Return a field as py-pde's, with its name as label; without ``copy`` on its own array."""
    view = FieldView(grid_of(field), field.values, field.name)
    return view.copy() if copy else view


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
