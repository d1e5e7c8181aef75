"""Scatter and gather against py-pde, and their laws: unity, conservation, adjointness."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pde import ScalarField
from pde.grids.cartesian import CartesianGrid
from plain_pde import uncompiled

from multicell.nutrient.balls import gather, scatter
from multicell.nutrient.cartesian import Box

ORIGIN = (-30.0, 5.0, 100.0)
SPACING = 7.5
SHAPE = (5, 6, 7)
SIZE = SPACING * np.array(SHAPE)
BOX = Box(ORIGIN, SHAPE, SPACING)


def pde_grid():
    return CartesianGrid([(a, a + s) for a, s in zip(ORIGIN, SIZE, strict=True)], SHAPE)


def points(n=40, seed=3):
    """Return points in the box: inside, within half a spacing of the faces, and at nodes."""
    share = np.random.default_rng(seed).random((n, 3))
    share[: n // 4] *= 0.5 / max(SHAPE)
    share[n // 4 : n // 2] = 1.0 - share[n // 4 : n // 2] * 0.5 / max(SHAPE)
    share[-1] = (0.5 + np.array([0, 2, 6])) / SHAPE
    return np.asarray(ORIGIN) + share * SIZE


inside = st.lists(st.tuples(*[st.floats(0.0, 1.0) for _ in range(3)]), min_size=1, max_size=20).map(
    lambda rows: np.asarray(ORIGIN) + np.array(rows) * SIZE * (1 - 1e-12)
)


def test_scatter_agrees_with_pde_insert_also_near_the_faces():
    position = points()
    amount = np.random.default_rng(4).uniform(-1.0, 3.0, len(position))
    theirs = ScalarField(pde_grid(), 0.0)
    for x, a in zip(position, amount, strict=True):
        theirs.insert(x, a)
    ours = scatter(BOX, position, amount)
    np.testing.assert_allclose(ours, theirs.data, rtol=0, atol=1e-15)


def test_gather_agrees_with_pde_interpolate_also_near_the_faces():
    values = np.random.default_rng(5).random(SHAPE)
    position = points()
    with uncompiled():
        theirs = ScalarField(pde_grid(), values).interpolate(position)
    np.testing.assert_allclose(gather(BOX, position, values), theirs, atol=1e-14)


@given(inside, st.integers(0, 99))
def test_gather_is_the_transpose_of_scatter(position, seed):
    rng = np.random.default_rng(seed)
    amount, values = rng.random(len(position)), rng.random(SHAPE)
    left = np.sum(scatter(BOX, position, amount) * values) * SPACING**3
    right = np.sum(amount * gather(BOX, position, values))
    assert left == pytest.approx(right, rel=1e-12)


@pytest.mark.parametrize("bad", [-1e-9, np.nan, np.inf, -np.inf, 1e300])
def test_positions_outside_are_refused(bad):
    position = points(4)
    position[2, 1] = ORIGIN[1] + bad
    with pytest.raises(ValueError, match=r"row 2.*outside"):
        scatter(BOX, position, np.ones(4))
    with pytest.raises(ValueError, match=r"row 2.*outside"):
        gather(BOX, position, np.ones(SHAPE))


@pytest.mark.slow
def test_read_only_arrays_and_no_cells_are_fine():
    position, values = points(4), np.ones(SHAPE)
    position.flags.writeable = values.flags.writeable = False
    np.testing.assert_allclose(gather(BOX, position, values), 1.0)
    assert not scatter(BOX, np.empty((0, 3)), np.empty(0)).any()


def test_as_many_amounts_as_positions_are_asked_for():
    with pytest.raises(ValueError, match="amount has shape"):
        scatter(BOX, points(4), np.ones(3))


@given(inside, st.integers(0, 99))
def test_scatter_conserves_the_amount_and_keeps_its_sign(position, seed):
    amount = np.random.default_rng(seed).random(len(position))
    density = scatter(BOX, position, amount)
    assert density.min() >= 0.0
    assert density.sum() * SPACING**3 == pytest.approx(amount.sum(), rel=1e-13)


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match="amount has shape"):
        scatter(BOX, points(4), np.ones(3))
    with pytest.raises(ValueError, match="position has shape"):
        gather(BOX, np.zeros((2, 2)), np.ones(SHAPE))
    with pytest.raises(ValueError, match="values has shape"):
        gather(BOX, points(4), np.ones(3))
