"""The list of pairs that compiled loops build is the one that Python builds."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from strategies import cluster

from multicell.compiling.threads import launch
from multicell.mechanics import neighbours


def rebuilt(run, position, radius, chunk, arrays=None, reference=None):
    """Build a list; return whether it is crowded, and its arrays."""
    n = len(position)
    return getattr(neighbours, run)(
        position,
        np.full((n, 3), np.nan) if reference is None else reference,
        radius,
        0.0,
        np.zeros(n),
        chunk,
        *(arrays or neighbours.no_list(n, chunk)[:2]),
    )


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
    crowded, *arrays = rebuilt(run, position, radius + 0.25, chunk)
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
    reference = np.full((20_000, 3), np.nan)
    crowded, *_ = rebuilt("rebuild", places, radius, 2048, reference=reference)
    assert crowded
    assert np.isnan(reference[:, 0]).all()


@pytest.mark.parametrize("run", ["rebuild", "rebuild_parallel"])
def test_a_list_is_built_into_the_room_of_another_if_there_is_enough(run):
    position, radius, _ = cluster(700, 3, variation=0.3)
    launch()
    found = neighbours.build(position, radius, 0.5, 1, 100)
    for size in (len(found.first) - 1, len(found.first), 2 * len(found.first)):
        room = np.full(size, -1, dtype=np.int32), np.full(size, -1, dtype=np.int32)
        crowded, *arrays = rebuilt(run, position, radius + 0.25, 100, room)
        assert not crowded
        enough = size >= len(found.first)
        assert np.shares_memory(arrays[0], room[0]) == enough
        assert np.shares_memory(arrays[1], room[1]) == enough
        again = neighbours.PairList(*arrays, 100, 700)
        np.testing.assert_array_equal(again.pairs(), found.pairs())


def sides(pairs):
    """Return what each chunk sums: cells with their partners, sorted; check what it owns."""
    found = []
    for c, (start, inner, end) in enumerate(
        zip(pairs.start, pairs.inner_end, pairs.outer_end, strict=True)
    ):
        own = np.stack([pairs.first[start:end], pairs.second[start:end]], axis=1)
        assert (own[:, 0] // pairs.chunk == c).all()
        assert (own[: inner - start, 1] // pairs.chunk == c).all()
        found += [own, own[: inner - start, ::-1]]
    return np.unique(np.concatenate(found), axis=0, return_counts=True)


@pytest.mark.parametrize("chunk", [100, 2048])
@pytest.mark.parametrize("ending", ["", "_parallel"])
def test_a_repaired_list_is_the_one_that_is_built_at_its_reference(ending, chunk):
    position, radius, _ = cluster(3000, 3, variation=0.3)
    rng = np.random.default_rng(chunk)
    launch()
    repair = getattr(neighbours, f"repair{ending}")
    rebuild = getattr(neighbours, f"rebuild{ending}")
    reference, margin = np.full((3000, 3), np.nan), np.full(3000, 0.4)
    common = reference, radius, 0.4, margin, chunk
    arrays, outcomes = neighbours.no_list(3000, chunk), []
    for part in (0.0, 0.001, 0.05, 0.05, 0.15, 0.9, 0.02, 0.02):
        moved = rng.random(3000) < part
        position = position + moved[:, None] * rng.normal(0.0, 0.8, (3000, 3))
        repaired, *ends = repair(position, *common, *arrays)
        outcomes.append(repaired)
        if repaired:
            arrays = *arrays[:3], *ends
        else:
            crowded, *arrays = rebuild(position, *common, *arrays[:2])
            assert not crowded
        assert (np.linalg.norm(position - reference, axis=1) <= margin).all()
        exact = neighbours.build(reference, radius + margin, 0.0)
        listed = neighbours.PairList(*arrays, chunk, 3000)
        assert len(listed) == len(exact)
        np.testing.assert_array_equal(listed.pairs(), exact.pairs())
        both, count = sides(listed)
        assert len(both) == 2 * len(exact)
        assert (count == 1).all()
    assert not outcomes[0]
    assert not outcomes[5]
    assert all(outcomes[1:3])
