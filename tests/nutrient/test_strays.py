"""Cells that have left the tissue: the unstirred layer stays round the tissue."""

import numpy as np
import pytest
from running import finished

import multicell as mc
from multicell.nutrient import cartesian, tissue
from multicell.nutrient.field import NutrientField
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.tissue import Tissue, drawn_in, drawn_to_ball
from multicell.scene.nutrient import Nutrient

RADIUS = 5.0
FAR = 300.0 * np.vstack([np.eye(3), -np.eye(3)])  # six cells, one along each direction
GEOMETRIES = {
    "cubes": {},
    "shells": {"geometry": "radial"},
    "layer": {"geometry": "radial", "layer": 40.0},
    "either": {"geometry": "auto"},
}


def ball(count=800, middle=(0.0, 0.0, 0.0), seed=1):
    """Return cells at random in a ball about as dense as tissue."""
    rng = np.random.default_rng(seed)
    across = RADIUS * (count / 0.7) ** (1.0 / 3.0)
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    return np.array(middle) + across * way * rng.random((count, 1)) ** (1.0 / 3.0)


def field(dimensions=3, regime="steady", **keys):
    nutrient = Nutrient(**{"boundary": 0.07, "uptake": 20.0, "spacing": 8.0, **keys})
    return NutrientField("oxygen", FieldParameters(nutrient, 8.0, 10.0, regime, dimensions))


def solved(position, **keys):
    found = field(**keys)
    n = len(position)
    report = found.solve(position, np.full(n, 20.0), radius=np.full(n, RADIUS))
    return found, report


def at_middle(position, **keys):
    found, _ = solved(position, **keys)
    return float(found.sample(np.zeros((1, 3)))[0])


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_six_cells_far_away_leave_the_middle_as_it_is(geometry):
    alone = at_middle(ball(), **GEOMETRIES[geometry])
    with_strays = at_middle(np.vstack([ball(), FAR]), **GEOMETRIES[geometry])
    assert with_strays == pytest.approx(alone, rel=0.01)


def test_six_cells_together_far_away_leave_the_middle_as_it_is():
    clump = np.array([300.0, 20.0, 0.0]) + 8.0 * np.vstack([np.eye(3), -np.eye(3)])
    assert at_middle(np.vstack([ball(), clump])) == pytest.approx(at_middle(ball()), rel=0.01)


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_cells_beyond_the_grid_find_the_medium_and_no_gradient(geometry):
    found, _ = solved(np.vstack([ball(), FAR]), **GEOMETRIES[geometry])
    np.testing.assert_allclose(found.sample(FAR), 0.07, rtol=1e-5)
    assert (found.gradient(FAR) == 0.0).all()
    assert (np.abs(found.gradient(ball())) > 0.0).any()


def test_their_uptake_is_part_of_the_balance():
    """Uptake of strays comes in over the sides: nearly their uptake in the medium."""
    _, alone = solved(ball())
    _, both = solved(np.vstack([ball(), FAR]))
    more = both.uptake - alone.uptake
    assert more == pytest.approx(6 * 20.0 * 0.07 / 0.075, rel=0.01)
    assert abs(both.inflow - both.uptake) < 1e-8 * both.uptake


@pytest.mark.parametrize("regime", ["steady", "transient"])
def test_the_account_of_a_run_with_strays_closes(regime):
    base = mc.load_scene("spheroid").with_changes({
        "duration": "1 h", "initial.count": 400, "growth": None, "death": None,
        "nutrients.oxygen.regime": regime, "nutrients.oxygen.secretion": 1.0,
    })  # fmt: skip
    cells = mc.Simulation(base).cells
    cells.position[np.argsort(-cells.position[:, 0])[:3]] += [300.0, 0.0, 0.0]
    simulation = finished(base, cells=cells)
    assert simulation.ledger["oxygen"].uptake > 0.0
    assert simulation.ledger["oxygen"].relative_remainder < 1e-8
    assert simulation.fields["oxygen"].values.size < 40**3
    far = simulation.cells.position[:, 0] > 200.0
    assert far.sum() == 3
    boundary = base.nutrients["oxygen"].boundary
    np.testing.assert_allclose(simulation.concentrations["oxygen"][far], boundary, rtol=1e-4)


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_a_cell_that_leaves_makes_no_jump(geometry):
    """Between steps of 1 µm the middle changes by less than 0.1 %, and ends where it was."""
    cells = ball()
    edge = cells[:, 0].max()
    course = [
        at_middle(np.vstack([cells, [[edge + gap, 0.0, 0.0]]]), **GEOMETRIES[geometry])
        for gap in np.arange(0.0, 90.0, 1.0)
    ]
    steps = np.abs(np.diff(course)) / course[0]
    assert steps.max() < 1e-3
    assert course[-1] == pytest.approx(at_middle(cells, **GEOMETRIES[geometry]), rel=1e-3)


def test_both_of_two_balls_have_the_layer():
    """Neither is a stray of the other, also where one has a fifth of the cells."""
    pair = np.vstack([ball(800), ball(200, (400.0, 0.0, 0.0), seed=2)])
    found, _ = solved(pair)
    reach = pair.max(axis=0)[0] + 50.0
    assert found.layout.box.upper[0] == pytest.approx(reach, rel=1e-12)


def test_tissue_without_strays_is_left_alone():
    for count in (1, 9, 30, 1000):
        position, radius = ball(count), np.full(count, RADIUS)
        assert drawn_in(position, radius) is position
        assert drawn_to_ball(position, radius) is position


@pytest.mark.parametrize("strays", [0, 1, 9, 40])
def test_a_sample_that_shows_no_gap_changes_no_border(strays, monkeypatch):
    """A sample of the cells spares the search for gaps, and misses none that is there."""
    cells, rng = ball(9_000), np.random.default_rng(strays)
    cells[rng.choice(len(cells), strays, replace=False)] *= rng.uniform(1.0, 2.0, (strays, 1))
    found, radius = [], np.full(len(cells), RADIUS)
    whole = tissue._is_dense
    for known in (lambda *given: found.append(whole(*given)) or found[-1], lambda *_: False):
        monkeypatch.setattr(tissue, "_is_dense", known)
        found.append(drawn_in(cells, radius))
    np.testing.assert_array_equal(found[1], found[2])
    assert found[0] == (strays == 0)


def test_a_thread_of_cells_is_tissue():
    thread = np.zeros((60, 3))
    thread[:, 0] = 9.0 * np.arange(60)
    radius = np.full(60, RADIUS)
    assert drawn_in(thread, radius) is thread


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_fields_round_the_same_cells_have_the_grids_of_fields_alone(geometry, monkeypatch):
    position, radius = np.vstack([ball(400), FAR]), np.full(406, RADIUS)
    asked, departure = [], cartesian.departure
    monkeypatch.setattr(cartesian, "departure", lambda *all: asked.append(1) or departure(*all))
    together, shapes = Tissue(position, radius), []
    for margin in (40.0, 40.0, 80.0):
        one = field(**{"margin": margin} | GEOMETRIES[geometry])
        layout, reached = one.lay(together)
        alone, there = one.lay(Tissue(position, radius))
        np.testing.assert_array_equal(reached, there)
        assert not np.array_equal(reached, position)
        assert (layout.shape, layout.spacing) == (alone.shape, alone.spacing)
        shapes.append(layout.shape)
    assert shapes[0] == shapes[1]
    assert (shapes[1] != shapes[2]) == (geometry != "layer")
    assert len(asked) == (4 if geometry == "either" else 0)  # once together, three times alone
