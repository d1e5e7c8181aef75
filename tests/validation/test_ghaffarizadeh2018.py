"""Imported settings of PhysiCell against counts of PhysiCell 1.14.2 itself.

The models and PhysiCell's numbers are those of ``tests/benchmarks/compare_physicell.py``, which
runs PhysiCell with two seeds; ``docs/physicell.md`` lists them. Theirs is the middle of the two.
"""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

SUBJECT, SOURCE = "biology", "ghaffarizadeh2018"
_FILE = Path(__file__).parents[1] / "benchmarks" / "compare_physicell.py"
SEEDS = (0, 1)


@pytest.fixture(scope="module")
def program():
    spec = importlib.util.spec_from_file_location("compare_physicell", _FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def ours(program, folder, name):
    """Return numbers of cells, mean volumes, Ki67+ and distances, (seeds, outputs, 5)."""
    path = program.write(folder, name, 1)
    return np.array([program.of_multicell(path, seed) for seed in SEEDS])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "words", "counts"),
    [  # output -> two numbers of PhysiCell, and the deviation of one run by the exact process
        ("flow", "flow cytometry (basic), 100 cells", {2: ((226, 236), 11), 4: ((628, 678), 34)}),
        ("ki67", "Ki67 (advanced), 50 cells", {6: ((579, 598), 18)}),
        ("disc", "flow cytometry (separated), 73 cells", {1: ((160, 160), 6), 2: ((442, 453), 19)}),
    ],
)
def test_cells_of_imported_models_are_as_many_as_physicells(
    name, words, counts, program, compare, tmp_path
):
    found, every = ours(program, tmp_path / name, name), program.MODELS[name][2]
    for output, (theirs, spread) in counts.items():
        # two runs of each: their means differ by a normal number with this deviation
        what = f"PhysiCell's {words}: cells after {output * every} h"
        compare.value(what, np.mean(theirs), found[:, output, 0].mean(), 3.0 * spread, "cells")
    if name == "disc":
        what = f"PhysiCell's {words}: rms distance after 48 h"
        compare.value(what, 125.5, found[:, 2, 3].mean(), 5.0, "µm")
        compare.value(
            f"PhysiCell's {words}: mean volume after 48 h", 3056, found[:, 2, 1].mean(), 90, "µm³"
        )
    if name == "ki67":
        what = f"PhysiCell's {words}: Ki67+ part after 72 h"
        compare.value(what, 0.755, found[:, 6, 2].mean(), 0.06)
