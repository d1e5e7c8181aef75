"""Configuration of Sphinx for the documentation.

From the top folder, after ``pip install ".[docs]"``::

    sphinx-build -W --keep-going -b html docs build/docs

Pages with a ``file_format: mystnb`` header are executed, each in a folder of its own that goes
afterwards. A cell that raises fails the build, and so does a line ``!command`` that ends with an
exit code other than 0: ``kernel.py`` among the extensions makes IPython raise there, which it does
not by itself. A cell that fails on purpose carries the tag ``raises-exception``. Tutorials find the
packages only that they tell readers to install (``environments.py``). Programs of
``examples/`` are run for the gallery unless their docstring says "not run in the documentation".

Pages load nothing from other servers; ``offline.py`` fails the build where one would.
"""

import gc
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))
# executed pages read data and examples beside them
os.environ["MULTICELL_DOCS"] = str(Path(__file__).resolve().parent)

import gallery

from multicell import __version__

project = "multicell"
author = "The multicell developers"
copyright = author
version = release = __version__
language = "en"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx-mathjax-offline",  # sets the path of MathJax to a copy among our own files
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.bibtex",
    "environments",
    "gallery",
    "kernel",
    "notebooks",
    "offline",
    "public_names",
    "scene_keys",
]
exclude_patterns = [
    "extensions", "notebooks", "paper", "gallery/*.ipynb", "gallery/*.md5", "jupyter_execute",
]  # fmt: skip

bibtex_bibfiles = ["references.bib"]
bibtex_reference_style = "author_year"

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 4
sphinx_gallery_conf = gallery.configuration()

nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_show_tb = True  # a failure is a warning, which -W makes an error
nb_execution_timeout = 1200  # s for a cell, also where many others compute
nb_merge_streams = True
nb_ipywidgets_js = {}  # none are used, and theirs come from another server

autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 80
autosummary_generate = False
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

smartquotes = False  # they make one dash of the two before an option

html_theme = "furo"
html_title = f"multicell {version}"
html_static_path = ["static"]
html_css_files = ["multicell.css"]
html_copy_source = False
copybutton_exclude = ".linenos, .gp, .go"


def setup(app):
    """Let pages be read in parallel: the copy of MathJax only adds files at the end."""
    # pages are trees of objects that live until the end, through which the collector would look
    # again and again, in each of the processes that write them too
    gc.set_threshold(50_000, 20, 50)
    mathjax = app.extensions["sphinx-mathjax-offline"]
    mathjax.parallel_read_safe = mathjax.parallel_write_safe = True
