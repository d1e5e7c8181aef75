"""Fields that begin as a file: closed forms, amounts, copies in run folders, and refusals."""

import random
import shutil
from dataclasses import replace

import numpy as np
import pytest
from running import finished, refused
from scipy.interpolate import RegularGridInterpolator

import multicell as mc
from multicell.cli.main import main
from multicell.errors import OutputError, SceneError
from multicell.nutrient.cartesian import Box
from multicell.nutrient.resampling import resampled
from multicell.report.explain.scene import explain
from multicell.scene.scene import Scene, load_scene
from multicell.simulation import Simulation
from multicell.tables.grids import grid_values

WALLS = {"*": {"type": "derivative", "derivative": 0}}
FIELD = {"diffusion": 5.0, "boundary": 0, "uptake": 0, "regime": "transient", "spacing": "4 um",
         "time_tolerance": 1e-4, "sides": WALLS}  # fmt: skip
DOMAIN = {"x": [-80, 80], "y": [-40, 40]}


def scene_of(field=None, **parts):
    return Scene.from_dict({
        "duration": "2 min", "coupling_step": "1 min", "dimensions": 2,
        "initial": {"count": 4, "spacing": 4.0}, "contact": {"law": "none"},
        "domain": DOMAIN, "output": {"every": "1 min"},
        "nutrients": {"signal": {**FIELD, **(field or {})}}, **parts,
    })  # fmt: skip


def centres(ends, n):
    low, high = ends
    return low + (np.arange(n) + 0.5) * (high - low) / n


def saved(path, values):
    np.save(path, values)
    return str(path)


@pytest.fixture
def steps(tmp_path):
    """Write 8 by 4 whole numbers between the ends of the domain in each format; return paths."""
    pytest.importorskip("tifffile")
    import tifffile
    from PIL import Image

    values = np.arange(32).reshape(8, 4) % 13
    paths = {ending: tmp_path / f"signal.{ending}" for ending in ("npy", "tif", "png", "csv")}
    np.save(paths["npy"], np.asfortranarray(values.astype(np.float32)))
    tifffile.imwrite(paths["tif"], values.T.astype(np.uint16))
    Image.fromarray(np.ascontiguousarray(values.T).astype(np.uint8)).save(paths["png"])
    places = [(x, y) for x in centres((-80, 80), 8) for y in centres((-40, 40), 4)]
    rows = [f"{x},{y},0,{9.5},{v}" for (x, y), v in zip(places, values.flat, strict=True)]
    random.Random(1).shuffle(rows)
    paths["csv"].write_text("\n".join(["x,y,z,other,signal", *rows]) + "\n", encoding="utf-8")
    return values, {ending: str(path) for ending, path in paths.items()}


# -- other grids

BOX = Box((-10.0, 4.0, -2.0), (10, 6, 4), 2.0)
ENDS = ((-10.0, 10.0), (4.0, 16.0), (-2.0, 6.0))


def test_values_at_the_nodes_are_taken_as_they_are():
    values = np.random.default_rng(0).random(BOX.shape)
    np.testing.assert_allclose(resampled(values, ENDS, BOX, 7.0), values, rtol=1e-13)


@pytest.mark.parametrize("shape", [(5, 3, 2), (4, 7, 3), (23, 17, 9), (60, 3, 5)])
def test_linear_profiles_stay_linear(shape):
    """Coarser, finer and mixed; the last half box at each end is flat, as stated."""

    def profile(x, y, z):
        return 100.0 + 3.0 * x - 2.0 * y + 0.5 * z

    axes = [centres(ends, n) for ends, n in zip(ENDS, shape, strict=True)]
    values = profile(*np.meshgrid(*axes, indexing="ij"))
    found = resampled(values, ENDS, BOX, 0.0)
    exact = profile(*np.meshgrid(*BOX.axes(), indexing="ij"))
    steps = [(high - low) / n for (low, high), n in zip(ENDS, shape, strict=True)]
    away = [0.5 * step + (1.0 if step < 2.0 else 0.0) for step in steps]  # means reach further
    bounds = zip(BOX.axes(), ENDS, away, strict=True)
    inner = np.ix_(*[(x >= low + d) & (x <= high - d) for x, (low, high), d in bounds])
    assert found[inner].size > 0
    np.testing.assert_allclose(found[inner], exact[inner], rtol=1e-12)


def test_coarser_values_are_interpolated_as_by_scipy():
    values = np.random.default_rng(1).random((5, 3, 2))
    axes = [centres(ends, n) for ends, n in zip(ENDS, values.shape, strict=True)]
    places = np.stack(np.meshgrid(*BOX.axes(), indexing="ij"), axis=-1)
    within = np.clip(places, [x[0] for x in axes], [x[-1] for x in axes])
    exact = RegularGridInterpolator(axes, values)(within)
    np.testing.assert_allclose(resampled(values, ENDS, BOX, 0.0), exact, rtol=1e-12)


@pytest.mark.parametrize("repeats", [False, True])
def test_the_amount_of_finer_values_is_that_of_the_nodes(repeats):
    box = replace(BOX, repeats=(repeats,) * 3)
    values = np.random.default_rng(2).random((37, 19, 11))
    found = resampled(values, ENDS, box, 5.0)
    assert found.mean() == pytest.approx(values.mean(), rel=1e-12)
    assert found.min() >= 0.0


def test_beyond_the_ends_is_the_medium():
    """Half a node within: half of it is medium where values are denser than nodes."""
    values = np.full((20, 12, 8), 3.0)
    found = resampled(values, ((-7.0, 5.0), ENDS[1], ENDS[2]), BOX, 1.0)
    np.testing.assert_allclose(found[:, 0, 0], [1, 2, 3, 3, 3, 3, 3, 2, 1, 1], rtol=1e-12)


def test_values_of_axes_that_repeat_meet_at_the_sides():
    box = Box((0.0, 0.0, -1.0), (4, 4, 1), 2.0, 5.0, (True, False, False))
    values = np.array([[0.0, 0.0], [8.0, 8.0]])
    found = resampled(values, ((0.0, 8.0), (0.0, 8.0)), box, 0.0)
    np.testing.assert_allclose(found[:, 0, 0], [2.0, 2.0, 6.0, 6.0])
    walls = Box(box.origin, box.shape, 2.0, 5.0)
    found = resampled(values, ((0.0, 8.0), (0.0, 8.0)), walls, 0.0)
    np.testing.assert_allclose(found[:, 0, 0], [0.0, 2.0, 6.0, 8.0])


# -- runs


def test_a_gaussian_of_a_file_diffuses_as_that_of_a_formula(tmp_path):
    """Its variance grows by 2 D t, from 100 to 340 µm², and its amount stays."""
    domain = {"x": [-80, 80], "y": [-80, 80]}
    x = centres((-80, 80), 40)
    values = 0.1 * np.exp(-(x[:, None] ** 2 + x**2) / 200.0)
    file = saved(tmp_path / "gauss.npy", values)
    runs = [
        finished(scene_of({"diffusion": 1.0, **field}, domain=domain))
        for field in ({"initial_file": file},
                      {"initial_formula": "0.1 * exp(-(x**2 + y**2) / 200)"})
    ]  # fmt: skip
    found, same = (run.fields["signal"] for run in runs)
    np.testing.assert_allclose(found.values, same.values, rtol=1e-9, atol=1e-15)
    variance = 100.0 + 2.0 * 1.0 * 120.0
    exact = 0.1 * 100.0 / variance * np.exp(-(x[:, None] ** 2 + x**2) / (2.0 * variance))
    near = exact > 0.3 * exact.max()
    np.testing.assert_allclose(found.values[:, :, 0][near], exact[near], rtol=0.02)
    ledger = runs[0].summary()["ledger"]["signal"]
    assert abs(ledger["relative_remainder"]) < 1e-9
    assert runs[0].field_system.fields["signal"].stored() == pytest.approx(
        values.sum() * 16.0 * found.height, rel=1e-9
    )


@pytest.mark.parametrize("ending", ["npy", "tif", "png", "csv"])
def test_all_formats_give_the_same_field(steps, ending):
    values, paths = steps
    part = {"file": paths[ending], "scale": "2 uM"}
    field = Simulation(scene_of({"initial_file": part})).fields["signal"]
    axes = [centres(ends, n) for ends, n in zip(DOMAIN.values(), values.shape, strict=True)]
    places = np.stack(np.meshgrid(field.axis(0), field.axis(1), indexing="ij"), axis=-1)
    within = np.clip(places, [x[0] for x in axes], [x[-1] for x in axes])
    exact = RegularGridInterpolator(axes, 2e-3 * values)(within)
    np.testing.assert_allclose(field.values[:, :, 0], exact, rtol=1e-12, atol=1e-18)


def test_stacks_and_arrays_of_three_axes_lie_alike(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    values = np.random.default_rng(3).integers(0, 200, (3, 4, 5)).astype(np.uint8)
    tifffile.imwrite(tmp_path / "stack.tif", values.transpose(2, 1, 0), metadata={"axes": "ZYX"})
    np.save(tmp_path / "stack.npy", values)
    found = [
        grid_values((tmp_path / f"stack.{x}").read_bytes(), x, "").values for x in ("tif", "npy")
    ]
    assert np.array_equal(*found)
    assert np.array_equal(found[0], values)


def test_a_file_may_lie_in_a_part_of_the_domain(tmp_path):
    part = {"file": saved(tmp_path / "spot.npy", np.full((10, 10), 2.0)), "x": [0, 40],
            "y": ["-20 um", "20 um"], "scale": "1 uM"}  # fmt: skip
    run = Simulation(scene_of({"initial_file": part, "boundary": "1 uM"}))
    field = run.fields["signal"]
    inside = (np.abs(field.axis(0) - 20) < 20)[:, None] & (np.abs(field.axis(1)) < 20)
    np.testing.assert_allclose(field.values[:, :, 0], np.where(inside, 2e-3, 1e-3), rtol=1e-12)


def test_pressures_of_oxygen_are_concentrations(tmp_path):
    part = {"file": saved(tmp_path / "o.npy", np.full((4, 2), 2.0)), "scale": "20 mmHg"}
    fields = {"oxygen": {**FIELD, "boundary": "40 mmHg", "initial_file": part}}
    field = Simulation(scene_of(nutrients=fields)).fields["oxygen"]
    level = scene_of(nutrients=fields).nutrients["oxygen"].boundary
    np.testing.assert_allclose(field.values, level, rtol=1e-12)


def test_what_is_explained_names_the_file(steps):
    values, paths = steps
    text = str(explain(scene_of({"initial_file": {"file": paths["csv"], "scale": "2 uM"}})))
    assert "starts from 8 x 4 values of signal.csv, 0 to 0.024 mM" in text
    assert values.max() == 12


# -- files and folders


def test_a_run_keeps_a_copy_and_resumes_without_the_file(tmp_path, steps):
    from stored import assert_same_bits

    _, paths = steps
    scene = scene_of({"initial_file": {"file": paths["csv"], "scale": "1 uM"}})
    mc.run(scene, output=tmp_path / "whole", report=False)
    mc.run(scene.with_changes({"duration": "1 min"}), output=tmp_path / "part", report=False)
    copy = tmp_path / "part" / "signal.begins.csv"
    assert copy.read_bytes() == (tmp_path / "signal.csv").read_bytes()
    (tmp_path / "signal.csv").unlink()
    moved = shutil.move(tmp_path / "part", tmp_path / "moved")
    mc.resume(moved, changes={"duration": "2 min"}, report=False)
    assert_same_bits(tmp_path / "whole", tmp_path / "moved")
    again = load_scene(tmp_path / "whole" / "scene.toml")
    mc.run(again, output=tmp_path / "whole", overwrite=True, report=False)
    assert (tmp_path / "whole" / "signal.begins.csv").is_file()
    plain = scene_of({"initial_formula": "0.1"})
    mc.run(plain, output=tmp_path / "whole", overwrite=True, report=False)
    assert not (tmp_path / "whole" / "signal.begins.csv").exists()


def test_a_damaged_copy_is_named(tmp_path, steps):
    _, paths = steps
    mc.run(scene_of({"initial_file": paths["npy"]}), output=tmp_path / "out", report=False)
    copy = tmp_path / "out" / "signal.begins.npy"
    copy.write_bytes(copy.read_bytes()[:-4] + b"\0\0\0\1")
    with pytest.raises(OutputError, match="not the file that the scene was made with") as caught:
        mc.load_result(tmp_path / "out")
    assert caught.value.damaged


def test_paths_count_from_the_folder_of_the_scene(tmp_path, steps, monkeypatch, capsys):
    text = f'{scene_of().to_toml()}\n[nutrients.signal.initial_file]\nfile = "signal.npy"\n'
    (tmp_path / "s.toml").write_text(text)
    monkeypatch.chdir("/")
    scene = load_scene(tmp_path / "s.toml")
    assert scene.nutrients["signal"].initial_file.file == str(tmp_path / "signal.npy")
    other = scene.with_changes({"nutrients.signal.initial_file": steps[1]["png"]})
    assert other.nutrients["signal"].initial_file.file == steps[1]["png"]
    other = scene.with_changes({"nutrients.signal.initial_file.file": steps[1]["csv"]})
    assert other.nutrients["signal"].initial_file.file == steps[1]["csv"]
    assert Scene.from_dict(other.to_dict()) == other
    shutil.copy(steps[1]["npy"], tmp_path / "b.npy")
    np.save(tmp_path / "signal.npy", np.ones((2, 2)))
    with refused("nutrients.signal.initial_file.file", "not the file that the scene was made with"):
        Scene.from_dict(scene.to_dict())
    with pytest.raises(SystemExit):
        main(["run", str(tmp_path / "s.toml"), "-o", str(tmp_path / "out"), "--no-report", "--set",
              "nutrients.signal.initial_file=none.npy"])  # fmt: skip
    assert "none.npy' does not exist" in capsys.readouterr().err


def table(*rows):
    return "\n".join(("x,y,z,signal", *rows)) + "\n"


SQUARE = [f"{x},{y},0,1" for x in (0, 10) for y in (0, 10)]


@pytest.mark.parametrize(("content", "words", "path"), [
    (None, "does not exist", "file"),
    (np.ones((3, 3, 3)), "has 3 x 3 x 3 values, but the scene has 2 dimensions", "file"),
    (np.ones(5), "has the shape (5), must have two or three axes", "file"),
    (np.ones((0, 4)), "has the shape (0 x 4)", "file"),
    (np.array([[1.0, np.nan], [1.0, 1.0]]), "has nan at (0, 1)", "file"),
    (np.array([[1.0, 1.0], [-0.5, -1.0]]), "has -0.5 at (1, 0), and 1 more", "file"),
    (np.array([[1.0, np.inf]]), "has inf at (0, 1)", "file"),
    (np.ones((2, 2), dtype=complex), "must hold numbers", "file"),
    (np.array([["a", "b"]]), "must hold numbers", "file"),
    (np.full((2, 2), 2e5), "largest value 2e+05 mM, must be at most 1e+05", "scale"),
    (b"\x93NUMPY\1\0\x10\0{'descr': '<f8'}", "is no NumPy array", "file"),
    (b"\x89PNG\r\n\x1a\nnothing", "is no PNG image", "file"),
    (table(*SQUARE).replace("signal", "glucose"), "has no column 'signal', only x, y, z, glucose",
     "file"),
    (table(*SQUARE[:-1]), "has no row for (10, 10) um", "file"),
    (table(*SQUARE, SQUARE[1]), "has several rows for (0, 10) um", "file"),
    (table(*SQUARE, "3,0,0,1", "3,10,0,1"), "has places along x 3 to 7 um apart", "file"),
    (table(*SQUARE[:2]), "has one place along x", "file"),
    (table(*SQUARE[:3], "10,10,0,high"), "has texts in column 'signal'", "file"),
    (table(*SQUARE[:3], "10,nan,0,1"), "has a column 'y' that is no number", "file"),
    (table(*SQUARE[:3], "10,10,0,-1"), "has -1 at (1, 1)", "file"),
])  # fmt: skip
def test_files_that_hold_something_else(tmp_path, content, words, path):
    file = tmp_path / "signal.npy"
    if isinstance(content, np.ndarray):
        np.save(file, content)
    elif content is not None:
        file.write_bytes(content.encode() if isinstance(content, str) else content)
    with refused(f"nutrients.signal.initial_file.{path}", words):
        scene_of({"initial_file": str(file)})


@pytest.mark.parametrize(("field", "parts", "path", "words"), [
    ({"initial_formula": "x"}, {}, "initial_file", "initial_formula are given both"),
    ({"initial": "steady"}, {}, "initial", "there is an initial_file"),
    ({"regime": "steady", "sides": {}}, {}, "initial_file", "the field is steady"),
    ({}, {"domain": None}, "initial_file.x", "is missing: the scene has no domain"),
    ({"z": [0, 1]}, {}, "initial_file.z", "does not exist in a scene of 2 dimensions"),
    ({"x": [1, 0]}, {}, "initial_file.x", "lower end first"),
    ({"column": "signal"}, {}, "initial_file.column", "the file is no table"),
    ({"scale": 0}, {}, "initial_file.scale", "above 0"),
    ({"scale": "5 %"}, {}, "initial_file.scale", "a part of a gas"),
    ({"sha256": "0" * 64}, {}, "initial_file.file", "not the file that the scene was made with"),
    ({"file": ""}, {}, "initial_file.file", "is empty"),
    ({"file": "/"}, {}, "initial_file.file", "cannot be read"),
])  # fmt: skip
def test_keys_that_do_not_fit(tmp_path, field, parts, path, words):
    part = {"file": saved(tmp_path / "signal.npy", np.ones((2, 2)))}
    part |= {
        key: field[key] for key in field if key in ("x", "z", "column", "scale", "sha256", "file")
    }
    rest = {key: x for key, x in field.items() if key not in part}
    given = {key: x for key, x in {"domain": DOMAIN, **parts}.items() if x is not None}
    with refused(f"nutrients.signal.{path}", words):
        entries = scene_of().to_dict() | given
        entries["nutrients"]["signal"] |= {"initial_file": part, **rest}
        if "domain" not in given:
            del entries["domain"]
            entries["nutrients"]["signal"] |= {"sides": {}}
        Scene.from_dict(entries)


def test_colours_and_times_of_images_are_refused(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    from PIL import Image

    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "rgb.png")
    tifffile.imwrite(tmp_path / "rgb.tif", np.zeros((4, 4, 3), np.uint8), photometric="rgb")
    shape = np.zeros((2, 3, 4, 4), np.uint8)
    tifffile.imwrite(tmp_path / "film.tif", shape, imagej=True, metadata={"axes": "TZYX"})
    for name, words in {"rgb.png": "has colours", "rgb.tif": "has the axes YXS",
                        "film.tif": "has the axes TZYX"}.items():  # fmt: skip
        with refused("nutrients.signal.initial_file.file", words):
            scene_of({"initial_file": str(tmp_path / name)})


def test_a_header_that_promises_too_much_takes_no_memory(tmp_path):
    file = tmp_path / "signal.npy"
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d, 2), }" % 10**15
    file.write_bytes(b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header)
    with refused("nutrients.signal.initial_file.file", "must have at most"):
        scene_of({"initial_file": str(file)})


@pytest.mark.parametrize("ending", ["npy", "tif", "png", "csv"])
def test_damaged_files_are_read_or_refused_by_name(steps, tmp_path, ending):
    """Cut, with flipped bits, with bytes put in: the scene loads, or names the file."""
    whole, rng, refusals = (tmp_path / f"signal.{ending}").read_bytes(), random.Random(ending), []
    file = tmp_path / "hurt"
    for _ in range(150):
        data = bytearray(whole)
        for _ in range(rng.choice([1, 1, 3])):
            place = rng.randrange(len(data))
            way = rng.choice(["flip", "flip", "cut", "insert"])
            if way == "flip":
                data[place] ^= 1 << rng.randrange(8)
            elif way == "cut":
                del data[max(place, 1) :]
            else:
                data[place:place] = rng.randbytes(3)
        file.write_bytes(data)
        try:
            scene_of({"initial_file": str(file)})
        except SceneError as error:
            refusals.append(error.path)
    assert len(refusals) > 30
    assert {path.rpartition(".")[0] for path in refusals} == {"nutrients.signal.initial_file"}
