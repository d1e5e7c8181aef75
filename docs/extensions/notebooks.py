"""Tutorials as notebooks: each executed page of ``tutorials/`` can be downloaded and run.

A notebook holds the words and the programs of its page, without what only Sphinx understands and
without links to other pages, which do not come with it. It needs the packages that its page names,
any program that opens notebooks, and nothing of the documentation's folder.

A cell that only shows a picture is tagged ``remove-input`` and is code of the notebook. One that
puts a picture elsewhere on the page is tagged ``remove-cell`` and is not.
"""

import re
from pathlib import Path

import nbformat
from myst_nb.core.read import read_myst_markdown_notebook
from sphinx.application import Sphinx

FOLDER = "notebooks"  # beside the pages; not part of the repository
_FENCE = re.compile(r"^(`{3,}|:{3,})\{[^\n]*\n.*?^\1\s*$", re.DOTALL | re.MULTILINE)
_COMMENT = re.compile(r"^(%|\([\w-]+\)=).*\n?", re.MULTILINE)
_ROLE = re.compile(r"\{[\w:]+\}`(?:([^`<]+?)\s*<[^`>]+>|~?([^`]+))`")
_TITLE = re.compile(r"^(# .+)$", re.MULTILINE)
_LINK = re.compile(r"\[((?:[^\[\]]|\[[^\]]*\])+)\]\((?!https?:)[^)]+\)")


_OWN = {
    "network-in-every-cell": '".[networks,study]"',
    "paraview-pandas-scanpy": '".[export]" scanpy',
}


def environment(page: Path) -> str:
    """Return the argument of ``pip install``, in the package's folder, for a page to run."""
    return _OWN.get(page.stem, '".[study]"')


def _needs(page: Path) -> str:
    """Return the sentence on what a notebook needs."""
    packages = f"`pip install {environment(page)} jupyterlab`"
    return f"It runs in any folder, with {packages} in the folder of multicell."


def tutorials(source: Path) -> list[Path]:
    """Return the pages that become notebooks."""
    pages = sorted((source / "tutorials").glob("*.md"))
    return [page for page in pages if "file_format: mystnb" in page.read_text("utf-8")[:100]]


def notebook(page: Path) -> nbformat.NotebookNode:
    """Return a page as a notebook."""
    book = read_myst_markdown_notebook(page.read_text("utf-8"), path=page)
    book.cells = [cell for cell in book.cells if "remove-cell" not in cell.metadata.get("tags", [])]
    for cell in book.cells:
        if cell.cell_type == "markdown":
            cell.source = plain(cell.source)
    book.cells = [cell for cell in book.cells if cell.source.strip()]
    needs = f"*This page is a notebook. {_needs(page)}*"
    book.cells[0].source = _TITLE.sub(rf"\1\n\n{needs}", book.cells[0].source, count=1)
    book.metadata.kernelspec = {"display_name": "Python 3", "language": "python", "name": "python3"}
    for number, cell in enumerate(book.cells):  # the same page is the same file
        cell["id"] = f"cell-{number}"
        tags = [tag for tag in cell.metadata.get("tags", []) if tag == "raises-exception"]
        cell.metadata = nbformat.from_dict({"tags": tags} if tags else {})
    book.nbformat, book.nbformat_minor = 4, 5
    nbformat.validate(book)
    return book


def plain(text: str) -> str:
    """Return Markdown without directives, comments, targets and links to pages.

    Roles become code, and such links their words.
    """
    text = _COMMENT.sub("", _FENCE.sub("", text))
    text = _ROLE.sub(lambda found: f"`{found[1] or found[2]}`", text)
    return _LINK.sub(r"\1", text)


def write_all(app: Sphinx) -> None:
    """Write all notebooks beside the pages."""
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    for page in tutorials(Path(app.srcdir)):
        nbformat.write(notebook(page), folder / f"{page.stem}.ipynb")


def link(app: Sphinx, name: str, source: list[str]) -> None:
    """Put a link to the notebook below the title of a tutorial."""
    if name in {f"tutorials/{page.stem}" for page in tutorials(Path(app.srcdir))}:
        page = Path(name)
        words = (
            f"{{download}}`Download as a notebook </{FOLDER}/{page.name}.ipynb>`. {_needs(page)}"
        )
        source[0] = _TITLE.sub(rf"\1\n\n{words}", source[0], count=1)


def setup(app: Sphinx) -> dict[str, bool]:
    """Enter the steps of a build."""
    app.connect("builder-inited", write_all)
    app.connect("source-read", link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
