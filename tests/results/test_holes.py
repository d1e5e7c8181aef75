"""The largest hole in tissue, of holes that are known."""

import numpy as np
import pytest
from synthetic import cells_at

from multicell.biology.initial import packed_ball
from multicell.results.observables import largest_hole


def _without(inside):
    """A dense ball of cells of 5 µm, less those that a function of the position takes out."""
    x = packed_ball(3000) * 9.5
    x = x + np.random.default_rng(1).normal(scale=0.3, size=x.shape)
    return cells_at(x[~inside(x)], radius=5.0)


def test_dense_tissue_has_no_hole_of_the_size_of_a_cell():
    assert 0.0 < largest_hole(_without(lambda x: np.zeros(len(x), bool))) < 5.0


@pytest.mark.parametrize(("size", "shift"), [(15.0, 30.0), (35.0, 0.0)])
def test_a_ball_that_is_taken_out_is_found(size, shift):
    cells = _without(lambda x: np.linalg.norm(x - [shift, 0, 0], axis=1) < size + 5.0)
    nearest = np.linalg.norm(cells.position - [shift, 0, 0], axis=1).min() - 5.0
    # the largest empty ball may lie beside the centre of what was taken out
    assert nearest - 0.5 < largest_hole(cells) < nearest + 3.0


def test_what_is_open_to_the_outside_is_no_hole():
    well = _without(lambda x: (np.hypot(x[:, 0], x[:, 1]) < 25.0) & (x[:, 2] > -30.0))
    assert largest_hole(well) < 5.0


def test_few_cells_and_cells_in_a_plane_have_no_inside():
    assert np.isnan(largest_hole(cells_at(np.eye(3) * 10.0, radius=5.0)))
    flat = np.random.default_rng(2).uniform(-50, 50, (30, 3)) * [1, 1, 0]
    assert np.isnan(largest_hole(cells_at(flat, radius=5.0)))
