"""Springs in runs: which pairs are joined, what becomes of them, and when they break."""

import numpy as np
import pytest

import multicell as mc
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.biology.spring_graph import Springs, after_divisions, springs_at_start, tensions
from multicell.cells import State
from multicell.errors import SceneError
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

RADIUS = 5.0 * 0.5 ** (1 / 3)
DRAG = 6 * np.pi * 5.0 * RADIUS


def scene_of(count=6, spacing=0.95, springs=None, **parts):
    return Scene.from_dict({
        "duration": "10 min",
        "coupling_step": "1 min",
        "initial": {"count": count, "spacing": spacing},
        "cells": {"young_variation": 0.0},
        "contact": {"law": "hertz"},
        "integrator": {"atol": 1e-6, "rtol": 1e-9},
        "springs": {} if springs is None else {"net": springs},
        **parts,
    })  # fmt: skip


def distances(simulation):
    i, j = simulation.cells.rows_of(simulation.springs.pair).T
    x = simulation.cells.position
    return np.linalg.norm(x[j] - x[i], axis=1)


@pytest.mark.parametrize("method", ["auto", "cvode", "rkc2", "rosenbrock", "multirate-euler"])
def test_two_distant_cells_come_to_the_length_at_rest(method):
    """d - L falls like exp(-2 k t / Γ), and the history tells the tension k (d - L)."""
    law = {"stiffness": "0.2 nN/um", "rest": "150 um", "pairs": [[1, 0]]}
    result = mc.run(
        scene_of(2, 30.0, law, integrator={"method": method, "rtol": 1e-9, "atol": 1e-4})
    )
    start = 30.0 * 2 * RADIUS
    time = np.array(result.history["time"])
    exact = 0.2 * (start - 150.0) * np.exp(-2 * 0.2 * time / DRAG)
    np.testing.assert_allclose(result.history["largest_tension"], exact, atol=5e-4 * exact[0])
    assert set(result.history["springs"]) == {1}


def test_without_a_length_springs_rest_as_they_are_and_energy_falls():
    scene = scene_of(30, 0.85, {"stiffness": 0.3, "within": "8 um"})
    simulation = Simulation(scene, threads=1)
    assert len(simulation.springs) > 60
    np.testing.assert_allclose(distances(simulation), simulation.springs.rest, rtol=1e-14)
    assert simulation.springs.rest.max() <= 8.0
    energy = [simulation.energy()]
    while not simulation.finished:
        simulation.step()
        energy.append(simulation.energy())
    assert (np.diff(energy) < 0.0).all()
    mean = simulation.cells.position.mean(axis=0)
    np.testing.assert_allclose(mean, initial_cells(scene).position.mean(axis=0), atol=1e-6)


def test_a_spring_breaks_where_it_is_too_long_or_too_tight():
    start = initial_cells(scene_of(2, 38.0)).position
    axis = (start[1] - start[0]) / np.linalg.norm(start[1] - start[0])
    force = {"force": list(0.5 * axis), "cells": [1]}
    held = {"cells": [0]}
    springs = {
        "weak": {"stiffness": 0.01, "pairs": [[0, 1]], "breaking_force": "0.1 nN"},
        "short": {"stiffness": 0.01, "pairs": [[0, 1]], "breaking_length": "320 um"},
        "strong": {"stiffness": 0.01, "pairs": [[0, 1]]},
    }
    simulation = Simulation(
        scene_of(2, 38.0, springs=None, forces={"f": force}, motions={"m": held}).with_changes(
            {"springs": springs, "drag.viscosity": 0.1}
        ), threads=1,
    )  # fmt: skip
    rest = distances(simulation)[0]
    while not simulation.finished:
        length, table = distances(simulation), simulation.springs.table
        assert (length[table == 0] - rest <= 10.0).all()
        assert (length[table == 1] <= 320.0).all()
        simulation.step()
    assert simulation.springs.table.tolist() == [2]
    final = tensions(biology_plan(simulation.scene), simulation.springs, simulation.cells)
    # what is left goes on towards 0.5 nN
    assert 0.1 < final[0] < 0.5
    assert distances(simulation)[0] > 320.0


def daughters_of(cells, mothers, first, shift):
    """Return cells in which mothers have divided along x, ``shift`` µm to both sides."""
    left = np.flatnonzero(~np.isin(cells.id, mothers))
    rows = np.repeat(cells.rows_of(np.sort(mothers)), 2)
    born = cells.take(rows)
    born.parent = born.id.copy()
    born.id = first + np.arange(len(rows))
    born.position[::2, 0] += shift
    born.position[1::2, 0] -= shift
    return cells.replaced(left, born)


def test_the_nearer_daughter_takes_a_spring_over():
    scene = scene_of(3, springs={"stiffness": 1, "pairs": [[0, 1], [1, 2]], "sisters": True},
                     growth={})  # fmt: skip
    before = initial_cells(scene)
    before.position[:] = [[0, 0, 0], [10, 0, 0], [20, 0, 0]]
    springs = springs_at_start(scene, before)
    assert springs.pair.tolist() == [[0, 1], [1, 2]]
    # 1 -> 3 at 11, 4 at 9: 4 is nearer to 0, 3 nearer to 2
    after = daughters_of(before, [1], 3, 1.0)
    found = after_divisions(biology_plan(scene), springs, before, after)
    assert found.pair.tolist() == [[0, 4], [2, 3], [3, 4]]
    np.testing.assert_allclose(found.rest, [10, 10, 2 * before.radius[0]])
    # both ends divide: 0 -> 3 at 1, 4 at -1 and 1 -> 5 at 11, 6 at 9
    both = after_divisions(
        biology_plan(scene), springs, before, daughters_of(before, [0, 1], 3, 1.0)
    )
    assert both.pair.tolist() == [[2, 5], [3, 4], [3, 6], [5, 6]]
    alone = scene.with_changes({"springs.net.sisters": False})
    left = after_divisions(
        biology_plan(alone), springs, before, daughters_of(before, [0, 1], 3, 1.0)
    )
    assert left.pair.tolist() == [[2, 5], [3, 6]]
    # an end that is gone takes its spring along
    gone = after.take(after.id != 0)
    assert after_divisions(biology_plan(alone), springs, before, gone).pair.tolist() == [[2, 3]]


def test_a_growing_chain_stays_one_chain():
    """With springs between sisters there are as many springs as cells, less one."""
    scene = scene_of(
        5, 1.0, {"stiffness": 0.5, "pairs": [[0, 1]], "rest": "8 um", "sisters": True},
        growth={"cycle_time": "2 h"}, duration="5 h", coupling_step="10 min",
        initial={"count": 2, "spacing": 1.0, "stage": "uniform"}, integrator="cvode",
    )  # fmt: skip
    simulation = Simulation(scene, threads=1)
    while not simulation.finished:
        simulation.step()
        pair = simulation.springs.pair
        ends = np.unique(pair, return_counts=True)
        assert len(pair) == len(simulation.cells) - 1
        np.testing.assert_array_equal(ends[0], np.sort(simulation.cells.id))
        assert (pair[:, 0] < pair[:, 1]).all()
    assert simulation.divisions > 4


def test_springs_go_with_the_death_of_a_cell():
    scene = scene_of(
        3, springs={"stiffness": 1.0, "pairs": [[0, 1], [1, 2]]},
        death={"apoptosis_rate": "0.02 1/s", "apoptosis_time": "1 d"}, growth={},
    )  # fmt: skip
    simulation = Simulation(scene, threads=1)
    while not simulation.finished:
        simulation.step()
        dead = simulation.cells.id[simulation.cells.state == State.APOPTOTIC]
        assert not np.isin(simulation.springs.pair, dead).any()
    assert len(dead) > 0
    np.testing.assert_equal(simulation.history_row()["springs"], len(simulation.springs))


def test_pairs_come_from_a_table_beside_the_scene(tmp_path, monkeypatch):
    (tmp_path / "edges.csv").write_text("first_id,distance_um,second_id\n2,9.0,0\n1,8.5,2\n")
    text = 'duration = "1 h"\ninitial.count = 3\n[springs.net]\nstiffness = 1\nfile = "edges.csv"\n'
    (tmp_path / "scene.toml").write_text(text)
    scene = mc.load_scene(tmp_path / "scene.toml")
    assert scene.springs["net"].pairs == ((0, 2), (1, 2))
    assert scene.springs["net"].file is None
    again = Scene.from_dict(scene.to_dict())
    assert again == scene
    monkeypatch.chdir(tmp_path)
    assert scene.with_changes({"springs.net": {"stiffness": 1, "file": "edges.csv"}}) == scene


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "no column first_id"),
        ("first_id,other\n1,2\n", "no column second_id"),
        ("first_id,second_id\n1,2\n1,x\n", "line 3"),
        ("first_id,second_id\n1\n", "line 2"),
        ("first_id,second_id\n1,1\n", "joins 1 to itself"),
        ("first_id,second_id\n1,2\n2,1\n", "holds a pair twice"),
        (None, "cannot be read"),
    ],
)
def test_tables_that_hold_no_pairs_are_refused(tmp_path, content, words):
    file = tmp_path / "edges.csv"
    if content is not None:
        file.write_text(content)
    with pytest.raises(SceneError) as caught:
        scene_of(springs={"stiffness": 1, "file": str(file)})
    assert caught.value.path == "springs.net.file"
    assert words in caught.value.problem


@pytest.mark.parametrize(
    ("law", "path", "words"),
    [
        ({"stiffness": 1}, "springs.net.pairs", "must be given"),
        ({"stiffness": 1, "pairs": [[0, 1]], "within": 9}, "springs.net.pairs", "not both"),
        ({"stiffness": 0, "pairs": [[0, 1]]}, "springs.net.stiffness", "above 0"),
        ({"stiffness": 1, "pairs": []}, "springs.net.pairs", "list of pairs"),
        ({"stiffness": 1, "pairs": [[0, 1, 2]]}, "springs.net.pairs", "list of pairs"),
        ({"stiffness": 1, "pairs": [[0, "1"]]}, "springs.net.pairs", "whole numbers"),
        ({"stiffness": 1, "pairs": [[0, 1], [1, 0]]}, "springs.net.pairs", "twice"),
        ({"stiffness": 1, "pairs": [[2, 2]]}, "springs.net.pairs", "to itself"),
        (
            {"stiffness": 1, "pairs": [[0, 1]], "rest": 9, "breaking_length": 8},
            "springs.net.breaking_length",
            "above the length at rest",
        ),
        ({"stiffness": 1, "pairs": [[0, 1]], "sisters": True}, "springs.net.sisters", "no effect"),
    ],
)
def test_springs_without_meaning_are_refused(law, path, words):
    with pytest.raises(SceneError) as caught:
        scene_of(springs=law)
    assert caught.value.path == path
    assert words in caught.value.problem


@pytest.mark.parametrize(
    ("law", "path", "words"),
    [
        ({"stiffness": 1, "pairs": [[0, 99]]}, "springs.net.pairs", "the cell 99"),
        ({"stiffness": 1, "within": "1 um"}, "springs.net.within", "joins no cells"),
    ],
)
def test_springs_that_find_no_cells_are_refused_at_the_start(law, path, words):
    with pytest.raises(SceneError) as caught:
        Simulation(scene_of(springs=law))
    assert caught.value.path == path
    assert words in caught.value.problem


def test_springs_too_stiff_for_double_precision_are_refused():
    scene = scene_of(springs={"stiffness": 1e8, "pairs": [[0, 1]]}, drag={"viscosity": 1e-6})
    from multicell.errors import StepFailed

    with pytest.raises(StepFailed, match="double precision"):
        Simulation(scene, threads=1).step()


def test_a_scene_whose_springs_are_all_broken_goes_on():
    assert Springs().kept() == {}
    assert len(Springs.of({})) == 0
    scene = scene_of(4, springs={"stiffness": 0.1, "pairs": [[0, 1]], "breaking_length": 0.1})
    simulation = Simulation(scene, threads=1)
    simulation.step()
    assert len(simulation.springs) == 0
    simulation.step()
    assert simulation.history_row()["largest_tension"] == 0.0
