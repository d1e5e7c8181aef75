"""Cells on top of each other are counted before their pairs are listed: memory stays bounded."""

import json
import subprocess
import sys

import numpy as np
import pytest

import multicell as mc
from multicell.biology.initial import initial_cells
from multicell.errors import MulticellError
from multicell.simulation.assembly import apart_at_start

LOADED = """
import json, resource, sys
import multicell as mc
from multicell.errors import MulticellError
from multicell.scene.start_checks import deep_overlaps
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
said = ""
try:
    changes = {"initial.cells": sys.argv[1], **json.loads(sys.argv[2])}
    deep_overlaps(mc.load_scene("growth").with_changes(changes))
except MulticellError as error:
    said = str(error)
print(json.dumps([said, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before]))
"""


def loaded(path, **changes):
    """Return the refusal of a table of cells, and its memory, MB."""
    command = [sys.executable, "-c", LOADED, str(path), json.dumps(changes)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    said, kilobytes = json.loads(done.stdout)
    return said, kilobytes / 1000


def table(path, place, radius=None):
    titles, columns = "x_um,y_um,z_um", place
    if radius is not None:
        titles, columns = f"{titles},radius_um", np.column_stack([place, radius])
    np.savetxt(path, columns, "%.6f", ",", header=titles, comments="")
    return path


def test_many_cells_at_one_place_are_refused_with_their_rows(tmp_path):
    said, memory = loaded(table(tmp_path / "same.csv", np.zeros((20_000, 3))))
    assert "line 3, 'x_um': is at the place of line 2" in said
    assert "and so do 19,998 more" in said
    assert memory < 150


@pytest.mark.slow
@pytest.mark.parametrize("large", [1.0, 1.5, 3.0])
def test_a_crowd_is_refused_before_its_pairs_are_listed(large, tmp_path):
    # no two coincide, which is a hundredth of the radii
    place = np.stack(np.meshgrid(*[np.arange(28.0) * 5.0] * 3), axis=-1).reshape(-1, 3)[:20_000]
    radius = np.full(20_000, 100.0)
    radius[0] *= large
    path = table(tmp_path / "big.csv", place, radius)
    said, memory = loaded(path, **{"cells.division_radius": 5000.0})
    assert "has 20,000 cells of which more than" in said
    assert "units of places and radii" in said
    assert memory < 400


@pytest.mark.slow
def test_a_few_large_cells_among_many_small_ones_are_no_crowd(tmp_path):
    grid = np.stack(np.meshgrid(*[np.arange(24.0) * 8.0] * 3), axis=-1).reshape(-1, 3)
    radius = np.full(len(grid), 4.0)
    grid[0], radius[0] = [-500.0, 0.0, 0.0], 300.0
    path = table(tmp_path / "mixed.csv", grid, radius)
    said, memory = loaded(path, **{"cells.division_radius": 300.0})
    assert said == ""
    assert memory < 300


def test_cells_at_one_place_are_told_apart_without_their_pairs():
    scene = mc.load_scene("settle").with_changes({"initial.count": 20_000})
    cells = initial_cells(scene)
    cells.position[100:] = cells.position[7]
    moved = (apart_at_start(scene, cells).position != cells.position).any(axis=1)
    assert np.flatnonzero(moved).tolist() == list(range(100, 20_000))


@pytest.mark.slow
def test_a_crowd_that_is_handed_over_is_refused_in_words():
    scene = mc.load_scene("settle").with_changes({"initial.count": 4_000, "duration": "1 min"})
    cells = initial_cells(scene)
    cells.position[:] = 0.0  # 8 million pairs, of 500 for each cell and 4 million
    with pytest.raises(MulticellError, match="top of each other"):
        mc.Simulation(scene, cells=cells, threads=1).step()
