"""The gallery: programs of ``examples/`` that are run, with the pictures that they write.

A program is given a folder of its own to write to. Each PNG that it leaves there becomes a picture
of its page; matplotlib need not know of pages.
"""

import ast
import logging
import shutil
import tempfile
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx_gallery.scrapers import figure_rst

EXAMPLES = Path(__file__).parents[2] / "examples"
NOT_RUN = "not run in the documentation"
"""Said by the docstring of a program that the gallery shows only, with the reason."""
_written = Path(tempfile.gettempdir())


def executed() -> list[str]:
    """Return the names of the programs that are run for their pages."""
    return [
        file.name for file in sorted(EXAMPLES.glob("*.py")) if NOT_RUN not in " ".join(words(file))
    ]


def words(file: Path) -> list[str]:
    """Return the words of a program's docstring."""
    return (ast.get_docstring(ast.parse(file.read_text("utf-8"))) or "").split()


def output_of(source: str) -> Path:
    """Return the folder that a program writes to."""
    return _written / Path(source).stem


def arguments(gallery: dict[str, Any], variables: dict[str, Any]) -> list[str]:
    """Return the arguments of a program on the command line: where to write."""
    return [str(output_of(variables["src_file"]))]


def pictures(block: Any, variables: dict[str, Any], gallery: dict[str, Any]) -> str:
    """Return reStructuredText for the pictures that a program has written since last asked."""
    names = []
    for file in sorted(output_of(variables["src_file"]).glob("*.png")):
        name = next(variables["image_path_iterator"])
        shutil.move(file, name)
        names.append(name)
    return figure_rst(names, gallery["src_dir"]) if names else ""


def configuration() -> dict[str, Any]:
    """Return the settings of sphinx-gallery; functions by their names, for its cache."""
    return {
        "examples_dirs": [str(EXAMPLES)],
        "gallery_dirs": ["gallery"],
        "filename_pattern": "/(" + "|".join(executed()) + ")$",
        "default_thumb_file": str(EXAMPLES.parent / "docs" / "static" / "program.png"),
        "remove_config_comments": True,
        "image_scrapers": ("gallery.pictures",),
        "reset_argv": "gallery.arguments",
        "reset_modules": (),
        "only_warn_on_example_error": False,
        "write_computation_times": False,
        "show_memory": False,
        "show_signature": False,
        "min_reported_time": 1e9,
        "download_all_examples": False,
        "within_subsection_order": "FileNameSortKey",
    }


def begin(app: Sphinx) -> None:
    """Choose where programs write while the build lasts."""
    global _written
    logging.getLogger("pde").setLevel(logging.WARNING)  # of each step of its solvers
    _written = Path(tempfile.mkdtemp(prefix="examples-"))
    app.connect("build-finished", lambda *_: shutil.rmtree(_written, ignore_errors=True))


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx when to do it: before sphinx-gallery runs the programs."""
    app.connect("builder-inited", begin, priority=1)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
