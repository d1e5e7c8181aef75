"""Random streams: NumPy's Philox bit for bit, distributions by SciPy, independence of order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from multicell import random as streams
from multicell.errors import SceneError
from multicell.random import Purpose

IDS = np.arange(20_000)
WORD = st.integers(0, 2**64 - 1)


def numpy_block(counter: list[int], key: list[int]) -> list[int]:
    """Return NumPy's block at ``counter``: its generator counts up by one before it draws."""
    number = (sum(word << (64 * i) for i, word in enumerate(counter)) - 1) % 2**256
    before = [(number >> (64 * i)) % 2**64 for i in range(4)]
    generator = np.random.Philox(
        key=np.array(key, dtype=np.uint64), counter=np.array(before, dtype=np.uint64)
    )
    return generator.random_raw(4).tolist()


@settings(deadline=None, max_examples=200)
@given(st.lists(WORD, min_size=4, max_size=4), st.lists(WORD, min_size=2, max_size=2))
def test_philox_equals_numpy_bit_for_bit(counter: list[int], key: list[int]) -> None:
    block = streams.philox(np.array(counter, dtype=np.uint64), (key[0], key[1]))
    assert block.tolist() == numpy_block(counter, key)


def test_uniform_places_seed_purpose_step_and_id_as_documented() -> None:
    got = streams.uniform(2**64 - 5, Purpose.AXIS, 17, np.array([123_456]), 8)[0]
    raw = [
        word
        for block in range(2)
        for word in numpy_block([block, 17, 123_456, 0], [2**64 - 5, Purpose.AXIS])
    ]
    assert got.tolist() == [(word >> 11) / 2**53 for word in raw]


@pytest.mark.parametrize("draw", [streams.uniform, streams.normal])
def test_more_numbers_begin_with_the_same_blocks(draw) -> None:
    few, many = (draw(3, Purpose.STAGE, 0, IDS[:50], count) for count in (4, 5))
    assert few.shape == (50, 4)
    assert many.shape == (50, 5)
    uniform = streams.uniform(3, Purpose.STAGE, 0, IDS[:50], 5)
    np.testing.assert_array_equal(uniform[:, :4], streams.uniform(3, Purpose.STAGE, 0, IDS[:50], 4))


@pytest.mark.parametrize(
    "draw",
    [
        lambda ids: streams.uniform(5, Purpose.CYCLE, 9, ids, 3),
        lambda ids: streams.normal(5, Purpose.CYCLE, 9, ids, 3),
        lambda ids: streams.truncated_normal(5, Purpose.CYCLE, 9, ids, 1.0),
        lambda ids: streams.directions(5, Purpose.CYCLE, 9, ids, 3),
    ],
    ids=["uniform", "normal", "truncated_normal", "directions"],
)
def test_a_cell_gets_the_same_bits_in_any_order_and_company(draw) -> None:
    ids = IDS[:1001]
    everyone = draw(ids)
    order = np.random.default_rng(0).permutation(len(ids))
    np.testing.assert_array_equal(draw(ids[order]), everyone[order])
    np.testing.assert_array_equal(draw(ids[7:8]), everyone[7:8])
    assert len(draw(ids[:0])) == 0


def test_uniform_distribution_in_all_columns() -> None:
    u = streams.uniform(1, Purpose.STAGE, 4, IDS, 5)
    assert u.min() >= 0.0
    assert u.max() < 1.0
    assert all(stats.kstest(column, "uniform").pvalue > 1e-3 for column in u.T)


def test_streams_are_independent_of_each_other() -> None:
    base = streams.uniform(1, Purpose.CYCLE, 4, IDS, 2)
    others = [
        streams.uniform(2, Purpose.CYCLE, 4, IDS)[:, 0],
        streams.uniform(1, Purpose.MODULI, 4, IDS)[:, 0],
        streams.uniform(1, Purpose.CYCLE, 5, IDS)[:, 0],
        streams.uniform(1, Purpose.CYCLE, 4, IDS, attempt=1)[:, 0],
        np.roll(base[:, 0], 1),
        base[:, 1],
    ]
    for other in others:
        assert abs(np.corrcoef(base[:, 0], other)[0, 1]) < 4 / np.sqrt(len(IDS))


def test_normal_distribution() -> None:
    z = streams.normal(8, Purpose.PLACEMENT, 0, IDS, 3)
    assert all(stats.kstest(column, "norm").pvalue > 1e-3 for column in z.T)
    correlation = np.corrcoef(z.T) - np.eye(3)
    assert np.abs(correlation).max() < 4 / np.sqrt(len(IDS))


@pytest.mark.parametrize("limit", [0.5, 1.8, 3.0])
def test_truncated_normal_is_the_conditional_distribution(limit: float) -> None:
    z = streams.truncated_normal(8, Purpose.CYCLE, 2, IDS, limit)
    assert np.abs(z).max() <= limit
    # none sits on the limit, as clipped numbers would
    assert np.count_nonzero(np.abs(z) == limit) == 0
    assert stats.kstest(z, stats.truncnorm(-limit, limit).cdf).pvalue > 1e-3


def test_unit_vectors_are_uniform_on_the_sphere() -> None:
    v = streams.directions(8, Purpose.AXIS, 2, IDS, 3)
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), 1.0, rtol=1e-15)
    # any projection of a uniform direction is uniform in [-1, 1]
    for direction in np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.48, 0.64]]):
        assert stats.kstest(v @ direction, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    azimuth = np.arctan2(v[:, 1], v[:, 0])
    assert stats.kstest(azimuth, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3


def test_bad_keys_are_refused_with_words() -> None:
    for seed in (-1, 2**64):
        with pytest.raises(SceneError, match=f"seed: is {seed}, must be a whole number"):
            streams.uniform(seed, Purpose.AXIS, 0, IDS[:1])
    for step, ids, count in ((-1, IDS[:1], 1), (0, np.array([-1]), 1), (0, IDS[:1], -1)):
        with pytest.raises(ValueError, match="must not be negative"):
            streams.uniform(0, Purpose.AXIS, step, ids, count)
    with pytest.raises(ValueError, match=r"limit is 0\.0"):
        streams.truncated_normal(0, Purpose.AXIS, 0, IDS[:1], 0.0)


def test_purposes_keep_their_numbers() -> None:
    # results of old seeds depend on them
    assert {p.name: p.value for p in Purpose} == {
        "PLACEMENT": 1, "STAGE": 2, "CYCLE": 3, "MODULI": 4, "AXIS": 5, "SEPARATION": 6,
        "KIND": 7, "MOTILITY": 8, "PHASES": 9, "APOPTOSIS": 10, "NECROSIS": 11,
        "CONDITIONING": 12, "EIGENVECTOR": 13, "VIEW": 14, "RENEWAL": 15,
        "REST": 16, "CHANGE": 17, "MUTATION": 18, "RADIATION": 19, "DRIFT": 20,
        "TOLERANCE": 21,
        "ASYMMETRY": 22,
        "NETWORK": 23,
        "NETWORK_DIVISION": 24,
        "BROWNIAN": 25,
    }  # fmt: skip


def test_philox_known_answers_of_the_authors() -> None:
    # kat_vectors of the Random123 distribution, philox4x64-10
    zeros = streams.philox(np.zeros(4, dtype=np.uint64), (0, 0))
    assert [f"{word:016x}" for word in zeros.tolist()] == [
        "16554d9eca36314c", "db20fe9d672d0fdc", "d7e772cee186176b", "7e68b68aec7ba23b",
    ]  # fmt: skip
