"""Measures in two and three dimensions on discs and balls of known size, and what uses them."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import cells_at

import multicell as mc
from multicell.cells import Cells, State
from multicell.population import extents
from multicell.report.plots import contacts as contact_plots
from multicell.report.wording import measures
from multicell.results import observables
from multicell.results.frame import Frame
from multicell.results.observable import TissueState
from multicell.results.summary import history_row
from multicell.simulation import Simulation

BOTH = pytest.mark.parametrize("dimensions", [2, 3])
SHIFT = np.array([30.0, -70.0, 0.0])


def uniform(radius: float, dimensions: int, count: int = 100_000, seed: int = 3) -> np.ndarray:
    """Return points of a uniform disc or ball: the radius by inversion of its distribution."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction[:, dimensions:] = 0.0
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return direction * (radius * rng.random(count) ** (1.0 / dimensions))[:, None]


def lattice(radius: float, spacing: float, dimensions: int) -> np.ndarray:
    """Return a square or cubic lattice, cut to a disc or ball."""
    axis = np.arange(-np.ceil(radius / spacing), np.ceil(radius / spacing) + 1) * spacing
    points = np.stack(np.meshgrid(*[axis + 0.3] * dimensions, indexing="ij"), -1)
    points = points.reshape(-1, dimensions)
    points = points[np.linalg.norm(points, axis=1) < radius]
    return np.pad(points, ((0, 0), (0, 3 - dimensions)))


def moment_by_samples(cells: Cells, dimensions: int) -> float:
    """Return the mean square distance from the centroid of the cells' bodies, each on its own."""
    rng = np.random.default_rng(8)
    size = cells.radius**dimensions
    owner = rng.choice(len(cells), 400_000, p=size / size.sum())
    inner = uniform(1.0, dimensions, 400_000, seed=9)
    points = cells.position[owner] + cells.radius[owner, None] * inner
    return float(np.square(points - points.mean(axis=0)).sum(axis=1).mean())


@BOTH
def test_one_cell_has_its_own_size(dimensions):
    cells = cells_at([[40.0, -3.0, 0.0]], radius=4.5)
    living = extents.Extent(cells, dimensions)
    assert living.diameter() == pytest.approx(9.0, rel=1e-14)
    assert living.packing_ratio() == pytest.approx(1.0, rel=1e-13)
    assert living.dead_core == 0.0
    assert np.isnan(living.rim(living.dead_core))
    cells.state[:] = State.NECROTIC
    dead = extents.Extent(cells, dimensions)
    assert dead.dead_core == pytest.approx(4.5, rel=1e-14)
    assert dead.rim(dead.dead_core) == pytest.approx(0.0, abs=1e-12)


@BOTH
def test_unlike_cells_are_measured_as_their_bodies_are(dimensions):
    """Against the bodies themselves, sampled: sizes, centre and the cells' own extent."""
    rng = np.random.default_rng(2)
    position = rng.uniform(-40.0, 40.0, (12, 3))
    position[:, dimensions:] = 0.0
    cells = cells_at(position, radius=rng.uniform(1.0, 12.0, 12))
    share = dimensions / (dimensions + 2)
    expected = np.sqrt(moment_by_samples(cells, dimensions) / share)
    assert extents.Extent(cells, dimensions).diameter() == pytest.approx(2 * expected, rel=3e-3)
    size = cells.radius**dimensions
    middle = (size[:, None] * position).sum(axis=0) / size.sum()
    np.testing.assert_allclose(extents.centre(cells, dimensions), middle, rtol=1e-12)


@BOTH
def test_a_dense_tissue_with_a_core(dimensions):
    """Diameter, core, rim, hypoxic part and packing of touching cells in a disc and in a ball."""
    position = lattice(150.0 if dimensions == 2 else 80.0, 4.0, dimensions)
    edge = 150.0 if dimensions == 2 else 80.0
    distance = np.linalg.norm(position, axis=1)
    state = np.where(distance < 0.5 * edge, State.NECROTIC, State.PROLIFERATING)
    cells = cells_at(position + SHIFT, radius=2.0, state=state)
    extent = extents.Extent(cells, dimensions)
    assert extent.diameter() == pytest.approx(2 * edge, rel=6e-3)
    assert extent.dead_core == pytest.approx(0.5 * edge, rel=1e-2)
    assert extent.rim(extent.dead_core) == pytest.approx(0.5 * edge, rel=1e-2)
    assert extent.core(distance < 0.7 * edge) == pytest.approx(0.7 * edge, rel=1e-2)
    filled = np.pi / 4 if dimensions == 2 else np.pi / 6
    assert extent.packing_ratio() == pytest.approx(filled, rel=2e-2)


@BOTH
def test_cells_that_do_not_overlap_never_pass_a_packing_ratio_of_one(dimensions):
    """No body has a smaller radius of gyration than the ball of its volume."""
    rng = np.random.default_rng(4)
    for count in (2, 3, 7, 40):
        position = np.zeros((count, 3))
        radius = rng.uniform(0.2, 5.0, count)
        for k in range(1, count):  # each is pushed in from outside until it touches
            way = rng.normal(size=3) * (np.arange(3) < dimensions)
            way /= np.linalg.norm(way)
            far = np.linspace(300.0, 0.0, 6001)[:, None] * way
            gap = np.linalg.norm(far[:, None] - position[:k], axis=2) - radius[:k] - radius[k]
            position[k] = far[np.argmax((gap < 0.0).any(axis=1)) - 1]
        cells = cells_at(position, radius=radius)
        assert 0.0 < extents.Extent(cells, dimensions).packing_ratio() <= 1.0


@BOTH
def test_profiles_count_in_rings_and_shells(dimensions):
    cells = cells_at(uniform(100.0, dimensions, 50_000) + SHIFT, radius=0.5)
    c = np.linalg.norm(cells.position - SHIFT, axis=1)
    profile = observables.radial_profile(Frame(0.0, 0, cells, {"oxygen": c}), dimensions, bins=5)
    inner, outer = profile.edges[:-1], profile.edges[1:]
    filled = (outer**dimensions - inner**dimensions) / profile.edges[-1] ** dimensions
    np.testing.assert_allclose(profile.counts / len(cells), filled, rtol=0.1)
    d = dimensions
    mean = d / (d + 1) * (outer ** (d + 1) - inner ** (d + 1)) / (outer**d - inner**d)
    np.testing.assert_allclose(profile.concentrations["oxygen"], mean, rtol=2e-2)


@BOTH
def test_distance_of_two_cells_follows_from_their_diameter(dimensions):
    for apart in (3.0, 11.0):
        cells = cells_at([[0.0, 0, 0], [apart, 0, 0]], radius=[4.0, 7.0])
        size = np.array([extents.Extent(cells, dimensions).diameter()])
        found = contact_plots.distance_of_two(size, cells, dimensions)
        assert found[0] == pytest.approx(apart, rel=1e-12)


@BOTH
def test_a_rim_without_a_core_is_absent_everywhere(dimensions, tmp_path, monkeypatch):
    monkeypatch.setattr("multicell.report.page.PICTURES", {})
    scene = mc.Scene.from_dict(
        {"duration": "20 min", "dimensions": dimensions, "initial": {"count": 12}}
    )
    result = mc.run(scene, output=tmp_path / "run")
    assert np.isnan(result.history["viable_rim"]).all()
    assert (result.history["necrotic_radius"] == 0.0).all()
    assert result.summary()["viable_rim"] is None
    assert not any(name == "viable rim" for name, _ in measures(result.summary()))
    mc.export(result, tmp_path / "csv", tables=["history"])
    head, *rows = (tmp_path / "csv" / "history.csv").read_text().splitlines()
    place = head.split(",").index("viable_rim_um")
    assert [row.split(",")[place] for row in rows] == [""] * 3
    page = (tmp_path / "run" / "report.html").read_text()
    assert "viable rim" not in page


def test_dead_cells_outside_the_others_are_no_core():
    """Where a poison kills from outside there is no layer beyond the dead ones."""
    position = uniform(100.0, 3, 5000)
    outside = np.linalg.norm(position, axis=1) > 80.0
    cells = cells_at(position, radius=1.0, state=np.where(outside, State.NECROTIC, 0))
    extent = extents.Extent(cells, 3)
    assert extent.dead_core == 0.0
    assert np.isnan(extent.rim(extent.dead_core))


@BOTH
def test_a_simulation_measures_in_its_own_dimensions(dimensions):
    scene = mc.Scene.from_dict({"duration": "10 min", "dimensions": dimensions,
                                "initial": {"count": 300}})  # fmt: skip
    simulation = Simulation(scene)
    cells, row, summary = simulation.cells, simulation.history_row(), simulation.summary()
    # n touching cells of radius r in the densest packing, about a centre among them
    radius, filled = cells.radius[0], {2: np.pi / 12**0.5, 3: np.pi / 18**0.5}[dimensions]
    sites = radius * (300 / filled) ** (1.0 / dimensions)
    expected = 2.0 * np.sqrt(sites**2 + radius**2)
    assert row["diameter"] == summary["diameter"] == pytest.approx(expected, rel=1e-2)
    assert row["packing_ratio"] == summary["packing_ratio"]
    assert row["packing_ratio"] == pytest.approx(
        300 * (2 * radius / expected) ** dimensions, rel=3e-2
    )


# --- growth that pressure holds back --------------------------------------------------------------


def test_pressure_factor_by_hand():
    position = np.arange(18.0).reshape(6, 3)
    pressure = np.array([-0.1, 0.0, 0.05, 0.04, 0.3, 0.3])
    state = [State.PROLIFERATING, State.QUIESCENT, State.PROLIFERATING, State.PROLIFERATING,
             State.PROLIFERATING, State.NECROTIC]  # fmt: skip
    cells = cells_at(position, state=state, pressure=pressure)
    scene = mc.Scene.from_dict({"duration": "1 h", "growth": {"critical_pressure": 0.1}})
    row = history_row(TissueState(Frame(0.0, 0, cells, {}), scene))
    assert row["pressure_factor"] == pytest.approx((1 + 1 + 0.5 + 0.6 + 0) / 5)
    none = history_row(TissueState(Frame(0.0, 0, cells.take(np.array([5])), {}), scene))
    assert np.isnan(none["pressure_factor"])


@pytest.mark.slow
def test_a_contact_inhibited_monolayer_tells_that_it_is(tmp_path):
    """Many of its cells are held back though none of them rests; a free one tells nothing."""
    scene = mc.load_scene("monolayer").with_changes(
        {"initial.count": 300, "initial.spacing": 0.9, "duration": "12 h"}
    )
    result = mc.run(scene, output=tmp_path)
    history, summary = result.history, result.summary()
    assert 0.1 < summary["pressure_factor"] < 0.9
    assert history["pressure_factor"][-1] == summary["pressure_factor"]
    page = (tmp_path / "report.html").read_text()
    assert "rings about the centre" in page
    free = mc.run(scene.with_changes({"growth.critical_pressure": None, "duration": "15 min"}))
    assert "pressure_factor" not in free.history
    assert "pressure_factor" not in free.summary()


@pytest.mark.parametrize("friction", [{"normal": 0.2}, {"tangential": 0.2}])
@pytest.mark.parametrize("method", ["rkc2", "auto", "cvode", "backward-euler"])
def test_friction_leaves_cells_in_their_plane(method, friction):
    """An estimate of stability looks beside the plane: nothing of it stays in the next guess."""
    scene = mc.load_scene("settle").with_changes(
        {"dimensions": 2, "initial.count": 12, "friction": friction, "duration": "5 min",
         "integrator": {"method": method}}
    )  # fmt: skip
    result = mc.run(scene, threads=1)
    assert (result.frames[-1].cells.position[:, 2] == 0.0).all()
