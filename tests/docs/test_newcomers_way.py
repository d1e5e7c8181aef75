"""The path that ``docs/newcomer.py`` times: its commands exist, its page has a place for it."""

import importlib.util
import re
from pathlib import Path

import pytest

import multicell as mc
from multicell.cli.main import main

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def newcomer():
    """Return the program as a module."""
    spec = importlib.util.spec_from_file_location("newcomer", ROOT / "docs" / "newcomer.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_command_has_its_options(newcomer, tmp_path):
    given = [command for step in newcomer.steps(tmp_path) for command in step.commands]
    ours = [command[1:] for command in given if Path(command[0]).name == "multicell"]
    assert {name for name, *_ in ours} == {"run", "init", "fit", "plot"}
    for name, *options in ours:
        with main.commands[name].make_context(name, options) as context:
            assert context.params["output"] is not None


def test_the_scene_is_edited_as_it_is_written(newcomer, tmp_path):
    scene = tmp_path / "mine.toml"
    scene.write_text((ROOT / "multicell" / "scenes" / "spheroid.toml").read_text("utf-8"), "utf-8")
    newcomer.edited(scene)
    assert mc.load_scene(scene).initial.count == 100
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
