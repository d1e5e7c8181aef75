"""Time per step of the explicit loops against that of their evaluations alone.

``pytest -m benchmark tests/benchmarks/test_explicit_speed.py -s``. The overhead is the time of a
coupling step over evaluations x time of the kernel + list builds x time of a build; a loop
that adds nothing would show 1.0. The figures are printed and kept as ``extra_info``.
"""

import time

import numpy as np
import pytest
from strategies import cluster, mechanics

from multicell.integrators.adams_bashforth import AdamsBashforth2
from multicell.integrators.rkc import Rkc2
from multicell.integrators.runge_kutta import AdaptiveEuler, Dopri5, Euler, Heun, RungeKutta4
from multicell.mechanics import binning, neighbours

pytestmark = pytest.mark.benchmark

METHODS = {
    "euler": Euler(1.0),
    "heun": Heun(1.0),
    "ab2": AdamsBashforth2(1.0),
    "rk4": RungeKutta4(1.0),
    "euler-adaptive": AdaptiveEuler(1e-4, 1e-2),
    "dopri5": Dopri5(1e-6, 1e-4),
    "rkc2": Rkc2(1e-5, 1e-3),
}


def fastest(function, rounds):
    """Return the least time of a call, s."""
    times = []
    for _ in range(rounds):
        begun = time.perf_counter()
        function()
        times.append(time.perf_counter() - begun)
    return min(times)


@pytest.mark.parametrize("cells", [200, 1000, 10_000])
@pytest.mark.parametrize("name", METHODS)
def test_overhead(benchmark, name, cells):
    position, radius, young = cluster(cells, 0, spacing=0.88)
    order = binning.spatial_order(position, 10.0)
    position, radius, young = position[order], radius[order], young[order]
    out = np.empty_like(position)
    plain = mechanics(radius, young, duration=60.0)
    plain.velocity(0.0, position, out)
    evaluation = fastest(lambda: plain.velocity(0.0, position, out), 50)
    build = fastest(
        lambda: neighbours.build(position, plain._list_radius + plain._margin, 0.0, 1), 10
    )
    system = mechanics(radius, young, duration=60.0)

    def run():
        system.begin(plain.motion)
        system.work.evaluations = system.work.steps = system.work.list_builds = 0
        return METHODS[name].integrate(system, position)

    outcome = benchmark.pedantic(run, rounds=12, warmup_rounds=1)
    assert outcome.done
    work, seconds = system.work, benchmark.stats.stats.min
    alone = work.evaluations * evaluation + work.list_builds * build
    benchmark.extra_info |= {
        "steps": work.steps,
        "evaluations": work.evaluations,
        "list builds": work.list_builds,
        "us per step": round(seconds / work.steps * 1e6, 1),
        "us per evaluation": round(evaluation * 1e6, 1),
        "overhead": round(seconds / alone, 2),
    }
    print(f"\n{name} {cells}: {benchmark.extra_info}")
