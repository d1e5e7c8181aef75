"""Images of labels: every ball is a cell, at its place and with its radius."""

from __future__ import annotations

import io

import numpy as np
import pytest

import multicell as mc
from multicell.errors import DataError, SceneError
from multicell.tables.images import cells_of_image
from multicell.tables.mapping import parse_map

tifffile = pytest.importorskip("tifffile")
pytest.importorskip("skimage")


def balls(centres, radii, spacing, shape):
    """Return an image in which each ball has its own number; all lengths in µm."""
    image = np.zeros(shape, np.uint16)
    spacing = np.array(spacing)
    for number, (centre, radius) in enumerate(zip(centres, radii, strict=True), start=1):
        low = np.maximum(np.floor((centre - radius) / spacing).astype(int), 0)
        high = np.minimum(np.ceil((centre + radius) / spacing).astype(int) + 1, shape)
        axes = (np.arange(a, b) * h for a, b, h in zip(low, high, spacing, strict=True))
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        inside = ((grid - centre) ** 2).sum(axis=-1) <= radius**2
        image[tuple(slice(a, b) for a, b in zip(low, high, strict=True))][inside] = number
    return image


def saved(image, **how):
    content = io.BytesIO()
    tifffile.imwrite(content, image, **how)
    return content.getvalue()


def read(content, columns="", frame=None):
    return cells_of_image(content, "l.tif", parse_map(columns), frame)


@pytest.fixture(scope="module")
def many():
    """Three thousand balls that do not touch, in voxels of 1 × 0.5 × 0.5 µm."""
    generator = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(*[np.arange(15)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = (grid[:3000] + 0.5) * 12.0 + generator.uniform(-1, 1, (3000, 3))
    radii = generator.uniform(4.0, 5.0, 3000)
    return centres, radii, balls(centres, radii, (1.0, 0.5, 0.5), (180, 360, 360))


@pytest.mark.slow
def test_three_thousand_balls_are_counted_exactly_and_lie_within_half_a_voxel(many):
    centres, radii, image = many
    columns, said = read(saved(image), "pixel=0.5 um, slice=1 um")
    found = np.stack([columns[f"{axis} / um"] for axis in "zyx"], axis=1)
    assert len(found) == 3000
    assert (np.abs(found - centres) <= [0.5, 0.25, 0.25]).all()
    assert np.abs(columns["radius / um"] - radii).max() < 0.2
    assert said == "l.tif read as labels: 3,000 cells; pixels of 0.5 × 0.5 × 1 µm"


PAIR = np.array([[20.0, 20.0], [20.0, 40.0]]), np.array([8.0, 6.0])


def flat(size=0.5):
    return balls(*PAIR, (size, size), (100, 120))


@pytest.mark.parametrize(
    ("how", "columns"),
    [
        ({"ome": True, "metadata": {"axes": "YX", "PhysicalSizeX": 500, "PhysicalSizeXUnit": "nm",
                                    "PhysicalSizeY": 0.5, "PhysicalSizeYUnit": "µm"}}, ""),
        ({"imagej": True, "resolution": (2.0, 2.0), "metadata": {"unit": "um"}}, ""),
        ({"imagej": True, "resolution": (2.0, 2.0), "metadata": {"unit": "micron"}}, ""),
        ({}, "pixel=0.5 um"),
    ],
)  # fmt: skip
def test_the_size_of_pixels_is_that_of_the_file_or_stated(how, columns):
    found, _ = read(saved(flat(), **how), columns)
    np.testing.assert_allclose(found["x / um"], PAIR[0][:, 1], atol=0.01)
    np.testing.assert_allclose(found["radius / um"], PAIR[1], rtol=0.02)
    assert "z / um" not in found


def test_cells_that_are_not_round_move_apart_and_it_is_said():
    image = np.zeros((100, 100), np.uint16)
    for k in range(6):  # bars of 6 × 40 µm beside each other
        image[20:60, 20 + 6 * k : 26 + 6 * k] = k + 1
    found, said = read(saved(image), "pixel=1 um")
    place = np.stack([found["x / um"], found["y / um"]], axis=1)
    apart = np.linalg.norm(place[:, None] - place[None], axis=-1) + 1e9 * np.eye(6)
    assert apart.min() >= 0.8 * 2.0 * found["radius / um"].min() * (1.0 - 1e-3)
    assert "6 cells that overlapped moved by" in said
    np.testing.assert_allclose(place.mean(axis=0), [37.5, 39.5], atol=1e-6)


def test_a_frame_is_chosen():
    film = np.stack([flat(), np.roll(flat(), 10, axis=1)])
    content = saved(film, imagej=True, metadata={"axes": "TYX"})
    first, said = read(content, "pixel=0.5 um")
    second, _ = read(content, "pixel=0.5 um", frame=1)
    np.testing.assert_allclose(second["x / um"] - first["x / um"], 5.0)
    assert "of frame 0" in said
    with pytest.raises(SceneError, match="does not have"):
        read(content, "pixel=0.5 um", frame=2)


@pytest.mark.parametrize(
    ("content", "columns", "said"),
    [
        (
            lambda: saved(flat()),
            "",
            r"does not state the size of its pixels along y, x.*pixel=0\.65",
        ),
        (lambda: saved(np.zeros((9, 9), np.uint8)), "pixel=1 um", "has no label"),
        (lambda: saved(flat() / 7.3), "", "must be whole numbers of cells"),
        (lambda: saved((flat() > 0).astype(np.uint8)), "", "is a mask"),
        (lambda: saved(np.ones((9, 9, 3), np.uint8), photometric="rgb"), "", "has 3 channels"),
        (lambda: b"II*\0 and nothing more", "", "is no TIFF image"),
    ],
)
def test_images_that_cannot_be_read_are_refused(content, columns, said):
    with pytest.raises(DataError, match=said):
        read(content(), columns)


def test_a_run_starts_from_an_image(tmp_path):
    path = tmp_path / "labels.tif"
    path.write_bytes(saved(flat()))
    scene = mc.Scene(duration="1 h", dimensions=2).with_changes(
        {
            "cells.division_radius": "9 um",
            "initial.cells": {"file": str(path), "columns": "pixel=0.5 um"},
        }
    )
    run = mc.run(scene)
    np.testing.assert_allclose(np.sort(run.frames[0].cells.radius), [6.0, 8.0], rtol=0.02)


def channels():
    """Return two channels in which the first cell has 100 and 7, the second 30 and 9."""
    labels = flat()
    red, green = (np.choose(labels, [5.0, *level]) for level in ((100.0, 30.0), (7.0, 9.0)))
    return np.stack([red, green]).astype(np.float32)


def test_mean_intensities_of_labels_are_columns(tmp_path):
    for name, axes, image in (("cyx.tif", "CYX", channels()), ("one.tif", "YX", channels()[0])):
        (tmp_path / name).write_bytes(saved(image, metadata={"axes": axes}, ome=True))
    (tmp_path / "labels.tif").write_bytes(saved(flat()))
    table = mc.read_cells(tmp_path / "labels.tif", "pixel=0.5 um, image=cyx.tif")
    assert table["intensity_0"].tolist() == [100.0, 30.0]
    assert table["intensity_1"].tolist() == [7.0, 9.0]
    np.testing.assert_allclose(table["x / um"], PAIR[0][:, 1], atol=0.01)
    one = mc.read_cells(tmp_path / "labels.tif", "pixel=0.5 um, image=one.tif")
    assert one["intensity"].tolist() == [100.0, 30.0]


def test_types_by_intensity_start_a_run(tmp_path):
    (tmp_path / "raw.tif").write_bytes(saved(channels()[0]))
    (tmp_path / "labels.tif").write_bytes(saved(flat()))
    table = mc.read_cells(tmp_path / "labels.tif", "pixel=0.5 um, image=raw.tif")
    table["type"] = np.where(table["intensity"] > 50.0, "bright", "dark").astype(object)
    scene = mc.Scene(duration="1 h", dimensions=2, types={"bright": {}, "dark": {}})
    scene = scene.with_changes({"cells.division_radius": "9 um"})
    start = mc.Simulation(scene, cells=table).cells
    assert sorted(zip(start.radius.round(), start.kind, strict=True)) == [(6.0, 1), (8.0, 0)]


def test_an_intensity_can_be_a_value_of_a_network():
    found, said = cells_of_image(
        saved(flat()), "l.tif", parse_map("pixel=0.5 um, energy.ATP=intensity"), None,
        (saved(channels()[0]), "raw.tif"),
    )  # fmt: skip
    assert found["energy.ATP"].tolist() == [100.0, 30.0]
    assert said.endswith("mean intensity of raw.tif in 1 channel")


def test_an_image_of_another_size_is_refused():
    small = saved(channels()[0][:, :-1])
    with pytest.raises(DataError, match=r"raw.tif: has 100 × 119 pixels .* 100 × 120"):
        cells_of_image(saved(flat()), "l.tif", parse_map("pixel=1 um"), None, (small, "raw.tif"))


def test_intensities_of_a_stack_are_those_of_its_voxels():
    labels, gray = np.zeros((4, 20, 20), np.uint16), {"photometric": "minisblack"}
    labels[1:3, 5:9, 5:9], labels[:2, 12:15, 12:15] = 1, 2
    image = np.random.default_rng(0).random((4, 20, 20)).astype(np.float32)
    found, _ = cells_of_image(
        saved(labels, **gray),
        "l.tif",
        parse_map("pixel=1 um"),
        None,
        (saved(image, **gray), "raw.tif"),
    )
    wanted = [image[labels == k].mean() for k in (1, 2)]
    np.testing.assert_allclose(found["intensity"], wanted, rtol=1e-6)


@pytest.mark.parametrize("which", ["labels", "image"])
def test_damaged_images_are_read_or_refused_in_words(which):
    """Forty cuts and changed bytes of each file: no error of a library comes through."""
    whole = {"labels": saved(flat()), "image": saved(channels()[0])}
    random, refused = np.random.default_rng(7), 0
    for trial in range(40):
        content = bytearray(whole[which])
        if trial % 2:
            content = content[: int(random.integers(4, len(content)))]
        else:  # tags stand at the beginning, or at the end
            places = random.integers(4, 400, 6)
            for place in places:
                content[place] = int(random.integers(256))
        files = whole | {which: bytes(content)}
        try:
            cells_of_image(
                files["labels"], "l.tif", parse_map("pixel=1 um"), None, (files["image"], "raw.tif")
            )
        except (DataError, SceneError):
            refused += 1
    assert refused > 10


def test_pages_that_lead_back_to_one_before_are_refused():
    """Of two pages the second names the first as the next one."""
    content = bytearray(saved(np.stack([flat(), flat()]), photometric="minisblack"))
    with tifffile.TiffFile(io.BytesIO(content)) as file:
        first, second = file.pages
        size = file.tiff.offsetsize
        place = second.offset + file.tiff.tagnosize + len(second.tags) * file.tiff.tagsize
        content[place : place + size] = first.offset.to_bytes(size, "little")
    with pytest.raises(DataError, match="pages that lead back"):
        cells_of_image(bytes(content), "l.tif", parse_map("pixel=1 um"), None)
