"""A list of neighbours that follows its cells, by Python and by compiled loops."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from strategies import cluster

from multicell.compiling import KERNEL, address_of, typed
from multicell.mechanics import neighbours
from multicell.mechanics.neighbours import updating
from multicell.mechanics.neighbours.updating import update_list

LEAST = 0.3
FEW, MANY = 400, 1300  # cells; lists of the second are repaired


def tissue(n, seed=0):
    position, radius, _ = cluster(n, seed)
    return position, neighbours.NeighbourList(radius, LEAST, chunk=256)


def walk(position, seed=1):
    """Yield states in which few cells move far, then all of them, then nobody."""
    rng = np.random.default_rng(seed)
    position = position.copy()
    for part, length in ((0.02, 1.0), (0.02, 3.0), (1.0, 0.5), (0.05, 0.4), (0.0, 0.0)):
        moved = rng.random(len(position)) < part
        position[moved] += rng.normal(0.0, length, (moved.sum(), 3))
        yield position.copy()


def close(position, radius):
    """Return the pairs closer than the sum of their radii, by a k-d tree."""
    pairs = cKDTree(position).query_pairs(2.0 * radius.max(), output_type="ndarray")
    pairs = np.sort(pairs, axis=1)
    distance = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    return pairs[distance <= radius[pairs].sum(axis=1)]


LISTS = [(FEW, {updating.BUILT}), (MANY, {updating.BUILT, updating.REPAIRED})]


@pytest.mark.parametrize(("n", "expected"), LISTS)
def test_every_state_has_all_pairs_that_are_close(n, expected):
    position, near = tissue(n)
    found = {near.update(position)}
    for state in walk(position):
        found.add(near.update(state))
        listed = near.pairs.pairs()
        pairs = close(state, near.reach)
        assert len(pairs) > 4 * n
        assert np.isin(pairs @ [n, 1], listed @ [n, 1]).all()
        drift = np.linalg.norm(state - near.reference, axis=1)
        assert (drift <= near.margin).all()
    assert found == expected


def test_lists_of_before_are_left_as_they_were():
    position, near = tissue(MANY)
    near.update(position)
    known = []
    for state in walk(position):
        known.append((near.pairs, near.pairs.pairs()))
        near.update(state)
    assert len({id(pairs) for pairs, _ in known}) == len(known)
    for pairs, before in known:
        np.testing.assert_array_equal(pairs.pairs(), before)


@pytest.mark.parametrize("n", [FEW, MANY])
def test_a_compiled_loop_makes_the_same_lists(n):
    position, near = tissue(n)
    _, other = tissue(n)
    compiled, arrays = typed(**{**KERNEL, "cache": False})(update_list), other.hand_out()
    calls = updating.kernel_calls(position, other.reach, other.chunk, arrays, shared=False)
    places = {name: address_of(*call) for name, call in calls.items()}
    for state in (position, *walk(position)):
        expected = near.update(state)
        found, arrays = compiled(
            places["rebuild_at"], places.get("repair_at", 0), state, other.reference, other.reach,
            other.margin, other.least, other.chunk, arrays, *arrays[:2],
        )  # fmt: skip
        other.adopt(arrays)
        assert found == expected
        np.testing.assert_array_equal(other.margin, near.margin)
        np.testing.assert_array_equal(other.reference, near.reference)
        for start, end in zip(near.pairs.start, near.pairs.outer_end, strict=True):
            for name in ("first", "second"):
                mine, theirs = getattr(near.pairs, name), getattr(other.pairs, name)
                np.testing.assert_array_equal(mine[start:end], theirs[start:end])


@pytest.mark.slow
def test_after_too_many_pairs_there_is_no_list_until_the_next_state():
    position, near = tissue(20_000)
    near.update(position)
    assert near.update(np.zeros_like(position)) == updating.TOO_CROWDED
    assert near.pairs is None
    assert near.update(position) == updating.BUILT
    assert np.isin(
        close(position, near.reach) @ [20_000, 1], near.pairs.pairs() @ [20_000, 1]
    ).all()


def test_the_memory_of_a_list_serves_that_of_the_next_step():
    position, near = tissue(FEW)
    near.update(position)
    arrays = near.pairs.first, near.pairs.second
    after = neighbours.NeighbourList(near.reach, LEAST, chunk=256, room=near.release(FEW))
    assert near.pairs is None
    after.update(position)
    assert np.shares_memory(after.pairs.first, arrays[0])
    assert np.shares_memory(after.pairs.second, arrays[1])
    # a list much larger than the next one needs is not kept
    assert [len(part) for part in after.release(1)] == [0, 0]


@pytest.mark.parametrize("n", [0, 1])
def test_none_and_one_have_no_pairs(n):
    near = neighbours.NeighbourList(np.ones(n), LEAST)
    assert near.update(np.zeros((n, 3))) == updating.BUILT
    assert len(near.pairs) == 0
    np.testing.assert_array_equal(near.reference, np.zeros((n, 3)))
