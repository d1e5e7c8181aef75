"""Integration methods that were tried and are not in the package, compared with those that are.

Problem   coupling steps of growing tissue (tile_problems.py) with 350 cells, and the first
          step of the built-in scene stiff-inclusions with 1,000
Error     root mean square over the cells of the distance from the reference, over that of the
          motion that the best dilation leaves; goals of 10 % and 1 %
Question  the cost of reaching a goal, in passes over all cells (Work.effort, in evaluations) and
          in CPU time. Methods of the package are compiled, those that were tried are not.
Methods   ROCK4, proximal BDF2, IMEX (stiff pairs implicit), multirate RKC (mRKC)
Cost      printed at the end: about four minutes of CPU, one thread
Command   python docs/programs/tried.py     (--goals, --cells, --methods, --cache)

Tolerances and steps are tried from coarse to fine; the cheapest solve that reaches a goal counts.
For IMEX and mRKC the best of three definitions of "stiff" counts, and a pass over the cells with
stiff pairs costs their share of a pass.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rock4 import DEGREES, rock4, rock4_length
from tile_problems import Tile, solved

import multicell as mc
from multicell.cells import FloatArray
from multicell.comparison.ladders import find_method
from multicell.comparison.null_methods import MotionScale
from multicell.comparison.replay import ReplayProblem, Step, replay
from multicell.integrators import backward_euler, driver, rosenbrock_solver, stepping
from multicell.integrators.base import EqualSteps, ErrorControl, Outcome
from multicell.integrators.loops import chebyshev
from multicell.integrators.rosenbrock import Rosenbrock
from multicell.mechanics.motion import StateRejected
from multicell.mechanics.system import Mechanics

STATES = (
    ("typical", 1e2), ("fresh", 1e2), ("typical", 1e3), ("fresh", 1e3), ("fresh", 1e4),
    ("quiet", 1e4),
)  # fmt: skip
TOLERANCES = tuple(10.0 ** (-0.5 * k) for k in range(9))  # µm
STEPS = tuple(0.5**k for k in range(3, 11))  # of the coupling step
STIFF = (0.5, 0.2, 0.05)
"""Stiffness over that of the stiffest pair from which on a pair is called stiff."""
LIMIT, PATIENCE = 1.0, 3  # s of CPU time; solves that may take longer before a method is given up
PACKAGE = ("rkc2", "ab2-adaptive", "rosenbrock", "cvode", "backward-euler")
Stepped = tuple[FloatArray, FloatArray, FloatArray]
Field = Callable[[float, FloatArray], FloatArray]


def velocity_of(source: stepping.Called, elapsed: float, x: FloatArray) -> FloatArray:
    """Return the velocities; not a number where there are none."""
    out = np.empty_like(x)
    if source.velocity(elapsed, x, out) != stepping.DONE:
        out[:] = np.nan
    return out


@dataclass(frozen=True)
class Rock4(ErrorControl):
    """A stabilised method of order four; error control and estimates of λ are those of ``rkc2``."""

    stiff: float = 0.0
    exponent = 4.0

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step."""
        source, length = stepping.Called(system), system.motion.end - system.motion.begin
        radius, counts = system.motion.radius, np.zeros(5, dtype=np.int64)
        control = driver.control(self, system, self.exponent, lower=0)
        x, work, vector = (
            np.array(position),
            np.empty((2, *position.shape)),
            np.empty_like(position),
        )
        field = partial(velocity_of, source)
        slope = field(0.0, x)
        walk = stepping.control_state(
            stepping.starting_step(source, None, control, x, slope, *work, length, radius)[0]
        )
        chebyshev._scramble(vector)
        error, products, age, rate, part = slope, 10, 0, 0.0, None
        while walk[stepping.ELAPSED] < length:
            elapsed = walk[stepping.ELAPSED]
            if products:
                part, age = self.split(system, elapsed, x), 0
                chebyshev._mix(radius, vector, error)
                rate = 1.1 * chebyshev.spectral_radius(
                    source, None, elapsed, x, slope, radius, vector, products
                )[0]  # fmt: skip
            longest = rock4_length(DEGREES[-1]) / max(rate, 1e-300)
            step = stepping.fit_step(min(walk[stepping.DT], longest), length - elapsed)
            walk[stepping.DT] = step
            if stepping.stop_reason(walk, counts, control, length) != stepping.DONE:
                return Outcome(system.motion.begin + elapsed, x, "steps became too short")
            trial, end, error = self.step(field, elapsed, x, slope, step, rate, part)
            moved = stepping.furthest_move(x, trial, radius)[1]
            good = not stepping.refuse_step(walk, counts, control, stepping.DONE, moved)
            if good and stepping.accept_step(
                walk, counts, control, length, x, trial, error, 0.2, 5.0, False
            ):
                slope, age = end, age + 1
                products = 3 if age == 10 else 0
            else:
                error, products = slope, 10 if age else 0
        return Outcome(system.motion.end, x)

    def split(self, system: Mechanics, elapsed: float, x: FloatArray) -> Any:
        """Return parts that the following steps need besides λ."""

    def step(
        self,
        field: Field,
        t: float,
        x: FloatArray,
        slope: FloatArray,
        h: float,
        rate: float,
        _: Any,
    ) -> Stepped:
        """Return the end of a step, the slope there and the estimated error."""
        stages = next(s for s in DEGREES if rock4_length(s) >= h * rate * (1.0 - 1e-12))
        table, times, a, b, weights = rock4(stages)
        before = now = x
        for k, (mu, nu, kappa) in enumerate(table):
            f = field(t + times[k] * h, now) if k else slope
            before, now = now, mu * h * f + nu * now + kappa * before
        slopes = np.empty((5, *x.shape))
        for i in range(4):
            inner = now + h * np.tensordot(a[i, :i], slopes[:i], 1)
            slopes[i] = field(t + (times[-1] + a[i].sum()) * h, inner)
        trial = now + h * np.tensordot(b, slopes[:4], 1)
        slopes[4] = field(t + h, trial)
        return trial, slopes[4].copy(), h * np.tensordot(weights, slopes, 1)


def chebyshev_step(
    field: Field, t: float, x: FloatArray, slope: FloatArray, h: float, stages: int
) -> FloatArray:
    """Return the end of a step of the damped Chebyshev method of order one."""
    w0 = 1.0 + 0.05 / stages**2
    polynomial = np.polynomial.chebyshev.Chebyshev.basis(stages)
    w1 = polynomial(w0) / polynomial.deriv()(w0)
    sizes = [1.0, w0]
    before, now, past, at = x, x + w1 / w0 * h * slope, 0.0, w1 / w0
    for _ in range(1, stages):
        sizes = [sizes[1], 2.0 * w0 * sizes[1] - sizes[0]]
        mu, nu = 2.0 * w1 * sizes[0] / sizes[1], 2.0 * w0 * sizes[0] / sizes[1]
        f = field(t + at * h, now)
        before, now = now, mu * h * f + nu * now + (1.0 - nu) * before
        past, at = at, mu + nu * at + (1.0 - nu) * past
    return now


@dataclass(frozen=True)
class Multirate(Rock4):
    """mRKC of order one: the force of stiff cells is an average over a short time of its own.

    Abdulle, Grote & Rosilho de Souza, Math. Comp. 91 (2022)
    """

    exponent = 2.0

    def split(self, system: Mechanics, elapsed: float, x: FloatArray) -> Any:
        """Return the work, which cells are stiff, (n, 1) of 0 and 1, and λ of the others."""
        system.linearise(system.motion.begin + elapsed, x)
        fast = stiff_pairs(system, system.linearisation, self.stiff)[1].astype(float)[:, None]
        vector, slow = np.empty_like(x), 0.0
        chebyshev._scramble(vector)
        for _ in range(30):  # not counted: there may be a cheaper way
            vector *= (1.0 - fast) / max(float(np.linalg.norm(vector * (1.0 - fast))), 1e-300)
            system.jacobian_product(vector.copy(), vector)
            slow = float(np.linalg.norm(vector * (1.0 - fast)))
        system.work.jacobian_products -= 30
        return system.work, fast, 1.1 * slow

    def step(
        self, field: Field, t: float, x: FloatArray, slope: FloatArray, h: float, rate: float,
        part: Any,
    ) -> Stepped:  # fmt: skip
        """Return the end of a step, the slope there and the estimated error."""
        work, fast, slow_rate = part
        beta, inner, short, spent = 2.0 - 4.0 / 3.0 * 0.05, 1, 0.0, 0.0
        stages = max(1, math.ceil(math.sqrt(h * slow_rate / beta)))
        while inner == 1 or short * rate > beta * inner**2:
            inner += 1
            short = 6.0 * h / (beta * stages**2) * inner**2 / (inner**2 - 1)

        def averaged(at: float, y: FloatArray) -> FloatArray:
            whole = field(at, y)

            def split(now: float, u: FloatArray) -> FloatArray:
                nonlocal spent
                work.evaluations -= 1
                spent += float(fast.mean())
                return fast * field(now, u) + (1.0 - fast) * whole

            return (chebyshev_step(split, at, y, whole, short, inner) - y) / short

        trial = chebyshev_step(averaged, t, x, averaged(t, x), h, stages)
        work.evaluations += round(spent)
        end = field(t + h, trial)
        return trial, end, 0.5 * h * (end - slope)


def stiff_pairs(system: Mechanics, linear: Any, share: float) -> tuple[FloatArray, FloatArray]:
    """Return which places of the list hold stiff pairs, and which cells have one."""
    pairs, stiffness = linear.pairs, linear.along - linear.across
    used = np.zeros(len(stiffness), dtype=bool)
    for start, end in zip(pairs.start, pairs.outer_end, strict=True):
        used[start:end] = True
    stiff = used & (stiffness > share * stiffness[used].max(initial=0.0))
    cells = np.zeros(len(system), dtype=bool)
    cells[pairs.first[stiff]] = cells[pairs.second[stiff]] = True
    return stiff, cells


@dataclass(frozen=True)
class Imex(Rosenbrock):
    """``rosenbrock``, of order two with any matrix, with a matrix of the stiff pairs alone."""

    stiff: float = 0.0

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step."""
        walk = rosenbrock_solver.Walk(self, system, np.array(position))
        resolvent, shares, whole = walk._resolvent, [], walk._resolvent.linearise

        def linearise(at: float, x: FloatArray) -> None:
            whole(at, x)
            stiff, cells = stiff_pairs(system, resolvent.linear, self.stiff)
            along, across = resolvent.linear.along * stiff, resolvent.linear.across * stiff
            resolvent.linear = replace(resolvent.linear, along=along, across=across)
            shares.append(cells.mean())

        resolvent.linearise = linearise  # type: ignore[method-assign]
        outcome, work = walk.integrate(), system.work
        for name in ("jacobian_products", "preconditioner_setups", "preconditioner_solves"):
            setattr(work, name, round(float(np.mean(shares)) * getattr(work, name)))
        return outcome


@dataclass(frozen=True)
class Bdf2(EqualSteps):
    """BDF2 with equal steps: minima of ½ |x - (4 x_n - x_(n-1)) / 3|² 3 / (2 Δt) + U(x).

    Minima are found as in ``backward-euler``, whose extrapolated steps begin.
    """

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step."""
        begin, h, euler = system.motion.begin, self.step, backward_euler.BackwardEuler(self.step)

        def minimum(base: FloatArray, guess: FloatArray, end: float, step: float) -> FloatArray:
            implicit = backward_euler._Step(euler, system, base, end, step)
            implicit.trial = guess.copy()
            problem = implicit.solve()
            if problem:
                raise StateRejected(problem)
            return implicit.trial

        try:
            half = minimum(position, position, begin + 0.5 * h, 0.5 * h)
            half = minimum(half, half, begin + h, 0.5 * h)
            last, now = position, 2.0 * half - minimum(position, half, begin + h, h)
            for k in range(2, round((system.motion.end - begin) / h) + 1):
                base = (4.0 * now - last) / 3.0
                last, now = now, minimum(base, now, begin + k * h, 2.0 / 3.0 * h)
        except StateRejected as error:
            return Outcome(begin, position, str(error))
        return Outcome(system.motion.end, now)


TRIED: dict[str, Callable[[], list[Any]]] = {
    "rock4": lambda: [partial(Rock4, 1e-6)],
    "bdf2": lambda: [Bdf2],
    "imex": lambda: [partial(Imex, 1e-6, stiff=stiff) for stiff in STIFF],
    "mrkc": lambda: [partial(Multirate, 1e-6, stiff=stiff) for stiff in STIFF],
}


def cases(cells: int, folder: Path | None) -> Iterator[tuple[str, ReplayProblem, FloatArray]]:
    """Yield coupling steps: what each is, and where it ends."""
    for state, z in STATES:
        step = solved(Tile(state, cells, z, 1), folder)
        yield f"{state}, λΔt 10^{math.log10(z):.0f}", step.problem, step.end
    simulation = mc.Simulation(mc.load_scene("stiff-inclusions"), threads=1)
    template, start = simulation.prepared(), np.array(simulation.cells.position)
    problem = ReplayProblem(
        simulation.scene, template, start, simulation.cells.radius, [Step(template.motion)],
        [start], 1,
    )  # fmt: skip
    exact = replay(problem, find_method("rkc2", problem.scene, problem.mean_radius).make(1e-7))
    yield "stiff-inclusions", problem, exact.positions[0]


def cheapest(name: str, problem: ReplayProblem, end: FloatArray, goals: list[float]) -> list[str]:
    """Return for each goal effort and CPU time of the cheapest solve that reaches it."""
    radius, motion = problem.mean_radius, problem.steps[0].motion
    settings, variants = TOLERANCES, TRIED.get(name, list)()
    scale, best = MotionScale.of(problem.start, end, radius), dict.fromkeys(goals, (math.inf, 0.0))
    if name in PACKAGE:
        method = find_method(name, problem.scene, radius)
        unit = radius if method.control == "tolerance" else 1.0
        variants = [lambda setting: method.make(setting / unit)]
    if name in ("backward-euler", "bdf2"):
        settings = tuple(part * (motion.end - motion.begin) for part in STEPS)
    elif name not in PACKAGE:
        variants = [partial(lambda kind, atol: kind(atol=atol), kind) for kind in variants]
    for make in variants:
        slow = 0
        for setting in settings:
            found = replay(problem, make(setting), limit=30.0)
            slow += found.cpu > LIMIT
            error = scale.errors(found.positions[0], end)[0] if found.done else math.inf
            for goal in (goal for goal in goals if error <= goal):
                best[goal] = min(best[goal], (float(found.work.effort), found.cpu))
            if error <= min(goals) or slow == PATIENCE:
                break
    return [f"{n:.0f} ({1e3 * s:.0f} ms)" if n < math.inf else "–" for n, s in best.values()]


def main() -> None:
    """Solve, and print a row for each coupling step and goal."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--goals", type=float, nargs="+", default=[0.1, 0.01])
    parser.add_argument("--cells", type=int, default=350)
    parser.add_argument("--methods", nargs="+", default=[*PACKAGE, *TRIED])
    parser.add_argument("--cache", type=Path, help="folder of recorded states and references")
    given = parser.parse_args()
    [rock4(degree) for degree in DEGREES]  # five seconds, which belong to no solve
    print("| coupling step | goal | " + " | ".join(given.methods) + " |")
    print("|---" * (2 + len(given.methods)) + "|", flush=True)
    for name, problem, end in cases(given.cells, given.cache):
        columns = [cheapest(method, problem, end, given.goals) for method in given.methods]
        for goal, row in zip(given.goals, zip(*columns, strict=True), strict=True):
            print(f"| {name} | {100 * goal:g} % | " + " | ".join(row) + " |", flush=True)
    print(f"{time.process_time():.0f} s of CPU")


if __name__ == "__main__":
    main()
