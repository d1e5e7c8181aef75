"""Runs with prescribed motions of named cells: who is driven, when, and how."""

import json

import numpy as np
import pytest
from running import finished, refused

import multicell as mc
from multicell.biology.driven import named_at_start, pass_on
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.cells import State
from multicell.comparison.record import record
from multicell.comparison.replay import replay
from multicell.errors import StepFailed
from multicell.integrators.cvode import Cvode
from multicell.integrators.runge_kutta import Dopri5
from multicell.results.quantities import unit_of
from multicell.results.records import arrays_of
from multicell.scene.scene import Scene
from multicell.simulation import Simulation

RADIUS = 5.0 * 0.5 ** (1 / 3)
DRAG = 6 * np.pi * 5.0 * RADIUS


def scene_of(count=12, spacing=0.95, **parts):
    return Scene.from_dict({
        "duration": "10 min",
        "coupling_step": "1 min",
        "initial": {"count": count, "spacing": spacing},
        "cells": {"young_variation": 0.0},
        "integrator": {"atol": 1e-5, "rtol": 1e-8},
        **parts,
    })  # fmt: skip


def course(scene, **options):
    """Return the positions of the cells after each step in the order of identities, and the run."""
    simulation = Simulation(scene, threads=1, **options)
    found = [placed(simulation.cells)]
    while not simulation.finished:
        simulation.step()
        found.append(placed(simulation.cells))
    return np.array(found), simulation


def placed(cells):
    return cells.position[np.argsort(cells.id)]


@pytest.mark.parametrize("method", ["auto", "euler", "cvode", "rkc2", "rosenbrock", "ab2"])
def test_a_motion_is_exact_in_every_step_and_lets_go(method):
    motion = {"velocity": [0, 0, "5 nm/s"], "cells": [4, 2], "begin": 60, "end": 270}
    base = {"x": [-100, -4]}
    scene = scene_of(integrator=method, motions={"up": motion, "base": base})
    way, simulation = course(scene)
    # it ends between two multiples of the step: another one ends there
    times = np.sort([*60.0 * np.arange(11), 270.0])
    lasted = np.clip(times, 60, 270) - 60
    held = simulation.named["motions.base"]
    assert 0 < len(held) < 6
    np.testing.assert_array_equal(way[:, held], way[:1, held].repeat(12, axis=0))
    for cell in (2, 4):
        exact = way[1, cell] + 0.005 * lasted[:, None] * [0, 0, 1]
        np.testing.assert_allclose(way[1:6, cell], exact[1:6], atol=1e-12)
        assert np.abs(way[-1, cell] - way[5, cell]).max() > 1e-4


def test_forces_of_the_history_are_those_of_the_closed_forms():
    """Two cells are pressed together by one that moves: Hertz, and Stokes."""
    parts = {"contact": {"law": "hertz"}}
    start = placed(initial_cells(scene_of(2, 1.0, **parts)))
    distance = np.linalg.norm(start[1] - start[0])
    axis = (start[1] - start[0]) / distance
    motions = {"left": {"cells": [0]}, "right": {"cells": [1], "velocity": list(-0.001 * axis)}}
    history = mc.run(scene_of(2, 1.0, motions=motions, **parts)).history
    time = np.array(history["time"])
    overlap = np.maximum(2 * RADIUS - distance + 0.001 * time, 0.0)
    force = np.sqrt(RADIUS / 2) / (1.5 * 0.75) * overlap**1.5
    found = {
        name: np.stack([history[f"force_{name}_{a}"] for a in "xyz"], axis=1) for name in motions
    }
    # contact pushes the held cell away from the other one: it must be pushed towards it
    np.testing.assert_allclose(found["left"], force[:, None] * axis, atol=1e-9)
    towed = -(force + DRAG * 0.001)[:, None] * axis
    np.testing.assert_allclose(found["right"], towed, atol=1e-9)
    assert unit_of("force_left_x") == "nN"


def pressed(speed=-0.01, **changes):
    """Return a small version of the built-in scene."""
    scene = mc.load_scene("compression").with_changes({"initial.count": 60, **changes})
    motions = {"base": {"z": [-40, -5]}, "plate": {"z": [5, 40], "velocity": [0, 0, speed]}}
    return scene.with_changes({"motions": motions})


def test_all_that_is_held_from_outside_balances():
    """Without drag of moving cells, the forces on both layers of a cluster at rest add up to 0."""
    scene = pressed(speed=0.0, duration="1 h", coupling_step="1 min")
    _, simulation = course(scene)
    row = simulation.history_row()
    for axis in "xyz":
        total = row[f"force_base_{axis}"] + row[f"force_plate_{axis}"]
        assert total == pytest.approx(0.0, abs=1e-2)
    assert abs(row["force_base_z"]) > 0.1


def test_the_first_daughter_takes_over_and_the_other_is_free():
    scene = scene_of(
        4, initial={"count": 4, "spacing": 0.9, "stage": "uniform"},
        growth={"cycle_time": "2 h", "cycle_variation": 0.0}, duration="3 h",
        coupling_step="5 min", integrator="cvode", motions={"held": {"cells": [0, 2]}},
    )  # fmt: skip
    simulation = Simulation(scene, threads=1)
    places = {}
    while not simulation.finished:
        before, named = simulation.cells, dict(simulation.named)
        simulation.step()
        cells = simulation.cells
        for path, ids in named.items():
            heirs = simulation.named[path]
            assert len(heirs) == len(ids)
            for cell in ids:
                daughters = np.sort(cells.id[cells.parent == cell])
                assert (cell if (cells.id == cell).any() else daughters[0]) in heirs
        for cell in simulation.named["motions.held"]:
            where = cells.position[cells.id == cell][0]
            np.testing.assert_array_equal(places.setdefault(int(cell), where), where)
        assert len(before) <= len(cells)
    assert simulation.divisions >= 8
    assert min(simulation.named["motions.held"]) > 3


def test_a_type_keeps_its_drivers_and_removed_cells_leave_their_list():
    cells = initial_cells(scene_of(6))
    named = {"motions.f": np.array([1, 3, 5])}
    after = cells.take(np.array([0, 3, 2, 5, 4]))
    after.id[4], after.parent[4] = 9, 3
    left = pass_on(named, after, 6)
    np.testing.assert_array_equal(left["motions.f"], [3, 5])
    motility = {"force": 1.0, "bias": 1.0, "direction": [1, 0, 0]}
    scene = scene_of(6, types={"a": {}, "b": {}}, motions={"m": {"type": "b"}}, motility=motility)
    assert named_at_start(biology_plan(scene), initial_cells(scene)) == {}
    way, simulation = course(scene)
    kind = simulation.cells.kind[np.argsort(simulation.cells.id)]
    moved = np.abs(way[-1] - way[0]).max(axis=1)
    assert not moved[kind == 1].any()
    assert (moved[kind == 0] > 0.1).all()


def test_dead_cells_stay_driven_until_they_are_removed():
    scene = scene_of(
        6, motions={"m": {"cells": [0], "velocity": [0.001, 0, 0]}}, death={"lysis_time": "2 min"}
    )  # fmt: skip
    start = initial_cells(scene)
    start.state[0] = State.NECROTIC
    simulation = finished(scene, threads=1, cells=start.copy())
    assert 0 not in simulation.cells.id
    assert len(simulation.named["motions.m"]) == 0
    early = Simulation(scene, threads=1, cells=start.copy())
    early.step()
    np.testing.assert_allclose(placed(early.cells)[0] - start.position[0], [0.06, 0, 0], atol=1e-12)


def test_frames_of_other_scenes_say_nothing_of_drivers():
    simulation = Simulation(scene_of(2), threads=1)
    text = arrays_of(simulation.frame(), [])["progress/text"].tobytes()
    assert "driven" not in json.loads(text)


def test_a_recorded_run_is_replayed_by_another_method():
    """Work-precision charts: driven cells are exact in both, the others differ by the tolerance."""
    scene = pressed(duration="1 min")
    problem, reference = record(scene, Cvode(1e-8, 1e-6), threads=1)
    other = replay(problem, Dopri5(1e-8, 1e-6))
    assert other.problem == ""
    held = problem.steps[-1].motion.held
    np.testing.assert_array_equal(other.positions[-1][held], reference.positions[-1][held])
    np.testing.assert_allclose(other.positions[-1], reference.positions[-1], atol=5e-3)
    moved = reference.positions[-1] - problem.start
    assert np.abs(moved[held]).max() == pytest.approx(0.6)


def test_a_held_cell_beyond_a_side_ends_the_run_by_name():
    scene = scene_of(
        1, domain={"x": [-20, 20], "y": [-20, 20], "z": [-20, 20]},
        motions={"m": {"velocity": [0.06, 0, 0]}},
    )  # fmt: skip
    with pytest.raises(StepFailed, match=r"left the domain through the side x\+"):
        course(scene)


def test_an_ode_problem_has_driven_cells_as_constants():
    scene = pressed()
    problem = mc.ode_problem(scene, step=1)
    held = np.repeat(problem.system.motion.held, 3)
    slope = problem.f(problem.t0, problem.y0)
    assert not slope[held].any()
    assert slope[~held].any()
    end = problem.system.at_end(problem.y0.reshape(-1, 3)).ravel() - problem.y0
    np.testing.assert_allclose(
        end.reshape(-1, 3), 10.0 * problem.system.motion.velocity, atol=1e-13
    )


REFUSED = [
    ({"motions": {"m": {"velocity": [1e-3]}}}, "motions.m.velocity", "list of three"),
    ({"motions": {"m": {"velocity": ["1 um", 0, 0]}}}, "motions.m.velocity", "must be a velocity"),
    ({"motions": {"m": {"cells": []}}}, "motions.m.cells", "list of whole"),
    ({"motions": {"m": {"cells": [-1]}}}, "motions.m.cells", "from 0 on"),
    ({"motions": {"m": {"cells": [1, 1]}}}, "motions.m.cells", "twice"),
    ({"motions": {"m": {"type": "a"}}}, "motions.m.type", "no type"),
    ({"motions": {"m": {"begin": 9, "end": 9}}}, "motions.m.end", "after begin"),
    ({"motions": {"m": {"velocity": [0.1, 0, 0]}}}, "motions.m.velocity", "in a coupling step"),
    ({"motions": {"m": {"x": [3, 1]}}}, "motions.m.x", "lower end first"),
    (
        {"dimensions": 2, "motions": {"m": {"velocity": [0, 0, 1e-3]}}},
        "motions.m.velocity",
        "plane",
    ),
    ({"dimensions": 2, "motions": {"m": {"z": [0, 1]}}}, "motions.m.z", "2 dimensions"),
]


@pytest.mark.parametrize(("parts", "path", "words"), REFUSED)
def test_drivers_without_meaning_are_refused(parts, path, words):
    with refused(path, words):
        scene_of(**parts)


@pytest.mark.parametrize(
    ("parts", "path", "words"),
    [
        ({"motions": {"m": {"cells": [99]}}}, "motions.m.cells", "the cell 99"),
        ({"motions": {"m": {"x": [500, 600]}}}, "motions.m", "names no cell"),
        (
            {"motions": {"a": {"cells": [1, 2]}, "b": {"cells": [2], "begin": 60}}},
            "motions.b",
            "moves the cell 2, which motions.a moves as well",
        ),
        ({"motions": {"a": {"cells": [1]}, "b": {}}}, "motions.b", "moves the cell 1"),
    ],
)
def test_drivers_that_find_no_cells_are_refused_at_the_start(parts, path, words):
    with refused(path, words):
        Simulation(scene_of(**parts))
