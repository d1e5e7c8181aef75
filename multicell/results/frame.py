"""The state of a run at one time: the cells and the fields around them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray, IntArray
from multicell.schema import near_miss

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from pde.fields.collection import FieldCollection
    from pde.fields.scalar import ScalarField
    from pyvista import MultiBlock
    from xarray import Dataset

    from multicell.scene.parts import Domain

V = TypeVar("V")


class Named(dict[str, V]):
    """A dictionary of parts of a result by name, such as the columns of its history."""

    def __init__(self, entries: Mapping[str, V], what: str) -> None:
        super().__init__(entries)
        self._what = what

    def __missing__(self, name: object) -> NoReturn:
        raise KeyError(f"there is no {self._what} {name!r}. {near_miss(str(name), self)}")

    def __reduce__(self) -> tuple[Any, ...]:
        return Named, (dict(self), self._what)


@final
@dataclass(frozen=True, eq=False)
class Field:
    """A concentration on a regular grid of cubes, of squares in a plane, or on spherical shells.

    - ``name``: name of the nutrient
    - ``unit``: unit of the values, ``"mM"``
    - ``origin``, (3,) float64, µm: corner of the box with the smallest coordinates
    - ``spacing``: edge of a grid cube in µm
    - ``values``, (nx, ny, nz) float64: values at the centres of the cubes, ``origin + (i + 1/2) *
      spacing``; of a plane with ``nz = 1``. Of shells with ``ny = nz = 1``: at the distances ``(i +
      1/2) * spacing`` from ``origin``, which is their centre.
    - ``kind``: ``"box"`` or ``"radial"``
    - ``height``: of the layer in two dimensions, µm; else 0
    - ``repeats``, (3,) bool: along which axes space repeats (``domain.periodic``)

    :meth:`to_pde` gives it to py-pde, whose fields can be drawn, interpolated and written to files.
    """

    name: str
    unit: str
    origin: FloatArray
    spacing: float
    values: NDArray[np.float64]
    kind: str = "box"
    height: float = 0.0
    repeats: tuple[bool, bool, bool] = (False, False, False)

    def __repr__(self) -> str:
        shape = " × ".join(f"{n}" for n in self.values.shape if n > 1) or "1"
        span = f"{self.values.min():.3g} to {self.values.max():.3g} {self.unit}"
        return f"<Field {self.name}, {shape} of {self.spacing:g} µm, {span}>"

    def in_plane(self, z: float) -> Field:
        """Return a radial field on squares in the plane at height z (µm), as a flat box."""
        away = z - float(self.origin[2])
        count = self.values.shape[0]
        middles = (np.arange(count) + 0.5) * self.spacing
        axis = np.concatenate([-middles[::-1], middles])
        distance = np.sqrt(axis[:, None] ** 2 + axis[None, :] ** 2 + away**2)
        plane = np.interp(distance, middles, self.values.ravel())
        corner = np.array([*(self.origin[:2] - count * self.spacing), z - 0.5 * self.spacing])
        return Field(self.name, self.unit, corner, self.spacing, plane[:, :, None])

    def axis(self, direction: int) -> FloatArray:
        """Return the coordinates of the grid centres along one direction, in µm."""
        count = self.values.shape[direction]
        return np.asarray(self.origin[direction] + (np.arange(count) + 0.5) * self.spacing)

    def to_pde(self, *, copy: bool = True) -> ScalarField:
        """Return it as py-pde's ``ScalarField``, with the name as label.

        On a ``CartesianGrid`` in the coordinates of the cells (µm; x and y of a plane). Shells are
        a ``SphericalSymGrid``, whose coordinate is the distance from ``origin``.

        Parameters
        ----------
        copy
            Whether it has values of its own; else its ``data`` are :attr:`values`, which are
            read-only in a run and its frames.
        """
        from multicell.results.pde_fields import scalar_field

        return scalar_field(self, copy=copy)


@final
@dataclass(frozen=True)
class Progress:
    """State of a run besides cells and fields, which it needs to be resumed exactly.

    Replays and stability are those of :mod:`multicell.integrators.shift` and
    :mod:`multicell.integrators.stability`.
    """

    next_id: int  # first identity that is free
    divisions: int  # so far
    removals: int
    unsorted: int  # new cells since the last sorting
    released: float  # volume that dead cells have lost, µm³
    separation: Mapping[str, float] | None  # when and how the last contact broke in a pull
    ledger: Mapping[str, Mapping[str, float]]  # account of each field, amol
    rates: Mapping[str, Mapping[str, float]]  # what a steady field exchanges now, amol/s
    work: Mapping[str, int]  # cost of the integration
    grids: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # that the run chooses
    driven: Mapping[str, list[int]] = field(default_factory=dict)  # cells named by a table at first
    first_states: Mapping[str, int] = field(default_factory=dict)  # cells at rest, dead, unfit
    exposures: Mapping[str, float] = field(default_factory=dict)  # error of events, slopes of rates
    replays: Mapping[str, float] = field(default_factory=dict)
    stability: Mapping[str, float] = field(default_factory=dict)
    cavity: float | None = None  # radius to which cells have widened a gel, µm
    lengths: Sequence[float] = ()  # of steps that a run chooses: simulation.step_lengths
    learnt: Sequence[float] = ()  # what `auto` has: multicell.integrators.costs.Learnt
    inside: Sequence[str] = ()  # names of the columns of Cells.inside


@final
@dataclass(frozen=True, eq=False)
class Frame:
    """The state of a run at one time.

    Attributes
    ----------
    time
        Simulated time in s.
    step
        Number of coupling steps done.
    cells
        All cells.
    concentrations : name -> (n,) float64, mM
        Concentration of each nutrient at the cells, in the order of ``cells``.
    fields : name -> Field
        The nutrient fields as they were last solved.
    contacts : (m, 2) int64
        Identities of the pairs in contact, where the run counts them (exact JKR, several types,
        a pull).
    progress
        What else a run needs to be resumed; None in frames made by hand.
    draw
        What draws it; None in frames that are not of a result.
    """

    time: float
    step: int
    cells: Cells
    concentrations: Mapping[str, FloatArray] = field(default_factory=dict)
    fields: Mapping[str, Field] = field(default_factory=dict)
    contacts: IntArray = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    progress: Progress | None = None
    draw: Callable[..., Figure] | None = None

    def within(self, domain: Domain | None) -> Frame:
        """Return the frame with cells inside a domain, along axes along which space repeats.

        The positions of a frame go on beyond its sides, so that displacements are those of the
        cells; so pictures and exports for viewers show them.
        """
        if domain is None or not domain.periodic:
            return self
        inside = domain.inside(self.cells.position)
        return replace(self, cells=self.cells.changed(position=inside))

    def __post_init__(self) -> None:
        concentrations = Named(self.concentrations, "concentration")
        object.__setattr__(self, "concentrations", concentrations)
        object.__setattr__(self, "fields", Named(self.fields, "field"))

    @property
    def inside(self) -> dict[str, FloatArray]:
        """Values of networks in the cells, ``NETWORK.NAME`` -> (n,), NaN in cells without it."""
        if self.cells.inside is None or self.progress is None:
            return {}
        pairs = zip(self.progress.inside, self.cells.inside.T, strict=True)
        return {name: values for name, values in pairs if "~" not in name}

    def __repr__(self) -> str:
        fields = f", fields: {', '.join(self.fields)}" if self.fields else ""
        count = f"{len(self.cells):,} cells"
        return f"<Frame at {self.time / 3600.0:g} h, step {self.step}, {count}{fields}>"

    def plot(self, **options: Any) -> Figure:
        """Draw the cells that a plane cuts.

        Parameters
        ----------
        **options
            ``plane`` and ``colour``, as for ``plot.section`` of the result.

        Raises
        ------
        ValueError
            If the frame is not one of a result, which knows the scene.
        """
        if self.draw is None:
            raise ValueError("only frames of a result can be drawn: result.frames, result.at()")
        return self.draw(self, **options)

    def to_pde(self, names: Iterable[str] | None = None) -> FieldCollection:
        """Return fields that share a grid as a copy in py-pde's ``FieldCollection``.

        Parameters
        ----------
        names
            Of the fields; absent: all. Their labels in the collection.

        Raises
        ------
        SceneError
            If there are none, a name is none of theirs, or they live on different grids; which
            share one is said.
        """
        from multicell.results.pde_fields import collection

        return collection(self.fields, names)

    def to_pandas(self) -> DataFrame:
        """Return the cells as a table, its columns titled with their units (``radius_um``).

        Types are numbers: ``Result.to_pandas("cells")`` knows their names.

        Raises
        ------
        MissingPackage
            If pandas is not installed.
        """
        from multicell.results.tables import cells_table, data_frame

        return data_frame(cells_table(self))

    def to_xarray(self) -> Dataset:
        """Return cells along ``cell`` and each field along axes of its own, with units.

        Raises
        ------
        MissingPackage
            If xarray is not installed.
        """
        from multicell.results.tables import frame_arrays

        return frame_arrays(self)

    def to_pyvista(self) -> MultiBlock:
        """Return the cells as points and the fields as grids of VTK, by name.

        ``cells`` are points in µm with all quantities, named with their units. Fields have their
        values at the cells of their grids (:func:`multicell.results.tables.field_grid`).

        Raises
        ------
        MissingPackage
            If pyvista is not installed.
        """
        from multicell.results.tables import frame_blocks

        return frame_blocks(self)
