"""The layer of medium follows tissue of any shape: none, one cell, two pieces, off the middle."""

import bits
import numpy as np
import pytest
from layered import LEVEL, MARGIN, D, directions, field, packed
from running import finished

import multicell as mc
from multicell.nutrient.layer import mean_end

SIZE = 8.0  # radius of cells, µm
SHAPE = "nutrients.oxygen.margin_shape"


def test_no_cell_leaves_the_medium():
    oxygen = field(10.0, 1e-3)
    report = oxygen.solve(np.empty((0, 3)), np.empty(0), radius=np.empty(0))
    np.testing.assert_allclose(oxygen.values, LEVEL, rtol=1e-12)
    assert report.uptake == 0.0


@pytest.mark.parametrize("shape", ["tissue", "box"])
def test_one_cell_in_its_layer(shape):
    """c = c0 - q/(4 pi D) (1/r - 1/margin) round it, the same in all directions without corners."""
    oxygen = field(5.0, 1e-12, of={"margin_shape": shape})
    uptake, here = 600.0, np.array([[1.3, -2.1, 0.7]])
    report = oxygen.solve(here, np.array([uptake]), radius=np.array([SIZE]))
    distance = np.repeat([20.0, 30.0, 40.0], 2)
    ways = np.array([[1.0, 0.0, 0.0], np.ones(3) / np.sqrt(3.0)] * 3)
    found = oxygen.sample(here + distance[:, None] * ways, np.zeros(6))
    exact = LEVEL - uptake / (4.0 * np.pi * D) * (1.0 / distance - 1.0 / MARGIN)
    off = np.abs(found - exact).max() / (LEVEL - exact.min())
    assert (off < 0.02) == (shape == "tissue")
    assert report.uptake == pytest.approx(uptake, rel=1e-9)
    assert report.inflow == pytest.approx(report.uptake, rel=1e-8)


def two_pieces():
    """Return a large ball and a small one far from it, which make a box that neither is mid of."""
    large, volume = packed(110.0)
    small, _ = packed(50.0)
    return large, small + np.array([330.0, 120.0, -90.0]), volume


def test_two_pieces_have_a_layer_each():
    """Between them lies medium: each has the field of a ball in its own layer, to 1 %."""
    large, small, volume = two_pieces()
    rate, position = 0.012, np.vstack([large, small])
    size = np.full(len(position), SIZE)
    oxygen = field(10.0, 1e-9)
    oxygen.solve(position, np.full(len(position), rate * volume), radius=size)
    found = oxygen.sample(position, size)
    for piece, values in ((large, found[: len(large)]), (small, found[len(large) :])):
        place = piece - piece.mean(axis=0)
        end = mean_end(place, size[: len(piece)], MARGIN)
        radius = (len(piece) * volume / (4.0 / 3.0 * np.pi)) ** (1.0 / 3.0)
        away = np.sqrt((place**2).sum(axis=1))
        surface = LEVEL - rate * radius**3 / (3.0 * D) * (1.0 / radius - 1.0 / end)
        exact = surface - rate / (6.0 * D) * (radius**2 - away**2)
        assert (LEVEL - exact).max() > 0.09 * LEVEL
        for cells in directions(place, radius):
            assert values[cells].mean() == pytest.approx(exact[cells].mean(), rel=0.01)
    between = 0.42 * large.mean(axis=0) + 0.58 * small.mean(axis=0)
    assert oxygen.sample(between[None], np.zeros(1)) == pytest.approx(LEVEL, rel=1e-4)


def test_the_medium_follows_the_ends_of_a_row():
    """A row along the diagonal finds as much at its sides as one along an axis, to 1 %."""
    along = 12.0 * np.arange(-8, 9)
    found = []
    for way in ([1.0, 0.0, 0.0], np.ones(3) / np.sqrt(3.0)):
        oxygen, position = field(8.0, 1e-3), along[:, None] * np.asarray(way)
        size = np.full(len(along), SIZE)
        oxygen.solve(position, np.full(len(along), 600.0), radius=size)
        found.append(oxygen.sample(position, size))
    assert (LEVEL - found[0]).max() > 0.05 * LEVEL
    np.testing.assert_allclose(found[0], found[1], atol=0.01 * LEVEL)


CASES = {
    "steady": {"nutrients.oxygen.regime": "steady", "nutrients.oxygen.spacing": "3.4 um"},
    "transient": {"nutrients.oxygen.regime": "transient", "nutrients.oxygen.spacing": "12 um"},
    "rim": {"nutrients.oxygen.margin": 0, "nutrients.oxygen.spacing": "5 um"},
}


def case(name):
    return {"initial.count": 60, "duration": "30 min", SHAPE: "tissue", **CASES[name]}


@pytest.mark.parametrize("name", CASES)
def test_threads_and_resumes_leave_the_bits(name):
    """Of one thread, of two, and after any frame."""
    runs = [bits.simulation("spheroid", case(name), threads) for threads in (1, 2)]
    frames = [runs[0].frame()]
    while not runs[0].finished:
        runs[0].step()
        frames.append(runs[0].frame())
    finished(runs[1])
    end = bits.digest(frames[-1])
    assert bits.digest(runs[1].frame()) == end
    if name == "steady":  # on so many nodes threads share the planes
        assert frames[-1].fields["oxygen"].values.size >= 50_000
    for frame in frames[:-1]:
        again = bits.simulation("spheroid", case(name), 1, frame=frame)
        finished(again)
        assert bits.digest(again.frame()) == end
    assert abs(runs[0].summary()["ledger"]["oxygen"]["relative_remainder"]) < 1e-9


def test_a_resumed_folder_has_the_bits_of_a_whole_run(tmp_path):
    scene = mc.load_scene("spheroid").with_changes(case("transient"))
    whole = mc.run(scene, output=tmp_path / "whole", report=False, threads=1)
    half = scene.with_changes({"duration": "10 min"})
    mc.run(half, output=tmp_path / "half", report=False, threads=1)
    longer = mc.resume(tmp_path / "half", report=False, threads=1, changes={"duration": "30 min"})
    assert bits.digest(longer.frames[-1]) == bits.digest(whole.frames[-1])
    assert whole.scene.to_dict()["nutrients"]["oxygen"]["margin_shape"] == "tissue"
