"""First use of the package: notebooks, wrong times, wrong folders."""

import matplotlib.pyplot
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure

import multicell as mc
from multicell.cli import progress
from multicell.cli.main import main
from multicell.report.plots.style import save_figure


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a run of one hour."""
    folder = tmp_path_factory.mktemp("newcomer") / "out"
    scene = mc.load_scene("growth").with_changes({"duration": "1 h", "output.every": "20 min"})
    mc.run(scene, output=folder, report=False)
    return folder


def words(*arguments):
    """Return the exit code and what a command wrote."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    return result.exit_code, " ".join(result.output.split())


def test_a_notebook_shows_a_picture_that_ends_a_cell(folder, tmp_path):
    before = matplotlib.pyplot.get_fignums()
    figure = mc.load_result(folder).plot.growth()
    assert isinstance(figure, Figure)
    save_figure(figure, tmp_path / "growth.png")
    assert figure._repr_png_() == (tmp_path / "growth.png").read_bytes()
    assert matplotlib.pyplot.get_fignums() == before


@pytest.mark.parametrize(("parent", "terminal"), [(None, True), ("123", False)])
def test_progress_draws_no_bar_in_the_cell_of_a_notebook(monkeypatch, parent, terminal):
    monkeypatch.setenv("FORCE_COLOR", "1")  # as the kernels of notebooks set it
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    if parent is not None:
        monkeypatch.setenv("JPY_PARENT_PID", parent)
    assert progress.on_stderr().is_terminal is terminal


def test_a_time_outside_the_run_is_not_its_last_frame(folder, tmp_path):
    picture = tmp_path / "late.png"
    code, output = words("plot", folder, "-o", picture, "--time", "40 d")
    assert code == 2
    assert "no frame at 40 d: it goes from 0 min to 60 min" in output
    assert not picture.exists()
    assert words("plot", folder, "-o", picture, "--time", "1 h")[0] == 0


def test_a_folder_that_is_not_there_is_told_from_one_without_results(tmp_path):
    code, output = words("view", tmp_path / "nowhere", "--no-browser")
    assert code == 2
    assert "there is no such folder" in output
    code, output = words("view", tmp_path, "--no-browser")
    assert code == 2
    assert "frames.h5 is missing" in output


def test_files_where_folders_are_meant_and_folders_that_are_not_there(folder, tmp_path):
    code, output = words("export", folder, "-o", tmp_path / "cells.csv")
    assert (code, "name a folder" in output) == (2, True)
    code, output = words("plot", folder, "-o", tmp_path / "none" / "a.png")
    assert (code, f"there is no folder '{tmp_path / 'none'}'" in output) == (3, True)
    code, output = words("explain", folder / "frames.h5")
    assert (code, f"The scene of that run is '{folder / 'scene.toml'}'" in output) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_is_done_says_how_to_prolong_it(folder):
    code, output = words("resume", folder)
    assert code == 2
    assert "ends with the frame at 60 min" in output
    assert "--set duration='120 min'" in output


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["run", "spheroid", "-o", "out", "--set", "duration", "3 d"], "--set duration='…'"),
        (["study", "new", "growth", "-o", "out", "--vary", "seed", "1,2"], "--vary seed='VALUES'"),
    ],
)
def test_a_space_in_place_of_the_equals_sign_is_told(given, told):
    code, output = words(*given)
    assert code == 2
    assert f"write the value without a space, as {told}" in output


def test_a_scene_may_be_a_name_or_a_path_wherever_one_is_run(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text('duration = "10 min"\n[initial]\ncount = 2\n', "utf-8")
    for given in (path, str(path)):
        assert mc.run(given).summary()["cells"] == 2
        assert len(mc.ode_problem(given).y0) == 6
    with pytest.raises(mc.SceneError, match="Did you mean 'growth'"):
        mc.run("grwth")
