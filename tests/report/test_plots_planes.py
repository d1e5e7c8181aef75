"""Sections across any axis and coloured by any quantity, pictures of several runs, formats."""

import re

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.collections import EllipseCollection
from synthetic import cells_at

import multicell as mc
from multicell.cells import Cells, State
from multicell.cli.main import main
from multicell.report.plots.colouring import colouring, colourings, founder
from multicell.report.plots.run import Plots
from multicell.report.plots.section import Plane, slice_at, turn_frame
from multicell.report.plots.style import save_figure
from multicell.results.frame import Field, Frame


def discs(figure):
    """Return the circles of a section: those that are cut, the last ones drawn."""
    found = [c for c in figure.axes[0].collections if isinstance(c, EllipseCollection)]
    return found[-1]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    scene = mc.load_scene("spheroid").with_changes(
        {"duration": "8 h", "initial.count": 150, "output.every": "4 h", "cells.young": "0.5 kPa"}
    )
    return mc.run(scene, output=tmp_path_factory.mktemp("planes") / "run", report=False)


@pytest.mark.parametrize("axis", "xyz")
def test_a_plane_across_any_axis_cuts_the_cells_there(run, axis):
    frame = run.frames[-1]
    at = 8.0
    figure = run.plot.section(plane=f"{axis}={at}")
    k = "xyz".index(axis)
    away = frame.cells.position[:, k] - at
    inside = np.abs(away) < frame.cells.radius
    right, up = (k + 1) % 3, (k + 2) % 3
    drawn = discs(figure)
    np.testing.assert_allclose(drawn.get_offsets(), frame.cells.position[inside][:, [right, up]])
    radius = np.sqrt(frame.cells.radius[inside] ** 2 - away[inside] ** 2)
    np.testing.assert_allclose(drawn.get_widths(), 2.0 * radius)


def test_what_is_turned_is_not_mirrored():
    values = np.arange(60.0).reshape(3, 4, 5)
    field = Field("oxygen", "mM", np.array([1.0, 2.0, 3.0]), 2.0, values)
    frame = Frame(0.0, 0, Cells.empty(), fields={"oxygen": field})
    for axis, order in (("x", [1, 2, 0]), ("y", [2, 0, 1])):
        assert np.linalg.det(np.eye(3)[order]) == pytest.approx(1.0)
        seen = turn_frame(frame, Plane(axis)).fields["oxygen"]
        for index in np.ndindex(values.shape):
            assert seen.values[tuple(np.array(index)[order])] == values[index]
        np.testing.assert_array_equal(seen.origin, field.origin[order])
    middle = slice_at(turn_frame(frame, Plane("x")).fields["oxygen"], 1.0 + 2.0 * 1.5)
    np.testing.assert_array_equal(middle, values[1])


def test_colours_follow_a_quantity_and_leave_out_the_rarest(run):
    frame = run.frames[-1]
    shade = colouring(frame, run.scene, "pressure", {})
    low, high = np.percentile(frame.cells.pressure, (0.5, 99.5))
    assert shade.range == pytest.approx((low, high))
    order = np.argsort(frame.cells.pressure)
    # viridis grows lighter
    lightness = shade.rgb[order] @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) > -1e-2).all()
    text = {t.get_text() for t in run.plot.section(colour="pressure").texts}
    assert "Pressure (kPa)" in text


@pytest.mark.parametrize("name", ["type", "phase", "clone", "doomed", "volume", "oxygen"])
def test_everything_that_cells_have_can_be_shown(run, name):
    assert name in colourings(run.frames[-1])
    assert len(discs(run.plot.section(colour=name)).get_facecolor()) > 10


def test_irradiated_cells_are_coloured_by_their_fate(run):
    cells = run.frames[-1].cells.copy()
    cells.doomed[:3] = 2, 1, 1
    cells.state[2:4] = State.APOPTOTIC, State.NECROTIC
    shade = colouring(Frame(0.0, 0, cells), run.scene, "doomed", {})
    assert list(shade.palette) == ["clonogenic", "doomed", "dead"]
    assert shade.group[:4].tolist() == [1, 1, 2, 2]
    assert not shade.group[4:].any()


def test_clones_are_what_descends_from_one_cell(run):
    lineage = mc.load_result(run.folder).lineage
    parent = dict(zip(lineage["id"].tolist(), lineage["parent"].tolist(), strict=True))
    ids = run.frames[-1].cells.id
    for cell, first in zip(ids.tolist(), founder(ids, lineage).tolist(), strict=True):
        while parent[cell] >= 0:
            cell = parent[cell]
        assert cell == first


def test_descendants_of_one_cell_are_parted_by_a_generation():
    # 0 -> 1, 2 -> 3, 4, 5, 6 -> 7 ... 14 -> 15, 16 from 7
    lineage = {
        "id": np.arange(17),
        "parent": np.array([-1, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7]),
    }
    ids = np.array([15, 16, 8, 9, 14])
    np.testing.assert_array_equal(founder(ids, lineage), [7, 7, 8, 9, 14])
    # a cell that is older than its generation is its own clone's
    np.testing.assert_array_equal(founder(np.array([0]), lineage), [0])


def test_cells_that_the_lineage_does_not_know_are_founders():
    nothing = {"id": np.empty(0, np.int64), "parent": np.empty(0, np.int64)}
    np.testing.assert_array_equal(founder(np.array([3, 0]), nothing), [3, 0])
    few = {"id": np.array([0]), "parent": np.array([-1])}
    np.testing.assert_array_equal(founder(np.array([5, 0]), few), [5, 0])


def test_cells_behind_the_plane_are_paler_the_deeper_they_lie():
    n = 5
    position = np.zeros((n, 3))
    position[:, 0] = 30.0 * np.arange(n)
    position[:, 2] = [0.0, -8.0, -14.0, -40.0, 8.0]  # cut, behind, deeper, too deep, in front
    frame = Frame(0.0, 0, cells_at(position))
    figure = Plots([frame], {}, mc.load_scene("settle")).section(plane="z=0")
    deep, cut = (c for c in figure.axes[0].collections if isinstance(c, EllipseCollection))
    assert cut.get_offsets()[:, 0].tolist() == [0.0]
    # the deepest is drawn first
    assert deep.get_offsets()[:, 0].tolist() == [60.0, 30.0]
    full, (deepest, near) = cut.get_facecolors()[0], deep.get_facecolors()
    assert full[0] < near[0] < deepest[0] < 1.0


def test_several_runs_lie_over_each_other(run):
    other = mc.run(run.scene.with_changes({"duration": "2 h", "seed": 5}))
    figure = run.plot.quantity("diameter", {"other": other})
    lines = figure.axes[0].lines
    np.testing.assert_array_equal(lines[0].get_ydata(), run.history["diameter"])
    np.testing.assert_array_equal(lines[1].get_ydata(), other.history["diameter"])
    assert [t.get_text() for t in figure.axes[0].get_legend().get_texts()] == ["this run", "other"]
    assert figure.axes[0].get_ylabel() == "diameter (µm)"
    assert figure.axes[0].get_xlim()[1] == pytest.approx(8.0)


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_the_same_picture_is_the_same_file(run, tmp_path, ending):
    for name in "ab":
        save_figure(run.plot.growth(), tmp_path / f"{name}.{ending}")
    first, second = ((tmp_path / f"{name}.{ending}").read_bytes() for name in "ab")
    assert first == second
    begins = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    assert first.startswith(begins[ending])


REFUSED = {
    "plane": (["--section", "w=3"], "is no plane"),
    "far": (["--section", "x=900"], r"cuts no cell: they lie between -\d"),
    "colour": (["--colour", "presure"], "Did you mean 'pressure'"),
    "quantity": (["--quantity", "diametr"], "Did you mean 'diameter'"),
    "time": (["--time", "3"], "without a unit"),
    "mixed": (["--quantity", "diameter", "--time", "3 h"], "no meaning with --quantity"),
    "colour of growth": (
        ["--picture", "growth", "--colour", "age"],
        "no meaning with --picture growth",
    ),
    "nothing": (["--picture", "pull"], "no picture of"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_drawn_is_said(run, tmp_path, case):
    options, words = REFUSED[case]
    given = ["plot", str(run.folder), "-o", str(tmp_path / "a.png"), *options]
    done = CliRunner().invoke(main, given)
    assert done.exit_code == 2, done.output
    assert re.search(words, done.output)
    assert not (tmp_path / "a.png").exists()


def test_command(run, tmp_path):
    def call(*options):
        return CliRunner().invoke(main, ["plot", *map(str, options)])

    path = tmp_path / "a.svg"
    given = [run.folder, "-o", path, "--section", "x", "--colour", "pressure", "--time", "4.2 h"]
    assert call(*given).exit_code == 0
    assert "after 4 h: section across x through the centre" in path.read_text()
    assert "exists already" in call(*given).output
    assert call(*given, "--overwrite").exit_code == 0
    assert call(run.folder, "-o", tmp_path / "a.jpg").exit_code == 2
    again = tmp_path / "again"
    mc.run(run.scene, output=again, report=False)
    both = [run.folder, again, "-o", tmp_path / "b.png"]
    assert "--quantity only" in call(*both).output
    assert call(*both, "--quantity", "cells").exit_code == 0
    assert call(run.folder, "-o", tmp_path / "c.png", "--picture", "profiles").exit_code == 0
