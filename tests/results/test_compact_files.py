"""Result files hold every bit, in few bytes; files of other formats are refused."""

import h5py
import numpy as np
import pytest
from stored import contents

import multicell as mc
from multicell.results.coding import decode, encode
from multicell.results.reader import Contents, Frames

RNG = np.random.default_rng(5)


@pytest.mark.parametrize(
    "shape",
    [(1, 1, 1), (2, 1, 1), (60, 1, 1), (9, 8, 1), (1, 5, 7), (5, 3, 2), (6, 7, 8), (0, 0, 0)],
)
def test_any_field_comes_back_to_the_bit(shape):
    values = RNG.normal(size=shape) * 10.0 ** RNG.integers(-300, 300, shape)
    strange = np.array([np.nan, -np.inf, -0.0, 5e-324])
    values.flat[:4] = strange[: min(values.size, 4)]
    values.view("<i8").reshape(-1)[-1:] = -3  # not a number that NumPy makes
    coded, faces = encode(values)
    assert decode(coded, faces).tobytes() == values.tobytes()


def steady(n, low, high):
    """Return a harmonic field by a direct solve: given on two faces, no slope on the others."""
    from scipy.sparse import diags_array, identity, kron
    from scipy.sparse.linalg import spsolve

    def line(ends):
        main = np.full(n, 2.0)
        main[[0, -1]] = ends
        return diags_array([main, -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1])

    one, fixed, free = identity(n), line(3.0), line(1.0)
    operator = kron(kron(fixed, one), one) + kron(kron(one, free), one) + kron(kron(one, one), free)
    source = np.zeros((n, n, n))
    source[0] += 2.0 * low
    source[-1] += 2.0 * high
    source[n // 2, n // 2, n // 2] -= 0.1 * (low + high)  # what one cell takes up
    return spsolve(operator.tocsc(), source.ravel()).reshape(n, n, n)


def test_the_stencil_foretells_a_steady_field_and_what_holds_at_its_faces():
    values = steady(12, 0.05, 0.07)
    coded, faces = encode(values)
    np.testing.assert_allclose(faces[:2], [0.05, 0.07], rtol=1e-9)
    assert np.isnan(faces[2:]).all()
    # the first layer has none before it; elsewhere rounding is left over, but round the source
    digits = np.log2(coded[1:] + 1.0)
    assert np.median(digits) < 12
    assert (digits > 30).sum() < 20
    assert decode(coded, faces).tobytes() == values.tobytes()


SCENES = {
    "cubes": ("spheroid", {"duration": "3 h"}),
    "shells": ("spheroid", {"duration": "3 h", "nutrients.oxygen.geometry": "radial"}),
    "phases": ("emt6", {"duration": "3 h"}),
}


@pytest.mark.parametrize("case", SCENES)
def test_files_hold_what_memory_holds(case, tmp_path):
    name, changes = SCENES[case]
    scene = mc.load_scene(name).with_changes(
        {**changes, "initial.count": 100, "output.every": "1 h"}
    )
    held = mc.run(scene, threads=1)
    mc.run(scene, output=tmp_path / "out", threads=1, report=False)
    there = Frames(Contents(tmp_path / "out"))
    assert len(there) == len(held.frames)
    for one, other in zip(held.frames, there, strict=True):
        for column, values in one.cells.columns():
            assert getattr(other.cells, column).tobytes() == values.tobytes(), column
        for nutrient, field in one.fields.items():
            assert other.fields[nutrient].values.tobytes() == field.values.tobytes()
            assert (
                other.concentrations[nutrient].tobytes() == one.concentrations[nutrient].tobytes()
            )


def test_a_cell_takes_seventy_bytes_a_frame(tmp_path):
    """Positions, radius and pressure have 6 to 7 random bytes a number."""
    scene = mc.load_scene("spheroid").with_changes(
        {"initial.count": 800, "duration": "1 h", "output.every": "15 min"}
    )
    mc.run(scene, output=tmp_path / "out", threads=1, report=False)
    found = contents(tmp_path / "out")
    rows = found["cells/id"][1][0]
    nodes = found["fields/oxygen/coded"][1][0]
    with h5py.File(tmp_path / "out" / "frames.h5") as file:
        cells = [file[path].id.get_storage_size() for path in found if path.startswith("cells/")]
        field = file["fields/oxygen/coded"].id.get_storage_size()
    assert sum(cells) / rows < 70.0
    assert field / nodes < 4.5
