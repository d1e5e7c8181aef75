"""Cost of the restarts of CVODE in every coupling step, beside those of one solver for several.

Problem   coupling steps of runs with about a thousand cells, replayed with their events: growing
          tissue (grow-2000) with divisions all the time and between two waves of them, and two
          scenes in which none divides: settle-1000, and compression between driven layers
Question  (a) one solver goes through all steps; (b) each step has one of its own that begins with
          a given first step, the best of a ladder. A run would have to guess it, and gain less
Method    In (a) a vector has a place for every cell that lives in any of the steps. Before a
          division both daughters have the mother's place, and what they were moved by is taken
          off: the vector is continuous, and the solver keeps history, order and step for all cells.
          Where error control meets something new it shortens the step. What a solver keeps is in no
          frame, so that a run which did this would not resume exactly
Cost      passes over all cells (Work.effort) and internal steps at 0.01 µm, in those of CVODE as it
          is. About three minutes of CPU
Command   python tests/benchmarks/compare_long_solves.py    (--states, --cells, --steps)
"""

from __future__ import annotations

import argparse
from functools import partial
from types import SimpleNamespace

import numpy as np

import multicell as mc
from multicell.comparison.record import record
from multicell.comparison.replay import ReplayProblem, replay
from multicell.integrators import cvode_solver
from multicell.integrators.base import Outcome
from multicell.integrators.cvode import Cvode
from multicell.integrators.restarts import IntegrationProgress, Restart, _Refused

LEAD = 3
"""Coupling steps at a state's own viscosity before those that are measured."""
FIRST = (0.0, 1e-2, 1e-3, 1e-4)
"""First steps of the ladder, over the coupling step; CVODE's own first."""
STATES = {
    "growing, 5 kPa s": ("asynchronous", 5.0),
    "growing, 0.5 kPa s": ("asynchronous", 0.5),
    "growing, 0.05 kPa s": ("asynchronous", 0.05),
    "growing, 0.01 kPa s": ("asynchronous", 0.01),
    "between waves, 5 kPa s": ("birth", 5.0),
    "between waves, 0.05 kPa s": ("birth", 0.05),
    "settling": ("settle-1000", None),
    "compressed": ("compression", None),
}


def grown(stage: str, cells: int) -> mc.Cells:
    """Return cells that have grown together at 5 kPa s, born at any time or in waves."""
    factor, hours = (1.4, 8.0) if stage == "asynchronous" else (1.9, 24.0)
    scene = mc.load_scene("grow-2000").with_changes({
        "initial.count": round(cells / factor), "initial.stage": stage, "initial.jitter": 0.1,
        "initial.spacing": 0.9, "stop_cells": None,
    })  # fmt: skip
    simulation = mc.Simulation(scene, threads=1)
    while simulation.time < 3600.0 * hours:
        simulation.step()
    return simulation.cells


def recorded(state: str, cells: int, steps: int, known: dict[str, mc.Cells]) -> ReplayProblem:
    """Return the coupling steps of a state, with their events."""
    kind, viscosity = STATES[state]
    if viscosity is None:
        scene = mc.load_scene(kind).with_changes({"initial.count": cells})
        simulation = mc.Simulation(scene, threads=1)
    else:
        if kind not in known:
            known[kind] = grown(kind, cells)
        scene = mc.load_scene("grow-2000").with_changes({
            "drag.viscosity": viscosity, "stop_cells": None,
        })  # fmt: skip
        simulation = mc.Simulation(scene, threads=1, cells=known[kind])
    for _ in range(LEAD):
        simulation.step()
    ended = scene.with_changes({"duration": steps * scene.coupling_step})
    return record(ended, Cvode(), cells=simulation.cells, threads=1)[0]


class Slots:
    """Mechanics of several coupling steps, with one place for every cell that lives in any.

    Before its birth a cell has the place of its mother, less what it is moved by at birth; one that
    has died stays where it was.
    """

    def __init__(self, problem: ReplayProblem) -> None:
        self.inner, self._steps = problem.system(), problem.steps
        self._cell = [np.arange(len(self._steps[-1].motion.radius))]
        for k in range(len(self._steps) - 1, 0, -1):
            cells = len(self._steps[k - 1].motion.radius)
            self._cell.insert(0, self._earlier(self._steps[k].before, self._cell[0], cells))
        size = len(self._cell[0])
        # what has died is not there in later steps
        padded = [np.full(size, -1) for _ in self._cell]
        for all_places, places in zip(padded, self._cell, strict=True):
            all_places[: len(places)] = places
        self._cell = padded
        self._shift = np.zeros((size, 3))
        self.start = problem.start[self._cell[0]]
        self.begin, self.solvers = self._steps[0].motion.begin, 0

    def _earlier(self, events, later, cells):
        """Return the cell before the events of every place, and of those that died in them."""
        if events is None:
            return later
        places = np.where(later >= 0, events.source[later], -1)
        return np.concatenate((places, np.setdiff1d(np.arange(cells), events.source)))

    def enter(self, k: int) -> None:
        """Begin a coupling step."""
        if k > 0:
            self._carry(self._steps[k - 1].motion, self._steps[k].before, k)
        motion = self._steps[k].motion
        self.inner.begin(motion)
        cell = self._cell[k]
        self._there = cell >= 0
        self._index = cell[self._there]
        self._places = np.zeros(len(motion.radius), dtype=np.int64)
        self._places[self._index] = np.flatnonzero(self._there)
        radius = np.ones(len(cell))
        radius[self._there] = motion.radius[self._index]
        self.motion = SimpleNamespace(begin=self.begin, end=motion.end, radius=radius)

    def _carry(self, before, events, k):
        """Add to the shifts what happens at the end of a step."""
        if before.velocity is not None:
            there = self._cell[k - 1] >= 0
            moved = (before.end - before.begin) * before.velocity
            self._shift[there] += moved[self._cell[k - 1][there]]
        if events is not None:
            there = self._cell[k] >= 0
            self._shift[there] += events.offset[self._cell[k][there]]

    def __len__(self) -> int:
        return len(self.start)

    def __getattr__(self, name: str):
        return getattr(self.inner, name)

    def positions(self, y):
        """Return the positions of the cells that there are."""
        return (y + self._shift)[self._places]

    def _spread(self, values, out):
        out[:] = 0.0
        out[self._there] = values[self._index]

    def velocity(self, now, y, out) -> None:
        values = np.empty((len(self._places), 3))
        self.inner.velocity(now, self.positions(y), values)
        self._spread(values, out)

    def linearise(self, now, y):
        return self.inner.linearise(now, self.positions(y))

    def jacobian_product(self, vector, out, linear) -> None:
        values = np.empty((len(self._places), 3))
        self.inner.jacobian_product(vector[self._places], values, linear)
        self._spread(values, out)

    def precondition(self, vector, out) -> None:
        values = np.empty((len(self._places), 3))
        self.inner.precondition(vector[self._places], values)
        out[:] = vector
        out[self._there] = values[self._index]

    def missed_contact(self, begin, end, before, after, speed, end_speed, moved, tolerance):
        states = self.positions(before), self.positions(after)
        speeds = speed[self._places], end_speed[self._places]
        return self.inner.missed_contact(begin, end, *states, *speeds, moved, tolerance)


def run_through(problem: ReplayProblem, method: Cvode) -> Slots:
    """Solve all steps by one solver as long as it can continue; return what it did."""
    system = Slots(problem)
    system.enter(0)
    run = IntegrationProgress(method, system, system.start, part=method.part)
    share, session, mild, ceiling = run.share, None, method.light, 0.0
    for k in range(len(problem.steps)):
        if k:
            system.enter(k)
            run.speed = np.empty_like(run.position)
            system.velocity(system.inner.motion.begin, run.position, run.speed)
            if isinstance(session, cvode_solver.Krylov):
                session._reference[:] = np.inf  # J is taken anew
            if run.share != share or ceiling > 0.0:
                run.share, session = share, None
        run.length, ceiling = system.motion.end - system.begin, 0.0
        while run.elapsed < run.length:
            try:
                if session is None:
                    run.offset = run.elapsed
                    session, mild = opened(method, run, ceiling, mild)
                    system.solvers += 1
                if run._advance(session, ceiling):
                    session, ceiling = None, 4.0 * ceiling if 4.0 * ceiling < run.length else 0.0
            except Restart:
                session, mild = None, False
            except _Refused as refusal:
                system.work.rejections += 1
                session, mild, ceiling = None, False, 0.25 * (refusal.dt or run.left)
            if run.problem:
                raise SystemExit(run.problem)
    system.end = system.inner.at_end(system.positions(run.position))
    return system


def opened(method, run, ceiling, mild):
    """Return a session at the last accepted state, and whether it is a mild one."""
    if mild:
        session = cvode_solver.UnpreconditionedCvode(method, run)
        if not session.begins_slowly():
            return session, True
        session.close()
    return cvode_solver.Krylov(method, run, ceiling), False


class FirstStep:
    """CVODE that begins with a given part of a coupling step, and with the full method."""

    def __init__(self, part: float) -> None:
        self.part = part

    def integrate(self, system, position) -> Outcome:
        """Integrate over the coupling step."""
        method = Cvode(light=False)
        run = IntegrationProgress(method, system, position, part=method.part)
        made = cvode_solver.CVODE

        def start(run, ceiling):
            first = self.part * run.length if run.steps == 0 else 0.0
            cvode_solver.CVODE = partial(made, first_step=first)
            try:
                return cvode_solver.Krylov(method, run, ceiling)
            finally:
                cvode_solver.CVODE = made

        return run.integrate(start)


def efforts(problem: ReplayProblem, starts: list[np.ndarray], part: float) -> list[float]:
    """Return the effort of each step with a first step, from where the recorded run was."""
    found = []
    for step, start in zip(problem.steps, starts, strict=True):
        system = problem.system()
        system.begin(step.motion)
        outcome = FirstStep(part).integrate(system, start)
        if not outcome.done:
            raise SystemExit(outcome.problem)
        found.append(system.work.effort)
    return found


def row(state: str, problem: ReplayProblem) -> str:
    """Return the line of a state in the table."""
    events = [step.before for step in problem.steps[1:]]
    born = [0 if e is None else np.count_nonzero(e.offset.any(axis=1)) / 2 for e in events]
    plain, through = replay(problem, Cvode()), run_through(problem, Cvode())
    apart = np.median(np.linalg.norm(through.end - plain.positions[-1], axis=1))
    reached = [problem.start, *plain.positions]
    starts = [problem.beginning(k, reached[k]) for k in range(len(problem.steps))]
    ladder = np.array([efforts(problem, starts, part) for part in FIRST])
    own = ladder[0].sum()
    return (
        f"| {state} | {problem.counts[0]}, {np.mean(born):.0f} | {plain.work.effort}, "
        f"{plain.work.steps} | {through.work.effort / plain.work.effort:.2f}, "
        f"{through.work.steps / plain.work.steps:.2f} | "
        + ", ".join(f"{x / own:.2f}" for x in ladder[1:].sum(axis=1))
        + f" | {ladder.min(axis=0).sum() / own:.2f} | {through.solvers}, {apart:.1g} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--states", nargs="+", default=list(STATES), choices=list(STATES))
    parser.add_argument("--cells", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=4)
    options = parser.parse_args()
    ladder = ", ".join(f"{part:g}" for part in FIRST[1:])
    print(
        "| state | cells, divisions a step | passes, steps | (a) passes, steps | (b) first step "
        f"{ladder} | (b) best in each step | solvers of (a), apart / µm |\n{'|---' * 7}|"
    )
    known: dict[str, mc.Cells] = {}
    for state in options.states:
        print(row(state, recorded(state, options.cells, options.steps, known)), flush=True)


if __name__ == "__main__":
    main()
