"""The path that ``docs/programs/newcomer.py`` times: commands exist, the page has a place."""

import importlib.util
import re
from pathlib import Path

import pytest

import multicell as mc
from multicell.cli.main import main
from multicell.measured.data import read_data

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def newcomer():
    """Return the program as a module."""
    spec = importlib.util.spec_from_file_location(
        "newcomer", ROOT / "docs" / "programs" / "newcomer.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_command_has_its_options(newcomer, tmp_path):
    given = [command for step in newcomer.steps(tmp_path) for command in step.commands]
    ours = [command[1:] for command in given if Path(command[0]).name == "multicell"]
    asked = {"run", "init", "study", "fit", "dose-response", "export", "plot"}
    assert {name for name, *_ in ours} == asked
    for name, *options in ours:
        command = main.get_command(None, name)
        if name == "study":
            command, options = command.commands[options[0]], options[1:]
        with command.make_context(name, options) as context:
            assert context.params.get("output", context.params.get("folder")) is not None


def test_what_is_typed_is_understood(newcomer, tmp_path):
    for name, text in newcomer.FILES.items():
        (tmp_path / name).write_text(text, "utf-8")
    scene = mc.load_scene("growth").with_changes({"initial.count": 8})
    data = read_data(tmp_path / "growth.csv", scene).data
    assert {(d.observable, d.tissues) for d in data} == {("cells", 6.0), ("diameter", 1.0)}
    assert [d.time for d in data[::2]] == [43200.0 * k for k in range(1, 6)]
    found = mc.dose_response(data=tmp_path / "plate.csv")
    assert found.ic50.value == pytest.approx(1.4, rel=0.1)  # µM: half of the control, by eye
    nbformat = pytest.importorskip("nbformat")
    nbformat.validate(nbformat.read(tmp_path / "first.ipynb", 4))


def test_the_scene_is_edited_as_it_is_written(newcomer, tmp_path):
    scene = tmp_path / "mine.toml"
    scene.write_text((ROOT / "multicell" / "scenes" / "spheroid.toml").read_text("utf-8"), "utf-8")
    newcomer.edited(scene)
    loaded = mc.load_scene(scene)
    assert loaded.initial.count == 100
    assert loaded.growth.cycle_time == 20 * 3600.0
    assert loaded.cells.division_radius == 5.02
    with pytest.raises(ValueError, match="has no"):
        newcomer.edited(scene)


def test_the_page_has_the_table_of_all_steps(newcomer, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(newcomer.PAGE.read_text("utf-8"), "utf-8")
    times = {step.name: newcomer.Times(65.0, 40.0) for step in newcomer.steps(tmp_path)}
    newcomer.written(newcomer.table(times), page)
    names = [
        row.split(" | ")[0].strip("| ")
        for row in re.findall(r"^\| .* \|$", page.read_text("utf-8"), re.M)
    ]
    assert [name for name in names if name in times] == list(times)
    assert "| 1 min 5 s | 40 s |" in page.read_text("utf-8")
