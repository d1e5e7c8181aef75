"""Scenes with adhesion, types, friction and pull: physics, courses in time, bad input."""

import numpy as np
import pytest
from formulas import pair
from running import finished, refused
from scipy.optimize import brentq

import multicell as mc
from multicell import Simulation
from multicell.cells import contact_rows
from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.jkr import JKR
from multicell.contact.law import effective_modulus, effective_radius
from multicell.integrators.cvode import Cvode
from multicell.integrators.runge_kutta import Euler
from multicell.mechanics.friction import FrictionMatrix
from multicell.mechanics.motion import Motion, StateRejected
from multicell.mechanics.system import Mechanics


@pytest.mark.kernels
@pytest.mark.parametrize("law", ["jkr", "exact-jkr"])
def test_doublet_separates_at_three_halves_pi_sigma_r(law):
    scene = mc.load_scene("doublet").with_changes({"contact.law": law})
    if law == "exact-jkr":  # it rests at a third of the overlap
        scene = scene.with_changes({"initial.spacing": 0.95})
    simulation = Simulation(scene)
    radius = effective_radius(*simulation.cells.radius)
    finished(simulation)
    expected = 1.5 * np.pi * 0.1 * radius
    assert simulation.separation["force"] == pytest.approx(expected, rel=0.01)
    assert simulation.separation["force"] > expected
    assert simulation.time < scene.duration
    assert simulation.summary()["separation"] == simulation.separation


def ramp(step, ligand):
    """Return where four cells with receptors and a course of ligands are after ten minutes."""
    scene = mc.load_scene("settle").with_changes(
        {
            "duration": "10 min",
            "coupling_step": step,
            "initial.count": 4,
            "initial.spacing": 0.9,
            "contact": {"law": "hertz"},
            "adhesion": {"strength": "0.1 nN/um^2"},
            "types": {"a": {"receptor": 0.9, "ligand": ligand}},
            "integrator.rtol": 1e-10,
            "integrator.atol": 1e-9,
            "drag.viscosity": 0.5,
        }
    )
    cells = finished(scene).cells
    return cells.position[np.argsort(cells.id)], cells


@pytest.mark.slow
def test_ligands_that_ramp_to_zero_within_one_step():
    """One coupling step with rates ends where 600 short ones with nearly constant values do."""
    position, cells = ramp("10 min", [[0, 0.9], ["10 min", 0.0]])
    fine, _ = ramp("1 s", [[0, 0.9], ["10 min", 0.0]])
    constant, _ = ramp("10 min", 0.9)
    np.testing.assert_allclose(position, fine, atol=1e-6)
    assert np.abs(position - constant).max() > 1e-2
    assert (cells.ligand == 0.0).all()
    assert (cells.receptor == 0.9).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "step"), [(Cvode(1e-8, 1e-7), 2.0), (Cvode(1e-8, 1e-7), 0.5), (Euler(0.0005), 2.0)]
)
def test_hysteresis_does_not_depend_on_integrator_or_step(method, step):
    """Load, unload and pull: overlaps follow the loaded branch, the pair parts under pull-off."""
    law, radii, young = ExactJKR(surface_energy=0.1), np.full(2, 10.0), np.ones(2)
    modulus, radius = effective_modulus(1, 0.5, 1, 0.5), 5.0
    rest = float(law.equilibrium_overlap(modulus, radius))
    position = np.array([[0.0, 0, 0], [20.0 - rest, 0, 0]])
    pull_off = -float(law.pull_off_force(radius))
    touching, rate = np.array([[0, 1]]), 0.05
    for k in range(int(60.0 / step)):
        begin = k * step
        system = Mechanics(law, 1e-5)
        along = np.array([[-1.0, 0, 0], [1, 0, 0]])
        push = np.hstack([rate * begin * along, rate * along])
        system.begin(
            Motion(radii, np.zeros(2), young, np.full(2, 0.5), begin, begin + step,
                   push=push, touching=touching)
        )  # fmt: skip
        outcome = method.integrate(system, position)
        load = rate * (begin + step)
        if not outcome.done or load > pull_off:
            break
        position = outcome.position
        touching = system.contacts(begin + step, position)
        overlap = 20.0 - np.linalg.norm(position[1] - position[0])
        static = brentq(
            lambda h, load=load: float(pair(law, h, modulus, radius, touching=True)[0]) + load,
            float(law.pull_off_overlap(modulus, radius)), rest + 1e-9,
        )  # fmt: skip
        assert overlap == pytest.approx(static, abs=2e-3)
        assert len(touching) == 1
    assert load > pull_off
    assert load - rate * step <= pull_off


def test_contacts_follow_cells_through_sorting_and_death():
    scene = mc.load_scene("settle").with_changes({"contact.law": "exact-jkr", "duration": "2 min"})
    simulation = Simulation(scene)
    simulation.step()
    ids = {frozenset(pair) for pair in simulation.contacts.tolist()}
    simulation.cells = simulation.cells.take(np.arange(len(simulation.cells))[::-1][:-20])
    index = contact_rows(simulation.cells, simulation.contacts)
    found = {frozenset(pair) for pair in simulation.cells.id[index].tolist()}
    alive = set(simulation.cells.id.tolist())
    assert found == {pair for pair in ids if pair <= alive}
    assert len(found) < len(ids)


def test_friction_slows_the_settling_and_keeps_its_end():
    scene = mc.load_scene("settle").with_changes(
        {"initial.count": 30, "duration": "20 min", "drag.viscosity": 0.5}
    )
    rubbing = scene.with_changes({"friction.normal": 0.5, "friction.tangential": 0.1})
    free, slow = Simulation(scene), Simulation(rubbing)
    free.step(), slow.step()
    assert slow.energy() > free.energy()
    assert slow.summary()["integrator"]["friction_iterations"] > 0
    while not free.finished:
        free.step(), slow.step()
    assert slow.summary()["diameter"] == pytest.approx(free.summary()["diameter"], rel=0.02)


def test_friction_that_cannot_be_solved_for_rejects_the_state(monkeypatch):
    """In the right-hand side and in a Jacobian product alike."""
    position = np.array([[0.0, 0, 0], [8.0, 0, 0]])
    system = Mechanics(JKR(), 5.0, friction=(0.1, 0.1))
    half = np.full(2, 0.5)
    system.begin(Motion(np.full(2, 5.0), np.zeros(2), np.ones(2), half, 0.0, 10.0))
    out = np.empty_like(position)
    system.velocity(0.0, position, out)
    system.linearise(0.0, position)

    def fails(*_, **__):
        raise StateRejected("after 2000 iterations")

    monkeypatch.setattr(FrictionMatrix, "solve", fails)
    with pytest.raises(StateRejected, match="2000 iterations"):
        system.velocity(0.0, position, out)
    with pytest.raises(StateRejected, match="2000 iterations"):
        system.jacobian_product(position, out)


def test_types_share_the_cells_and_their_stiffness():
    scene = mc.load_scene("settle").with_changes(
        {
            "cells.young_variation": 0,
            "initial.count": 100,
            "types": {"soft": {"fraction": 3}, "hard": {"fraction": 1, "young": "7 kPa"}},
        }
    )
    cells = Simulation(scene).cells
    assert np.bincount(cells.kind).tolist() == [75, 25]
    assert set(cells.young[cells.kind == 0]) == {1.0}
    assert set(cells.young[cells.kind == 1]) == {7.0}


def test_two_dimensions_stay_in_their_plane():
    scene = mc.load_scene("growth").with_changes({"dimensions": 2, "duration": "3 d"})
    simulation = finished(scene)
    assert len(simulation.cells) > 15
    assert (simulation.cells.position[:, 2] == 0.0).all()
    assert np.ptp(simulation.cells.position[:, 1]) > 10.0


def symmetric(name="b"):
    return {
        "types.a.surface_energy": {"a": 0.1, name: 0.02},
        "types.b.surface_energy": {"a": 0.02, "b": 0.05},
    }


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        (symmetric() | {"types.a.surface_energy.b": 0.03}, "types.a.surface_energy.b", "symmetric"),
        (symmetric("c"), "types.a.surface_energy.c", "not a type"),
        (symmetric() | {"types.a.surface_energy.b": None}, "types.a.surface_energy.b", "missing"),
        (symmetric() | {"contact.law": "hertz"}, "types.a.surface_energy", "law"),
        ({"types.a.surface_energy": {"a": -0.1}}, "types.a.surface_energy.a", "at least 0"),
        ({"types.a.fraction": 0}, "types", "add up to 0"),
        ({"types.a.ligand": [[0, 1], [5, -1]], "adhesion": {}}, "types.a.ligand", "at least 0"),
        ({"types.a.ligand": [[5, 1], [0, 1]], "adhesion": {}}, "types.a.ligand", "rise"),
        ({"types.a.ligand": [3, 4], "adhesion": {}}, "types.a.ligand", "list of"),
        ({"types.a.ligand": "0.4", "adhesion": {}}, "types.a.ligand", "number"),
        ({"types.a.receptor": 0.5}, "types.a.receptor", "no adhesion"),
        ({"adhesion": {}}, "adhesion", "no type"),
        ({"cells.poisson": 0.75}, "cells.poisson", "at most 0.5"),
        ({"contact.smoothing": "5 um"}, "contact.smoothing", "birth radius"),
        ({"types.a.recepter": 1}, "types.a.recepter", "receptor"),
    ],
)
def test_bad_input(changes, path, words):
    with refused(path, words):
        mc.load_scene("settle").with_changes(changes)
