"""Pictures and report: what they show, and that the page stands alone."""

import re
from itertools import pairwise

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from matplotlib.image import imread
from picture_texts import read, rendered, texts
from synthetic import BARE, SCENE, ball, cells_at, growing_frames, history_of, spheroid

from multicell.cells import Cells, State
from multicell.errors import OutputError
from multicell.report.plots import style as drawing
from multicell.report.plots.run import Plots
from multicell.report.plots.section import refine, slice_at
from multicell.report.plots.style import save_figure
from multicell.report.result import Result, history_columns
from multicell.report.wording import clock, time_unit
from multicell.results.frame import Field, Frame
from multicell.results.summary import state_summary


@pytest.fixture(scope="module")
def frames():
    return growing_frames(count=6, last=1500)


@pytest.fixture(scope="module")
def result(frames):
    last = frames[-1]
    summary = state_summary(BARE, last) | {
        "divisions": 1700,
        "steps": 1296,
        "integrator": {"method": "cvode", "evaluations": 12345},
        "wall": {"nutrient": 2.0, "mechanics": 60.0, "total": 133.0},
        "ledger": {
            "oxygen": {"inflow": 1.5e9, "relative_remainder": 3e-10},
            "relative_remainder": 3e-10,
        },
        "versions": {"numpy": "2.4"},
    }
    return Result(None, frames, history_columns(history_of(frames)), summary, SCENE)


@pytest.mark.parametrize("name", ["growth", "section", "profiles"])
def test_picture_has_title_time_cells_and_size(result, tmp_path, name):
    figure = getattr(result.plot, name)()
    words = texts(figure)
    assert SCENE.title in words
    count = f"{len(result.frames[-1].cells):,} cells after 9 d"
    assert any(text.startswith(count) for text in words)
    save_figure(figure, tmp_path / "picture.png")
    assert imread(tmp_path / "picture.png").shape[:2] == (1000, 1600)


def test_section_draws_the_cut_of_each_cell():
    position = [[0, 0, 0], [12, 0, 3], [0, 12, -3], [-12, 0, 0], [0, 0, 8], [0, 0, -8]]
    cells = cells_at(position, radius=5.0, state=[0, 1, 2, 0, 0, 0])
    figure = Plots([Frame(0.0, 0, cells)], {}, BARE).section()
    *_, circles = figure.axes[0].findobj(EllipseCollection)  # those behind come first
    # the centre of mass lies at z = 0: the cells at ±8 µm are not cut, those at ±3 show 4 µm
    np.testing.assert_allclose(circles.get_widths(), [10.0, 8.0, 8.0, 10.0])
    np.testing.assert_allclose(circles.get_offsets(), np.array(position)[:4, :2])
    expected = [
        mpl.colors.to_rgb(drawing.STATE_COLOURS[State(s).name.lower()]) for s in (0, 1, 2, 0)
    ]
    np.testing.assert_allclose(circles.get_facecolor()[:, :3], expected)


def test_section_marks_thresholds_of_the_field():
    figure = Plots([spheroid(3000)], {}, SCENE).section()
    legend = texts(figure)
    assert "below 0.02: quiescence" in legend
    assert "most cells are necrotic" in legend
    assert "Oxygen (mM)" in legend


def test_slice_interpolates_between_layers():
    values = np.broadcast_to(np.array([1.0, 2.0, 4.0]), (2, 2, 3))
    field = Field("oxygen", "mM", np.zeros(3), 10.0, values)
    np.testing.assert_allclose(slice_at(field, 5.0), 1.0)
    np.testing.assert_allclose(slice_at(field, 20.0), 3.0)
    np.testing.assert_allclose(slice_at(field, 25.0), 4.0)
    with pytest.raises(ValueError, match="outside"):
        slice_at(field, 26.0)


def test_count_is_logarithmic_only_where_it_grows(frames):
    growing = Plots(frames, history_columns(history_of(frames)), SCENE).growth()
    assert growing.axes[0].get_yscale() == "log"
    still = [Frame(t, t, cells_at(ball(50))) for t in (0, 60, 120)]
    figure = Plots(still, history_columns(history_of(still)), BARE).growth()
    assert figure.axes[0].get_yscale() == "linear"
    assert figure.axes[0].get_ylim()[0] == 0.0


def test_one_cell_at_one_time_can_be_drawn():
    one = [Frame(0.0, 0, cells_at([[0, 0, 0]]))]
    pictures = Plots(one, history_columns(history_of(one)), BARE)
    for figure in (pictures.growth(), pictures.section(), pictures.profiles()):
        rendered(figure)
        assert any("1 cell after 0 s" in text for text in texts(figure))


def test_nothing_to_draw_is_said():
    with pytest.raises(ValueError, match="empty"):
        Plots([], {}, BARE).growth()
    with pytest.raises(ValueError, match="no centre"):
        Plots([Frame(0.0, 0, Cells.empty())], {}, BARE).section()


BLUE, ORANGE = drawing.type_colours(["a", "b"]).values()


@pytest.mark.parametrize(
    "colours", [drawing.STATE_COLOURS.values(), (BLUE, ORANGE, drawing.STATE_COLOURS["necrotic"])]
)
def test_states_and_the_first_two_types_differ_in_lightness(colours):
    weights = np.array([0.2126, 0.7152, 0.0722])
    light = sorted(weights @ np.array(mpl.colors.to_rgb(c)) ** 2.2 for c in colours)
    # the contrast that WCAG asks of graphics against their neighbours is 3, of pairs here 1.8
    assert min((b + 0.05) / (a + 0.05) for a, b in pairwise(light)) > 1.8


def test_times_have_units_that_suit_them():
    times = {30: "30 s", 3600: "60 min", 36000: "10 h", 950400: "11 d"}
    assert {seconds: time_unit(seconds).text(seconds) for seconds in times} == times
    walls = {0.5: "0.5 s", 42.3: "42 s", 134: "2 min 14 s", 7260: "2 h 1 min"}
    assert {seconds: clock(seconds) for seconds in walls} == walls


@pytest.fixture(scope="module")
def path(result, tmp_path_factory):
    return result.report(tmp_path_factory.mktemp("report"))


def test_report_stands_alone(path):
    page = read(path)
    html = path.read_text(encoding="utf-8")
    own = re.sub(r"<script.*?</script>|base64,[\w+/=]+", "", html, flags=re.DOTALL)
    assert not re.search(r"https?:|//[a-z]|@import|url\(", own)
    assert not {"link", "iframe", "object", "embed"} & {tag for tag, _ in page.tags}
    # what scripts there are is part of the page, and may load nothing (test_viewer.py)
    assert not any("src" in attrs for tag, attrs in page.tags if tag == "script")
    sources = [attrs["src"] for tag, attrs in page.tags if tag == "img"]
    assert len(sources) == 3
    # with few colours, in base64
    files = [file.stat().st_size for file in path.parent.glob("*.png")]
    assert sum(map(len, sources)) < 4 / 3 * sum(files)
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert all(attrs.get("alt") for tag, attrs in page.tags if tag == "img")


def test_report_shows_figures_work_wall_time_and_the_scene(result, path):
    text = read(path).text
    cells = f"{len(result.frames[-1].cells):,}"
    for words in (cells, "9 d", "1,700", "2 min 13 s", "12,345", "3.0e-10"):
        assert words in text, words
    assert result.scene.to_toml().strip() in text


def test_report_of_an_interrupted_run_says_so(tmp_path):
    result = Result(None, [], {}, {"interrupted": True}, BARE)
    page = read(result.report(tmp_path))
    assert "Interrupted before its end" in page.text
    assert [tag for tag, _ in page.tags if tag == "img"] == []


def test_report_refuses_a_folder_that_cannot_be_written(result, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="Not a directory"):
        result.report(tmp_path / "file" / "out")


def test_a_refined_section_goes_smoothly_through_its_points():
    x, y = np.meshgrid(np.arange(7.0), np.arange(5.0), indexing="ij")
    values = (x**2 + 3.0 * y)[:, :, None]
    fine = refine(Field("oxygen", "mM", np.zeros(3), 10.0, values), 0.0)[2].T
    np.testing.assert_array_equal(fine[::4, ::4], values[:, :, 0])
    inside = fine[4:21, 0]  # at the ends slopes are those of lines
    np.testing.assert_allclose(inside, np.linspace(1.0, 5.0, 17) ** 2, rtol=1e-14)


def test_a_section_of_one_row_is_refined_along_it():
    values = np.arange(4.0).reshape(4, 1, 1)
    fine = refine(Field("oxygen", "mM", np.zeros(3), 10.0, values), 0.0)[2]
    np.testing.assert_allclose(fine, [np.linspace(0.0, 3.0, 13)])


def test_states_over_the_radius_are_one_area_each(result):
    """In dark mode an area that would be lost has an edge, which must not part its shells."""
    parts = result.plot.profiles().axes[-1]
    assert len(parts.patches) == len(parts.get_legend_handles_labels()[1]) > 1
    top = parts.patches[-1].get_data()
    assert np.nanmax(top.values) == pytest.approx(100.0)
    assert np.array_equal(top.baseline, parts.patches[-2].get_data().values)
