"""Pages from templates: escaped, complete, packaged, and loaded only when one is written."""

import html
import re
import subprocess
import sys
import time
import tomllib
from importlib.resources import files

import pytest
from matplotlib.figure import Figure
from numba import njit
from synthetic import BARE

import multicell as mc
from multicell.report.html import write_page
from multicell.report.wording import clock


@pytest.mark.slow
def test_templates_are_loaded_when_a_page_is_written():
    code = (
        "import sys, multicell as mc; mc.load_scene('settle'); mc.compare; mc.stability; mc.run; "
        "import multicell.report.page; print('jinja2' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def written(tmp_path, **changed):
    given = {
        "scene": BARE, "title": "A title", "subtitle": "a subtitle", "tiles": {"cells": "12"},
        "pictures": {}, "summary": {}, "phases": {}, "longest": 1.0, "accounts": {}, "entries": [],
        "viewer": None, "diagnostics": {}, "compared": None,
    }  # fmt: skip
    return write_page(tmp_path / "page.html", "run.html", **(given | changed)).read_text("utf-8")


def test_whatever_a_template_is_given_is_escaped(tmp_path):
    bad = "<script>&\"'"
    page = written(
        tmp_path, title=bad, subtitle=bad, tiles={bad: bad},
        pictures={tmp_path / "p.png": (Figure, bad)},
        summary={"notes": [bad], "versions": {bad: bad}, "states": None},
        accounts={bad: {"inflow": 1.0}}, entries=["inflow"],
    )  # fmt: skip
    assert "<script" not in page
    assert page.count("&lt;script&gt;&amp;") == 11


def test_a_template_that_lacks_a_value_is_refused(tmp_path):
    from jinja2 import UndefinedError

    with pytest.raises(UndefinedError, match="is undefined"):
        write_page(
            tmp_path / "page.html", "compare.html", scene=BARE, title="", subtitle="", tiles={},
            pictures={}, judge="", verdicts={}, verdict="", pale="",
            result={"norms": {"position": "distances"}},
        )  # fmt: skip
    assert not (tmp_path / "page.html").exists()


COUNTS = r"\d|\b(one|two|three|four|five|ten|hundred|thousand|per cent|doublet|pair)\b"


def test_titles_of_built_in_scenes_state_no_number_that_a_key_can_change():
    for path in files("multicell.scenes").iterdir():
        if path.name.endswith(".toml"):
            title = tomllib.loads(path.read_text("utf-8"))["title"]
            title = title.replace("EMT6", "").replace("WM983b", "")  # names of cell lines
            assert title
            assert re.search(COUNTS, title, re.IGNORECASE) is None


@pytest.fixture(scope="module")
def short_run(tmp_path_factory):
    """A run with its wall time measured from outside too."""
    changes = {"initial.count": 30, "duration": "1 h", "coupling_step": "10 min"}
    scene = mc.load_scene("growth").with_changes(changes)
    begin = time.perf_counter()
    run = mc.run(scene, output=tmp_path_factory.mktemp("short") / "run", report=False)
    return run, time.perf_counter() - begin


def test_the_wall_times_shown_add_up_to_the_total(short_run, monkeypatch):
    monkeypatch.setattr("multicell.report.page.PICTURES", {})
    run, outside = short_run
    wall = run.summary()["wall"]
    parts = {name: seconds for name, seconds in wall.items() if name != "total"}
    assert {"startup", "compile", "mechanics", "rest"} < set(parts)
    assert min(parts.values()) >= 0.0
    assert sum(parts.values()) == pytest.approx(wall["total"], abs=1e-9)
    assert wall["mechanics"] < wall["total"] < outside  # reading back is no part of the run
    page = html.unescape(run.report().read_text("utf-8"))
    assert "from 30 cells · method" in page
    card = re.search(r"<h2>Wall time</h2>(.*?)</table>", page, re.DOTALL)[1]
    rows = re.findall(r"<tr><th>(?:<b>)?([^<]+).*?class=\"number\">([^<]+)<", card)
    assert [name for name, _ in rows] == ["start-up", *list(parts)[1:], "total"]
    assert [words for _, words in rows] == [clock(seconds) for seconds in wall.values()]


def test_compiling_is_told_apart_from_the_phase_that_needed_it():
    simulation = mc.Simulation(mc.load_scene("settle").with_changes({"initial.count": 2}))
    before, begin = dict(simulation.wall), time.perf_counter()
    with simulation.phase("events"):
        njit(lambda x: x * x + 1.25)(3.0)
        time.sleep(0.05)
    took = time.perf_counter() - begin
    spent = {name: simulation.wall[name] - before[name] for name in before}
    assert spent["compile"] > 0.0
    assert 0.05 <= spent["events"] < took - spent["compile"] + 1e-9
    assert 0.05 + spent["compile"] <= sum(spent.values()) <= took
