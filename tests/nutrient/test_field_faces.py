"""Concentrations and gradients near the faces of a grid: exact for lines and parabolas."""

import numpy as np
import pytest
from running import finished

import multicell as mc
from multicell.nutrient.cartesian import Box
from multicell.nutrient.faces import by_condition, by_parabola, ghost_terms
from multicell.nutrient.field import NutrientField
from multicell.nutrient.grid import BoxLayout, ShellLayout
from multicell.nutrient.parameters import FieldParameters
from multicell.report.explain.scene import explain
from multicell.scene.nutrient import Nutrient

BOXES = {
    "cubes": Box((-13.0, 4.0, -31.0), (5, 3, 7), 2.5),
    "squares": Box((-13.0, 4.0, -1.25), (5, 3, 1), 2.5, 8.0),
}


def nodes(box):
    axes = [o + (np.arange(n) + 0.5) * box.spacing
            for o, n in zip(box.origin, box.shape, strict=True)]  # fmt: skip
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def places(box, seed=0):
    """Return points inside, near faces, and exactly on faces, edges and corners."""
    rng = np.random.default_rng(seed)
    low, high = np.array(box.origin), np.array(box.upper)
    points = low + (high - low) * rng.random((300, 3))
    middle = 0.5 * (low + high)
    for axis in range(3):
        for end in (low, high):
            row = middle.copy()
            row[axis] = end[axis]
            points = np.vstack([points, row, np.where(rng.random(3) < 0.5, low, high)])
    return np.vstack([points, low, high])


@pytest.mark.parametrize("kind", BOXES)
def test_gradients_of_lines_and_parabolas_are_exact_up_to_the_faces(kind):
    box = BOXES[kind]
    layout, rng = BoxLayout(box), np.random.default_rng(1)
    points = places(box)
    flat = box.height is not None
    a, b = rng.normal(size=3), rng.normal(size=(3, 3))
    b = b + b.T
    if flat:
        a[2] = 0.0
        b[2] = b[:, 2] = 0.0
        points[:, 2] = 0.0
    for square in (0.0 * b, b):
        x = nodes(box)
        values = 3.0 + x @ a + 0.5 * np.einsum("...i,ij,...j", x, square, x)
        exact = a + points @ square
        found = layout.gradient(points, values)
        np.testing.assert_allclose(found, exact, atol=1e-9 * np.abs(exact).max())


def test_gradients_on_shells_are_exact_up_to_the_surface():
    layout = ShellLayout(np.array([3.0, -2.0, 7.0]), 4.0, 6)
    r = (np.arange(6) + 0.5) * 4.0
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distance = np.concatenate([24.0 * rng.random(197), [24.0, 0.0, 24.0 - 1e-9]])
    points = layout.centre + distance[:, None] * direction
    found = layout.gradient(points, 2.0 + 0.3 * r**2)
    np.testing.assert_allclose(found, 0.6 * (points - layout.centre), atol=1e-9)
    with pytest.raises(ValueError, match="outside"):
        layout.gradient(layout.centre + np.array([[24.1, 0.0, 0.0]]), r)
    # a line has a kink in the middle, where the field of a ball has none
    far = distance > 4.0
    found = layout.gradient(points, 2.0 + 0.3 * r)
    np.testing.assert_allclose(found[far], 0.3 * direction[far], atol=1e-9)


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 2, 2), (2, 9, 1)])
def test_grids_of_few_nodes_have_gradients_everywhere(shape):
    box = Box((0.0, 0.0, 0.0), shape, 1.0)
    values = nodes(box) @ np.array([1.0, -2.0, 0.5])
    found = BoxLayout(box).gradient(places(box), values)
    several = np.array(shape) > 1
    np.testing.assert_allclose(found, np.broadcast_to(
        np.where(several, [1.0, -2.0, 0.5], 0.0), found.shape), atol=1e-12)  # fmt: skip


CONDITIONS = {
    "value": {"value": 0.7},
    "derivative": {"derivative": 0.2},
}


@pytest.mark.parametrize("kind", CONDITIONS)
def test_the_node_beyond_a_face_is_that_of_pde(kind):
    from pde import CartesianGrid

    rng, condition = np.random.default_rng(4), CONDITIONS[kind]
    values = rng.random((4, 3, 5))
    grid = CartesianGrid([[0, 4 * 1.5], [0, 3 * 1.5], [0, 5 * 1.5]], [4, 3, 5])
    full = np.zeros((6, 5, 7))
    full[1:-1, 1:-1, 1:-1] = values
    grid.get_boundary_conditions(condition, rank=0).set_ghost_cells(full)
    const, factor = ghost_terms(condition, 1.5)
    np.testing.assert_allclose(const + factor * values[0], full[0, 1:-1, 1:-1], rtol=1e-12)
    faces = {axis + end: condition for axis in "xyz" for end in "-+"}
    padded = by_condition(values, faces, 1.5, "xyz")
    assert padded.shape == full.shape
    for axis in range(3):
        inner = tuple(slice(None) if a == axis else slice(1, -1) for a in range(3))
        np.testing.assert_allclose(padded[inner], full[inner], rtol=1e-12)
    np.testing.assert_array_equal(by_parabola(values, 3)[1:-1, 1:-1, 1:-1], values)


def test_cells_read_the_condition_on_a_face_and_never_less_than_nothing():
    """On a face with a value it is that value; within half a spacing the line to it."""
    box = BOXES["cubes"]
    layout, rng = BoxLayout(box), np.random.default_rng(5)
    sides = {axis + end: {"value": 0.0} for axis in "xyz" for end in "-+"}
    values, points = rng.random(box.shape), places(box)
    found = layout.read(points, values, sides)
    assert (found >= 0.0).all()
    low, high = np.array(box.origin), np.array(box.upper)
    on_face = ((points == low) | (points == high)).any(axis=1)
    assert on_face.sum() >= 8
    np.testing.assert_allclose(found[on_face], 0.0, atol=1e-15)
    # a linear field between two values is read exactly, also beyond the last nodes
    g = 0.04
    linear = np.broadcast_to((g * (nodes(box)[..., 0] + 13.0)), box.shape)
    walls = {axis + end: {"derivative": 0.0} for axis in "yz" for end in "-+"}
    walls |= {"x-": {"value": 0.0}, "x+": {"value": g * 12.5}}
    read = layout.read(points, np.ascontiguousarray(linear), walls)
    np.testing.assert_allclose(read, g * (points[:, 0] + 13.0), atol=1e-14)
    shells = ShellLayout(np.zeros(3), 4.0, 6)
    ring = np.array([[24.0, 0, 0], [0, 23.0, 0], [0, 0, 22.0], [0, 21.0, 0]])
    content = 1.0 - 0.05 * (np.arange(6) + 0.5)
    found = shells.read(ring, content, {"value": 0.1})
    np.testing.assert_allclose(found, [0.1, 0.1 + (0.725 - 0.1) / 2, 0.725, 0.7375])


@pytest.mark.parametrize(
    ("dimensions", "geometry", "margin"),
    [(3, "box", 1e-6), (3, "box", 0.4), (3, "box", 6.0), (3, "radial", 0.4), (2, "box", 1e-6)],
)
def test_chemotaxis_and_explain_go_on_with_a_thin_margin(dimensions, geometry, margin):
    """The outermost cells then lie next to the faces, where differences reach beyond the grid."""
    scene = mc.load_scene("spheroid").with_changes(
        {
            "dimensions": dimensions,
            "initial.count": 40,
            "duration": "30 min",
            "nutrients.oxygen.margin": margin,
            "nutrients.oxygen.height": "10 um",
            "nutrients.oxygen.geometry": geometry,
            "chemotaxis.oxygen": {"force": 0.2},
            "integrator": "auto",
        }
    )
    assert explain(scene)["parts"]
    simulation = finished(scene)
    assert np.isfinite(simulation.cells.position).all()
    found = simulation.field_system.gradients(simulation.cells)["oxygen"]
    assert np.isfinite(found).all()
    assert np.abs(found).max() > 0.0
    assert (simulation.concentrations["oxygen"] <= 0.07 * (1 + 1e-12)).all()


def test_a_field_taken_from_a_frame_is_read_by_its_conditions():
    nutrient = Nutrient(margin=2.0, spacing=10.0, uptake=0.0, boundary=0.3)
    parameters = FieldParameters(nutrient, 10.0, 10.0, "steady", dimensions=3)
    position = np.array([[-30.0, 0.0, 0.0], [30.0, 5.0, 0.0], [0.0, -20.0, 20.0]])
    field = NutrientField("a", parameters)
    field.solve(position, np.full(3, 50.0))
    other = NutrientField("a", parameters)
    other.restore(field.field(), 0.0)
    np.testing.assert_array_equal(other.sample(position), field.sample(position))
    corner = np.array([field.layout.box.origin])
    assert other.sample(corner)[0] == pytest.approx(0.3, rel=1e-12)
