"""The coupling loop: order of events, bits, ledgers, optional parts, failures."""

import ast
import subprocess
import sys

import numpy as np
import pytest
from running import finished

import multicell as mc
from multicell import Simulation
from multicell.biology.initial import initial_cells
from multicell.errors import StepFailed

SMALL = {
    "duration": "30 h",
    "initial.count": 60,
    "initial.stage": "uniform",
    "initial.spacing": 0.9,
    "nutrients.oxygen.boundary": "0.032 mM",
    "nutrients.oxygen.uptake": "150 amol/s",
    "nutrients.oxygen.necrosis": "0.0135 mM",
    "nutrients.oxygen.spacing": "12 um",
}
"""A spheroid that grows, starves and dies within seconds."""


def small(**changes):
    return mc.load_scene("spheroid").with_changes(SMALL | changes)


@pytest.fixture(scope="module")
def grown():
    return finished(small())


def test_small_spheroid_has_all_three_states(grown):
    counts = np.bincount(grown.cells.state, minlength=3)
    assert (counts > 0).all()
    assert len(grown.cells) > 100
    assert grown.divisions > 0
    assert grown.time == 30 * 3600.0


def test_every_cell_is_accounted_for(grown):
    """Each division adds one cell, each removal takes one, and identities are unique."""
    assert len(grown.cells) == 60 + grown.divisions - grown.removals
    assert len(np.unique(grown.cells.id)) == len(grown.cells)
    assert (grown.cells.parent < grown.cells.id).all()


def test_stop_cells_ends_the_run():
    simulation = finished(small(stop_cells=80))
    assert 80 <= len(simulation.cells) < 100
    assert simulation.time < 30 * 3600.0


def test_settling_lowers_the_energy_and_keeps_the_centre():
    simulation = Simulation(mc.load_scene("settle"))
    drag = simulation.cells.radius[:, None]
    centre = (drag * simulation.cells.position).sum(axis=0) / drag.sum()
    energies = [simulation.energy()]
    for _ in range(10):
        simulation.step()
        energies.append(simulation.energy())
    assert (np.diff(energies) < 0).all()
    drag = simulation.cells.radius[:, None]
    after = (drag * simulation.cells.position).sum(axis=0) / drag.sum()
    np.testing.assert_allclose(after, centre, atol=1e-4)


def test_coincident_cells_come_apart():
    scene = mc.load_scene("settle").with_changes({"initial.count": 4, "duration": "1 h"})
    cells = initial_cells(scene)
    cells.position[:] = 0.0
    simulation = finished(scene, cells=cells)
    assert np.isfinite(simulation.cells.position).all()
    pairs = simulation.cells.position[:, None] - simulation.cells.position
    distance = np.linalg.norm(pairs, axis=-1)[np.triu_indices(4, 1)]
    assert (distance > 4.0).all()


def test_a_cell_far_outside_stays_finite_and_where_it_is():
    scene = mc.load_scene("settle").with_changes({"duration": "5 min"})
    cells = initial_cells(scene)
    cells.position[7] = [1e7, -1e7, 1e7]
    stray = cells.id[7]
    simulation = finished(scene, cells=cells)
    index = int(np.flatnonzero(simulation.cells.id == stray)[0])
    np.testing.assert_array_equal(simulation.cells.position[index], [1e7, -1e7, 1e7])
    assert np.isfinite(simulation.cells.position).all()


def test_all_cells_may_die():
    simulation = finished(
        small(
            **{
                "nutrients.oxygen.boundary": 0,
                "death.lysis_time": "1 h",
                "death.removal_fraction": 0.5,
                "initial.count": 5,
            }
        )
    )
    assert len(simulation.cells) == 0
    assert simulation.summary()["diameter"] == 0.0


SHORT = "mc.run(mc.load_scene({!r}).with_changes({{'duration': '20 min', 'initial.count': 3}}))"
ABSENT = ("mechanics.walls", "mechanics.compression", "nutrient.reactions")
PARTS = [f"multicell.{name}" for name in ABSENT]


@pytest.mark.parametrize(
    ("action", "heavy"),
    [
        ("", ["numba", "scipy", "sksundae", "pde", "pint", "h5py"]),
        (
            SHORT.format("growth"),
            ["pde", "matplotlib", "h5py", "rich", "sympy", "scipy.fft", *PARTS],
        ),
        (SHORT.format("spheroid"), ["scipy.fft", "scipy.optimize._optimize", *PARTS]),
    ],
    ids=["import", "a run without nutrients", "a run with a field"],
)
def test_packages_that_are_not_needed_are_not_loaded(action, heavy):
    program = f"import sys, multicell as mc\n{action}\nprint(sorted(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    loaded = ast.literal_eval(done.stdout)
    assert [name for name in heavy if name in loaded] == []
    assert ("pde" in loaded) == ("spheroid" in action)


def test_more_threads_than_there_are_is_refused():
    with pytest.raises(mc.SceneError, match="threads: is 100000"):
        Simulation(mc.load_scene("settle"), threads=100000)


def test_public_names():
    assert set(mc.__all__) == {
        "JKR", "Cells", "Event", "Hertz", "Network", "network", "read_network", "MulticellError",
        "OutputError", "Result", "Scene",
        "SceneError", "Simulation", "StabilityMap", "State", "StepFailed", "WorkPrecision",
        "compare", "export", "load_result", "load_scene", "resume", "run", "scene_names",
        "compare_networks", "network_stability", "NetworkPrecision", "moving_stability",
        "FailureMap", "compare_fields", "FieldPrecision",
        "stability", "Integrator", "MethodInfo", "OdeProblem", "Outcome", "StateRejected",
        "ode_problem", "testing", "load_law", "pair_law", "OwnReaction", "Imported",
        "import_physicell",
        "Reaction", "reaction", "response", "FieldEquation", "FieldProblem",
        "ImplicitFieldSolver", "Schedule", "SteadyFieldSolver", "Substance",
        "field_problem", "Study", "study", "load_study", "Sensitivity", "sensitivity", "Fit", "fit",
        "DoseResponse", "dose_response", "growth_law", "Observable",
        "observable", "load_observable", "RunTable", "coarsen", "compare_coarse", "compare_fits",
        "gradient", "load_fit", "read_cells",
    }  # fmt: skip
    assert all(hasattr(mc, name) for name in mc.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = mc.nothing


def test_another_seed_differs():
    one, other = (finished(small(seed=seed, duration="1 h")) for seed in (1, 2))
    assert sorted(other.cells.radius.tolist()) != sorted(one.cells.radius.tolist())


def test_a_step_that_cannot_be_solved_names_cell_time_and_remedy():
    scene = mc.load_scene("settle").with_changes(
        {"integrator": "euler", "integrator.step": "1 h", "coupling_step": "1 h"}
    )
    simulation = Simulation(scene)
    before = simulation.cells
    with pytest.raises(mc.StepFailed, match=r"cell \d+, t = 0 s.*Choose a shorter") as caught:
        simulation.step()
    assert caught.value.cell in before.id
    assert simulation.cells is before
    assert simulation.step_index == 0


def test_no_step_begins_at_the_end_of_a_run():
    simulation = Simulation(mc.Scene.from_dict({"duration": "10 min", "coupling_step": "5 min"}))
    simulation.step()
    simulation.step()
    before = simulation.cells
    with pytest.raises(StepFailed, match="has reached its duration"):
        simulation.step()
    assert (simulation.time, simulation.step_index) == (600.0, 2)
    assert simulation.cells is before


def test_what_is_written_into_the_cells_acts_in_the_next_step():
    """The pressure that stops growth, written in place; the factor of the last step is not kept."""
    simulation = Simulation(
        mc.Scene.from_dict({"duration": "1 h", "coupling_step": "10 min", "initial": {"count": 8},
                            "growth": {"critical_pressure": 0.1}})
    )  # fmt: skip
    simulation.step()
    simulation.history_row()
    simulation.cells.pressure[:] = 1.0
    before = simulation.cells.volume.copy()
    simulation.step()
    assert np.array_equal(simulation.cells.volume, before)
