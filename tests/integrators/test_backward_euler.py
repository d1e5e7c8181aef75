"""Backward Euler as the minimum of an energy, against SciPy's minimisers of the same function."""

import ast
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from strategies import cluster, divided, mechanics

import multicell
from multicell import JKR, Simulation
from multicell.contact.law import compliance
from multicell.integrators.backward_euler import BackwardEuler, _Step
from multicell.mechanics.motion import Motion
from multicell.mechanics.sphere import Sphere
from multicell.mechanics.system import Mechanics
from multicell.scene.scene import Scene

FREE = 50.0
"""Radii that a cell may move: no step is refused for its length."""


def just_divided(n, seed):
    """Return centres, radii and moduli of a ball in which every tenth cell has just divided."""
    return divided(*cluster(n, seed), np.arange(n // 10), seed)


def outside(system, start, step):
    """Return the energy of a step and its gradient, written anew: nN µm and nN."""
    drag = system.drag * system.motion.end_radius[:, None]

    def energy(x):
        x = x.reshape(-1, 3)
        moved = x - start
        gradient = drag * moved / step - system.force(step, x)
        return 0.5 * (drag * moved**2).sum() / step + system.energy(step, x), gradient.ravel()

    return energy


def residual(system, start, end, step):
    velocity = np.empty_like(start)
    system.velocity(step, end, velocity)
    return np.abs(end - start - step * velocity).max()


@pytest.mark.parametrize("step", [5.0, 20.0, 41.0, 300.0])
def test_a_step_ends_where_l_bfgs_finds_the_least_energy(step):
    start, radius, young = just_divided(200, 1)
    rate = 1e-3 * radius / step
    system = mechanics(radius, young, duration=step, rate=rate)
    outcome = BackwardEuler(step, FREE, tolerance=1e-5).integrate(system, start)
    assert outcome.problem == ""
    assert residual(system, start, outcome.position, step) < 1e-5
    energy = outside(mechanics(radius, young, duration=step, rate=rate), start, step)
    options = {"maxiter": 5000, "maxfun": 20000, "ftol": 0.0, "gtol": 1e-9}
    found = minimize(energy, start.ravel(), jac=True, method="L-BFGS-B", options=options)
    # beyond there are several minima, in which other contacts have formed
    if step <= 20.0:
        np.testing.assert_allclose(outcome.position.ravel(), found.x, rtol=0, atol=1e-5)
    assert energy(outcome.position.ravel())[0] <= found.fun + 1e-3 * abs(found.fun)
    assert energy(outcome.position.ravel())[0] < energy(start.ravel())[0]


@pytest.mark.parametrize("step", [5.0, 41.0, 300.0])
def test_the_energy_falls_in_every_step_however_long(step):
    position, radius, young = just_divided(60, 3)
    system = mechanics(radius, young, duration=step)
    energies = [system.energy(0.0, position)]
    for _ in range(12):
        position = BackwardEuler(step, FREE).integrate(system, position).position
        energies.append(system.energy(0.0, position))
    assert np.diff(energies).max() <= 0.0
    assert energies[-1] < energies[0] - 1.0


def test_a_minimum_is_no_saddle():
    """A ball pressed to half its distances: the straight solution is there, and is not taken."""
    start, radius, young = cluster(60, 2, spacing=0.55)
    system = mechanics(radius, young, duration=40.0, viscosity=0.05)
    outcome = BackwardEuler(40.0, FREE, tolerance=1e-8).integrate(system, start)
    assert outcome.done
    system.linearise(40.0, outcome.position)
    column, image = np.zeros((60, 3)), np.empty((60, 3))
    hessian = np.empty((180, 180))
    for k in range(180):
        column.ravel()[k] = 1.0
        system.jacobian_product(column, image)
        hessian[:, k] = (column - 40.0 * image).ravel()
        column.ravel()[k] = 0.0
    assert np.linalg.eigvals(hessian).real.min() > 0.0


def test_the_cost_of_a_hard_step_is_tens_of_evaluations():
    start, radius, young = just_divided(400, 2)
    system = mechanics(radius, young, duration=300.0)
    assert BackwardEuler(300.0, FREE).integrate(system, start).done
    # Newton's method on the residual spent 3,500 products, and failed
    assert system.work.jacobian_products < 200
    assert system.work.evaluations < 100


BASE = {
    "title": "What has an energy",
    "duration": "1 h",
    "coupling_step": "1 min",
    "initial": {"count": 20, "stage": "uniform", "spacing": 0.8},
}
WITH = {
    "growth": {"growth": {"cycle_time": "2 h"}},
    "walls": {"domain": {**{axis: ["-12 um", "12 um"] for axis in "xyz"}}},
    "held and moved": {
        "motions": {"a": {"cells": [0]}, "b": {"cells": [3, 4], "velocity": [1e-3, 0, 0]}}
    },
    "a force that rises": {"pull": {"force": 0.2, "rate": 1e-3}},
    "crawling": {"motility": {"force": "0.1 nN", "persistence": "10 min"}},
    "exact-jkr": {"contact": {"law": "exact-jkr"}},
    "hertz": {"contact": {"law": "hertz"}},
    "spring law": {"contact": {"law": "cubic"}},
    "types": {
        "types": {"a": {"fraction": 0.5}, "b": {"fraction": 0.5, "young": "3 kPa"}},
    },
    "bonds": {
        "adhesion": {"strength": "0.1 kPa"},
        "types": {"a": {"fraction": 1.0, "receptor": 0.9, "ligand": 0.9}},
    },
    "plane": {"dimensions": 2},
}


@pytest.mark.parametrize("name", WITH)
def test_the_residual_is_the_slope_of_the_energy_with_every_part(name):
    simulation = Simulation(Scene.from_dict(BASE | WITH[name]))
    start, system = simulation.cells.position, simulation.prepared()
    free = np.tile(np.arange(3) < simulation.scene.dimensions, (len(start), 1))
    if system.prescribed is not None:
        free &= ~system.prescribed.held[:, None]
    assert slope_error(system, start, free) < 1e-5


def slope_error(system, start, free):
    """Return by how much the residual misses the slope of the energy, relatively."""
    begin = system.motion.begin
    implicit = _Step(BackwardEuler(30.0), system, start, begin + 30.0, 30.0)
    assert implicit.descends
    place, way = free * np.random.default_rng(0).normal(size=(2, *start.shape))
    place = start + 0.1 * place
    rise = implicit._energy(place + 1e-5 * way) - implicit._energy(place - 1e-5 * way)
    return abs(rise / 2e-5 / implicit._product(implicit._residual(place), way) - 1.0)


def test_friction_has_no_energy_and_is_solved_as_before():
    start, radius, young = cluster(40, 2)
    system = mechanics(radius, young, JKR(surface_energy=0.1), duration=20.0, friction=(0.1, 0.1))
    outcome = BackwardEuler(20.0, tolerance=1e-6).integrate(system, start)
    assert outcome.done
    assert residual(system, start, outcome.position, 20.0) < 1e-4


@pytest.mark.parametrize("part", ["gel", "friction", "gel and friction"])
def test_a_step_in_a_gel_or_with_friction_ends_where_its_equation_holds(part):
    position, radius, young = cluster(30, 4, spacing=0.8)
    wall = Sphere(12.0, float(compliance(1.0, 0.5)), 2.0) if "gel" in part else None
    friction = (0.2, 0.1) if "friction" in part else (0.0, 0.0)
    system = Mechanics(JKR(), 5.0, walls=wall, friction=friction)
    still = np.zeros(len(radius))
    system.begin(Motion(radius, still, young, np.full(len(radius), 0.5), 0.0, 40.0))
    outcome = BackwardEuler(40.0, FREE, tolerance=1e-6).integrate(system, position)
    assert outcome.problem == ""
    assert residual(system, position, outcome.position, 40.0) < 1e-5
    assert np.abs(outcome.position - position).max() > 0.01


@pytest.mark.slow
def test_linear_operators_state_their_type():
    """SciPy otherwise finds it by the product of a vector of small integers."""
    package = Path(multicell.__file__).parent
    calls = [
        (file.name, node)
        for file in package.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "LinearOperator"
    ]
    assert len(calls) >= 3
    assert [name for name, call in calls if "dtype" not in [k.arg for k in call.keywords]] == []
