"""Speed of friction at 10 000 cells on one thread; the numbers are recorded.

Aim: a right-hand side with friction costs at most 8 times one without. The cells move by
at most 0.01 µm between two right-hand sides, as between the iterations of an implicit step.
"""

import time

import numpy as np
import pytest
from strategies import cluster, mechanics

from multicell.mechanics import neighbours
from multicell.mechanics.friction import FrictionMatrix

pytestmark = pytest.mark.benchmark


@pytest.mark.parametrize("viscosity", [5.0, 0.05])
@pytest.mark.parametrize(("normal", "tangential"), [(0.1, 0.1), (0.2, 0.05)])
def test_right_hand_side_with_friction(benchmark, viscosity, normal, tangential):
    position, radius, young = cluster(10_000, 1)
    order = neighbours.spatial_order(position, 10.0)
    position, radius, young = position[order], radius[order], young[order]
    system = mechanics(radius, young, viscosity=viscosity)
    gamma = FrictionMatrix((normal, tangential), 10_000, system.drag, system.chunk)
    stokes, last, force = (
        system.drag * radius[:, None],
        np.zeros((10_000, 3)),
        np.empty((10_000, 3)),
    )

    def with_friction(state, velocity):
        system.velocity(0.0, state, force)
        np.multiply(force, stokes, out=force)
        gamma.measure(system._rows, system.neighbours.pairs)
        return gamma.solve(force, velocity)

    with_friction(position, last)
    moved = position + 0.01 * last / np.abs(last).max()

    def start():
        return (moved, last.copy()), {}

    iterations = benchmark.pedantic(with_friction, setup=start, rounds=50, warmup_rounds=2)
    without = []
    for _ in range(50):
        begin = time.perf_counter()
        system.velocity(0.0, moved, force)
        without.append(time.perf_counter() - begin)
    ratio = benchmark.stats.stats.min / min(without)
    benchmark.extra_info |= {"iterations": iterations, "times one without": ratio}
    print(f"{iterations} iterations, {ratio:.1f} times a right-hand side without friction")
    assert 0 < iterations < 20
