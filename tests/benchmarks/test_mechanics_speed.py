"""Speed of the mechanics: ``pytest -m benchmark tests/benchmarks``.

Targets on the machine that the project is developed on (2 cores of an AMD EPYC, Zen 5), in
nanoseconds per cell: right-hand side of 100 000 packed, sorted cells 45 on one thread and 28
on two; neighbour list 450. The figures are printed as ``extra_info``, never asserted.
"""

import numpy as np
import pytest
from strategies import cluster

from multicell import JKR
from multicell.mechanics import binning, neighbours
from multicell.mechanics.compression import Compression
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

CELLS = 100_000

pytestmark = pytest.mark.benchmark


@pytest.fixture(scope="module")
def tissue():
    """Packed cells of unlike radius and modulus with about twelve neighbours, sorted."""
    position, radius, young = cluster(CELLS, 0, spacing=0.88)
    order = binning.spatial_order(position, 10.0)
    return position[order], radius[order], young[order]


def mechanics(tissue, threads, compression=None):
    _, radius, young = tissue
    system = Mechanics(JKR(surface_energy=0.1), 5.0, threads, compression=compression)
    nothing = np.zeros(CELLS)
    system.begin(Motion(radius, nothing, young, nothing + 0.5, 0.0, 60.0))
    return system


def per_cell(benchmark, function, *arguments):
    benchmark.pedantic(function, arguments, rounds=40, warmup_rounds=3)
    median = benchmark.stats.stats.median * 1e9 / CELLS
    benchmark.extra_info["ns per cell"] = round(median, 1)
    print(f"\n{benchmark.name}: {median:.1f} ns per cell")
    return median


@pytest.mark.parametrize("threads", [1, 2])
def test_right_hand_side(benchmark, tissue, threads):
    system, out = mechanics(tissue, threads), np.empty((CELLS, 3))
    assert per_cell(benchmark, system.velocity, 0.0, tissue[0], out) > 0
    assert system.work.list_builds == 1
    touching = 2 * (np.linalg.norm(out, axis=1) > 0).mean()
    assert touching > 0.99


@pytest.mark.parametrize("threads", [1, 2])
def test_jacobian_product(benchmark, tissue, threads):
    system, out = mechanics(tissue, threads), np.empty((CELLS, 3))
    vector = np.random.default_rng(0).normal(size=out.shape)
    system.linearise(0.0, tissue[0])
    assert per_cell(benchmark, system.jacobian_product, vector, out) > 0
    assert np.isfinite(out).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_compressed_right_hand_side(benchmark, tissue, threads):
    """Most cells of this tissue are above the threshold."""
    system, out = mechanics(tissue, threads, Compression(10.0)), np.empty((CELLS, 3))
    assert per_cell(benchmark, system.velocity, 0.0, tissue[0], out) > 0
    system.linearise(0.0, tissue[0])
    assert (system.linearisation.coupling.weight > 0.0).mean() > 0.5


@pytest.mark.parametrize("threads", [1, 2])
def test_compressed_jacobian_product(benchmark, tissue, threads):
    system, out = mechanics(tissue, threads, Compression(10.0)), np.empty((CELLS, 3))
    vector = np.random.default_rng(0).normal(size=out.shape)
    system.linearise(0.0, tissue[0])
    assert per_cell(benchmark, system.jacobian_product, vector, out) > 0
    assert np.isfinite(out).all()


def test_linearisation(benchmark, tissue):
    system = mechanics(tissue, 1)
    assert per_cell(benchmark, system.linearise, 0.0, tissue[0]) > 0


@pytest.mark.parametrize("threads", [1, 2])
def test_neighbour_list(benchmark, tissue, threads):
    position, radius, _ = tissue
    skin = 0.15 * radius.mean()
    assert per_cell(benchmark, neighbours.build, position, radius, skin, threads) > 0
    assert len(neighbours.build(position, radius, skin, threads)) > 5 * CELLS


def test_spatial_order(benchmark, tissue):
    assert per_cell(benchmark, binning.spatial_order, tissue[0], 10.0) > 0
