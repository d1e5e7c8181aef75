"""Tutorials as notebooks: the programs of the page, for readers with nothing but the package."""

import re
import subprocess
import sys
from pathlib import Path

import notebook_runner
import pytest
from page_commands import ROOT

import multicell as mc
from multicell.report.wording import diagnostics, measures

nbformat = pytest.importorskip("nbformat", reason="notebooks are made with multicell[docs]")
pytest.importorskip("myst_nb")
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "extensions"))

import notebooks  # noqa: E402

PAGES = notebooks.tutorials(DOCS)
by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
WRITTEN = (
    r"(?:-o|--output) ([\w.-]+)",
    r'output="([\w.-]+)"',
    r"%%writefile (\S+)",
    r'savefig\("([\w.-]+)"\)',
    r'write_text\("([\w.-]+)"\)',
)


def code(text: str) -> str:
    """Return the code of a notebook, or of the fences of a page."""
    return "\n".join(re.findall(r"^```[^\n]*\n(.*?)^```", text, re.M | re.S))


def shown(page: Path) -> str:
    """Return the code that a reader of a page sees."""
    cells = re.findall(
        r"^```(?:\{code-cell\}|\w)[^\n]*\n.*?^```", page.read_text("utf-8"), re.M | re.S
    )
    return "\n".join(
        cell for cell in cells if not re.search(r"tags: \[remove-(cell|input)\]", cell)
    )


def written(text: str) -> set[str]:
    """Return files and folders that code writes."""
    return {name for pattern in WRITTEN for name in re.findall(pattern, text)}


@by_page
def test_holds_programs_and_words_of_its_page(page):
    book, text = notebooks.notebook(page), page.read_text("utf-8")
    nbformat.validate(book)
    source = "\n".join(cell.source for cell in book.cells if cell.cell_type == "code")
    words = "\n".join(cell.source for cell in book.cells if cell.cell_type == "markdown")
    cells = sum(cell.cell_type == "code" for cell in book.cells)
    assert cells == text.count("\n```{code-cell}") - text.count(":tags: [remove-cell]")
    lines = [line for line in shown(page).splitlines() if line.startswith("!multicell")]
    assert lines == [line for line in source.splitlines() if line.startswith("!multicell")]
    assert re.search(r"(?m)^#+ .+$", words)[0] == re.search(r"(?m)^# .+$", text)[0]
    assert not re.search(r"(?m)^(`{3}|:{3})\{|^%|^\([\w-]+\)=|\{\w+\}`", words)
    assert re.findall(r"\]\((?!https?:)[^)]+\)", words) == []  # pages that did not come with it
    assert nbformat.writes(book) == nbformat.writes(notebooks.notebook(page))


@by_page
def test_code_is_for_readers(page):
    source = "\n".join(c.source for c in notebooks.notebook(page).cells if c.cell_type == "code")
    for text in (source, shown(page)):
        assert re.findall(r"\bmyst_nb\b|\bglue\b|\bIPython\b|MULTICELL_DOCS", text) == []
        assert re.findall(r"\b(?:docs|examples|tests)/\S+", text) == []  # of a checkout


def test_folders_are_not_those_of_the_readme_or_of_each_other():
    taken = {"README": written(code((ROOT / "README.md").read_text("utf-8")))}
    assert {"out", "study", "chart"} <= taken["README"]
    for page in PAGES:
        names = written(shown(page)) - {"slip", "new-run"}  # of commands that are refused
        for other, there in taken.items():
            assert names & there == set(), (page.stem, other)
        taken[page.stem] = names
    assert "rich-medium" in taken["first-spheroid"]


@by_page
def test_page_names_the_environment_that_the_notebook_needs(page):
    needs = notebooks.environment(page)
    stated = re.findall(r"(?m)^pip install (\"[^#\n]+?) *(?:#.*)?$", page.read_text("utf-8"))
    assert stated in ([], [needs])
    assert f"pip install {needs}" in notebooks.notebook(page).cells[0].source


def test_first_tutorial_explains_every_line_of_a_run(tmp_path):
    changes = {"initial.count": 60, "duration": "2 h", "output.every": "1 h"}
    summary = mc.run(mc.load_scene("spheroid").with_changes(changes)).summary()
    text = (DOCS / "tutorials" / "first-spheroid.md").read_text("utf-8")
    rows = re.findall(r"(?m)^\| ([^|]+) \|", text)
    explained = {name for row in rows for name in row.split(", ")}
    printed = {name for name, _ in (*measures(summary), *diagnostics(summary))}
    assert {"cells", "wall time", "nutrient unaccounted for"} <= printed
    assert printed | {"states", "force evaluations"} <= explained


def test_environment_has_what_an_extra_brings_and_no_more():
    gone = notebook_runner.refused([".[study]"])
    assert {"pyvista", "scanpy", "IPython", "myst_nb", "pytest"} <= gone
    assert {"numpy", "PIL", "matplotlib", "pandas", "distributed", "xarray"} & gone == set()


SHORTER = {
    "cluster-study": {'duration="2 d"': 'duration="10 h"', "0.02,0.03,0.05 mM": "0.02,0.05 mM"},
    "coculture": {", 2.5)": ", 4)"},
    "dose-response-in-an-hour": {
        "count = 60": "count = 30",
        "--seeds 4": "--seeds 2",
        "seeds=4": "seeds=2",
    },
    "first-spheroid": {
        '"4 d"': '"1 d"',
        '--time "3 d"': '--time "1 d"',
        'duration = "3 d"': 'duration = "26 h"',
        'duration="4.5 d"': 'duration="30 h"',
    },
    "fit-and-predict": {
        '"wm983b", 3': '"wm983b", 5',
        "log 70:180": "log 15:40",
        "budget=38": "budget=38, cores=1",
        '"coupling_step": "2 h"': '"coupling_step": "4 h"',
        '"duration": "21 d"': '"duration": "12 d"',
        "sample(10": "sample(3",
    },
    "network-in-every-cell": {'invasion.toml")': 'invasion.toml").with_changes(duration="5 h")'},
    "own-cell-line": {
        'coupling_step = "20 min"': 'coupling_step = "2 h"',
        "--budget 60": "--budget 38",
        "budget=60": "budget=38",
        "sample(10": "sample(3",
    },
    "paraview-pandas-scanpy": {
        'duration="2.5 d"': 'duration="10 h"',
        'output.every="12 h"': 'output.every="2 h"',
    },
    "radiotherapy": {"count = 1000": "count = 300", 'duration = "6 d"': 'duration = "61 h"'},
    "resistant-clone": {
        'duration = "8 d"': 'duration = "101 h"',
        "count = 200": "count = 60",
        "fraction = 0.98": "fraction = 0.9",
        "fraction = 0.02": "fraction = 0.1",
        '"duration": "4 d"': '"duration": "1 d"',
        'duration="3 d"': 'duration="1 d"',
    },
}
"""What stands in programs of a page, and what a test of imports, names and files runs instead.

The documentation's build runs each page with the numbers that stand there.
"""


def shortened(page):
    """Return the notebook of a page with less to compute."""
    book = notebooks.notebook(page)
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    for old, new in SHORTER.get(page.stem, {}).items():
        assert any(old in cell.source for cell in cells), old
        for cell in cells:
            cell.source = cell.source.replace(old, new)
    return book


@pytest.mark.slow
@by_page
def test_runs_in_its_environment_from_an_empty_folder(page, tmp_path):
    asked = notebooks.environment(page).replace('"', "").split()
    book, work = tmp_path / "book.ipynb", tmp_path / "work"
    nbformat.write(shortened(page), book)
    work.mkdir()
    done = subprocess.run(
        [sys.executable, notebook_runner.__file__, book],
        cwd=work,
        env=notebook_runner.environment(asked, tmp_path / "environment"),
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert written(shown(page)) & {file.name for file in work.iterdir()} != set()
