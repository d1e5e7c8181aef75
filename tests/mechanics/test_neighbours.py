"""Neighbour search against SciPy's k-d tree, by Python and in compiled loops."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from strategies import cluster, seeds
from synthetic import cells_at

from multicell.compiling import threads
from multicell.compiling.threads import launch
from multicell.mechanics import neighbours
from multicell.mechanics.neighbours import building, order
from multicell.simulation.coupling_step import sorted_in_space


def oracle(position, cutoff):
    pairs = cKDTree(position).query_pairs(cutoff, output_type="ndarray")
    return np.unique(np.sort(pairs, axis=1), axis=0).reshape(-1, 2)


def uniform(n, width, seed=0):
    return np.random.default_rng(seed).uniform(-width, width, (n, 3))


def far_flung():
    """A tissue, stray cells up to 10¹² µm away, and groups of close cells out there."""
    rng = np.random.default_rng(1)
    stray = rng.normal(0, 1, (200, 3)) * 10.0 ** rng.uniform(0, 12, (200, 1))
    return np.concatenate([uniform(2000, 40), stray, stray[:50] + rng.normal(0, 2, (50, 3))])


CONFIGURATIONS = {
    "random": (uniform(6000, 60), 8.0),
    "dense": (uniform(1500, 6), 3.0),
    "empty": (np.zeros((0, 3)), 1.0),
    "single": (np.zeros((1, 3)), 1.0),
    "two": (np.array([[0.0, 0, 0], [0, 0, 2]]), 2.0),
    "coincident": (np.full((300, 3), 7.25), 1.0),
    "far-flung": (far_flung(), 6.0),
    "line": (uniform(4000, 1e7) * [1, 0, 0], 1000.0),
    "plane": (uniform(3000, 50) * [1, 1, 0], 4.0),
    "several chunks": (cluster(3 * neighbours.CHUNK + 5, 0)[0], 11.0),
}


@pytest.mark.parametrize("name", CONFIGURATIONS)
@pytest.mark.parametrize("threads", [1, 2])
def test_pairs_equal_those_of_a_kd_tree(name, threads):
    position, cutoff = CONFIGURATIONS[name]
    half = np.full(len(position), 0.5 * cutoff)
    found = neighbours.build(position, half, 0.0, threads).pairs()
    np.testing.assert_array_equal(found, oracle(position, cutoff))
    np.testing.assert_array_equal(neighbours.neighbour_pairs(position, cutoff), found)


@given(seeds, st.integers(0, 60), st.floats(-3, 9), st.floats(-2, 2))
def test_any_cloud(seed, n, decades, log_cutoff):
    rng = np.random.default_rng(seed)
    position = rng.normal(0, 1, (n, 3)) * 10.0 ** rng.uniform(-3, decades, (n, 1))
    cutoff = 10.0**log_cutoff
    np.testing.assert_array_equal(
        neighbours.neighbour_pairs(position, cutoff), oracle(position, cutoff)
    )


def test_the_largest_numbers_there_are():
    """Here the k-d tree gives up; two pairs are close, by construction."""
    big = np.finfo(float).max
    position = np.array(
        [[big, 0, 0], [big, 0, 0], [-big, 0, 5], [-big, 0, 6], [0, -big, big], [1e300, 2, 3]]
    )
    assert neighbours.neighbour_pairs(position, 2.0).tolist() == [[0, 1], [2, 3]]


def test_unlike_radii_and_skin():
    position, radius, _ = cluster(900, 3, variation=0.4)
    skin = 0.7
    pairs = oracle(position, 2 * radius.max() + skin)
    distance = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    expected = pairs[distance <= radius[pairs].sum(axis=1) + skin]
    np.testing.assert_array_equal(neighbours.build(position, radius, skin).pairs(), expected)


def test_a_chunk_owns_its_cells():
    position, radius, _ = cluster(2 * neighbours.CHUNK + 100, 4)
    found = neighbours.build(position, radius, 0.5)
    for c in range(len(found.start)):
        low, high = c * neighbours.CHUNK, (c + 1) * neighbours.CHUNK
        inner = slice(found.start[c], found.inner_end[c])
        outer = slice(found.inner_end[c], found.outer_end[c])
        for array in (found.first[inner], found.second[inner], found.first[outer]):
            assert ((array >= low) & (array < high)).all()
        beyond = found.second[outer]
        assert ((beyond < low) | (beyond >= high)).all()
    assert len(found) == len(found.pairs())


def test_too_many_pairs_is_an_error_and_not_a_full_memory():
    with pytest.raises(neighbours.TooManyPairsError, match="pairs among 20000 cells"):
        neighbours.neighbour_pairs(np.zeros((20_000, 3)), 1.0)


def test_spatial_order_keeps_neighbours_together():
    position = cluster(5000, 5)[0]
    order = neighbours.spatial_order(position, 10.0)
    assert np.array_equal(np.sort(order), np.arange(5000))
    steps = np.linalg.norm(np.diff(position[order], axis=0), axis=1)
    assert np.median(steps) < 12.0
    before = np.linalg.norm(np.diff(position, axis=0), axis=1)
    assert np.median(before) > 50.0


def test_threads_sort_cells_as_one_does(monkeypatch):
    rng = np.random.default_rng(4)
    made = cells_at(rng.normal(0.0, 40.0, (3000, 3)), rng.uniform(4.0, 6.0, 3000))
    alone, _ = sorted_in_space(made, 3000)  # many share a box: ties
    monkeypatch.setattr(order, "_PART", 10)
    monkeypatch.setattr(threads, "_WORTH", 10)
    for number in (2, 5, 16):
        assert sorted_in_space(made, 3000, None, number)[0].equals(alone)
        share, large = partial(threads.share_rows, number), made.radius > 5.0
        assert made.replaced(large, made, share).equals(made.replaced(large, made))
        assert made.take(large, share).equals(made.take(large))


def test_spatial_order_of_any_finite_input():
    big = np.finfo(float).max
    position = np.array([[big, 0, 0], [-big, 1, 2], [0, 0, 0], [big, 0, 0]])
    assert sorted(neighbours.spatial_order(position, 1.0)) == [0, 1, 2, 3]
    assert len(neighbours.spatial_order(np.zeros((0, 3)), 1.0)) == 0
    assert neighbours.spatial_order(np.zeros((4, 3)), 1.0).tolist() == [0, 1, 2, 3]


# in compiled loops

NONE = np.empty(0, dtype=np.int32)


def stray(position):
    """Return the cells with two of them so far away that bins are sparse."""
    far = position.copy()
    far[0] = [1e12, -1e9, 3e10]
    far[1] = far[0] + [0.0, 3.0, 0.0]
    return far


@pytest.mark.parametrize("place", [np.copy, stray])
@pytest.mark.parametrize("chunk", [7, 100, 2048])
@pytest.mark.parametrize("run", ["rebuild", "rebuild_parallel"])
def test_compiled_and_called_lists_are_the_same(place, chunk, run):
    position, radius, _ = cluster(700, 3, variation=0.3)
    position = place(position)
    found = neighbours.build(position, radius, 0.5, 1, chunk)
    launch()
    crowded, *arrays = getattr(building, run)(position, radius, 0.5, chunk, NONE, NONE)
    assert not crowded
    compiled = neighbours.PairList(*arrays, chunk, len(position))
    for name in ("start", "inner_end", "outer_end"):
        np.testing.assert_array_equal(getattr(compiled, name), getattr(found, name))
    for start, end in zip(found.start, found.outer_end, strict=True):
        for name in ("first", "second"):
            np.testing.assert_array_equal(
                getattr(compiled, name)[start:end], getattr(found, name)[start:end]
            )
    near = cKDTree(position).query_pairs(2 * radius.max() + 0.5, output_type="ndarray")
    distance = np.linalg.norm(position[near[:, 0]] - position[near[:, 1]], axis=1)
    expected = near[distance <= radius[near].sum(axis=1) + 0.5]
    assert len(found) == len(expected)


def test_compiled_lists_tell_when_there_are_too_many_pairs():
    places, radius = np.zeros((20_000, 3)), np.full(20_000, 0.5)
    crowded, *_ = building.rebuild(places, radius, 0.0, 2048, NONE, NONE)
    assert crowded


@pytest.mark.parametrize("run", ["rebuild", "rebuild_parallel"])
def test_a_list_is_built_into_the_room_of_another_if_there_is_enough(run):
    position, radius, _ = cluster(700, 3, variation=0.3)
    launch()
    found = neighbours.build(position, radius, 0.5, 1, 100)
    for size in (len(found.first) - 1, len(found.first), 2 * len(found.first)):
        room = np.full(size, -1, dtype=np.int32), np.full(size, -1, dtype=np.int32)
        build = getattr(building, run)
        crowded, first, second, *ends = build(position, radius, 0.5, 100, *room)
        assert not crowded
        enough = size >= len(found.first)
        assert np.shares_memory(first, room[0]) == enough
        assert np.shares_memory(second, room[1]) == enough
        again = neighbours.PairList(first, second, *ends, 100, 700)
        np.testing.assert_array_equal(again.pairs(), found.pairs())
