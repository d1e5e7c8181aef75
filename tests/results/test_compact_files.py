"""What result files leave out comes back to the bit, and they are as small as that makes them."""

import h5py
import numpy as np
import pytest
from stored import contents
from synthetic import SCENE, ball, cells_at, growing_frames

import multicell as mc
from multicell.results.coding import decode, encode
from multicell.results.following import interpolated
from multicell.results.frame import Field, Frame
from multicell.results.keeping import KEPT, POOLS, Keeper, Pool
from multicell.results.reader import Contents, Frames
from multicell.results.writer import Store

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


def test_entries_are_written_for_what_changes():
    n, keeper, frames = 50, Keeper(), []
    columns = {name: np.zeros(n) for name in KEPT}
    columns |= {"parent": np.full(n, -1), "kind": np.zeros(n, np.int16)}
    columns["young"] = RNG.normal(size=n)
    ids = RNG.permutation(n)
    frames.append((0.0, ids, columns))
    order = RNG.permutation(n)[:40]  # ten are gone, all have another place
    later = {name: values[order] for name, values in columns.items()}
    later["age"] = later["age"] + 600.0
    frames.append((600.0, ids[order], later))
    changed = {name: values.copy() for name, values in later.items()}
    changed["age"] += 300.0
    changed["young"][:3] += 1e-16 + np.abs(changed["young"][:3])
    changed["receptor"][5] = -0.0  # other bits, though the same number
    frames.append((900.0, ids[order], changed))
    entries = [keeper.entries(*frame) for frame in frames]
    assert [len(e["birth/id"]) for e in entries] == [50, 0, 3]
    assert [len(e["age/id"]) for e in entries] == [50, 0, 0]
    assert [len(e["surface/id"]) for e in entries] == [50, 0, 1]
    times = np.array([time for time, _, _ in frames])
    for pool, names in POOLS.items():
        whole = {x: np.concatenate([e[f"{pool}/{x}"] for e in entries]) for x in ("id", *names)}
        ends = np.cumsum([0, *(len(e[f"{pool}/id"]) for e in entries)])
        found = Pool(whole.pop("id"), ends, times, whole)
        for place, (_, who, written) in enumerate(frames):
            for name, column in found.at(place, who).items():
                assert column.tobytes() == written[name].tobytes(), (place, name)
        with pytest.raises(ValueError, match="no entry"):
            found.at(1, np.array([n + 7]))


def test_interpolation_is_that_of_scipy_and_of_the_runs():
    from scipy.interpolate import RegularGridInterpolator

    values, origin, spacing = RNG.random((6, 7, 8)), np.array([-3.0, 2.0, 1.0]), 2.5
    axes = [o + (np.arange(n) + 0.5) * spacing for o, n in zip(origin, values.shape, strict=True)]
    inner = [(a[0], a[-1]) for a in axes]
    points = np.stack([RNG.uniform(*pair, 300) for pair in inner], axis=1)
    here = interpolated(points, values, origin, spacing, radial=False, flat=False)
    np.testing.assert_allclose(here, RegularGridInterpolator(axes, values)(points), rtol=1e-12)
    outside = points + 100.0
    assert np.isnan(interpolated(outside, values, origin, spacing, radial=False, flat=False)).all()


SCENES = {
    "cubes": ("spheroid", {"duration": "12 h", "initial.count": 200}),
    "shells": (
        "spheroid",
        {"duration": "6 h", "initial.count": 200, "nutrients.oxygen.geometry": "radial"},
    ),
    "domain": ("chemotaxis", {"duration": "20 min"}),
    "plane": ("monolayer", {"duration": "6 h", "initial.count": 30}),
    "phases": ("emt6", {"duration": "3 h", "initial.count": 100}),
    "receptors": ("sorting-cams", {"duration": "20 min", "initial.count": 60}),
}


@pytest.mark.parametrize("case", SCENES)
def test_files_hold_what_memory_holds(case, tmp_path):
    name, changes = SCENES[case]
    scene = mc.load_scene(name).with_changes({**changes, "output.every": "1 h"})
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
    with h5py.File(tmp_path / "out" / "frames.h5") as file:
        rows = file["cells/id"].shape[0]
        for nutrient in scene.nutrients:  # nearly all follow from the field
            assert file[f"concentrations/{nutrient}/row"].shape[0] <= 0.1 * rows


def test_frames_are_read_in_any_order_and_also_when_nothing_follows(tmp_path):
    frames = growing_frames(count=5, last=400)  # every column of every frame made by hand
    strange = cells_at(ball(50))
    strange.age[:] = RNG.normal(size=len(strange))
    strange.parent[:] = np.arange(len(strange))[::-1]
    found = {"oxygen": RNG.random(len(strange))}
    field = Field("oxygen", "mM", np.zeros(3), 1.0, np.full((2, 2, 2), np.nan))
    frames.append(Frame(9.1e5, 1600, strange, found, {"oxygen": field}))
    with Store.create(tmp_path / "out", SCENE) as store:
        for frame in frames:
            store.append(frame)
    back = Frames(Contents(tmp_path / "out"))
    for place in (5, 0, 3, 3, 1):
        for name, column in frames[place].cells.columns():
            assert getattr(back[place].cells, name).tobytes() == column.tobytes()
        assert (
            back[place].concentrations["oxygen"].tobytes()
            == frames[place].concentrations["oxygen"].tobytes()
        )


def test_a_cell_takes_fifty_bytes_a_frame(tmp_path):
    """Positions, radius and pressure have 6 to 7 random bytes a number; ages and moduli none."""
    scene = mc.load_scene("spheroid").with_changes(
        {"initial.count": 1500, "initial.stage": "asynchronous", "duration": "5 h",
         "output.every": "30 min"}
    )  # fmt: skip
    mc.run(scene, output=tmp_path / "out", threads=1, report=False)
    found = contents(tmp_path / "out")
    rows = found["cells/id"][1][0]
    nodes = found["fields/oxygen/coded"][1][0]
    with h5py.File(tmp_path / "out" / "frames.h5") as file:
        kept = [file[path].id.get_storage_size() for path in found if path.startswith("kept/")]
        cells = [file[path].id.get_storage_size() for path in found if path.startswith("cells/")]
        field = file["fields/oxygen/coded"].id.get_storage_size()
    assert sum(cells) / rows < 40.0
    assert sum(kept) / rows < 5.0
    assert field / nodes < 4.5
