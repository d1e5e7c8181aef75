"""The medium flows in to what dead cells lose, and the tissue with it."""

import numpy as np
import pytest
from synthetic import cells_at

import multicell as mc
from multicell import SceneError
from multicell.biology.motion import inflow_velocity
from multicell.cells import State


def _cloud(n=3000, radius=100.0, dimensions=3):
    rng = np.random.default_rng(2)
    x = rng.normal(size=(n, 3))
    x[:, dimensions:] = 0.0
    x /= np.linalg.norm(x, axis=1)[:, None]
    x *= (radius * rng.random(n) ** (1 / dimensions))[:, None]
    return cells_at(x, radius=4.0)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_flow_through_a_sphere_is_the_volume_of_tissue_lost_within(dimensions):
    """Gauss: 4πr² u(r), in a plane 2πr u(r), is the loss within r over the packing."""
    cells = _cloud(dimensions=dimensions)
    cells.state[:] = State.NECROTIC
    after = 0.99 * cells.radius
    u = inflow_velocity(cells, after, 60.0, dimensions, 0.0)
    size = (lambda r: 4 / 3 * np.pi * r**3) if dimensions == 3 else (lambda r: np.pi * r**2)
    area = (lambda r: 4 * np.pi * r**2) if dimensions == 3 else (lambda r: 2 * np.pi * r)
    weights = size(cells.radius)
    origin = np.average(cells.position, axis=0, weights=weights)
    away = cells.position - origin
    r = np.linalg.norm(away, axis=1)
    spread = np.average(r**2, weights=weights) + dimensions / (dimensions + 2) * 16.0
    packing = weights.sum() / size(np.sqrt((dimensions + 2) / dimensions * spread))
    lost = (weights - size(after)) / 60.0
    inward = -(u * away).sum(axis=1) / r
    for k in np.argsort(r)[[10, 500, 2999]]:
        expected = lost[r < r[k]].sum() / packing / area(r[k])
        assert inward[k] == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(u, -inward[:, None] * away / r[:, None], atol=1e-15)


def test_nothing_lost_nothing_flows():
    cells = _cloud(100)
    assert inflow_velocity(cells, 0.9 * cells.radius, 60.0, 3, 0.0) is None
    cells.state[:] = State.NECROTIC
    assert inflow_velocity(cells, cells.radius, 60.0, 3, 0.0) is None
    assert inflow_velocity(cells, 1.1 * cells.radius, 60.0, 3, 0.0) is None  # they swell


def test_walls_refuse_inflow():
    scene = mc.load_scene("wm983b")
    walls = {axis: ["-500 um", "500 um"] for axis in "xyz"}
    with pytest.raises(SceneError, match=r"death\.inflow: has no meaning in a domain"):
        scene.with_changes({"domain": walls, "nutrients": None})
