"""Models as people have them: what PhysiCell passes over, cells at borders, tables elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

import multicell as mc
from multicell.contact.physicell import PhysiCell
from multicell.scene.pairs import pair_of

CELLS_FOLDER = "<folder>./config</folder><filename>cells.csv"
DECLARED = 'substrate name="oxygen"'


def entries(found, word):
    return [entry for entry in found.entries if word in f"{entry.path} {entry.note}"]


def test_a_substance_that_is_not_declared_is_left_out_with_an_entry(project):
    found = mc.import_physicell(project((DECLARED, 'substrate name="oxgen"')))
    (entry,) = entries(found, "no substance 'oxgen' is declared")
    assert str(entry.fate) == "left out"
    assert entry.value == "10"
    assert found.keys["nutrients"]["oxygen"]["uptake"] == 0.0


def test_a_table_without_a_cell_of_the_model_is_as_none(project):
    """Types that there are not, places outside of the box: the start is that without a table."""
    for cells in ("900,0,0,0\n", "0,0,0,8\n", "x,y,z,type\n0,0,0,stranger\n"):
        found = mc.import_physicell(project(cells=cells))
        (entry,) = entries(found, "as if there were no table")
        assert str(entry.fate) == "left out"
        assert len(found.cells["position_x_um"]) >= 1
        assert len(mc.Simulation(found.scene).cells) == len(found.cells["position_x_um"])


@pytest.mark.parametrize("corner", [(100.0, 80.0), (-100.0, -80.0), (100.0, -80.0)])
def test_cells_that_are_moved_apart_stay_in_the_box(project, corner):
    """Coinciding cells in a corner once z is flattened: none is pushed out by the import."""
    x, y = corner
    cells = "".join(f"{x},{y},{z},0\n" for z in range(-4, 5))
    found = mc.import_physicell(
        project(("<use_2D>false</use_2D>", "<use_2D>true</use_2D>"), cells=cells)
    )
    place = np.stack([found.cells["position_x_um"], found.cells["position_y_um"]], axis=1)
    assert len(place) == 9
    assert (np.abs(place) <= [100.0, 80.0]).all()
    apart = np.linalg.norm(place[:, None] - place[None], axis=-1) + 1e9 * np.eye(9)
    assert apart.min() > 0.02 * found.cells["radius_um"].max()
    mc.Simulation(found.scene)  # which refuses cells outside


@pytest.mark.parametrize("strength", ["5", "9.5"])
def test_strong_adhesion_is_physicell_s_own_law(project, strength):
    """Its force at any distance is PhysiCell's: repulsion and adhesion are apart, both bounded."""
    change = (
        '<cell_cell_adhesion_strength units="micron/min">0.4<',
        f'<cell_cell_adhesion_strength units="micron/min">{strength}<',
    )
    found = mc.import_physicell(project(change))
    assert isinstance(found.scene.contact, PhysiCell)
    pair = pair_of(found.scene, 0, 0, 8.0, 8.0)
    for d in (0.5, 6.0, 15.0, 18.0):
        push = 10.0 * max(1.0 - d / 16.0, 0.0) ** 2 - float(strength) * (1.0 - d / 20.0) ** 2
        moved = (
            60.0 * float(pair.force(16.0 - d)) / (6.0 * np.pi * found.scene.drag.viscosity * 8.0)
        )
        assert moved == pytest.approx(push, rel=1e-12)
    mc.Simulation(found.scene)  # none of them is refused


def test_adhesion_above_repulsion_is_cut_to_it(project):
    """Their difference attracts at all distances: PhysiCell's own cells end in one point."""
    old = '<cell_cell_adhesion_strength units="micron/min">0.4<'
    made = mc.import_physicell(project((old, old.replace("0.4", "40"))))
    (entry,) = [e for e in made.entries if e.value == "40"]
    assert str(entry.fate) == "approximated"
    assert entry.note.startswith("0.99 of the repulsion with tumour cell")
    mc.Simulation(made.scene).step()


def test_a_table_is_found_from_the_root_of_physicell(project, tmp_path):
    """A sample project names its table from the root; the model's folder is all that there is."""
    for folder, taken in (
        ("./config", ""),
        ("./sample_projects/mine/config", "config/cells.csv"),
        ("user_projects/mine/data", "data/cells.csv"),
        ("/home/somebody/PhysiCell/data", "data/cells.csv"),
    ):
        path = project((CELLS_FOLDER, CELLS_FOLDER.replace("./config", folder)))
        (tmp_path / "data").mkdir(exist_ok=True)
        if "data" in folder:
            (tmp_path / "config" / "cells.csv").rename(tmp_path / "data" / "cells.csv")
        found = mc.import_physicell(path)
        assert len(found.cells["position_x_um"]) == 4
        (entry,) = [e for e in found.entries if e.path.endswith("cell_positions/folder")]
        assert str(entry.fate) == "mapped"
        assert entry.note == (taken and f"not there; taken from '{taken}'")
