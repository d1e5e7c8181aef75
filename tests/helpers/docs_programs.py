"""Modules of the documentation's programs, as tests load them."""

import importlib
import sys
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
PROGRAMS = DOCS / "programs"


def program(name):
    """Return a module of ``docs/programs/``; what it imports from beside it is found there."""
    sys.path.insert(0, str(PROGRAMS))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(PROGRAMS))
