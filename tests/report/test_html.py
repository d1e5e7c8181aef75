"""Pages from templates: escaped, complete, packaged, and loaded only when one is written."""

import subprocess
import sys
from importlib.resources import files

import pytest
from matplotlib.figure import Figure
from synthetic import BARE

from multicell.report.html import write_page
from multicell.report.wording import clock

NAMES = (
    "base.html", "parts.html", "run.html", "compare.html", "fields.html", "stability.html",
    "style.css", "viewer.html", "study.html", "sorted.html", "sensitivity.html", "fit.html",
)  # fmt: skip


def test_the_templates_are_part_of_the_package():
    folder = files("multicell.report") / "templates"
    assert sorted(entry.name for entry in folder.iterdir()) == sorted(NAMES)


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
        "viewer": None,
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

    with pytest.raises(UndefinedError, match="result"):
        write_page(
            tmp_path / "page.html", "compare.html", scene=BARE, title="", subtitle="", tiles={},
            pictures={}, judge="", verdicts={}, looks={}, pale="",
        )  # fmt: skip
    assert not (tmp_path / "page.html").exists()


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.5, "0.5 s"), (12.3, "12 s"), (134.0, "2 min 14 s"), (7260.0, "2 h 1 min")],
)
def test_wall_times_are_told_in_words(seconds, words):
    assert clock(seconds) == words
