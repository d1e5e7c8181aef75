"""Fields of frames in py-pde's language: same values, same places, its tools work on them."""

import pickle
import subprocess
import sys

import numpy as np
import pde
import pytest
from plain_pde import uncompiled

import multicell as mc
from multicell.errors import SceneError
from multicell.results.frame import Field, Frame

GRIDS = {
    "cubes": Field(
        "a", "mM", np.array([-3.0, 4.0, 10.0]), 2.5, np.random.default_rng(1).random((4, 6, 5))
    ),
    "squares": Field(
        "a", "mM", np.array([-3.0, 4.0, -1.25]), 2.5, np.random.default_rng(2).random((7, 6, 1)),
        height=10.0,
    ),
    "shells": Field(
        "a", "mM", np.array([1.0, 2.0, 3.0]), 2.5, np.random.default_rng(3).random((9, 1, 1)),
        kind="radial",
    ),
}  # fmt: skip


def places(field):
    """Return the coordinates of a field's nodes as the field's own documentation has them."""
    if field.kind == "radial":
        return ((np.arange(field.values.size) + 0.5) * field.spacing)[:, None]
    axes = [field.axis(i) for i in range(2 if field.height else 3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


@pytest.mark.parametrize("kind", GRIDS)
def test_values_and_coordinates_are_the_same(kind):
    field = GRIDS[kind]
    field.to_pde().data[...] = 7.0  # a copy
    found = field.to_pde()
    assert isinstance(found, pde.ScalarField)
    assert isinstance(found.grid, pde.SphericalSymGrid if kind == "shells" else pde.CartesianGrid)
    assert found.label == "a"
    np.testing.assert_array_equal(found.data.ravel(), field.values.ravel())
    ours = places(field)
    np.testing.assert_allclose(found.grid.cell_coords.reshape(ours.shape), ours, rtol=1e-13)
    with uncompiled():
        there = found.interpolate(ours)
    np.testing.assert_allclose(there, field.values.ravel(), rtol=1e-12)


@pytest.mark.parametrize("kind", GRIDS)
def test_a_view_is_on_the_array_itself(kind):
    field = GRIDS[kind]
    view, copied = field.to_pde(copy=False), field.to_pde()
    assert np.shares_memory(view.data, field.values)
    assert not np.shares_memory(copied.data, field.values)
    assert view.grid is copied.grid  # made once for the same box
    assert view == copied
    operator = {"value": 0.3} if kind == "shells" else {"*": {"value": 0.3}}
    with uncompiled():
        found, expected = view.laplace(operator), copied.laplace(operator)
    np.testing.assert_array_equal(found.data, expected.data)
    for made in (found, 2.0 * view, pickle.loads(pickle.dumps(view))):
        assert type(made) is pde.ScalarField
    together = pde.FieldCollection([field.to_pde(copy=False), copied])
    assert np.shares_memory(together.data, together[0].data)
    np.testing.assert_array_equal(together[0].data, field.to_pde().data)


def test_views_of_read_only_values_are_read_only():
    values = np.ones((3, 3, 3))
    values.flags.writeable = False
    view = Field("a", "mM", np.zeros(3), 1.0, values).to_pde(copy=False)
    with pytest.raises(ValueError, match="read-only"):
        view += 1.0
    assert (view + 1.0).data.max() == 2.0


def frame_of(**fields):
    cells = mc.Simulation(mc.load_scene("growth")).cells
    return Frame(0.0, 0, cells, fields=fields)


def test_fields_that_share_a_grid_are_a_collection():
    a = GRIDS["cubes"]
    b = Field("b", "mM", a.origin, a.spacing, 2.0 * a.values)
    frame = frame_of(a=a, b=b, c=GRIDS["shells"])
    found = frame.to_pde(["a", "b"])
    assert isinstance(found, pde.FieldCollection)
    assert list(found.labels) == ["a", "b"]
    np.testing.assert_array_equal(found["b"].data, b.values)
    assert len(frame_of(a=a, b=b).to_pde()) == 2
    assert frame.to_pde(["c"])[0].grid.num_axes == 1


@pytest.mark.parametrize(
    ("fields", "names", "words"),
    [
        (GRIDS, None, r"\['cubes'\] and \['squares'\] and \['shells'\]"),
        (GRIDS, ["cubes", "x"], "has 'x', the frame holds cubes, squares, shells"),
        (GRIDS, "cubes", "expected a list of names"),
        (GRIDS, [], "expected a list of names"),
        ({}, None, "holds none"),
    ],
)
def test_other_names_and_several_grids_are_refused(fields, names, words):
    with pytest.raises(SceneError, match=words):
        frame_of(**fields).to_pde(names)


def test_py_pde_is_loaded_for_it_only():
    code = (
        "import sys, numpy as np\n"
        "from multicell.results.frame import Field\n"
        "field = Field('a', 'mM', np.zeros(3), 1.0, np.ones((2, 2, 2)))\n"
        "field.axis(0)\n"
        "assert 'pde' not in sys.modules\n"
        "field.to_pde()\n"
        "assert 'pde' in sys.modules\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_fields_of_a_run_agree_with_what_its_cells_find():
    scene = mc.load_scene("growth").with_changes(
        {"initial.count": 40, "duration": "10 min", "coupling_step": "10 min",
         "nutrients.oxygen": {"spacing": "15 um"}}
    )  # fmt: skip
    frame = mc.run(scene).frames[-1]
    field = frame.fields["oxygen"].to_pde()
    steps = (np.arange(6) + 0.5) / 6.0 - 0.5
    # each cell finds the mean over its ball, by a cube with the same second moments
    cube = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 1, 3)
    points = frame.cells.position + cube * (2.4**0.5 * frame.cells.radius[:, None])
    with uncompiled():
        found = field.interpolate(points.reshape(-1, 3)).reshape(len(cube), -1).mean(axis=0)
    np.testing.assert_allclose(found, frame.concentrations["oxygen"], rtol=1e-4)
    assert frame.to_pde()["oxygen"].grid == frame.fields["oxygen"].to_pde().grid
