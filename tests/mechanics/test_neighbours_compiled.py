"""The list of pairs that compiled loops build is the one that Python builds."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from strategies import cluster

from multicell.compiling.threads import launch
from multicell.mechanics import neighbours

NONE = np.empty(0, dtype=np.int32)


def stray(position):
    """Return the cells with two of them so far away that bins are sparse."""
    far = position.copy()
    far[0] = [1e12, -1e9, 3e10]
    far[1] = far[0] + [0.0, 3.0, 0.0]
    return far


@pytest.mark.parametrize("place", [np.copy, stray])
@pytest.mark.parametrize("chunk", [100, 2048])
@pytest.mark.parametrize("run", ["rebuild", "rebuild_parallel"])
def test_compiled_and_called_lists_are_the_same(place, chunk, run):
    position, radius, _ = cluster(700, 3, variation=0.3)
    position = place(position)
    found = neighbours.build(position, radius, 0.5, 1, chunk)
    launch()
    crowded, *arrays = getattr(neighbours, run)(position, radius, 0.5, chunk, NONE, NONE)
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
    crowded, *_ = neighbours.rebuild(places, radius, 0.0, 2048, NONE, NONE)
    assert crowded


@pytest.mark.parametrize("run", ["rebuild", "rebuild_parallel"])
def test_a_list_is_built_into_the_room_of_another_if_there_is_enough(run):
    position, radius, _ = cluster(700, 3, variation=0.3)
    launch()
    found = neighbours.build(position, radius, 0.5, 1, 100)
    for size in (len(found.first) - 1, len(found.first), 2 * len(found.first)):
        room = np.full(size, -1, dtype=np.int32), np.full(size, -1, dtype=np.int32)
        build = getattr(neighbours, run)
        crowded, first, second, *ends = build(position, radius, 0.5, 100, *room)
        assert not crowded
        enough = size >= len(found.first)
        assert np.shares_memory(first, room[0]) == enough
        assert np.shares_memory(second, room[1]) == enough
        again = neighbours.PairList(first, second, *ends, 100, 700)
        np.testing.assert_array_equal(again.pairs(), found.pairs())
