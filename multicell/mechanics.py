"""Overdamped mechanics of a population: forces, Jacobian, energy, pressure.

The equation of motion is 6πη r_i(t) dx_i/dt = Σ_j F_ij (Stokes drag, contact forces of
:mod:`multicell.contact`). Over a coupling step a radius runs linearly in time between its
values at the two ends, so that volumes are exact at both ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from multicell import kernels, neighbours
from multicell.cells import SPHERE
from multicell.contact import PairLaw, compliance

FloatArray = NDArray[np.float64]


class StateRejected(Exception):  # noqa: N818 - what happened to a trial state, not a fault
    """A trial state that has no meaning: not finite, or with too many cells in one place."""


@final
@dataclass
class Work:
    """Counts of what an integration has cost."""

    evaluations: int = 0
    linearisations: int = 0
    jacobian_products: int = 0
    preconditioner_setups: int = 0
    preconditioner_solves: int = 0
    list_builds: int = 0
    steps: int = 0
    rejections: int = 0

    def add(self, other: Work) -> None:
        """Add the counts of ``other`` to these."""
        for name, count in vars(other).items():
            setattr(self, name, getattr(self, name) + count)


@final
@dataclass
class Motion:
    """What is known of the cells during one coupling step, from ``begin`` to ``end``.

    Attributes
    ----------
    radius, radius_rate : (n,)
        Radius at ``begin``, µm, and its constant rate, µm/s.
    young, poisson : (n,)
        Elastic constants, kPa and dimensionless.
    begin, end : float
        Time, s.
    """

    radius: FloatArray
    radius_rate: FloatArray
    young: FloatArray
    poisson: FloatArray
    begin: float
    end: float


@final
@dataclass(frozen=True)
class Linearisation:
    """Direction, dF/dh + F/d and F/d of every pair at one state."""

    pairs: neighbours.PairList
    normal: FloatArray
    along: FloatArray
    across: FloatArray

    @classmethod
    def room(cls, pairs: neighbours.PairList) -> Linearisation:
        """Return arrays of the size that a list needs, not filled yet."""
        size = len(pairs.first)
        return cls(pairs, np.empty((size, 3)), np.empty(size), np.empty(size))


@final
@dataclass
class Mechanics:
    """Right-hand side, Jacobian and observables of overdamped cells.

    Owns the neighbour list and all work arrays, which can be rebuilt from the state.

    Parameters
    ----------
    law
        Pair law.
    viscosity
        Viscosity η of the medium, kPa·s.
    threads
        With more than one, chunks of cells are shared among threads; same bits.
    skin
        Margin of the neighbour list as a fraction of the mean radius.
    chunk
        Cells that one thread works on at a time; it decides the order of the sums.
    shared_chunks
        Number of chunks from which on threads are used: below, waking them costs more
        than they save.
    """

    law: PairLaw
    viscosity: float
    threads: int = 1
    skin: float = 0.15
    chunk: int = neighbours.CHUNK
    shared_chunks: int = 8
    work: Work = field(default_factory=Work)

    def __post_init__(self) -> None:
        self.drag = 6.0 * math.pi * self.viscosity
        self._pairs: neighbours.PairList | None = None
        self._linear: Linearisation | None = None

    def begin(self, motion: Motion) -> None:
        """Take the radii and moduli for a coupling step; the old list is dropped."""
        self.motion = motion
        n = len(motion.radius)
        self._compliance = compliance(motion.young, motion.poisson)
        self._rows = np.zeros((n, 5))
        self._rows[:, 4] = self._compliance
        end_radius = motion.radius + motion.radius_rate * (motion.end - motion.begin)
        self._list_radius = np.maximum(motion.radius, end_radius)
        self._skin = self.skin * float(self._list_radius.mean()) if n else 0.0
        self._pairs = self._linear = None
        self._blocks = np.empty((n, 6))
        self._inverse = np.empty((n, 6))

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.motion.radius)

    def velocity(self, time: float, position: FloatArray, out: FloatArray) -> None:
        """Write dx/dt, (n, 3) µm/s, at ``position``, (n, 3) µm, and ``time``, s.

        Raises
        ------
        StateRejected
            If the positions are not finite or too many cells overlap.
        """
        self.work.evaluations += 1
        position = _frozen(position)
        pairs = self._pairs if self._pairs is not None else self._rebuild(position)
        while self._velocities(pairs)(
            self.chunk, position, self._reference, self.motion.radius,
            self.motion.radius_rate, time - self.motion.begin, self._drift_limit, self._rows,
            pairs.first, pairs.second, pairs.start, pairs.inner_end, pairs.outer_end,
            self.law.code, self.law.adhesion, self.drag, out,
        ):  # fmt: skip
            pairs = self._rebuild(position)

    def linearise(self, time: float, position: FloatArray) -> None:
        """Prepare :meth:`jacobian_product` at a state."""
        self._linearise(time, position)

    def _linearise(self, time: float, position: FloatArray) -> Linearisation:
        self.work.linearisations += 1
        pairs = self._settle(time, position)
        if self._linear is None or self._linear.pairs is not pairs:
            self._linear = Linearisation.room(pairs)
        linear = self._linear
        run = kernels.linearise_parallel if self._shared(pairs) else kernels.linearise
        run(
            self._rows, pairs.first, pairs.second, pairs.start, pairs.outer_end,
            self.law.code, self.law.adhesion, linear.normal, linear.along, linear.across,
        )  # fmt: skip
        return linear

    def jacobian_product(self, vector: FloatArray, out: FloatArray) -> None:
        """Write J v, (n, 3) µm/s, for ``vector`` (n, 3) µm at the last linearisation."""
        self.work.jacobian_products += 1
        linear = self._linearised()
        pairs = linear.pairs
        run = kernels.products_parallel if self._shared(pairs) else kernels.products
        run(
            self.chunk, self._rows, pairs.first, pairs.second, pairs.start,
            pairs.inner_end, pairs.outer_end, linear.normal, linear.along, linear.across,
            self.drag, _frozen(vector), out,
        )  # fmt: skip

    def setup_preconditioner(self, gamma: float) -> None:
        """Invert the 3 x 3 diagonal blocks of I - γJ, stable part, at the linearisation."""
        self.work.preconditioner_setups += 1
        self._fill_blocks(self._linearised())
        kernels.invert_blocks(self._rows, self._blocks, gamma, self.drag, self._inverse)

    def precondition(self, vector: FloatArray, out: FloatArray) -> None:
        """Write the solution of the block-diagonal system for ``vector``, (n, 3)."""
        self.work.preconditioner_solves += 1
        kernels.apply_blocks(self._inverse, _frozen(vector), out)

    def force(self, time: float, position: FloatArray) -> FloatArray:
        """Return the contact force on each cell, (n, 3) nN."""
        out = np.empty_like(position)
        self.velocity(time, position, out)
        return np.asarray(out * (self.drag * self._rows[:, 3:4]))

    def energy(self, time: float, position: FloatArray) -> float:
        """Return the contact energy Σ U(h) over all pairs, fJ."""
        return self._energy_and_virials(time, position)[0]

    def pressure(self, time: float, position: FloatArray) -> FloatArray:
        """Return the virial pressure of each cell, (n,) kPa, tension negative.

        p_i = 1/(3 V_i) ½ Σ_j F_ij d_ij with the volume V_i of the free sphere: a third of
        the trace of the contact stress of one cell. It is zero on average in a cluster at
        rest, where adhesion and repulsion balance.
        """
        virials = self._energy_and_virials(time, position)[1]
        return np.asarray(virials / (3.0 * SPHERE * self._rows[:, 3] ** 3))

    def stiffness_bound(self, time: float, position: FloatArray) -> float:
        """Return an upper bound on the decay rates of the linearised motion, 1/s.

        With the stable part D_i of the stiffness of a cell's contacts, no eigenvalue of -J is
        above 2 max_i λ_max(D_i) / Γ_i, since (u - v)² <= 2 u² + 2 v² for each pair.
        Explicit Euler is stable for steps below 2 over the largest decay rate.
        """
        if len(self) == 0:
            return 0.0
        self._fill_blocks(self._linearise(time, position))
        xx, yy, zz, xy, xz, yz = self._blocks.T
        full = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
        largest = np.linalg.eigvalsh(full)[:, -1]
        return float((2.0 * largest / (self.drag * self._rows[:, 3])).max())

    def _fill_blocks(self, linear: Linearisation) -> None:
        pairs = linear.pairs
        kernels.diagonal_blocks(
            self._rows, pairs.first, pairs.second, pairs.start, pairs.inner_end,
            pairs.outer_end, linear.normal, linear.along, linear.across, self._blocks,
        )  # fmt: skip

    def _energy_and_virials(self, time: float, position: FloatArray) -> tuple[float, FloatArray]:
        pairs = self._settle(time, position)
        virials = np.empty(len(self))
        energy = kernels.energy_and_virials(
            self._rows, pairs.first, pairs.second, pairs.start, pairs.inner_end,
            pairs.outer_end, self.law.code, self.law.adhesion, virials,
        )  # fmt: skip
        return float(energy), virials

    def _settle(self, time: float, position: FloatArray) -> neighbours.PairList:
        """Bring rows and list to a state; return the list."""
        position = _frozen(position)
        pairs = self._pairs if self._pairs is not None else self._rebuild(position)
        while kernels.pack(
            self.chunk, position, self._reference, self.motion.radius,
            self.motion.radius_rate, time - self.motion.begin, self._drift_limit, self._rows,
        ):  # fmt: skip
            pairs = self._rebuild(position)
        return pairs

    def _rebuild(self, position: FloatArray) -> neighbours.PairList:
        """Build the neighbour list at a state."""
        if not np.isfinite(position).all():
            raise StateRejected("a position is not a number")
        self.work.list_builds += 1
        self._reference = np.array(position)
        self._drift_limit = (0.5 * self._skin) ** 2
        try:
            pairs = neighbours.build(
                self._reference, self._list_radius, self._skin, self._list_threads(), self.chunk
            )
        except neighbours.TooManyPairsError as error:
            raise StateRejected(f"cells lie on top of each other ({error})") from error
        self._pairs = pairs
        return pairs

    def _linearised(self) -> Linearisation:
        if self._linear is None:
            raise RuntimeError("linearise() must come first")
        return self._linear

    def _list_threads(self) -> int:
        return self.threads if len(self) >= self.shared_chunks * self.chunk else 1

    def _shared(self, pairs: neighbours.PairList) -> bool:
        return self.threads > 1 and len(pairs.start) >= self.shared_chunks

    def _velocities(self, pairs: neighbours.PairList) -> Any:
        return kernels.velocities_parallel if self._shared(pairs) else kernels.velocities


def _frozen(array: FloatArray) -> FloatArray:
    """Return a read-only view: solvers hand out read-only memory, and one type compiles once."""
    view = array.view()
    view.flags.writeable = False
    return view
