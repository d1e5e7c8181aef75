"""Measures of a population against closed forms."""

import numpy as np
import pytest
from synthetic import BARE, ball, cells_at, spheroid

from multicell.cells import Cells, Phase, State
from multicell.population import extents
from multicell.results import observables
from multicell.results.frame import Field, Frame
from multicell.results.observable import TissueState
from multicell.results.summary import history_row


def _uniform_ball(radius, count=200_000, seed=3):
    """Return points of a uniform ball, with the radius by inversion of its distribution."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return direction * (radius * rng.random(count) ** (1 / 3))[:, None]


def test_two_cells_follow_the_parallel_axis_theorem_and_weigh_as_their_volumes():
    cells = cells_at([[-6.0, 0.0, 0.0], [6.0, 0.0, 0.0]], radius=5.0)
    expected = np.sqrt(5.0 / 3.0 * (36.0 + 0.6 * 25.0))
    assert extents.Extent(cells, 3).diameter() == pytest.approx(2.0 * expected, rel=1e-14)
    cells = cells_at([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]], radius=[2.0, 1.0])
    np.testing.assert_allclose(extents.centre(cells, 3), [1.0, 0.0, 0.0], rtol=1e-14)


def test_uniform_ball_is_measured_with_its_own_radius():
    cells = cells_at(_uniform_ball(100.0) + np.array([30.0, 0.0, -8.0]), radius=0.5)
    # standard error of the mean square distance: sqrt(12/175) R^2 / sqrt(n), half of it in R
    assert extents.Extent(cells, 3).diameter() == pytest.approx(200.0, rel=4 * 0.262 / 2 / 447)


def test_packed_ball_does_not_depend_on_the_cells_overlap():
    position = ball(4000, jitter=0.0)
    small, large = (extents.Extent(cells_at(position, radius=r), 3).diameter() for r in (1.0, 5.0))
    expected = 2.0 * (3 * 4000 * 8.4**3 / np.sqrt(2) / (4 * np.pi)) ** (1 / 3)
    assert small == pytest.approx(expected, rel=5e-3)
    # exactly R^2 + r^2: only the cells' own extent differs
    assert large**2 - small**2 == pytest.approx(4.0 * (25.0 - 1.0), rel=1e-9)


def test_layers_of_a_ball_give_core_rims_and_the_part_that_proliferates():
    """A ball of radius 100 whose cells are necrotic within 60 and quiescent up to 80 µm."""
    position = _uniform_ball(100.0)
    states = np.array([State.NECROTIC, State.QUIESCENT, State.PROLIFERATING])
    layer = np.digitize(np.linalg.norm(position, axis=1), [60.0, 80.0])
    state = states[layer]
    frame = Frame(0.0, 0, cells_at(position, radius=0.2, state=state), {})
    row = history_row(TissueState(frame, BARE.with_changes({"growth": {}})))
    assert row["proliferating_rim"] == pytest.approx(20.0, rel=2e-2)
    assert row["viable_rim"] == pytest.approx(40.0, rel=1e-2)
    assert row["necrotic_radius"] == pytest.approx(60.0, rel=4e-3)
    names = ("necrotic", "quiescent", "proliferating", "apoptotic")
    assert [row[name] for name in names] == np.bincount(layer, minlength=4).tolist()
    assert row["radius"] == pytest.approx(0.5 * row["diameter"])
    part = (1.0 - 0.8**3) / (1.0 - 0.6**3)
    assert row["growth_fraction"] == pytest.approx(part, abs=4 * (part / len(position)) ** 0.5)


def test_no_cells_have_no_size_and_no_centre():
    cells = Cells.empty()
    row = history_row(TissueState(Frame(600.0, 1, cells, {}), BARE))
    assert row["cells"] == row["diameter"] == row["necrotic_radius"] == 0.0
    assert np.isnan([row["viable_rim"], row["packing_ratio"]]).all()
    with pytest.raises(ValueError, match="no centre"):
        extents.centre(cells, 3)


def test_measures_do_not_depend_on_the_order_of_cells():
    cells = spheroid(500).cells
    turned = cells.take(np.random.default_rng(5).permutation(len(cells)))
    first, second = (history_row(TissueState(Frame(0.0, 0, c, {}), BARE)) for c in (cells, turned))
    assert second == pytest.approx(first, rel=1e-12, nan_ok=True)


def test_history_row_holds_floats_and_extra_columns():
    frame = spheroid(300)
    row = history_row(TissueState(frame, BARE), evaluations=17)
    assert all(type(value) is float for value in row.values())
    assert row["evaluations"] == 17.0
    assert row["cells"] == row["proliferating"] + row["quiescent"] + row["necrotic"]
    assert row["largest_pressure"] == frame.cells.pressure.max()


def test_profile_counts_every_cell_once_and_fractions_add_up():
    frame = spheroid(4000)
    profile = observables.radial_profile(frame, 3, bins=12)
    assert profile.counts.sum() == len(frame.cells)
    filled = profile.counts > 0
    np.testing.assert_allclose(sum(profile.fractions.values())[filled], 1.0, rtol=1e-14)
    assert profile.fractions["necrotic"][0] == 1.0
    assert profile.fractions["proliferating"][-1] == 1.0


def test_profile_of_a_linear_concentration_is_its_mean_by_shell():
    cells = cells_at([[-9.0, 0, 0], [9.0, 0, 0], [-3.0, 0, 0], [3.0, 0, 0]], radius=1.0)
    frame = Frame(0.0, 0, cells, {"oxygen": np.array([9.0, 11.0, 2.0, 4.0])})
    profile = observables.radial_profile(frame, 3, bins=3)
    np.testing.assert_allclose(profile.edges, [0.0, 3.0, 6.0, 9.0])
    np.testing.assert_array_equal(profile.counts, [0, 2, 2])
    np.testing.assert_allclose(profile.concentrations["oxygen"], [np.nan, 3.0, 10.0])


def test_field_profile_of_the_squared_radius():
    n, spacing = 40, 2.0
    axis = (np.arange(n) + 0.5) * spacing
    middle = np.full(3, 0.5 * n * spacing)
    x, y, z = np.meshgrid(*[axis - middle[0]] * 3, indexing="ij")
    field = Field("oxygen", "mM", np.zeros(3), spacing, x**2 + y**2 + z**2)
    edges = np.array([0.0, 15.0, 30.0, 39.0])
    means = observables.field_profile(field, middle, edges)
    a, b = edges[:-1], edges[1:]
    np.testing.assert_allclose(means, 0.6 * (b**5 - a**5) / (b**3 - a**3), rtol=2e-2)


def _with_cycling_share(share, count=20_000, radius=100.0):
    """Return a uniform ball in which each cell is in S with the given chance at its distance."""
    position = _uniform_ball(radius, count)
    chance = share(np.linalg.norm(position, axis=1))
    cycling = np.random.default_rng(5).random(count) < chance
    cells = cells_at(position, radius=1.0)
    cells.phase = np.where(cycling, Phase.S, Phase.G1).astype(np.int8)
    return cells


@pytest.mark.parametrize("edge", [0.0, 30.0, 95.0])
def test_inhibited_radius_is_where_cycling_stops(edge):
    cells = _with_cycling_share(lambda r: 0.5 * (r > edge))
    assert extents.inhibited_radius(cells, 3) == pytest.approx(edge, abs=1.0)


def test_inhibited_radius_is_at_a_fifth_of_the_share_at_the_surface():
    # the outermost tenth of the cells begins at 100 * 0.9^(1/3) um and has a mean share near 0.6
    cells = _with_cycling_share(lambda r: 0.6 * np.clip((r - 20.0) / 70.0, 0.0, 1.0))
    assert extents.inhibited_radius(cells, 3) == pytest.approx(20.0 + 0.2 * 70.0, abs=3.0)


def test_cells_that_died_in_s_do_not_cycle():
    cells = _with_cycling_share(lambda r: 0.5 * np.ones_like(r))
    core = np.linalg.norm(cells.position, axis=1) < 50.0
    cells.state = np.where(core, State.NECROTIC, cells.state).astype(np.int8)
    assert extents.inhibited_radius(cells, 3) == pytest.approx(50.0, abs=1.0)
