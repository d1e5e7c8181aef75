"""Integration methods that were tried and are not in the package, compared with those that are.

Problem   coupling steps of growing tissue (docs/tile_problems.py) with 350 cells, and the first
          step of the built-in scene stiff-inclusions with 1,000
Error     root mean square over the cells of the distance from the reference, over that of the
          motion that the best dilation leaves; goals of 10 % and 1 %
Question  at what cost a method reaches a goal, over the cost of the best method of the package.
          Cost is the number of passes over all cells, in evaluations (Work.effort)
Methods   ROCK4, proximal BDF2, IMEX (stiff pairs implicit), multirate RKC; ARKODE's RKC and RKL
          where sundials4py is installed (Python 3.12 or later)
Cost      printed at the end: about three minutes of CPU, one thread
Command   python docs/tried.py     (--goal 0.1 0.01, --cells, --methods)

All tolerances and steps of a ladder are tried from coarse to fine, for multirate and IMEX also
three definitions of what is stiff; the cheapest solve that reaches the goal counts. For multirate
and IMEX the cost assumes that passes over a part of the cells cost that part of a pass.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from tile_problems import Tile, solved

import multicell as mc
from multicell.cells import FloatArray
from multicell.comparison.ladders import find_method
from multicell.comparison.null_methods import MotionScale
from multicell.comparison.replay import Problem, Step, replay
from multicell.integrators import backward_euler, driver, rosenbrock_solver, stepping
from multicell.integrators.base import EqualSteps, ErrorControl, Outcome
from multicell.integrators.loops import chebyshev
from multicell.integrators.rosenbrock import Rosenbrock
from multicell.mechanics.motion import StateRejected
from multicell.mechanics.system import Mechanics

TOLERANCES = tuple(10.0 ** (-0.5 * k) for k in range(-1, 9))  # µm
STIFF = (0.5, 0.2, 0.05)
"""Stiffness over that of the stiffest pair from which on a pair is called stiff."""
PACKAGE = ("rkc2", "ab2-adaptive", "rosenbrock", "cvode", "backward-euler")

# ROCK4: Abdulle, SIAM J. Sci. Comput. 23 (2002) 2042, https://doi.org/10.1137/S1064827500379549.
# Its tables are not used: polynomials and weights are derived here from the conditions of order.

_NEAR = 0.05  # -z from which on the polynomial oscillates
_TREES = np.array([1, 1, 2, 3, 6, 4, 8, 12, 24.0])
"""Density of the empty tree and of the eight rooted trees of up to four vertices: •, [•], [••],
[[•]], [•••], [•[•]], [[••]], [[[•]]]."""


def slope_series(a: FloatArray) -> FloatArray:
    """Return the B-series of h f(y) for that of y: one number for each tree."""
    return np.array(
        [0, 1, a[1], a[1] ** 2, a[2], a[1] ** 3, a[1] * a[2], a[3], a[4]]
    )  # fmt: skip


def recurrence(roots: FloatArray, stages: int, length: float) -> FloatArray:
    """Return (s - 4, 3): h f(y_j), y_j and y_(j-1) in y_(j+1).

    The polynomials are orthogonal on [-length, -_NEAR] with the weight |w|² of the four complex
    zeros, over the square root of Chebyshev's weight, and 1 at zero.
    """
    half, zero = (length - _NEAR) / 2.0, (length + _NEAR) / (length - _NEAR)
    x = np.cos(np.pi * (np.arange(4 * stages) + 0.5) / (4 * stages))
    z = half * (x - zero)
    weight = np.prod([np.abs(1 - z / complex(*pair)) ** 4 for pair in roots.reshape(2, 2)], axis=0)
    weight /= weight.max()
    before, now, last, table = np.zeros_like(x), np.ones_like(x), 1.0, []
    for _ in range(stages - 4):
        square = float((weight * now * now).sum())
        a, c = (weight * x * now * now).sum() / square, (weight * x * now * before).sum() / last
        r = 1.0 / (zero - a - c)
        before, now, last = now, r * ((x - a) * now - c * before), square
        table.append((r / half, r * (zero - a), -r * c))
    return np.array(table)


def series_of(table: FloatArray) -> list[FloatArray]:
    """Return the B-series of all stages of a recurrence."""
    start = np.eye(1, 9)[0]
    stages = [start, start]
    for mu, nu, kappa in table:
        stages.append(mu * slope_series(stages[-1]) + nu * stages[-1] + kappa * stages[-2])
    return stages[1:]


def rock4_length(stages: int) -> float:
    """Return a stable length; the longest is that within two per cent."""
    return 0.35 * stages**2 - 2.95


@cache
def rock4(stages: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return recurrence, times of its stages, A and b of the last four, weights of the error."""
    length = rock4_length(stages)

    def tall(roots: FloatArray) -> FloatArray:
        """Return how far R is from exp(z): R = w P must agree up to z⁴."""
        p = series_of(recurrence(roots, stages, length))[-1][[0, 1, 2, 4, 8]]
        for pair in roots.reshape(2, 2):
            size = pair @ pair
            p = np.convolve(p, [1.0, -2.0 * pair[0] / size, 1.0 / size])[:5]
        return p[1:] * [1, 2, 6, 24] - 1.0

    exact = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    table = recurrence(least_squares(tall, [-2.4, 1.3, -0.27, 3.4], **exact).x, stages, length)
    series = series_of(table)

    def last_stages(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        a, slopes = tableau(x)[0], []
        for i in range(4):
            inner = sum((a[i, j] * slopes[j] for j in range(i)), series[-1])
            slopes.append(slope_series(inner))
        end = sum((x[6 + i] * slopes[i] for i in range(4)), series[-1])
        return end, np.array([*slopes, slope_series(end)])

    # ten numbers for eight conditions: the nearest to the classical method over what is left
    guess = (1.0 - series[-1][1]) * np.array([0.5, 0, 0.5, 0, 0, 1, 1 / 6, 1 / 3, 1 / 3, 1 / 6])
    found = least_squares(lambda x: last_stages(x)[0][1:] * _TREES[1:] - 1.0, guess, **exact).x
    slopes = last_stages(found)[1]
    # the error is the combination of slopes that vanishes up to order three
    null = np.linalg.svd(slopes[:, 1:5].T)[2][-1]
    null /= 24.0 * np.abs(null @ slopes[:, 5:]).max()
    return table, np.array([s[1] for s in series]), *tableau(found), null


def tableau(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return A, (4, 4), and b, (4,), of ten numbers."""
    a = np.zeros((4, 4))
    a[1, 0], a[2, :2], a[3, :3] = x[0], x[1:3], x[3:6]
    return a, x[6:]


Field = Callable[[float, FloatArray], FloatArray]


@dataclass(frozen=True)
class Stabilised(ErrorControl):
    """A stabilised explicit method under error control, with λ as ``rkc2`` finds it; abstract."""

    stiff: float = 0.2
    exponent = 3.0

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step."""
        source, length = stepping.Called(system), system.motion.end - system.motion.begin
        radius, counts = system.motion.radius, np.zeros(4, dtype=np.int64)
        control = driver.control(self, system, self.exponent, lower=0)
        x, work, vector = np.array(position), np.empty((2, *position.shape)), np.empty_like(position)
        field = partial(velocity_of, source)
        slope = field(0.0, x)
        walk = stepping.control_state(
            stepping.starting_step(source, None, control, x, slope, *work, length, radius)[0]
        )
        chebyshev._scramble(vector)
        error, products = slope, 10
        while walk[stepping.ELAPSED] < length:
            elapsed = walk[stepping.ELAPSED]
            if products:
                part = self.split(system, elapsed, x)
                chebyshev._mix(radius, vector, error)
                rate = 1.1 * chebyshev.spectral_radius(
                    source, None, elapsed, x, slope, radius, vector, products
                )[0]  # fmt: skip
                products, age = 0, 0
            longest = rock4_length(150) / max(rate, 1e-300)
            step = stepping.fit_step(min(walk[stepping.STEP], longest), length - elapsed)
            walk[stepping.STEP] = step
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
        """Return what the following steps need besides λ."""


def velocity_of(source: stepping.Called, elapsed: float, x: FloatArray) -> FloatArray:
    """Return the velocities; not a number where there are none."""
    out = np.empty_like(x)
    if source.velocity(elapsed, x, out) != stepping.DONE:
        out[:] = np.nan
    return out


@dataclass(frozen=True)
class Rock4(Stabilised):
    """Order four with four evaluations more than those of the recurrence."""

    exponent = 4.0

    def step(
        self, field: Field, t: float, x: FloatArray, slope: FloatArray, h: float, rate: float, _: Any
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the end of a step, the slope there and the estimated error."""
        stages = next(s for s in DEGREES if rock4_length(s) >= min(h * rate, rock4_length(150)))
        table, times, a, b, weights = rock4(stages)
        before = now = x
        f = slope
        for k, (mu, nu, kappa) in enumerate(table):
            f = field(t + times[k] * h, now) if k else slope
            before, now = now, mu * h * f + nu * now + kappa * before
        slopes: list[FloatArray] = []
        for i in range(4):
            inner = now + h * sum((a[i, j] * slopes[j] for j in range(i)), np.zeros_like(x))
            slopes.append(field(t + (times[-1] + a[i].sum()) * h, inner))
        trial = now + h * sum(b[i] * slopes[i] for i in range(4))
        slopes.append(field(t + h, trial))
        return trial, slopes[-1], h * sum(w * f for w, f in zip(weights, slopes, strict=True))


DEGREES = (*range(5, 20), *range(20, 40, 3), *range(40, 80, 6), *range(80, 140, 12), 150)


# Multirate RKC: Abdulle, Grote & Rosilho de Souza, Math. Comp. 91 (2022) 2681,
# https://doi.org/10.1090/mcom/3753.

_DAMPING = 0.05
_BETA = 2.0 - 4.0 / 3.0 * _DAMPING


def chebyshev_first(
    field: Field, t: float, x: FloatArray, slope: FloatArray, h: float, stages: int
) -> FloatArray:
    """Return the end of a step of the damped method of order one."""
    w0 = 1.0 + _DAMPING / stages**2
    polynomial = np.polynomial.chebyshev.Chebyshev.basis(stages)
    w1 = polynomial(w0) / polynomial.deriv()(w0)
    size = [1.0, w0]
    for _ in range(1, stages):
        size.append(2.0 * w0 * size[-1] - size[-2])
    before, now, past, time_ = x, x + w1 / w0 * h * slope, 0.0, w1 / w0
    for j in range(2, stages + 1):
        mu, nu = 2.0 * w1 * size[j - 1] / size[j], 2.0 * w0 * size[j - 1] / size[j]
        f = field(t + time_ * h, now)
        before, now = now, mu * h * f + nu * now + (1.0 - nu) * before
        past, time_ = time_, mu + nu * time_ + (1.0 - nu) * past
    return now


@dataclass(frozen=True)
class MultirateRkc(Stabilised):
    """Order one: the force of stiff cells is an average over a short time of its own.

    An evaluation of stiff cells alone counts as the part of the cells that they are.
    """

    exponent = 2.0

    def split(self, system: Mechanics, elapsed: float, x: FloatArray) -> Any:
        """Return the work, which cells are stiff, as (n, 1) of 0 and 1, and λ of the others."""
        system.linearise(system.motion.begin + elapsed, x)
        fast = stiff_pairs(system, system.linearisation, self.stiff)[1].astype(float)[:, None]
        # a bound as that of all: not counted, since a cheaper one may exist
        vector, slow = np.ones_like(x), 0.0
        chebyshev._scramble(vector)
        out = np.empty_like(x)
        for _ in range(30):
            vector *= (1.0 - fast) / max(float(np.linalg.norm(vector * (1.0 - fast))), 1e-300)
            system.jacobian_product(vector, out)
            system.work.jacobian_products -= 1
            slow = float(np.linalg.norm(out * (1.0 - fast)))
            vector = out.copy()
        return system.work, fast, 1.1 * slow

    def step(
        self, field: Field, t: float, x: FloatArray, slope: FloatArray, h: float, rate: float,
        part: Any,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
        """Return the end of a step, the slope there and the estimated error."""
        work, fast, slow_rate = part
        share, stages = float(fast.mean()), max(1, math.ceil(math.sqrt(h * slow_rate / _BETA)))
        inner, short = 1, 0.0
        while not inner > 1 or short * rate > _BETA * inner**2:
            inner += 1
            short = 6.0 * h / (_BETA * stages**2) * inner**2 / (inner**2 - 1)
        spent: list[float] = []

        def averaged(time_: float, y: FloatArray) -> FloatArray:
            all_ = field(time_, y)
            slow = (1.0 - fast) * all_

            def split(now: float, u: FloatArray) -> FloatArray:
                work.evaluations -= 1
                spent.append(share)
                return fast * field(now, u) + slow

            return (chebyshev_first(split, time_, y, all_, short, inner) - y) / short

        trial = chebyshev_first(averaged, t, x, averaged(t, x), h, stages)
        work.evaluations += round(sum(spent))
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
    """``rosenbrock`` with a matrix of the stiff pairs alone: of order two with any matrix.

    Products and preconditioners count as the part of the cells that have a stiff pair.
    """

    stiff: float = 0.2

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step."""
        walk = rosenbrock_solver.Walk(self, system, np.array(position))
        resolvent, shares = walk._resolvent, []
        whole = resolvent.linearise

        def linearise(time_: float, x: FloatArray) -> None:
            whole(time_, x)
            stiff, cells = stiff_pairs(system, resolvent.linear, self.stiff)
            resolvent.linear.along[~stiff] = 0.0
            resolvent.linear = replace(
                resolvent.linear, across=np.where(stiff, resolvent.linear.across, 0.0)
            )
            shares.append(float(cells.mean()))

        resolvent.linearise = linearise
        outcome, work = walk.integrate(), system.work
        for name in ("jacobian_products", "preconditioner_setups", "preconditioner_solves"):
            setattr(work, name, round(float(np.mean(shares)) * getattr(work, name)))
        return outcome


@dataclass(frozen=True)
class ProximalBdf2(EqualSteps):
    """BDF2 with equal steps, each a minimum of ½ |x - (4 x_n - x_(n-1)) / 3|² 3 / (2 Δt) + U(x).

    It begins with extrapolated backward Euler steps. Minima are found as ``backward-euler`` does.
    """

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step."""
        motion, euler = system.motion, backward_euler.BackwardEuler(self.step, tolerance=1e-4)
        count = max(1, round((motion.end - motion.begin) / self.step))
        h = (motion.end - motion.begin) / count

        def minimum(base: FloatArray, guess: FloatArray, end: float, step: float) -> FloatArray:
            implicit = backward_euler._Step(euler, system, base, end, step)
            implicit.trial = guess.copy()
            problem = implicit.solve()
            if problem:
                raise StateRejected(problem)
            return implicit.trial

        try:
            first = motion.begin + h
            half = minimum(position, position, first - 0.5 * h, 0.5 * h)
            half = minimum(half, half, first, 0.5 * h)
            last, now = position, 2.0 * half - minimum(position, half, first, h)
            for k in range(2, count + 1):
                base = (4.0 * now - last) / 3.0
                last, now = now, minimum(base, now, motion.begin + k * h, 2.0 / 3.0 * h)
        except StateRejected as error:
            return Outcome(motion.begin, position, str(error))
        return Outcome(motion.end, now)


@dataclass(frozen=True)
class Case:
    """A coupling step with the end that is right."""

    name: str
    problem: Problem
    end: FloatArray

    def error(self, found: FloatArray) -> float:
        """Return the error of an end, relative to the motion."""
        scale = MotionScale.of(self.problem.start, self.end, self.problem.mean_radius)
        return scale.errors(found, self.end)[0]


def cases(cells: int) -> Iterator[Case]:
    """Yield the coupling steps."""
    for state, z in STATES:
        step = solved(Tile(state, cells, z, 1), __import__("pathlib").Path("/tmp/m/tiles"))
        yield Case(f"{state}, λΔt {z:.0e}", step.problem, step.end)
    simulation = mc.Simulation(mc.load_scene("stiff-inclusions"), threads=1)
    template, start = simulation.prepared(), np.array(simulation.cells.position)
    problem = Problem(
        simulation.scene, template, start, simulation.cells.radius, [Step(template.motion)],
        [start], 1,
    )  # fmt: skip
    exact = replay(problem, find_method("rkc2", problem.scene, problem.mean_radius).make(1e-7))
    yield Case("stiff-inclusions", problem, exact.positions[0])


STATES = (
    ("typical", 1e2), ("fresh", 1e2), ("typical", 1e3), ("fresh", 1e3), ("fresh", 1e4),
    ("quiet", 1e4), ("quiet", 1e6),
)  # fmt: skip


def variants(name: str, case: Case) -> list[Callable[[float], Any]]:
    """Return makers of integrators: each takes a tolerance in µm, or 2^-k for a step."""
    motion = case.problem.steps[0].motion
    length = motion.end - motion.begin
    if name in PACKAGE:
        method = find_method(name, case.problem.scene, case.problem.mean_radius)
        if method.control == "step":
            return [lambda part: method.make(part * length)]
        return [lambda atol: method.make(atol / case.problem.mean_radius)]
    if name == "proximal-bdf2":
        return [lambda part: ProximalBdf2(part * length)]
    if name == "rock4":
        return [lambda atol: Rock4(1e-6, atol)]
    kind = Imex if name == "imex" else MultirateRkc
    return [partial(kind, 1e-6, stiff=stiff) for stiff in STIFF] and [
        partial(lambda atol, stiff: kind(1e-6, atol, stiff=stiff), stiff=stiff) for stiff in STIFF
    ]


def cheapest(name: str, case: Case, goals: list[float]) -> dict[float, tuple[float, float]]:
    """Return goal -> effort and CPU time in s of the cheapest solve that reaches it."""
    best: dict[float, tuple[float, float]] = {}
    steps = name in ("backward-euler", "proximal-bdf2")
    ladder = tuple(0.5**k for k in range(11)) if steps else TOLERANCES
    for make in variants(name, case):
        for setting in ladder:
            found = replay(case.problem, make(setting), limit=LIMIT)
            if not found.done:
                continue
            error = case.error(found.positions[0])
            for goal in goals:
                cost = (float(found.work.effort), found.cpu)
                if error <= goal and cost < best.get(goal, (math.inf, 0.0)):
                    best[goal] = cost
            if error <= min(goals) or found.cpu > LIMIT:
                break
    return best


TRIED = ("rock4", "proximal-bdf2", "imex", "multirate-rkc")
LIMIT = 1.5  # s of a solve beyond which finer ones are not tried


def main() -> None:
    """Solve, and print a row for each coupling step and goal."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--goal", type=float, nargs="+", default=[0.1, 0.01])
    parser.add_argument("--cells", type=int, default=350)
    parser.add_argument("--methods", nargs="+", default=[*PACKAGE, *TRIED])
    given = parser.parse_args()
    print("| coupling step | goal | " + " | ".join(given.methods) + " |")
    print("|---" * (2 + len(given.methods)) + "|", flush=True)
    for case in cases(given.cells):
        found = {name: cheapest(name, case, given.goal) for name in given.methods}
        for goal in given.goal:
            cost = [found[n].get(goal, (math.inf, 0.0)) for n in given.methods]
            texts = [f"{c:.0f} ({1e3 * s:.0f} ms)" if c < math.inf else "–" for c, s in cost]
            print(f"| {case.name} | {100 * goal:g} % | " + " | ".join(texts) + " |", flush=True)
    print(f"{time.process_time():.0f} s of CPU")


if __name__ == "__main__":
    main()
