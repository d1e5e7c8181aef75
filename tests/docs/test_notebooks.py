"""Tutorials as notebooks: all programs of the page, no word that only Sphinx understands."""

import os
import re
import sys
from pathlib import Path

import nbformat
import pytest

pytest.importorskip("myst_nb")
DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS / "extensions"))

import notebooks  # noqa: E402

PAGES = notebooks.tutorials(DOCS)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_notebook_holds_the_programs_and_the_words_of_its_page(page):
    book, text = notebooks.notebook(page), page.read_text("utf-8")
    nbformat.validate(book)
    code = "\n".join(cell.source for cell in book.cells if cell.cell_type == "code")
    words = "\n".join(cell.source for cell in book.cells if cell.cell_type == "markdown")
    assert sum(cell.cell_type == "code" for cell in book.cells) == text.count("\n```{code-cell}")
    lines = [line for line in text.splitlines() if line.startswith(("!multicell", "import "))]
    assert all(line in code for line in lines)
    assert "myst_nb" not in code
    assert re.search(r"(?m)^#+ .+$", words)[0] == re.search(r"(?m)^# .+$", text)[0]
    assert not re.search(r"(?m)^(`{3}|:{3})\{|^%|^\([\w-]+\)=|\{\w+\}`", words)
    assert nbformat.writes(book) == nbformat.writes(notebooks.notebook(page))


@pytest.mark.slow
def test_a_notebook_runs_in_an_empty_folder(tmp_path, monkeypatch):
    programs = Path(sys.executable).parent  # on the path of an environment that is active
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    client = pytest.importorskip("nbclient")
    book = notebooks.notebook(DOCS / "tutorials" / "own-force-law.md")
    client.execute(book, cwd=tmp_path, timeout=600)
    assert any(cell.get("outputs") for cell in book.cells)
