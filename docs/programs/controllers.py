"""Control of the step of ``ab2-adaptive``: evaluations by other controls at equal error.

Problem   coupling steps of growing tissue, each from its own recorded state: 3,000 cells at two
          viscosities, and EMT6/Ro in a rich medium
Question  with errors of the worst cell that are alike, how many evaluations does a step take
Methods   Adams-Bashforth of order 2 with step factors 0.9 e^(-a/3) e_last^(b/3), e being the
          estimated error in units of what is allowed: (a, b) of the package (0.7, 0.4), PI control
          with more weight on the last error, elementary control (1, 0), the same foreseeing how
          errors fall; and the steps of the package corrected by their own estimated error, half of
          it or all (then of order 3: predict, evaluate, correct), which costs no evaluation
Error     distance of the worst cell from the reference, ``rk4-adaptive`` at 10⁻⁴ µm; median over
          the steps
Measured  evaluations in a coupling step at twice, once and half the error of the package at its
          default tolerance; between the two tolerances beside it on a ladder by a straight line
          between logarithms
Cost      a minute of CPU
Command   python docs/programs/controllers.py    (--cells 10000 --steps 12)

The loop is written out here in NumPy; with the control of the package it takes the steps of the
package, which the program checks.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

import multicell as mc
from multicell.cells import FloatArray
from multicell.comparison.record import record
from multicell.comparison.replay import ReplayProblem, advance_system
from multicell.integrators import driver
from multicell.integrators.adams_bashforth import AdaptiveAdams
from multicell.integrators.rkc import Rkc2
from multicell.integrators.runge_kutta import AdaptiveRungeKutta4
from multicell.mechanics.system import Mechanics

RICH = Path(__file__).parents[1] / "rich-medium.toml"
SCENES = {
    "growing, 5 kPa·s": ("spheroid", 600.0, {"drag.viscosity": 5.0}),
    "growing, 0.5 kPa·s": ("spheroid", 600.0, {"drag.viscosity": 0.5}),
    "EMT6/Ro": (str(RICH), 900.0, {}),
}
"""Name in the table -> scene, length of its coupling steps in s, and what is changed of it."""
LADDER = 10.0 ** np.arange(1.25, -2.01, -0.25)
"""What the estimated error of a step may be, over what it may be in the package at 0.1 µm."""
GOALS = (2.0, 1.0, 0.5)  # times the error of the package
Factor = Callable[[float, float, float], float]


def controlled(a: float, b: float) -> Factor:
    """Return PI control: the step's factor by this error, the last one and the last factor."""
    return lambda error, before, _: 0.9 * error ** (-a / 3.0) * before ** (b / 3.0)


def foreseeing(error: float, before: float, last: float) -> float:
    """Return the factor of elementary control where errors go on to change as they did.

    Gustafsson's control of the steps of implicit methods.
    """
    return 0.9 * last * error ** (-2.0 / 3.0) * before ** (1.0 / 3.0)


VARIANTS: dict[str, tuple[Factor, float]] = {
    "(0.7, 0.4)": (controlled(0.7, 0.4), 0.0),
    "(0.8, 0.2)": (controlled(0.8, 0.2), 0.0),
    "(0.6, 0.1)": (controlled(0.6, 0.1), 0.0),
    "elementary": (controlled(1.0, 0.0), 0.0),
    "foreseeing": (foreseeing, 0.0),
    "half corrected": (controlled(0.7, 0.4), 0.5),
    "corrected": (controlled(0.7, 0.4), 1.0),
}
"""Name in the table -> control, and the part of the estimated error that is taken off."""


def adams(
    system: Mechanics, position: FloatArray, factor: Factor, allowed: float, corrected: float
) -> tuple[FloatArray, int]:
    """Return the end of a coupling step and the number of evaluations.

    - ``allowed``: part of the error that the package allows
    - ``corrected``: part of the estimated error that is taken off each step
    """
    begin, length = system.motion.begin, system.motion.end - system.motion.begin
    control = driver.control(AdaptiveAdams(), system, 3.0, lower=2)
    count = 0

    def velocity(elapsed: float, x: FloatArray) -> FloatArray:
        nonlocal count
        count, out = count + 1, np.empty_like(x)
        system.velocity(begin + elapsed, x, out)
        return out

    def furthest(way: FloatArray) -> float:
        return float((np.sqrt(np.square(way).sum(axis=1)) / system.motion.radius).max())

    x, now = position, velocity(0.0, position)
    fastest, elapsed, before, grown, last, held = furthest(now), 0.0, 1.0, 1.0, 0.0, False
    old, dt = now, min(0.5 * length, 0.14 * control.max_displacement / fastest)
    while elapsed < length:
        left = length - elapsed
        dt = left / math.ceil(left / dt * (1.0 - 1e-12))
        if last == 0.0:
            r, end = 0.0, velocity(dt, x + dt * now)
            trial, share = x + 0.5 * dt * (now + end), 0.0
        else:
            r, end = dt / last, old
            trial = x + dt * ((1.0 + 0.5 * r) * now - 0.5 * r * old)
            share = 0.5 * dt * (3.0 + 2.0 * r) / (3.0 + 3.0 * r)
        moved = furthest(trial - x)
        if moved > control.max_displacement:
            dt, held = dt * max(0.1, min(0.7, 0.8 * control.max_displacement / moved)), True
            continue
        new = velocity(elapsed + dt, trial)
        error = share * (new - (1.0 + r) * now + r * old) if last else 0.5 * dt * (new - end)
        scale = control.atol + control.rtol * np.maximum(np.abs(x), np.abs(trial))
        size = float(np.sqrt(np.square(error / scale).mean())) / (control.strictness * allowed)
        if size > 1.0:
            dt, held = dt * max(0.2 if last else 0.02, 0.9 * size ** (-1.0 / 3.0)), True
            continue
        grown = min(2.0, max(0.2, factor(max(size, 1e-10), before, grown)))
        wanted = dt if 0.9 < grown < 1.2 else grown * dt
        elapsed = length if dt == left else elapsed + dt
        x = trial + corrected * error if last else trial
        old, now, last, before = now, new, dt, max(size, 1e-4)
        dt, held = min(dt, wanted) if held else wanted, False
    return x, count


def recorded(name: str, cells: int, steps: int) -> ReplayProblem:
    """Return coupling steps of a scene, each from its own state; the first ones are left out."""
    scene, length, changes = SCENES[name]
    changes = {"initial.count": cells, "initial.stage": "asynchronous", **changes}
    changes["duration"] = (steps + 3) * length
    return record(
        mc.load_scene(scene).with_changes(changes), Rkc2(atol=0.01), samples=10**6, threads=1
    )[0]


def measured(
    problem: ReplayProblem, ends: dict[int, FloatArray], factor: Factor, corrected: float
) -> FloatArray:
    """Return evaluations in a step and the error of the worst cell, µm, along the ladder."""
    rows = []
    for allowed in LADDER:
        counts, worst = [], []
        for k, end in ends.items():
            system = begun(problem, k)
            x, count = adams(system, problem.starts[k], factor, allowed, corrected)  # type: ignore[index]
            counts.append(count)
            worst.append(math.sqrt(np.square(x - end).sum(axis=1).max()))
        rows.append((np.mean(counts), np.median(worst)))
    return np.array(rows)


def begun(problem: ReplayProblem, k: int) -> Mechanics:
    """Return the mechanics of a coupling step, made ready."""
    system = problem.system()
    system.begin(problem.steps[k].motion)
    return system


def at_error(rows: FloatArray, goal: float) -> str:
    """Return the evaluations at an error of the worst cell: the most where the ladder crosses it.

    An error need not fall with each rung. A dash beyond the ends of the ladder.
    """
    count, error = np.log(rows).T
    goal, found = math.log(goal), []
    for k in range(len(rows) - 1):
        if min(error[k : k + 2]) <= goal <= max(error[k : k + 2]):
            part = (goal - error[k]) / (error[k + 1] - error[k])
            found.append(count[k] + part * (count[k + 1] - count[k]))
    return f"{math.exp(max(found)):.1f}" if found else "–"


def main() -> None:
    """Measure, and print a row for each scene and goal."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--cells", type=int, default=3000)
    parser.add_argument("--steps", type=int, default=6, help="coupling steps (%(default)s)")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    given = parser.parse_args()
    print("| tissue | worst cell / µm | " + " | ".join(VARIANTS) + " |")
    print("|---" * (2 + len(VARIANTS)) + "|", flush=True)
    for name in given.scenes:
        problem, ends = recorded(name, given.cells, given.steps), {}
        for k in range(3, len(problem.steps)):
            start = problem.starts[k]  # type: ignore[index]
            words, ends[k] = advance_system(
                begun(problem, k), AdaptiveRungeKutta4(1e-9, 1e-4), start
            )
            assert not words, words
            system = begun(problem, k)
            words, end = advance_system(system, AdaptiveAdams(), start)
            x, count = adams(begun(problem, k), start, *VARIANTS["(0.7, 0.4)"][:1], 1.0, 0.0)
            assert count == system.work.evaluations, words
            assert abs(x - end).max() < 1e-9
        rows = [measured(problem, ends, *variant) for variant in VARIANTS.values()]
        own = rows[0][np.argmin(abs(LADDER - 1.0))]
        for goal in own[1] * np.array(GOALS):
            cells = " | ".join(at_error(row, goal) for row in rows)
            print(f"| {name} | {goal:.2g} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
