"""A list that is repaired where few cells have drifted holds what a list of its own would."""

from dataclasses import replace

import numpy as np
import pytest
from strategies import cluster

from multicell.compiling.threads import launch
from multicell.mechanics import neighbours
from multicell.mechanics.neighbours import repairing

LEAST = 0.3


def prepared(n, seed, chunk):
    """Return the arrays of a list with margins, as :func:`repairing.repair` takes them."""
    position, radius, _ = cluster(n, seed)
    margin = np.full(n, LEAST)
    pairs = neighbours.build(position, radius + margin, 0.0, chunk=chunk)
    return position, radius, margin, pairs


def repaired(run, position, reference, radius, margin, pairs):
    """Return whether it was repaired, and the list."""
    first, second = pairs.first.copy(), pairs.second.copy()
    done, inner_end, outer_end = run(
        position, reference, radius, margin, LEAST, pairs.chunk, first, second, pairs.start,
        pairs.inner_end, pairs.outer_end,
    )  # fmt: skip
    ends = pairs.start, inner_end, outer_end
    return done, neighbours.PairList(first, second, *ends, pairs.chunk, pairs.n)


def expect_complete(pairs, reference, wide):
    """Expect all pairs of a list built at the references, and few others, which move apart."""
    n = len(wide)
    expected = neighbours.build(reference, wide, -1e-9).pairs()
    found = pairs.pairs()
    assert np.isin(expected @ [n, 1], found @ [n, 1]).all()
    assert len(found) == len(pairs) < 1.1 * len(expected)


@pytest.mark.parametrize(
    "run", [repairing.repair, pytest.param(repairing.repair_parallel, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("chunk", [64, 333, 2048])
def test_repeated_repairs_leave_the_pairs_of_a_list_built_at_the_references(run, chunk):
    launch()
    reference, radius, margin, pairs = prepared(2000, 1, chunk)
    position, rng = reference.copy(), np.random.default_rng(2)
    for length in (0.2, 0.5, 2.0, 5.0, 0.2, 1.0):
        walkers = rng.choice(2000, rng.integers(1, 120), replace=False)
        position[walkers] += rng.normal(0.0, length, (len(walkers), 3))
        done, pairs = repaired(run, position, reference, radius, margin, pairs)
        assert done
        expect_complete(pairs, reference, radius + margin)
        # chunk by chunk: outer ones stand in both, with the chunk's own cell first
        inside, outside = [], []
        for c in range(len(pairs.start)):
            own = pairs.first[pairs.start[c] : pairs.outer_end[c]] // chunk
            assert (own == c).all()
            both = np.stack([pairs.first, pairs.second], axis=1)
            inside.append(both[pairs.start[c] : pairs.inner_end[c]])
            outside.append(both[pairs.inner_end[c] : pairs.outer_end[c]])
            assert (inside[-1] // chunk == c).all()
            assert (outside[-1][:, 1] // chunk != c).all()
        inner, outer = np.concatenate(inside), np.concatenate(outside)
        assert len(np.unique(np.sort(inner, axis=1), axis=0)) == len(inner)
        assert len(np.unique(outer, axis=0)) == len(outer)
        assert set(map(tuple, outer)) == set(map(tuple, outer[:, ::-1]))
        # everyone has some margin left
        drift = np.linalg.norm(position - reference, axis=1)
        assert (drift <= 0.87 * margin).all()


def test_cells_that_move_and_spread_together_keep_their_list():
    reference, radius, margin, pairs = prepared(2000, 5, 333)
    position = 1.1 * reference + [50.0, -20.0, 7.0]
    assert (np.linalg.norm(position - reference, axis=1) > 10.0 * LEAST).all()
    position[::100] += 1.0
    done, pairs = repaired(repairing.repair, position, reference, radius, margin, pairs)
    assert done
    assert (margin[::100] > LEAST).all()
    assert (margin > LEAST).sum() == 20
    expect_complete(pairs, reference, radius + margin)


def test_cells_that_come_closer_together_do_not():
    reference, radius, margin, pairs = prepared(2000, 5, 333)
    done, _ = repaired(repairing.repair, 0.9 * reference, reference, radius, margin, pairs)
    assert not done


def test_threads_do_not_change_the_order_of_the_pairs():
    launch()
    lists = []
    for run in (repairing.repair, repairing.repair_parallel):
        reference, radius, margin, pairs = prepared(2000, 4, 100)
        position = reference.copy()
        position[::40] += 1.0
        lists.append(repaired(run, position, reference, radius, margin, pairs)[1])
    for c in range(len(lists[0].start)):
        used = [slice(one.start[c], one.outer_end[c]) for one in lists]
        np.testing.assert_array_equal(lists[0].first[used[0]], lists[1].first[used[1]])
        np.testing.assert_array_equal(lists[0].second[used[0]], lists[1].second[used[1]])


def drifted(position):
    position[::4] += np.random.default_rng(0).normal(0.0, 2.0, (250, 3))


def flown_apart(position):
    position[5] = 1e9


def in_one_place(position):
    """Each of 60 is close to all, and the list has no room for so many pairs."""
    position[:60] = position[0]


@pytest.mark.parametrize("move", [drifted, flown_apart, in_one_place])
def test_what_cannot_be_repaired_asks_for_a_new_list_and_is_left_as_it_was(move):
    reference, radius, margin, pairs = prepared(1000, 3, 2048)
    end = int(pairs.outer_end[-1])
    pairs = replace(pairs, first=pairs.first[:end].copy(), second=pairs.second[:end].copy())
    position, before = reference.copy(), margin.copy()
    move(position)
    done, after = repaired(repairing.repair, position, reference, radius, margin, pairs)
    assert not done
    np.testing.assert_array_equal(margin, before)
    np.testing.assert_array_equal(after.pairs(), pairs.pairs())


def test_a_chunk_all_of_whose_cells_drift_has_room_for_their_new_pairs():
    """Daughters stand at the end, and so in chunks of their own."""
    reference, radius, margin, pairs = prepared(2560, 3, 256)
    last = slice(int(pairs.start[-1]), int(pairs.outer_end[-1]))
    end = last.stop + (last.stop - last.start) // 2
    pairs = replace(pairs, first=pairs.first[:end].copy(), second=pairs.second[:end].copy())
    position = reference.copy()
    position[-250:] += np.random.default_rng(0).normal(0.0, 0.3, (250, 3))
    done, pairs = repaired(repairing.repair, position, reference, radius, margin, pairs)
    assert done
    expect_complete(pairs, reference, radius + margin)


def test_no_list_asks_for_a_new_list():
    reference, radius, margin, pairs = prepared(100, 3, 2048)
    position = reference.copy()
    reference[:] = np.nan
    done, _ = repaired(repairing.repair, position, reference, radius, margin, pairs)
    assert not done
    assert np.isnan(reference).all()
