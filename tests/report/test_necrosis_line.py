"""The line round the necrotic core: against the sum over all cells, and where there is none."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from synthetic import SCENE, ball, cells_at, spheroid

from multicell.cells import State
from multicell.report.plots.run import Plots
from multicell.report.plots.section import LABEL, _smooth, necrotic_share


def core(radius, count=4000):
    """Return a ball of cells that are dead within a radius of its centre."""
    cells = cells_at(ball(count))
    apart = np.linalg.norm(cells.position, axis=1)
    cells.state[:] = np.where(apart < radius, State.NECROTIC, State.QUIESCENT)
    return cells


def test_the_share_is_that_of_a_bell_over_all_cells():
    cells = core(30.0)
    x, y, share = necrotic_share(cells, cells.position, 5.0)
    width = 1.5 * cells.radius.mean()
    for i, j in ((len(x) // 2, len(y) // 2), (len(x) // 3, len(y) // 2), (len(x) // 4, 10)):
        apart = np.linalg.norm(cells.position - [x[i], y[j], 5.0], axis=1)
        bell = np.exp(-0.5 * (apart / width) ** 2)
        exact = bell[cells.state == State.NECROTIC].sum() / bell.sum()
        assert share[j, i] == pytest.approx(exact, abs=0.03)


@pytest.mark.parametrize("radius", [25.0, 40.0])
def test_the_line_is_where_the_core_ends(radius):
    cells = core(radius)
    x, y, share = necrotic_share(cells, cells.position, 0.0)
    width = 1.5 * cells.radius.mean()
    inside = (np.nan_to_num(share) > 0.5).sum() * (x[1] - x[0]) * (y[1] - y[0])
    assert np.sqrt(inside / np.pi) == pytest.approx(
        radius - width**2 / radius,
        abs=1.5,  # averages over a bell draw a curved edge inwards
    )


def test_no_line_without_dead_cells_or_round_few_of_them():
    cells = core(0.0)
    assert necrotic_share(cells, cells.position, 0.0) is None
    cells.state[:: len(cells) // 40] = State.NECROTIC
    assert np.nanmax(necrotic_share(cells, cells.position, 0.0)[2]) < 0.5


def test_the_legend_names_no_line_that_is_not_drawn():
    figure = Plots([spheroid(500)], {}, SCENE).section()
    assert LABEL not in {text.get_text() for x in figure.legends for text in x.get_texts()}


@pytest.mark.parametrize("width", [0.7, 4.0])
def test_smoothing_is_that_of_scipy(width):
    values = np.random.default_rng(3).random((40, 23))
    values[:5] = 0.0
    found = _smooth(values, width)
    expected = gaussian_filter(values, width, mode="constant", truncate=9.0)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)
