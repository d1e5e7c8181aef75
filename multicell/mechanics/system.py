"""Overdamped mechanics of a population: forces, Jacobian, energy, pressure.

The equation of motion is 6πη r_i(t) dx_i/dt = Σ_j F_ij (Stokes drag, contact forces of
:mod:`multicell.contact.law`). Over a coupling step a radius runs linearly in time between its
values at the two ends, so that volumes are exact at both ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import SPHERE, FloatArray, stokes_drag
from multicell.compiling.threads import launch, may_share
from multicell.contact.law import PairLaw, compliance
from multicell.mechanics import blocks, forces, neighbours, pair_values
from multicell.mechanics.motion import Motion, StateRejected, Work
from multicell.mechanics.neighbours import NeighbourList, PairList
from multicell.mechanics.rows import COMPLIANCE, RADIUS
from multicell.mechanics.watch import ContactWatch
from multicell.vectors import cubes

if TYPE_CHECKING:
    from multicell.mechanics.compression import Coupling, Pressed, TissueCompression
    from multicell.mechanics.friction import PairFriction
    from multicell.mechanics.prescribed import Prescribed
    from multicell.mechanics.sphere import Sphere
    from multicell.mechanics.walls import Walls


_NOTHING = np.empty((0, 0))
_NO_BLOCKS = _NO_PUSH = np.empty((0, 6))
_NO_BONDS = np.empty((0, 4))


@final
@dataclass
class Linearisation:
    """Direction, dF/dh + F/d and F/d of every pair at one state.

    ``walls`` is the stiffness of each cell's walls along each axis, (n, 3) nN/µm, or empty;
    for a spherical wall xx, yy, zz, xy, xz, yz at a fixed radius. ``coupling`` is what the change
    of the cells' pressures adds where tissue resists compression, ``yielding``, (n, 3), the g of
    the + g gᵀ that the yielding of a gel adds to the derivative of forces.
    """

    pairs: PairList
    normal: FloatArray
    along: FloatArray
    across: FloatArray
    data: forces.PairData | None = None
    walls: FloatArray = field(default_factory=lambda: _NOTHING)
    coupling: Coupling | None = None
    yielding: FloatArray | None = None

    @classmethod
    def room(cls, pairs: PairList) -> Linearisation:
        """Return arrays of the size that a list needs, not filled yet."""
        size = len(pairs.first)
        return cls(pairs, np.empty((size, 3)), np.empty(size), np.empty(size))

    def stiffened(self) -> Linearisation:
        """Return it with pairs that stand for many-body stiffness as well."""
        if self.coupling is None:
            return self
        from multicell.mechanics import compression

        return compression.stiffened(self)


Kernels = tuple[forces.CellData, Any, FloatArray, float, FloatArray]
"""Arguments of kernels besides pairs: cells, law, reach of the list, margin, rows."""


@final
@dataclass
class Mechanics:
    """Right-hand side, Jacobian and observables of overdamped cells.

    Owns the neighbour list and all work arrays, which can be rebuilt from the state.

    - ``law``: pair law
    - ``viscosity``: viscosity η of the medium, kPa·s
    - ``threads``: with more than one, chunks of cells are shared among threads; same bits
    - ``skin``: least distance between surfaces over which the neighbour list holds pairs beyond
      what the law asks for, as a fraction of the mean radius; it widens round cells that move far
    - ``chunk``: cells that one thread works on at a time; it decides the order of the sums
    - ``shared_chunks``: number of chunks from which on threads are used: below, waking them costs
      more than they save
    - ``bond_strength``: f_ad of differential adhesion (eq. 3.7), nN/µm²; felt by cells with
      receptors.
    - ``friction``, (float, float): friction of touching cells per contact area, along the line of
      centres and across it, nN s/µm³; see :mod:`multicell.mechanics.friction`
    - ``pair_table``, (k, k), optional: symmetric matrix over the cell types of what the law takes
      (:meth:`~multicell.contact.law.PairLaw.for_pair`): surface energies in nN/µm, or factors
    - ``walls``, optional: elastic walls that the cells press against
    - ``compression``, optional: many-body resistance to compression
    - ``period``, (3,), µm, optional: lengths after which space repeats along x, y and z; zero where
      it does not
    """

    law: PairLaw
    viscosity: float
    threads: int = 1
    skin: float = 0.2
    chunk: int = neighbours.CHUNK
    shared_chunks: int = 8
    bond_strength: float = 0.0
    friction: tuple[float, float] = (0.0, 0.0)
    pair_table: FloatArray | None = None
    walls: Walls | Sphere | None = None
    compression: TissueCompression | None = None
    period: FloatArray | None = None
    work: Work = field(default_factory=Work)

    def __post_init__(self) -> None:
        if self.threads > 1:
            launch()
        self.drag = stokes_drag(self.viscosity)
        self._period = None if self.period is None else np.zeros((2, 3))
        if self.period is not None and self._period is not None:
            self._period[0] = self.period
            np.divide(1.0, self.period, out=self._period[1], where=self.period > 0.0)
        self.neighbours, self._room = NeighbourList(np.empty(0), 0.0), _NOTHING
        self._laws: dict[bool, Any] = {}
        self._cells: forces.CellData
        self._pair_data: forces.PairData
        self._linear: Linearisation | None = None
        self._pair_friction: PairFriction | None = None
        self.prescribed: Prescribed | None = None
        # of the coupling step, once multicell.integrators.limits has found it, 1/s
        self.stiffness_scale: float | None = None
        # what the coupling steps of a run have taught multicell.integrators.auto
        self.learnt: tuple[float, ...] = ()

    def begin(self, motion: Motion) -> None:
        """Take the radii and moduli for a coupling step; the old list is dropped."""
        self.motion = motion
        self.stiffness_scale = None
        n = len(motion.radius)
        bonded = motion.bonds is not None
        width = 7 if bonded else 5
        if bonded not in self._laws:
            self._laws[bonded] = self._constants(bonded)
        self._law = self._laws[bonded]
        if len(self._room) < n or self._room.shape[1] != width:
            self._room = np.zeros((n + n // 8, width))  # for some steps of growing tissue
        self._rows = self._room[:n]
        self._rows[:, COMPLIANCE] = compliance(motion.young, motion.poisson)
        largest = np.maximum(motion.radius, motion.end_radius)
        self.neighbours = NeighbourList(
            self._list_radius(largest),
            0.5 * self.skin * float(largest.sum() / n) if n else 0.0,
            chunk=self.chunk,
            newborn=motion.newborn,
            room=self.neighbours.release(n),
            shared=self.shared(-(-n // self.chunk)),
            period=self.period,
        )
        if not self.law.acts:
            self.neighbours.hold_no_pairs()
            self._pair_data = forces.PairData(*self.neighbours.hand_out(), None, None, None)
        self._cells = forces.CellData(
            self.chunk,
            self.neighbours.margin,
            self.neighbours.reference,
            motion.radius,
            motion.radius_rate,
            _NO_BONDS if motion.bonds is None else motion.bonds,
            _NO_PUSH if motion.push is None else motion.push,
        )
        self._linear = None
        self._watch: ContactWatch | None = None
        self._blocks = self._inverse = _NO_BLOCKS  # few methods use them
        if max(self.friction) > 0.0:
            from multicell.mechanics.friction import PairFriction

            self._pair_friction = PairFriction(
                self.friction, n, self.drag, self.chunk, self._period
            )
        self.prescribed = None
        if motion.held is not None and motion.velocity is not None:
            from multicell.mechanics.prescribed import Prescribed

            self.prescribed = Prescribed(motion.held, motion.velocity, motion.begin)

    def _constants(self, bonded: bool) -> Any:
        """Return the constants of the law, floats, for cells with receptors or without."""
        law = self.law.constants()._replace(
            adhesion_constant=self.law.adhesion,
            bond_strength=self.bond_strength if bonded else None,
            medium_drag=self.drag,
        )
        return law._make(None if value is None else float(value) for value in law)

    @property
    def _is_too_wide(self) -> bool:
        """Whether a cell may be in reach of two images of another one."""
        if self.period is None:
            return False
        return bool(self.neighbours.reach.max() > 0.25 * self.period[self.period > 0.0].min())

    def _list_radius(self, radius: FloatArray) -> FloatArray:
        """Return half of the distances within which cells matter to each other, (n,) µm."""
        if len(radius) == 0:
            return radius
        law, softest = self.law, 0.5 / float(self._rows[:, COMPLIANCE].max())
        table, sticky = self.pair_table, self.motion.sticky
        if table is not None or sticky is not None:
            most = law.surface_energy if table is None else float(table.max())
            law = law.for_pair(most * (1.0 if sticky is None else float(sticky.max())))
        return law.list_radius(radius, softest)

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.motion.radius)

    def velocity(self, time: float, position: FloatArray, out: FloatArray) -> None:
        """Write dx/dt, (n, 3) µm/s, at ``position``, (n, 3) µm, and ``time``, s."""
        self.work.evaluations += 1
        friction, given = self._pair_friction, self.prescribed
        if friction is None:
            self._forces(time, position, True, out)
            if given is not None:
                out[given.held] = 0.0
            return
        pairs = self._forces(time, position, False, friction.force)
        shared = self._shared(pairs)
        iterations = friction.velocity(self._rows, pairs, shared, out, given)
        self.work.friction_iterations += iterations

    def linearise(self, time: float, position: FloatArray) -> Linearisation:
        """Prepare :meth:`jacobian_product` at a state; return the pairs' stiffness there."""
        self.work.linearisations += 1
        pairs = self._settle(time, position)
        if self._linear is None or self._linear.pairs is not pairs:
            self._linear = Linearisation.room(pairs)
        linear = self._linear
        run = forces.linearise_parallel if self._shared(pairs) else forces.linearise
        run(
            self._rows,
            self._pair_data,
            self._law,
            time - self.motion.begin,
            linear.normal,
            linear.along,
            linear.across,
        )
        linear.data = self._pair_data
        pressed = self._settle_pressures(pairs)
        if self.walls is not None:
            linear.walls = self.walls.stiffness(self._rows)
        add_pressures = None
        if self.compression is not None and pressed is not None:
            shared = self._shared(pairs)
            linear.coupling = self.compression.linearise(self._rows, pressed, linear, shared=shared)
            add_pressures = partial(
                self.compression.add_yielding,
                self.chunk,
                self._rows,
                linear,
                pressed,
                shared=shared,
            )
        if self.walls is not None:
            linear.yielding = self.walls.yielding(self._rows, add_pressures)
        if self._pair_friction is not None:
            self._pair_friction.linearise(self._rows, pairs, self._shared(pairs))
        return linear

    @property
    def linearisation(self) -> Linearisation:
        """The pairs' stiffness at the last state given to :meth:`linearise`."""
        if self._linear is None:
            raise RuntimeError("linearise() must come first")
        return self._linear

    @property
    def weighed_rows(self) -> FloatArray:
        """The :attr:`rows` for preconditioners, to which held cells have an immense drag."""
        return self._rows if self.prescribed is None else self.prescribed.weighed(self._rows)

    @property
    def rows(self) -> FloatArray:
        """The cells at the last state seen, as :mod:`multicell.mechanics.forces` takes them."""
        return self._rows

    def jacobian_product(
        self, vector: FloatArray, out: FloatArray, linear: Linearisation | None = None
    ) -> None:
        """Write J v, (n, 3) µm/s, for ``vector`` (n, 3) µm at the last linearisation, or at one."""
        self.work.jacobian_products += 1
        linear = self.linearisation if linear is None else linear
        given = self.prescribed
        if given is not None:
            vector = given.released(vector)
        run = forces.products_parallel if self._shared(linear.pairs) else forces.products
        drag = self.drag if self._pair_friction is None else 0.0
        run(
            self.chunk,
            self._rows,
            linear.data,
            linear.normal,
            linear.along,
            linear.across,
            drag,
            _frozen(vector),
            out,
        )
        if self.walls is not None:
            self.walls.subtract_products(self._rows, linear.walls, drag, _frozen(vector), out)
        if self.compression is not None:
            self.compression.add_products(
                self.chunk,
                self._rows,
                linear,
                drag,
                _frozen(vector),
                out,
                shared=self._shared(linear.pairs),
            )
        if linear.yielding is not None:
            force = (linear.yielding * vector).sum() * linear.yielding
            out += force / (drag * self._rows[:, 3, None]) if drag > 0.0 else force
        if given is not None:
            out[given.held] = 0.0
        if self._pair_friction is not None:
            self.work.friction_iterations += self._pair_friction.divide(out, given)

    def missed_contact(
        self,
        begin: float,
        end: float,
        before: FloatArray,
        after: FloatArray,
        speed: FloatArray,
        end_speed: FloatArray,
        moved: float,
        tolerance: float,
    ) -> float:
        """Return the part of a step to be taken instead where it misses a contact, else 1.

        See :func:`multicell.mechanics.forces.missed_contact`; the last evaluation must have been at
        the end of the step. Only pairs that may meet are looked at, and searched for anew where one
        that is not among them may have come near.

        - ``begin``, ``end``: of the step, s
        - ``before``, ``after``, ``speed``, ``end_speed``: (n, 3) µm and µm/s, there
        - ``moved``: how far a cell has moved at most, in its radius
        - ``tolerance``: how far attraction may be missed, µm
        """
        pairs = self.neighbours.pairs
        if pairs is None or not (self.law.snaps or self.motion.bonds is not None):
            return 1.0
        given, way = self.prescribed, moved * self.motion.largest_radius
        way = 2.0 * (way + self.motion.fastest_growth * (end - begin))
        if given is not None:
            before, after = given.placed(begin, before), given.placed(end, after)
            speed, end_speed = speed + given.velocity, end_speed + given.velocity
            way += given.fastest * (end - begin)
        if self._watch is None:
            self._watch = ContactWatch(self.motion)
        kernel = self._cells, self._pair_data, self._law, self._rows
        path = before, after, speed, end_speed
        return self._watch.missed_contact(pairs, kernel, path, begin, end, way, tolerance)

    def setup_preconditioner(self, gamma: float, linear: Linearisation) -> None:
        """Invert the 3 x 3 diagonal blocks of I - γJ, stable part, at the linearisation."""
        self.work.preconditioner_setups += 1
        self._fill_blocks(linear)
        if self._pair_friction is not None:
            # the drag that the blocks are divided by is that of Γ's diagonal
            stokes = self.drag * self._rows[:, RADIUS]
            self._blocks *= (stokes / self._pair_friction.diagonal())[:, None]
        if len(self._inverse) < len(self):
            self._inverse = np.empty((len(self), 6))
        blocks.invert_blocks(self._rows, self._blocks, gamma, self.drag, self._inverse)

    def precondition(self, vector: FloatArray, out: FloatArray) -> None:
        """Write the solution of the block-diagonal system for ``vector``, (n, 3)."""
        self.work.preconditioner_solves += 1
        blocks.apply_blocks(self._inverse, _frozen(vector), out)

    def force(self, time: float, position: FloatArray) -> FloatArray:
        """Return the force of contacts, walls and from outside on each cell, (n, 3) nN."""
        out = np.empty_like(position)
        self._forces(time, position, False, out)
        return out

    def contacts(self, time: float, position: FloatArray) -> NDArray[np.int64]:
        """Return the pairs in contact, (m, 2), smaller index first, in lexicographic order.

        Contact means an overlap above zero; under exact JKR a pair that was in contact at the
        step's beginning stays so until it breaks.
        """
        if not self.law.acts:
            radius = self.motion.radius + self.motion.radius_rate * (time - self.motion.begin)
            return neighbours.overlapping_pairs(position, radius, self.period)
        pairs = self._settle(time, position)
        marked = np.empty(len(pairs.first), dtype=np.bool_)
        elapsed = time - self.motion.begin
        forces.mark_contacts(self._rows, self._pair_data, elapsed, marked)
        found = np.stack([pairs.first[marked], pairs.second[marked]], axis=1).astype(np.int64)
        found.sort(axis=1)
        return found[np.lexsort((found[:, 1], found[:, 0]))]

    def energy(self, time: float, position: FloatArray) -> float:
        """Return the contact energy Σ U(h) over all pairs, and of walls and compression, fJ."""
        pressed = self._settle_pressures(self._settle(time, position))
        elapsed = time - self.motion.begin
        total = float(forces.energy(self._rows, self._pair_data, self._law, elapsed))
        if self.walls is not None:
            total += self.walls.energy(self._rows)
        if self.compression is not None and pressed is not None:
            total += self.compression.energy(self._rows, pressed)
        return total

    def pressure(self, time: float, position: FloatArray) -> FloatArray:
        """Return the virial pressure of each cell, (n,) kPa, tension negative.

        p_i = 1/(3 V_i) ½ Σ_j F_ij d_ij with the volume V_i of the free sphere: a third of
        the trace of the contact stress of one cell. It is zero on average in a cluster at
        rest, where adhesion and repulsion balance. A wall at the distance d adds F d to the
        sum, as a neighbour at 2 d would.
        """
        pairs = self._settle(time, position)
        virials = np.zeros(len(self))
        elapsed = time - self.motion.begin
        run = forces.half_virials_parallel if self._shared(pairs) else forces.half_virials
        run(self._rows, self._pair_data, self._law, elapsed, virials)
        pressed = self._settle_pressures(pairs)
        if self.walls is not None:
            self.walls.add_virials(self._rows, virials)
        if pressed is not None:
            self._resist(pairs, pressed, 0.0, np.zeros((len(self), 3)), virials)
        return np.asarray(virials / (3.0 * SPHERE * cubes(self._rows[:, RADIUS])))

    def stiffness_bound(self, time: float, position: FloatArray) -> float:
        """Return an upper bound on the decay rates of the linearised motion, 1/s.

        With the stable part D_i of the stiffness of a cell's contacts, no eigenvalue of -J is
        above 2 max_i λ_max(D_i) / Γ_i, since (u - v)² <= 2 u² + 2 v² for each pair.
        Explicit Euler is stable for steps below 2 over the largest decay rate.
        """
        if len(self) == 0:
            return 0.0
        self._fill_blocks(self.linearise(time, position))
        xx, yy, zz, xy, xz, yz = self._blocks.T
        full = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
        largest = np.linalg.eigvalsh(full)[:, -1]
        return float((2.0 * largest / (self.drag * self._rows[:, RADIUS])).max())

    def _fill_blocks(self, linear: Linearisation) -> None:
        linear = linear.stiffened()
        if len(self._blocks) < len(self):
            self._blocks = np.empty((len(self), 6))
        blocks.diagonal_blocks(
            linear.data, linear.normal, linear.along, linear.across, self._blocks
        )
        if self.walls is not None:
            self._blocks[:, : linear.walls.shape[1]] += linear.walls
        if self.prescribed is not None:
            self._blocks[self.prescribed.held] = 0.0

    def _forces(self, time: float, position: FloatArray, stokes: bool, out: FloatArray) -> PairList:
        """Write forces or velocities; return the list that holds at this state."""
        position = _frozen(self._placed(time, position))
        pairs = self.neighbours.pairs
        if pairs is None:
            pairs = self._update(position)
        run = forces.forces_parallel if self._shared(pairs) else forces.forces
        while run(
            self._cells,
            self._pair_data,
            self._law,
            position,
            time - self.motion.begin,
            stokes,
            self._rows,
            out,
        ):
            pairs = self._update(position)
        pressed = self._settle_pressures(pairs)
        if self.walls is not None:
            self.walls.add_forces(self._rows, self.drag if stokes else 0.0, out)
        drag = self.drag if stokes else 0.0
        self._resist(pairs, pressed, drag, out, np.empty(len(self)))
        return pairs

    def _settle_pressures(self, pairs: PairList) -> Pressed | None:
        """Let walls that yield do so at the state in ``rows``; return the cells' pressures."""
        if self.compression is None:
            if self.walls is not None:
                self.walls.settle(self._rows, None, None)
            return None
        return self.compression.pressed(
            self._rows, self._pair_data, self.chunk, self.walls, shared=self._shared(pairs)
        )

    def _resist(
        self,
        pairs: PairList,
        pressed: Pressed | None,
        drag: float,
        out: FloatArray,
        virials: FloatArray,
    ) -> None:
        """Add what compressed tissue adds to forces or velocities, and to virials."""
        if self.compression is not None and pressed is not None:
            self.compression.add_forces(
                self._rows,
                self._pair_data,
                pressed,
                drag,
                out,
                virials,
                shared=self._shared(pairs),
            )

    def _placed(self, time: float, position: FloatArray) -> FloatArray:
        """Return the positions of the cells, those with prescribed motion advanced."""
        return position if self.prescribed is None else self.prescribed.placed(time, position)

    def at_end(self, position: FloatArray) -> FloatArray:
        """Return where the cells are at the end of the coupling step, (n, 3) µm.

        ``position`` is what an integrator gives, for which cells whose motion is prescribed stand
        still.
        """
        return self._placed(self.motion.end, position)

    def resistance(self, velocity: FloatArray) -> FloatArray:
        """Return Γ v, (n, 3) nN, for velocities in µm/s at the state of the last evaluation."""
        if self._pair_friction is None:
            return np.asarray(self.drag * self._rows[:, 3, None] * velocity)
        return self._pair_friction.resistance(velocity)

    def _settle(self, time: float, position: FloatArray) -> PairList:
        """Bring rows and list to a state; return the list."""
        position = _frozen(self._placed(time, position))
        pairs = self.neighbours.pairs
        if pairs is None:
            pairs = self._update(position)
        run = forces.pack_parallel if self._shared(pairs) else forces.pack
        while run(self._cells, position, time - self.motion.begin, self._rows):
            pairs = self._update(position)
        return pairs

    def _update(self, position: FloatArray) -> PairList:
        """Bring the neighbour list to a state, with what the law keeps for each pair."""
        if not np.isfinite(position).all():
            raise StateRejected("a position is not a number")
        if self._is_too_wide:
            raise StateRejected(
                "cells reach farther than a quarter of the domain's shortest period"
            )
        found = self.neighbours.update(position)
        repaired = found == neighbours.REPAIRED
        self.work.list_repairs += repaired
        self.work.list_builds += not repaired
        pairs = self.neighbours.pairs
        if pairs is None:
            problem = neighbours.too_many_pairs(len(self))
            raise StateRejected(f"cells lie on top of each other ({problem})")
        self._pair_data = pair_values.pair_data(
            pairs, self.law, self.motion, self.pair_table, self._rows[:, COMPLIANCE]
        )
        if self._period is not None:
            self._pair_data = self._pair_data._replace(period=self._period)
        return pairs

    @property
    def has_pair_values(self) -> bool:
        """Whether the law keeps values for each pair, which are made with each list."""
        return pair_values.has_pair_values(self.law, self.motion, self.pair_table)

    def kernel_data(self) -> tuple[Kernels, forces.PairData, bool]:
        """Return the data of the kernels, for a loop that updates the neighbour list itself.

        The last says whether threads share them. :meth:`take_list` takes the list that the loop
        leaves.
        """
        known = self.neighbours
        if known.pairs is None:
            self._pair_data = forces.PairData(*known.hand_out(), None, None, None)
        pairs = self._pair_data
        shared = self.shared(len(pairs.start))
        return (self._cells, self._law, known.reach, known.least, self._rows), pairs, shared

    def take_list(self, pairs: forces.PairData) -> None:
        """Take over the neighbour list of a loop that was given :meth:`kernel_data`."""
        self._pair_data = pairs
        # the list that was linearised may have been overwritten
        self._linear = None
        self.neighbours.adopt(pairs[:5])

    def _shared(self, pairs: PairList) -> bool:
        return self.shared(len(pairs.start))

    def shared(self, chunks: int) -> bool:
        """Return whether threads share a loop over so many chunks."""
        return self.threads > 1 and chunks >= self.shared_chunks and may_share()


def _frozen(array: FloatArray) -> FloatArray:
    """Return a read-only view: solvers hand out read-only memory, and one type compiles once.

    What is not float64 row by row is copied.
    """
    view = np.ascontiguousarray(array, dtype=np.float64).view()
    view.flags.writeable = False
    return view
