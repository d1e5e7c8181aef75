"""Solver that brings all cells of a network through a coupling step, and finds steady states.

Failures are data with words: a cell that cannot be solved ends the step, with its row and time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from multicell.cells import FloatArray
from multicell.compiling import KERNEL, typed
from multicell.compiling.threads import Team
from multicell.networks.code import addresses
from multicell.networks.events import event_rules, first_conditions
from multicell.networks.kernels import Common, call_initial, call_rates
from multicell.networks.loop import (
    CASCADE,
    CELL_DONE,
    CELL_NOT_FINITE,
    CELL_OUT_OF_STEPS,
    CELL_SLIDES,
    CELL_STALLED,
    REMEMBERED,
    WORK,
    Batch,
    LoopControl,
    Tools,
    advance_cells,
)
from multicell.networks.methods import method_of
from multicell.networks.network import Network

MOST_STEPS: Final = 200_000
"""Steps that a cell may take in a coupling step."""

RELATIVE: Final = 1e-4
"""Usual relative tolerance of a step's error."""

_FLOOR, _SMALLEST = 1e-3, 1e-6  # of a state's own start, of the largest one: what counts as nothing
_SHARED = 256  # cells for each thread that shares the work

_WORDS: Final = {
    CELL_STALLED: "its steps become too short to count",
    CELL_OUT_OF_STEPS: f"it takes more than {MOST_STEPS} steps",
    CELL_NOT_FINITE: "a rate or a state is no finite number",
    CASCADE: "its events set off each other without end",
    CELL_SLIDES: "its rates jump to and fro where a condition on a state changes sides: "
    "let them change smoothly, or by two events with different thresholds",
}


@final
class NetworkFailed(Exception):  # noqa: N818 - what happened, as StepFailed
    """A cell whose network could not be solved.

    - ``row``: of the cell, ``time``: in the network's own unit
    """

    def __init__(self, row: int, time: float, problem: str) -> None:
        super().__init__(problem)
        self.row, self.time, self.problem = row, time, problem


@final
@dataclass(frozen=True, eq=False)
class Inside:
    """Networks of n cells: what a coupling step starts from, and ends with.

    - ``y``, (n, s); ``p``, (n, q): states and parameters
    - ``memory``, (n, 3 + k): what the solver knows of each cell
    - ``met``, (n,): when in the step what each cell waits for came true; infinite where it did
      not; None where none waits
    """

    y: FloatArray
    p: FloatArray
    memory: FloatArray
    met: FloatArray | None = None


@final
class NetworkSolver:
    """Solves a network in many cells at once.

    Parameters
    ----------
    network
        What to solve.
    method
        One of :data:`multicell.networks.methods.METHODS`.
    relative, absolute
        Tolerances of the error of one step; the absolute one in the unit of each state, (s,), one
        number for all, or None for what follows from the states at the start.
    length
        Of all steps, which are then under no error control, in the network's own unit of time; 0
        for steps under it. Methods without an estimate need one.
    threads
        How many may share the cells; the results have the same bits for any number.
    """

    def __init__(
        self,
        network: Network,
        *,
        method: str = "auto",
        relative: float = RELATIVE,
        absolute: float | FloatArray | None = None,
        length: float = 0.0,
        threads: int = 1,
    ) -> None:
        self.network, self.relative = network, relative
        self.method = method_of(method, relative)
        if self.method.fixed and not length > 0.0:
            raise ValueError(f"the method {method!r} needs the length of its steps")
        self._control = LoopControl(self.method.mode, MOST_STEPS, length)
        self._at = addresses(network)
        self._rules = event_rules(network, self._at.triggers, self._at.assigns)
        self._team = Team(threads)
        if absolute is None:
            start = np.abs(np.array(network.start))
            least = _SMALLEST * (start.max(initial=0.0) or 1.0)
            absolute = relative * np.maximum(_FLOOR * start, least)
        # writable, whatever is given: for arrays that are not, numba would compile it all once more
        self.absolute = np.full(len(network.states), absolute, dtype=float)
        self.work = np.zeros(WORK, dtype=np.int64)

    def begin(
        self, count: int, inputs: FloatArray | None = None, values: FloatArray | None = None
    ) -> Inside:
        """Return the networks of so many cells at the start.

        - ``inputs``, (n, m): at the start, by default the network's own
        - ``values``, (n, q): parameters of each cell, by default the network's own
        """
        network = self.network
        y = np.tile(np.array(network.start, dtype=float), (count, 1))
        p = np.tile(np.array(network.values, dtype=float), (count, 1))
        if values is not None:
            p[:] = values
        if self._at.initial:
            u = np.tile(np.array(network.defaults, dtype=float), (count, 1))
            if inputs is not None:
                u[:] = inputs
            _start_each(self._at.initial, u, p, y)
        memory = np.zeros((count, REMEMBERED + len(network.events)))
        memory[:, REMEMBERED:] = first_conditions(network)
        return Inside(y, p, memory)

    def advance(
        self,
        inside: Inside,
        before: FloatArray,
        after: FloatArray,
        start: float | FloatArray,
        span: float | FloatArray,
        *,
        growth: FloatArray | None = None,
        diluted: FloatArray | None = None,
        waiting: FloatArray | None = None,
    ) -> Inside:
        """Return the networks a time ``span`` after ``start``, for all cells or (n,), in its unit.

        - ``before``, ``after``, (n, m): inputs at both ends, between which they go linearly
        - ``growth``, (n,): d ln(volume)/dt, by which those of the states fall that ``diluted``,
          (s,), marks by 1
        - ``waiting``, (n, 4): what each cell waits for: place of a value (:meth:`place_of`), 1 or
          -1 for a rise or a fall, level, and the time from which it counts

        Raises
        ------
        NetworkFailed
            For the first cell that could not be solved.
        """
        count, states = inside.y.shape
        batch = Batch(
            inside.y.copy(),
            inside.p.copy(),
            np.ascontiguousarray(before, dtype=float),
            np.ascontiguousarray(after, dtype=float),
            np.zeros(count) if growth is None else np.ascontiguousarray(growth, dtype=float),
            np.full(count, start, dtype=float),
            np.full(count, span, dtype=float),
            inside.memory.copy(),
            np.zeros((count, WORK), dtype=np.int64),
            np.zeros(count, dtype=np.int64),
            np.zeros(count),
            np.empty((0, 4)) if waiting is None else np.ascontiguousarray(waiting, dtype=float),
            np.full(count, np.inf),
        )
        fall = np.zeros(states) if diluted is None else np.ascontiguousarray(diluted, dtype=float)
        observed = len(self.network.observed)
        common = Common(
            self._at.rates, self.relative, self.absolute, fall, self._at.observe, observed
        )
        method = self.method
        tools = Tools(common, method.rosenbrock, method.explicit, self._rules, self._control)
        team = self._team.at_most(1 + count // _SHARED)
        team.share(advance_cells, count, tools, batch)
        failed = np.flatnonzero(batch.status != CELL_DONE)
        if len(failed):
            row = int(failed[0])
            problem = _WORDS[int(batch.status[row])]
            raise NetworkFailed(row, float(batch.reached[row]), problem)
        self.work = self.work + batch.work.sum(axis=0)
        met = None if waiting is None else batch.met
        return Inside(batch.y, batch.p, batch.memory, met)

    def place_of(self, name: str) -> int:
        """Return the place of a value among states, parameters, inputs and observed values."""
        known = self.network
        return (*known.states, *known.parameters, *known.inputs, *known.observed).index(name)

    def rates(self, inside: Inside, inputs: FloatArray, time: float) -> FloatArray:
        """Return dy/dt, (n, s)."""
        return self._each(self._at.rates, inside, inputs, time, len(self.network.states))

    def observe(self, inside: Inside, inputs: FloatArray, time: float) -> FloatArray:
        """Return the observed values, (n, k)."""
        return self._each(self._at.observe, inside, inputs, time, len(self.network.observed))

    def _each(
        self, at: int, inside: Inside, inputs: FloatArray, time: float, width: int
    ) -> FloatArray:
        out = np.empty((len(inside.y), width))
        if width:
            u = np.ascontiguousarray(inputs, dtype=float)
            _call_each(at, time, inside.y, u, inside.p, out)
        return out

    def settle(self, inside: Inside, inputs: FloatArray, time: float) -> Inside:
        """Return the networks at rest under inputs that stay what they are.

        Raises
        ------
        NetworkFailed
            For a cell that does not come to rest.
        """
        quick = np.abs(self.rates(inside, inputs, time))
        typical = np.abs(inside.y) + self.absolute / self.relative
        span = float(1.0 / max((quick / typical).max(initial=0.0), 1e-300))
        for _ in range(_DOUBLINGS):
            inside = self.advance(inside, inputs, inputs, time, span)
            allowed = self.absolute + self.relative * np.abs(inside.y)
            moving = np.abs(self.rates(inside, inputs, time)) * span > allowed
            if not moving.any():
                return replace(inside, memory=self.begin(len(inside.y)).memory)
            span *= 2.0
        row = int(np.flatnonzero(moving.any(axis=1))[0])
        raise NetworkFailed(row, time, "it does not come to rest")


_DOUBLINGS: Final = 24  # of the time in which a steady state is looked for


@typed(**KERNEL)
def _start_each(at: int, u: FloatArray, p: FloatArray, y: FloatArray) -> None:
    for i in range(y.shape[0]):
        call_initial(at, u[i], p[i], y[i])


@typed(**KERNEL)
def _call_each(
    at: int, time: float, y: FloatArray, u: FloatArray, p: FloatArray, out: FloatArray
) -> None:
    for i in range(y.shape[0]):
        call_rates(at, time, y[i], u[i], p[i], out[i])
