"""Cells in space: spheres against their own geometry, cuts, films, and what is refused."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from synthetic import SCENE, spheroid

from multicell.cells import State
from multicell.cli.main import main
from multicell.errors import OutputError
from multicell.report.plots.colouring import colouring
from multicell.report.plots.movie import movie
from multicell.report.plots.run import Plots
from multicell.report.plots.space import View, film_picture, room, spheres

RED, GREEN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def drawn(place, radius, colours, view, half=20.0, size=200):
    return spheres(
        np.array(place, float), np.array(radius, float), np.array(colours, float), view,
        (half, half), (size, size),
    ).astype(int)  # fmt: skip


def test_a_sphere_is_a_disc_of_its_size_at_its_place():
    view = View(37.0, "none")
    right, up, _ = view.axes()
    picture = drawn([5.0 * right - 4.0 * up], [6.0], [RED], view)
    area = picture[..., 3].sum() / 255.0 * 0.2**2
    assert area == pytest.approx(np.pi * 36.0, rel=2e-3)
    rows, columns = np.nonzero(picture[..., 3] > 127)
    assert 0.2 * columns.mean() - 20.0 == pytest.approx(5.0, abs=0.15)
    assert 20.0 - 0.2 * rows.mean() == pytest.approx(-4.0, abs=0.15)


def test_the_axes_of_a_view_are_a_frame_and_z_points_upwards():
    for turn in (0.0, 50.0, 190.0):
        axes = View(turn).axes()
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert axes[1, 2] > 0.9


def test_what_is_nearer_hides_what_is_behind_it_in_any_order():
    view = View(0.0, "none")
    eye = view.axes()[2]
    for order in (1, -1):
        picture = drawn(
            [8.0 * eye, -8.0 * eye][::order], [5.0, 6.0][::order], [RED, GREEN][::order], view
        )
        assert picture[100, 100, 0] > 200
        assert picture[100, 100, 1] < 100
        assert picture[100, 100 + 28, 1] > 50  # the larger one stands out behind


@pytest.mark.parametrize(("cut", "part"), [("none", 0.0), ("half", 0.5), ("quarter", 0.25)])
def test_a_cut_takes_its_part_of_the_cells_away(cut, part):
    """Points of a ball that lie before all planes of the cut, counted."""
    rng = np.random.default_rng(2)
    points = rng.normal(size=(40_000, 3))
    planes = View(0.0, cut).planes()
    gone = (points @ planes.T > 0.0).all(axis=1) if len(planes) else np.zeros(len(points), bool)
    assert gone.mean() == pytest.approx(part, abs=0.01)


def test_a_cut_shows_the_inside_of_spheres_at_the_depth_of_its_plane():
    """A ball round the centre, halved: its face hides what is behind, and shows what sticks out."""
    view = View(0.0, "half")
    normal, eye = view.planes()[0], view.axes()[2]
    assert normal @ eye > 0.9
    whole = drawn([[0.0, 0.0, 0.0]], [10.0], [RED], view)
    assert whole[100, 100, 3] == 255
    # a small sphere within the large one, before the plane: cut away with it
    inside = drawn([[0.0, 0.0, 0.0], 3.0 * normal], [10.0, 2.0], [RED, GREEN], view)
    np.testing.assert_array_equal(inside, whole)
    # one that the plane cuts is seen, though spheres overlap: nobody is nearer
    behind = drawn([[0.0, 0.0, 0.0], -12.0 * normal], [10.0, 2.0], [RED, GREEN], view)
    np.testing.assert_array_equal(behind[100, 100], whole[100, 100])


@pytest.mark.slow
def test_the_quarter_opens_onto_the_core_of_a_spheroid():
    frame = spheroid(3000)
    shade = colouring(frame, SCENE, None, {})

    def middle(cut):
        figure = film_picture(frame, SCENE, shade, View(cut=cut), room(frame))
        picture = np.asarray(figure.axes[0].images[0].get_array()).astype(int)
        return picture[picture.shape[0] // 2, picture.shape[1] // 2]

    # dark violet of the necrotic core, not the green of the rim
    assert frame.cells.state.max() == State.NECROTIC
    assert middle("quarter")[2] > middle("quarter")[1]
    assert middle("none")[1] > middle("none")[2]


def test_no_cell_is_outside_of_the_window_from_any_side():
    frame = spheroid(500)
    for turn in (0.0, 77.0):
        shade = colouring(frame, SCENE, None, {})
        figure = film_picture(frame, SCENE, shade, View(turn, "none"), room(frame), clear=True)
        picture = figure.axes[0].images[0].get_array()
        for edge in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
            assert edge[:, 3].max() == 0


def test_cells_in_a_plane_and_unknown_cuts_are_refused():
    frame = spheroid(100)
    flat = SCENE.with_changes({"dimensions": 2, "nutrients.oxygen.height": "2 mm"})
    with pytest.raises(OutputError, match="a section shows them all"):
        Plots([frame], {}, flat).space()
    with pytest.raises(OutputError, match="no cut"):
        View(cut="third")
    with pytest.raises(OutputError, match="turn"):
        View(turn=float("nan"))


@pytest.mark.slow
def test_a_film_in_space_swings_to_both_sides_and_may_be_transparent(small_run, tmp_path):
    path = movie(small_run, tmp_path / "a.webp", space=True, rate=2.0, turn=80.0, transparent=True)
    with Image.open(path) as film:
        assert film.n_frames == len(small_run.frames) + 3  # 1.5 s more
        assert film.size == (640, 480)
        pictures = []
        for k in range(film.n_frames):
            film.seek(k)
            pictures.append(np.asarray(film.convert("RGBA")).astype(int))
    assert pictures[0][0, -1, 3] == 0
    assert np.abs(pictures[-1] - pictures[-3]).max() > 60  # it turns after the last frame too
    # opaque elsewhere
    with Image.open(movie(small_run, tmp_path / "b.gif", space=True, rate=1.0, cut="half")) as film:
        assert film.convert("RGBA").getextrema()[3] == (255, 255)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"transparent": True}, "background"),
        ({"space": True, "plane": "x"}, "name a cut"),
        ({"space": True, "turn": float("inf")}, "turn"),
        ({"space": True, "cut": "all"}, "no cut"),
    ],
)
def test_options_that_do_not_go_together_are_refused(small_run, tmp_path, given, words):
    with pytest.raises(OutputError, match=words):
        movie(small_run, tmp_path / "c.gif", **given)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_commands_draw_cells_in_space(small_run, tmp_path):
    def call(*words):
        return CliRunner().invoke(main, list(map(str, words)))

    still = tmp_path / "a.pdf"
    done = call("plot", small_run.folder, "-o", still, "--picture", "space", "--turn", 30, "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.output) == {"file": str(still)}
    assert still.read_bytes().startswith(b"%PDF")
    film = tmp_path / "a.gif"
    done = call(
        "movie", small_run.folder, "-o", film, "--space", "--cut", "none", "--rate", 2, "--quiet"
    )
    assert done.exit_code == 0, done.output
    assert film.stat().st_size > 10_000
    assert "exists already" in call("movie", small_run.folder, "-o", film, "--space").output
    wrong = [
        ("plot", "--cut", "half"),
        ("plot", "--picture", "growth", "--turn", 3),
        ("plot", "--picture", "space", "--section", "x"),
        ("movie", "--turn", 3),
    ]
    for command, *options in wrong:
        done = call(command, small_run.folder, "-o", tmp_path / "b.gif", *options)
        assert done.exit_code == 2
        assert re.search("(has|have) (a|no) meaning", done.output)
