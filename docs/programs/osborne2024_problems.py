"""The chain and the growing tissues of Osborne (2024), and Chaste's adaptive steps.

Parameters are those of test/TestNumerics.hpp in github.com/jmosborne/MultiCellularNumericalMethods
and the defaults of Chaste; lengths in cell diameters, times in hours. Births and directions are
drawn anew. ``osborne2024.py`` solves them.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from papers import Array, mechanics, motion, solve

from multicell.contact.springs import GeneralisedLinearSpring, LinearSpring

CHAIN = LinearSpring(stiffness_at_rest=15.0, cutoff=1.5)
SPRINGS = GeneralisedLinearSpring(stiffness_at_rest=15.0, cutoff=10.0, decay=5.0)
STABILITY: dict[str, Callable[[Array], Array]] = {
    "FE": lambda z: 1 + z,
    "MP": lambda z: 1 + z + z**2 / 2,
    "RK3": lambda z: 1 + z + z**2 / 2 + z**3 / 6,
    "RK4": lambda z: 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24,
    "BE": lambda z: 1 / (1 - z),
    "AM2": lambda z: (1 + z / 2) / (1 - z / 2),
}
OURS = {"FE": "euler", "MP": "heun", "RK4": "rk4", "BE": "backward-euler"}
"""The package's methods with the same stability functions."""
END, CHAIN_END, BIRTHS = 50.0, 4.0, 1.0 / 16.0


def chain(cells: int = 11, compression: float = 0.9) -> tuple[Array, Array, Array]:
    """Return the centres, the eigenvalues and the eigenvectors of the linear chain."""
    place = compression * (np.arange(cells) - (cells - 1) / 2.0)
    laplacian = np.diff(np.eye(cells), axis=0)
    values, vectors = np.linalg.eigh(-15.0 * laplacian.T @ laplacian)
    return place, values, vectors


def chain_errors(name: str, steps: Array) -> Array:
    """Return the closed form of a method's largest error in the chain, for each step."""
    place, values, vectors = chain()
    strain = vectors.T @ (place - place / 0.9)
    found = []
    for step in steps:
        k = np.arange(round(CHAIN_END / step) + 1)[:, None]
        away = STABILITY[name](step * values) ** k - np.exp(values * step * k)
        found.append(np.abs((away * strain) @ vectors.T).max())
    return np.array(found)


def births(seed: int, dimensions: int) -> list[tuple[float, int, Array]]:
    """Return time, mother and direction of all divisions, earliest first; newborns come last."""
    draw = np.random.default_rng(seed)
    due = [BIRTHS * np.ceil((draw.uniform(7, 17) - 12 * draw.random()) / BIRTHS) for _ in range(4)]
    due = [max(time, BIRTHS) for time in due]
    found = []
    while min(due) < END:
        mother = int(np.argmin(due))
        now = due[mother]
        way = np.zeros(3)
        way[:dimensions] = draw.normal(size=dimensions)
        found.append((now, mother, way / np.linalg.norm(way)))
        new = now + BIRTHS * np.ceil(draw.uniform(7, 17, 2) / BIRTHS)
        due[mother] = new[0]
        due.append(new[1])
    return found


Step = Callable[[Array, float, float], tuple[Array, int]]


def grow(
    seed: int, dimensions: int, advance: Step, shift: float = 0.0
) -> tuple[list[Array], int, float]:
    """Return the centres at full hours, the evaluations and the CPU time of a growing tissue.

    ``advance(position, begin, end)`` returns the centres at the end and the evaluations. The
    first cells may be displaced at random by about ``shift``.
    """
    position = np.array([(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0)], dtype=float)
    position[:, :dimensions] += np.random.default_rng(99).normal(0.0, shift, (4, dimensions))
    events = births(seed, dimensions)
    stops = sorted({*np.arange(1.0, END + 0.5), *(time for time, _, _ in events)})
    path, cost, now, begun = [], 0, 0.0, time.process_time()
    for stop in stops:
        position, more = advance(position, now, stop)
        cost, now = cost + more, stop
        if stop == round(stop):
            path.append(position)
        while events and events[0][0] == now:
            _, mother, way = events.pop(0)
            born = position[mother] + 0.15 * way
            position = np.concatenate([position, born[None]])
            position[mother] -= 0.15 * way
    return path, cost, time.process_time() - begun


def packaged(method: str, setting: float) -> Step:
    """Return ``advance`` by a method of the package."""

    def advance(position: Array, begin: float, end: float) -> tuple[Array, int]:
        found = solve(SPRINGS, position, [begin, end], method, setting)
        if found.problem:
            raise ArithmeticError(found.problem)
        return found.path[-1], found.cost

    return advance


def threshold(stages: int, longest: float, move: float) -> Step:
    """Return ``advance`` by Chaste's adaptive steps: Euler's (1 stage) or RK4's (4).

    A step that moves a cell further than ``move`` is repeated with 0.95 of the step that would
    move it so far; each step that is taken is followed by one that is longer by a hundredth, none
    beyond the next multiple of ``longest``.
    """

    def advance(position: Array, begin: float, end: float) -> tuple[Array, int]:
        system, cost, now, step = mechanics(SPRINGS), 0, begin, longest
        system.begin(motion(len(position), begin, end))

        def velocity(x: Array) -> Array:
            system.velocity(begin, x, out := np.empty_like(x))
            return out

        target = begin
        while target < end:
            target = min(target + longest, end)
            step = target - now
            while now < target - 1e-12:
                mean = first = velocity(position)
                cost += stages
                if stages == 4:
                    second = velocity(position + 0.5 * step * first)
                    third = velocity(position + 0.5 * step * second)
                    fourth = velocity(position + step * third)
                    mean = (first + 2.0 * (second + third) + fourth) / 6.0
                far = step * np.linalg.norm(mean, axis=1).max()
                if far > move:
                    step = min(0.95 * step * move / far, target - now)
                    continue
                position, now = position + step * mean, now + step
                step = min(1.01 * step, target - now)
        return position, cost

    return advance
