"""Local time stepping: short steps for the cells that move, long ones for the others.

Problem   coupling steps of ten minutes of growing clusters (tile_problems.py): quiet, typical
          and fresh tissue at a λΔt of 31 (5 kPa s) and 310
Question  how many evaluations would it save
Methods   ``all alike``: RKC2 under error control, the same step for all cells. ``two rates``: the
          same, but cells with large errors take RKC2 steps of their own first, while the others
          move along straight lines; then the others take the long step, in which the fast cells
          follow a cubic through their own states. Those cells are fast for which that costs least
          over the length of step. The order of such steps is measured by regression
Bound     ``ideal``: every cell takes the longest steps, halved from the coupling step, whose own
          error stays below a bound while all its neighbours move exactly as they should. Beside
          it ``alike``: such steps for all cells with the same 99th percentile of summed errors
Counted   evaluations of all cells; one of some cells counts as the share of pairs that it needs
Cost      a minute of CPU for 1,000 cells, most of it for the bound (--no-bound leaves it out)
Command   python docs/programs/local_stepping.py     (--cells 10000)
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from tile_problems import STATES, Tile, solved
from tile_tables import markdown

import multicell as mc
from multicell.integrators.loops.chebyshev import coefficients, stages_for
from multicell.mechanics.decay_rate import largest_decay_rate
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Velocity = Callable[[float, Array], Array]
SHARES = (0.0, 0.003, 0.01, 0.02, 0.04, 0.08, 0.16)
"""Parts of the cells that may be fast."""
TOLERANCE = 0.1  # µm
BOUNDS = (0.1, 0.03)  # µm, of the error of a step of one cell
MOST = 500  # stages


def cubic(
    share: float, step: float, ends: tuple[Array, Array], slopes: tuple[Array, Array]
) -> Array:
    """Return Hermite's cubic between two states at a share of the step."""
    s, r = share, 1.0 - share
    return (
        r * r * (1.0 + 2.0 * s) * ends[0] + s * s * (3.0 - 2.0 * s) * ends[1]
        + step * s * r * (r * slopes[0] - s * slopes[1])
    )  # fmt: skip


@dataclass
class Course:
    """States and velocities of some cells at increasing times, with cubics between."""

    times: list[float]
    states: list[Array]
    slopes: list[Array]

    def at(self, time: float) -> Array:
        """Return the states at a time."""
        k = int(np.searchsorted(self.times, time, side="right")) - 1
        k = min(max(k, 0), len(self.times) - 2)
        step = self.times[k + 1] - self.times[k]
        share = (time - self.times[k]) / step
        ends, slopes = self.states[k : k + 2], self.slopes[k : k + 2]
        return cubic(share, step, (ends[0], ends[1]), (slopes[0], slopes[1]))


def rkc_step(
    velocity: Velocity, time: float, x: Array, slope: Array, step: float, stages: int,
    known: tuple[Mask, Course] | None = None,
) -> Array:  # fmt: skip
    """Return the end of a step of RKC2; ``known`` cells follow their course in every stage."""
    table = coefficients(stages)

    def placed(state: Array, share: float) -> Array:
        if known is not None:
            state[known[0]] = known[1].at(time + share * step)
        return state

    far, near = x.copy(), placed(x + step * table[1, 2] * slope, table[1, 4])
    for j in range(2, stages + 1):
        mu, nu, mt, gt, share = table[j]
        here = velocity(time + table[j - 1, 4] * step, near)
        new = x + mu * (near - x) + nu * (far - x) + step * (mt * here + gt * slope)
        far, near = near, placed(new, share)
    return near


def error_of(x: Array, y: Array, step: float, before: Array, after: Array) -> Array:
    """Return the estimated error of a step of RKC2."""
    return 0.8 * (x - y) + 0.4 * step * (before + after)


class Equations:
    """The equations of motion of a coupling step; times count from its beginning."""

    def __init__(self, system: Mechanics, motion: Motion, start: Array) -> None:
        self.system, self.motion, self.start = system, motion, start
        system.begin(motion)
        self.length = self.motion.end - self.motion.begin
        self.rate = 1.1 * largest_decay_rate(self.system, self.motion.begin, self.start)
        self.radius = self.motion.radius
        reach = 2.25 * float(self.motion.end_radius.max())
        pairs = cKDTree(self.start).query_pairs(reach, output_type="ndarray")
        apart = np.linalg.norm(self.start[pairs[:, 0]] - self.start[pairs[:, 1]], axis=1)
        self.pairs = pairs[apart < 1.15 * self.motion.end_radius[pairs].sum(axis=1)]

    def velocity(self, time: float, x: Array) -> Array:
        """Return dx/dt of all cells, (n, 3) µm/s."""
        out = np.empty_like(x)
        self.system.velocity(self.motion.begin + time, x, out)
        return out

    def stages(self, step: float) -> int:
        """Return how many stages a step needs."""
        return max(2, int(stages_for(step, self.rate, MOST)))

    def share(self, some: Mask) -> float:
        """Return the share of the pairs that some cells need."""
        return float(some[self.pairs].any(axis=1).mean())

    @cached_property
    def _directed(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        return (
            np.concatenate([self.pairs[:, 0], self.pairs[:, 1]]),
            np.concatenate([self.pairs[:, 1], self.pairs[:, 0]]),
        )

    def among(self, time: float, x: Array, others: Array) -> Array:
        """Return the velocity of each cell at ``x`` when all its neighbours are at ``others``.

        Approximate JKR (eq. 3.6) written out once more, since the kernels hold one state only.
        """
        motion, (i, j) = self.motion, self._directed
        radius = motion.radius + (motion.end_radius - motion.radius) * time / self.length
        soft = 0.75 * (1.0 - motion.poisson**2) / motion.young
        apart = others[j] - x[i]
        distance = np.sqrt((apart**2).sum(axis=1))
        total, modulus = radius[i] + radius[j], 1.0 / (soft[i] + soft[j])
        effective = radius[i] * radius[j] / total
        overlap = np.maximum(total - distance, 0.0)
        force = modulus * np.sqrt(effective) * overlap**1.5
        force -= self.system.law.adhesion * np.sqrt(modulus) * (effective * overlap) ** 0.75
        sums = [np.bincount(i, -force * apart[:, a] / distance, minlength=len(x)) for a in range(3)]
        return np.stack(sums, axis=1) / (self.system.drag * radius)[:, None]


@dataclass
class Run:
    """Cost and result of a solve: evaluations of all, of some cells; steps; end, µm."""

    whole: float = 0.0
    some: float = 0.0
    steps: int = 0
    end: Array = field(default_factory=lambda: np.empty((0, 3)))


def substeps(
    of: Equations, run: Run, time: float, x: Array, slope: Array, step: float, fast: Mask,
    first: float, goal: float,
) -> Course:  # fmt: skip
    """Return the course of the fast cells over a step, the others on straight lines."""
    share, begin = of.share(fast), time

    def velocity(now: float, mine: Array) -> Array:
        state = x + (now - begin) * slope
        state[fast] = mine
        return of.velocity(now, state)[fast]

    course = Course([time], [x[fast]], [slope[fast]])
    trial = min(first, step)
    while course.times[-1] < begin + step * (1.0 - 1e-12):
        now, mine, before = course.times[-1], course.states[-1], course.slopes[-1]
        trial = min(trial, begin + step - now)
        stages = of.stages(trial)
        end = rkc_step(velocity, now, mine, before, trial, stages)
        after = velocity(now + trial, end)
        run.some += stages * share
        error = error_of(mine, end, trial, before, after)
        size = math.sqrt(float((error**2).sum()) / (3 * len(x))) / (0.5 * goal)
        if size <= 1.0:
            course.times.append(now + trial)
            course.states.append(end)
            course.slopes.append(after)
        trial *= min(5.0, max(0.2, 0.9 * max(size, 1e-9) ** (-1.0 / 3.0)))
    return course


def grouping(
    of: Equations, squares: Array, step: float, goal: float, left: float
) -> tuple[Mask, float, float]:
    """Return the fast cells, the next step and their first one: those that cost least."""
    n, order = len(squares), np.argsort(-squares)
    sums, best = np.cumsum(squares[order]), (math.inf, np.zeros(len(squares), bool), step, step)
    for part in SHARES:
        count = int(part * n)
        fast = np.zeros(n, bool)
        fast[order[:count]] = True
        taken = float(sums[count - 1]) if count else 0.0
        size = math.sqrt(max(float(sums[-1]) - taken, 0.0) / (3 * n)) / goal
        longest = min(step * min(5.0, max(0.1, 0.9 * max(size, 1e-9) ** (-1.0 / 3.0))), left)
        cost, short = float(of.stages(longest)), longest
        if count:
            worst = math.sqrt(taken / (3 * n)) / (0.5 * goal) * (longest / step) ** 3
            short = longest / max(1.0, worst ** (1.0 / 3.0))
            cost += of.share(fast) * of.stages(short) * longest / short
        if cost / longest < 0.9 * best[0]:
            best = (cost / longest, fast, longest, short)
    return best[1:]


def solve(of: Equations, *, two_rates: bool) -> Run:
    """Solve the coupling step under error control at the tolerance."""
    run, n = Run(), len(of.start)
    goal = TOLERANCE * math.sqrt(TOLERANCE / float(of.radius.mean()))
    time, x, step = 0.0, of.start.copy(), min(of.length, 1.5 / of.rate)
    fast, short, slope = np.zeros(n, bool), step, of.velocity(0.0, x)
    while time < of.length * (1.0 - 1e-12):
        left = of.length - time
        step = left if step >= left else min(step, 0.5 * left)
        known = None
        if fast.any():
            course = substeps(of, run, time, x, slope, step, fast, short, goal)
            known = (fast, course)
        stages = of.stages(step)
        y = rkc_step(of.velocity, time, x, slope, step, stages, known)
        after = of.velocity(time + step, y)
        run.whole += stages
        error = error_of(x, y, step, slope, after)
        squares = (error**2).sum(axis=1)
        if known is not None:
            # what straight lines in place of the neighbours' motion have done
            error[fast] = step / 3.0 * (after[fast] - course.slopes[-1])
        size = math.sqrt(float((error**2).sum()) / (3 * n)) / goal
        moved = float(np.linalg.norm(y - x, axis=1).max()) / float(of.radius.mean())
        good = size <= 1.0 and moved <= 0.5
        factor = min(5.0, max(0.2, 0.9 * max(size, 1e-9) ** (-1.0 / 3.0)))
        following = fast, step * factor, step * factor
        if two_rates:
            following = grouping(
                of, squares, step, goal, max(left - step, 0.1 * step) if good else left
            )
        if good:
            time, x, slope, run.steps = time + step, y, after, run.steps + 1
            fast, step, short = following
        else:
            same = following[0].sum() <= fast.sum()
            shorter = 0.5 if moved > 0.5 else 0.9 if same else 1.0
            fast, step, short = following[0], min(following[1], shorter * step), following[2]
    run.end = x
    return run


def bound(of: Equations, tolerance: float) -> tuple[float, float]:
    """Return evaluations a cell with ideal local steps, and with steps that are alike for all."""
    finest = 2 ** math.ceil(math.log2(8.0 * of.rate * of.length))
    fine = of.length / finest
    course = Course([0.0], [of.start], [of.velocity(0.0, of.start)])
    for k in range(finest):
        x = rkc_step(of.velocity, k * fine, course.states[-1], course.slopes[-1], fine, 3)
        course.times.append((k + 1) * fine)
        course.states.append(x)
        course.slopes.append(of.velocity((k + 1) * fine, x))
    levels = int(math.log2(finest)) - 1
    errors: dict[tuple[int, int], Array] = {}

    def error(level: int, place: int) -> Array:
        if (level, place) not in errors:
            step = of.length / 2**level
            begin = place * step
            x = course.at(begin)
            y = rkc_step(
                lambda now, mine: of.among(now, mine, course.at(now)), begin, x,
                of.among(begin, x, x), step, of.stages(step),
            )  # fmt: skip
            errors[level, place] = np.linalg.norm(y - course.at(begin + step), axis=1)
        return errors[level, place]

    n = len(of.start)
    cost, total = np.zeros(n), np.zeros(n)

    def each(level: int, place: int, cells: NDArray[np.int64]) -> None:
        own = error(level, place)[cells]
        good = own <= tolerance if level < levels else np.ones(len(cells), bool)
        cost[cells[good]] += of.stages(of.length / 2**level)
        total[cells[good]] += own[good]
        for half in range(2) if not good.all() else ():
            each(level + 1, 2 * place + half, cells[~good])

    each(0, 0, np.arange(n))
    aim = float(np.quantile(total, 0.99))

    def alike(level: int, place: int, allowed: float) -> tuple[float, Array]:
        own = error(level, place)
        if level == levels or float(np.quantile(own, 0.99)) <= allowed:
            return of.stages(of.length / 2**level), own
        one, two = (alike(level + 1, 2 * place + half, allowed) for half in range(2))
        return one[0] + two[0], one[1] + two[1]

    tried = [alike(0, 0, allowed) for allowed in np.geomspace(2.0 * aim, 0.01 * aim, 25)]
    fits = [one[0] for one in tried if float(np.quantile(one[1], 0.99)) <= aim]
    return float(cost.mean()), min(fits, default=math.nan)


def order() -> float:
    """Return the order of steps with two rates, every second cell fast.

    By regression of errors over the length of step, on a compressed ball that expands with the
    forces of a smooth law, so that no contact forms or breaks.
    """
    scene = mc.load_scene("settle").with_changes({
        "contact": {"law": "cubic"}, "drag.viscosity": "50 kPa s", "initial.spacing": 0.9,
    })  # fmt: skip
    simulation = mc.Simulation(scene, threads=1)
    system = simulation.prepared()
    of = Equations(system, system.motion, np.array(simulation.cells.position))
    fast = np.arange(len(of.start)) % 2 == 0

    def reached(steps: int, *, local: bool) -> Array:
        x, step = of.start, of.length / steps
        for k in range(steps):
            time = k * step
            slope, known = of.velocity(time, x), None
            if local:
                course = substeps(of, Run(), time, x, slope, step, fast, 0.25 * step, math.inf)
                known = (fast, course)
            x = rkc_step(of.velocity, time, x, slope, step, of.stages(step), known)
        return x

    exact, steps = reached(256, local=False), np.array([4, 8, 16, 32])
    errors = [float(np.sqrt(((reached(k, local=True) - exact) ** 2).mean())) for k in steps]
    return -float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--cells", type=int, default=1000)
    parser.add_argument("--stiffness", type=float, nargs="+", default=[31.0, 310.0])
    parser.add_argument("--no-bound", action="store_true", help="leave the bound out")
    chosen = parser.parse_args()
    print(f"order of steps with two rates: {order():.2f}")
    rows = []
    for state, stiffness in product(STATES, chosen.stiffness):
        step = solved(Tile(state, chosen.cells, stiffness, 1))
        motion = step.problem.steps[0].motion
        of = Equations(step.problem.system(), motion, np.array(step.problem.start))
        row = [state, f"{stiffness:g}"]
        for two_rates in (False, True):
            run = solve(of, two_rates=two_rates)
            away = np.linalg.norm(run.end - step.end, axis=1)
            error = f"{math.sqrt((away**2).mean()):.2g}, {away.max():.2g}"
            row.append(f"{run.whole + run.some:.0f}; {error}")
        for tolerance in () if chosen.no_bound else BOUNDS:
            row.append("{:.1f}, {:.0f}".format(*bound(of, tolerance)))
        rows.append(row)
    head = ["state", "λΔt", "all alike: evaluations; rms, worst / µm", "two rates: the same"]
    head += [] if chosen.no_bound else [f"ideal, alike at {tolerance} µm" for tolerance in BOUNDS]
    print(markdown(head, rows))


if __name__ == "__main__":
    main()
