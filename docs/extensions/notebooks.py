"""Tutorials as notebooks: each executed page of ``tutorials/`` can be downloaded and run.

A notebook holds the words and the programs of its page, without what only Sphinx understands. It
needs the package in its kernel, and nothing of the documentation's folder.
"""

import re
from pathlib import Path

import nbformat
from myst_nb.core.read import read_myst_markdown_notebook
from sphinx.application import Sphinx

FOLDER = "notebooks"  # beside the pages; not part of the repository
_FENCE = re.compile(r"^(`{3,}|:{3,})\{[^\n]*\n.*?^\1\s*$", re.DOTALL | re.MULTILINE)
_COMMENT = re.compile(r"^(%|\([\w-]+\)=).*\n?", re.MULTILINE)
_GLUE = re.compile(r'^glue\("[^"]+", (.+), display=False\)$', re.MULTILINE)
_ROLE = re.compile(r"\{[\w:]+\}`(?:([^`<]+?)\s*<[^`>]+>|~?([^`]+))`")


def tutorials(source: Path) -> list[Path]:
    """Return the pages that become notebooks."""
    pages = sorted((source / "tutorials").glob("*.md"))
    return [page for page in pages if "file_format: mystnb" in page.read_text("utf-8")[:100]]


def notebook(page: Path) -> nbformat.NotebookNode:
    """Return a page as a notebook."""
    book = read_myst_markdown_notebook(page.read_text("utf-8"), path=page)
    for cell in book.cells:
        if cell.cell_type == "markdown":
            cell.source = plain(cell.source)
        else:  # what a page shows elsewhere is shown where it is made
            cell.source = _GLUE.sub(r"\1", cell.source.replace("from myst_nb import glue\n", ""))
    book.cells = [cell for cell in book.cells if cell.source.strip()]
    book.metadata.kernelspec = {"display_name": "Python 3", "language": "python", "name": "python3"}
    for number, cell in enumerate(book.cells):  # the same page is the same file
        cell["id"] = f"cell-{number}"
        cell.metadata = nbformat.from_dict({"tags": cell.metadata.get("tags", [])})
    book.nbformat, book.nbformat_minor = 4, 5
    nbformat.validate(book)
    return book


def plain(text: str) -> str:
    """Return Markdown without directives, comments and targets; roles become code."""
    text = _COMMENT.sub("", _FENCE.sub("", text))
    return _ROLE.sub(lambda found: f"`{found[1] or found[2]}`", text)


def write_all(app: Sphinx) -> None:
    """Write all notebooks beside the pages."""
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    for page in tutorials(Path(app.srcdir)):
        nbformat.write(notebook(page), folder / f"{page.stem}.ipynb")


def link(app: Sphinx, name: str, source: list[str]) -> None:
    """Put a link to the notebook below the title of a tutorial."""
    if name in {f"tutorials/{page.stem}" for page in tutorials(Path(app.srcdir))}:
        words = f"{{download}}`Download as a notebook </{FOLDER}/{Path(name).name}.ipynb>`"
        source[0] = re.sub(r"(?m)^(# .+)$", rf"\1\n\n{words}", source[0], count=1)


def setup(app: Sphinx) -> dict[str, bool]:
    """Enter the steps of a build."""
    app.connect("builder-inited", write_all)
    app.connect("source-read", link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
