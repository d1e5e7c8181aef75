"""Where the nutrient grid lies: laid round the cells, kept while it fits, laid anew otherwise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import MulticellError

if TYPE_CHECKING:
    from pde.grids.cartesian import CartesianGrid

MAX_NODES = 256**3
"""Largest grid that is ever laid (one array of it takes 128 MiB)."""

_TOO_LONG = 1.5  # an axis that is longer than this times what is needed is laid anew


@final
class NutrientFailed(MulticellError):  # noqa: N818 - it names what happened, like StepFailed
    """A nutrient field that cannot be laid or solved.

    Parameters
    ----------
    problem
        What happened, in words.
    hint
        What to try.
    """

    exit_code: ClassVar[int] = 1

    def __init__(self, problem: str, hint: str) -> None:
        self.problem = problem
        self.hint = hint
        super().__init__(f"{problem}. {hint}")


@final
@dataclass(frozen=True)
class Box:
    """A cell-centred grid of cubes, aligned with the multiples of its spacing.

    Boxes of the same spacing share their nodes where they overlap, so that a field moves from one
    to the next without interpolation error.

    Attributes
    ----------
    first : (3,) int
        Lower corner in units of the spacing.
    shape : (3,) int
    spacing : float, µm
    """

    first: tuple[int, int, int]
    shape: tuple[int, int, int]
    spacing: float

    @property
    def origin(self) -> tuple[float, float, float]:
        """Lower corner, µm."""
        i, j, k = self.first
        return (i * self.spacing, j * self.spacing, k * self.spacing)

    @property
    def upper(self) -> tuple[float, float, float]:
        """Upper corner, µm."""
        i, j, k = (f + n for f, n in zip(self.first, self.shape, strict=True))
        return (i * self.spacing, j * self.spacing, k * self.spacing)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    def to_pde(self) -> CartesianGrid:
        """Return py-pde's grid of this box."""
        from pde.grids.cartesian import CartesianGrid

        return CartesianGrid(list(zip(self.origin, self.upper, strict=True)), self.shape)


def extent(position: FloatArray, margin: float) -> tuple[FloatArray, FloatArray]:
    """Return the corners (3,), (3,) in µm of the box that holds all cells and the margin.

    Raises
    ------
    NutrientFailed
        If a position is not finite.
    """
    if len(position) == 0:
        position = np.zeros((1, 3))
    low, high = position.min(axis=0) - margin, position.max(axis=0) + margin
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise NutrientFailed(
            "a cell's position is not a finite number, so no nutrient grid can be laid",
            "Look at the mechanics of the step before: a smaller coupling_step may help",
        )
    return low, high


def fits(box: Box, low: FloatArray, high: FloatArray) -> bool:
    """Say whether the box covers all from ``low`` to ``high`` (µm) without being far too long."""
    covers = bool(np.all(low >= box.origin) and np.all(high <= box.upper))
    longest = [_TOO_LONG * _axis_nodes(n) for n in (high - low) / box.spacing]
    return covers and all(n <= most for n, most in zip(box.shape, longest, strict=True))


def lay(low: FloatArray, high: FloatArray, spacing: float) -> Box:
    """Lay a box round the corners ``low`` and ``high`` (µm), with some room to grow.

    The number of nodes along an axis has only the factors 2, 3 and 5, where the sine transform is
    fast, and at least a sixteenth more than needed, so that a growing population seldom needs a
    new box.

    Raises
    ------
    NutrientFailed
        If more than :data:`MAX_NODES` nodes would be needed; nothing is allocated before.
    """
    needed = (high - low) / spacing
    _refuse_too_large(needed, high - low, spacing)
    shape = tuple(_axis_nodes(n) for n in needed)
    middle = 0.5 * (low + high) / spacing
    first = tuple(int(np.floor(m - 0.5 * n + 0.5)) for m, n in zip(middle, shape, strict=True))
    box = Box(first=first, shape=shape, spacing=spacing)  # type: ignore[arg-type]
    _refuse_too_large(np.array(shape, dtype=float), high - low, spacing)
    return box


def moved(values: FloatArray, old: Box, new: Box, fill: float) -> FloatArray:
    """Return node values on ``new``: those of ``old`` where it has the node, ``fill`` elsewhere."""
    if old.spacing != new.spacing:
        raise ValueError(f"boxes of different spacing: {old.spacing} and {new.spacing} um")
    out = np.full(new.shape, fill)
    source, target = [], []
    for a, n, b, m in zip(old.first, old.shape, new.first, new.shape, strict=True):
        start, stop = max(a, b), max(min(a + n, b + m), a, b)
        source.append(slice(start - a, stop - a))
        target.append(slice(start - b, stop - b))
    out[tuple(target)] = values[tuple(source)]
    return out


def _axis_nodes(needed: float) -> int:
    """Return the nodes to lay along an axis that needs this many (not rounded)."""
    from scipy.fft import next_fast_len

    # two more than needed: one for rounding up, one for aligning the corner
    n = int(np.ceil(needed))
    return int(next_fast_len(n + max(2, n // 16), real=True))


def _refuse_too_large(nodes: FloatArray, size: FloatArray, spacing: float) -> None:
    with np.errstate(over="ignore"):
        total = float(np.prod(nodes))
    if total <= MAX_NODES:
        return
    lengths = " x ".join(f"{length:.4g}" for length in size)
    raise NutrientFailed(
        f"cells and margin spread over {lengths} um, so the nutrient grid would need "
        f"{total:.3g} nodes at a spacing of {spacing:g} um, more than the {MAX_NODES} allowed",
        "Use a larger spacing of the nutrient, or find out why cells are so far apart",
    )
