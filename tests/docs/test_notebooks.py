"""Tutorials as notebooks: the programs of the page, for readers with nothing but the package."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import notebook_runner
import pytest
from page_commands import ROOT

import multicell as mc
from multicell.report.wording import diagnostics, measures

nbformat = pytest.importorskip("nbformat", reason="notebooks are made with multicell[docs]")
pytest.importorskip("myst_nb")
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "extensions"))

import environments  # noqa: E402
import notebooks  # noqa: E402
import requirements  # noqa: E402

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
    gone = requirements.refused([".[study]"])
    assert {"pyvista", "scanpy", "IPython", "myst_nb", "pytest"} <= gone
    assert {"numpy", "PIL", "matplotlib", "pandas", "distributed", "xarray"} & gone == set()


def test_processes_find_no_other_package(tmp_path):
    variables = requirements.variables(tmp_path, {"pluggy", "packaging"})
    modules = ("numpy", "packaging", "pluggy.hooks", "json")
    program = f"""
import importlib
for name in {modules}:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        print(error.name)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["packaging", "pluggy"]


def test_a_build_executes_each_tutorial_in_its_environment(monkeypatch):
    for name in ("PYTHONPATH", requirements.REFUSED):
        monkeypatch.setenv(name, "")
    handlers = {}
    app = SimpleNamespace(srcdir=DOCS, connect=handlers.__setitem__)
    environments.setup(app)
    handlers["builder-inited"](app)
    seen = {}
    for page in [*PAGES, DOCS / "pictures.md"]:
        name = str(page.relative_to(DOCS).with_suffix(""))
        handlers["source-read"](app, name, [])
        seen[page.stem] = set(os.environ[requirements.REFUSED].split(","))
    handlers["build-finished"](app, None)
    assert seen.pop("pictures") == {""}
    for stem, gone in seen.items():
        assert ("scanpy" in gone, "SALib" in gone, "antimony" in gone) == {
            "paraview-pandas-scanpy": (False, True, True),
            "network-in-every-cell": (True, False, False),
        }.get(stem, (True, False, True)), stem
        assert {"ipykernel", "IPython", "numba", "matplotlib"} & gone == set()


@by_page
def test_imports_are_of_its_environment(page):
    gone, brought = requirements.refused(environments.asked(page)), set()
    for cell in notebooks.notebook(page).cells:
        if cell.cell_type == "code" and not cell.source.startswith("%%"):
            text = re.sub(r"(?m)^( *)[!%].*$", r"\1pass", cell.source)
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.Import):
                    brought |= {name.name.partition(".")[0] for name in node.names}
                if isinstance(node, ast.ImportFrom):
                    brought.add(node.module.partition(".")[0])
    assert brought & gone == set()


SHORTER = {
    '"4 d"': '"1 d"',
    '--time "3 d"': '--time "1 d"',
    'duration = "3 d"': 'duration = "26 h"',
    'duration="4.5 d"': 'duration="30 h"',
}
"""What stands in programs of the first tutorial, and what a test of names and files runs instead.

The documentation's build runs each page with the numbers that stand there, in its environment.
"""


@pytest.mark.slow
def test_runs_as_a_plain_program_from_an_empty_folder(tmp_path):
    page = DOCS / "tutorials" / "first-spheroid.md"
    book, work = notebooks.notebook(page), tmp_path / "work"
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    for old, new in SHORTER.items():
        assert any(old in cell.source for cell in cells), old
        for cell in cells:
            cell.source = cell.source.replace(old, new)
    nbformat.write(book, tmp_path / "book.ipynb")
    work.mkdir()
    done = subprocess.run(
        [sys.executable, notebook_runner.__file__, tmp_path / "book.ipynb"],
        cwd=work,
        env=notebook_runner.environment(environments.asked(page), tmp_path / "environment"),
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert written(shown(page)) & {file.name for file in work.iterdir()} != set()
