"""A spherical wall and the gel round it, against closed forms, differences and SciPy."""

import numpy as np
import pytest
from formulas import dense_jacobian, end_of, product_of, slope
from running import refused
from scipy.integrate import quad
from scipy.optimize import brentq
from strategies import cluster

import multicell as mc
from multicell.contact.hertz import Hertz
from multicell.contact.law import compliance
from multicell.integrators import registry as integrators
from multicell.mechanics.compression import TissueCompression
from multicell.mechanics.jacobian import sparse_jacobian
from multicell.mechanics.motion import Motion
from multicell.mechanics.sphere import Sphere
from multicell.mechanics.system import Mechanics
from multicell.scene.parts import IntegratorOptions
from multicell.simulation import Simulation

pytestmark = pytest.mark.kernels

REST, SHEAR = 18.0, 0.5


def confined(n=60, *, shear=SHEAR, felt=None, rate=0.001, rest=REST):
    position, radius, young = cluster(n, 1, spacing=0.85)
    wall = Sphere(rest, float(compliance(1.0, 0.5)), shear)
    system = Mechanics(Hertz(), 5.0, walls=wall, compression=felt)
    system.begin(Motion(radius, np.full(n, rate), young, np.full(n, 0.5), 0.0, 50.0))
    return system, position


def gel_pressure(stretch, shear=SHEAR):
    """Return the pressure in a cavity: the integral of Cauchy stresses of a neo-Hookean solid."""
    return quad(lambda x: 2.0 * shear * (1.0 + x**3) / x**5, 1.0, stretch)[0]


def wall_force(position, radius, young, shear):
    """Return Hertz's forces on a sphere that is where SciPy finds it in balance; and its radius."""
    away = np.linalg.norm(position, axis=1)
    strength = np.sqrt(radius) / (0.75 * 0.75 / young + 0.75 * 0.75)

    def push(wall):
        return strength * np.maximum(away + radius - wall, 0.0) ** 1.5

    def excess(wall):
        return push(wall).sum() - 4.0 * np.pi * wall**2 * gel_pressure(wall / REST, shear)

    wall = REST
    if shear is not None and excess(REST) > 0.0:
        wall = brentq(excess, REST, (away + radius).max(), xtol=1e-13)
    return -(push(wall) / away)[:, None] * position, wall


@pytest.mark.parametrize("shear", [None, SHEAR])
@pytest.mark.parametrize("felt", [None, TissueCompression(10.0)])
def test_forces_and_jacobian_are_derivatives_of_the_energy(shear, felt):
    system, position = confined(30, shear=shear, felt=felt, rest=13.0)
    force = system.force(10.0, position)
    directions = np.random.default_rng(0).normal(size=(6, *position.shape))
    for direction in directions:
        change = slope(lambda x: system.energy(10.0, x), position, direction, 1e-5)
        assert -(force * direction).sum() == pytest.approx(change, rel=1e-6)
    exact = dense_jacobian(system, position)
    system.linearise(0.0, position)
    for v in directions:
        found = product_of(system, v).ravel()
        np.testing.assert_allclose(found, exact @ v.ravel(), atol=1e-6 * np.abs(found).max())
    matrix = sparse_jacobian(system).toarray()
    if shear is None:
        np.testing.assert_allclose(matrix, exact, atol=1e-6 * np.abs(exact).max())
    else:  # what is left is of rank one
        weighed = system.rows[:, 3].repeat(3)[:, None] * (exact - matrix)
        sizes = np.linalg.svd(weighed, compute_uv=False)
        assert sizes[1] < 1e-4 * sizes[0]
    assert -np.linalg.eigvals(exact).real.min() <= system.stiffness_bound(0.0, position)


@pytest.mark.parametrize("shear", [None, SHEAR])
def test_the_wall_stands_where_cells_and_gel_balance(shear):
    system, position = confined(shear=shear)
    plain = Mechanics(Hertz(), 5.0)
    plain.begin(system.motion)
    force = system.force(0.0, position) - plain.force(0.0, position)
    expected, wall = wall_force(position, system.motion.radius, system.motion.young, shear)
    assert system.walls.radius == pytest.approx(wall, rel=1e-12)
    assert (wall > REST) == (shear is not None)
    np.testing.assert_allclose(force, expected, rtol=1e-8, atol=1e-9)


METHODS = ("auto", "cvode", "rosenbrock", "rkc2", "backward-euler", "dopri5")


def spread():
    """Return cells that are spread: so many press on the gel only then."""
    system, position = confined(30, rest=REST)
    system.walls.rest = REST
    return system, position * 1.25


@pytest.fixture(scope="module")
def settled():
    system, position = spread()
    young = system.motion.young
    return end_of(
        position, system.motion.radius, young, Hertz(), 50.0, rate=0.001,
        outer=lambda x, r: wall_force(x, r, young, SHEAR)[0],
    )  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
def test_methods_agree_with_scipy_on_a_right_hand_side_of_our_own(method, settled):
    system, position = spread()
    options = IntegratorOptions(method=method, rtol=1e-9, atol=1e-6, step=0.25)
    outcome = integrators.from_options(options).integrate(system, position)
    assert outcome.done, outcome.problem
    assert system.walls.radius > REST + 0.01
    bound = 0.01 if method == "backward-euler" else 1e-3
    np.testing.assert_allclose(outcome.position, settled, atol=bound)


# scenes


def scene(**parts):
    entries = {
        "duration": "2 d", "coupling_step": "30 min", "seed": 1, "initial": {"count": 10},
        "cells": {"division_radius": "5 um", "young": "1 kPa"},
        "growth": {"critical_pressure": "0.3 kPa"}, "contact": {"law": "hertz"},
        "drag": {"viscosity": "5 kPa s"}, "compression": {"bulk_modulus": "5 kPa"},
        "domain": {"shape": "sphere", "radius": "12 um"},
    }  # fmt: skip
    return mc.Scene.from_dict(entries | parts)


def row_at_end(described):
    simulation = Simulation(described, threads=1)
    while simulation.time < described.duration:
        simulation.step()
    return simulation.history_row()


@pytest.mark.slow
def test_cells_grow_until_wall_or_gel_stops_them():
    rigid = row_at_end(scene())
    assert rigid["volume_fraction"] < 1.1
    assert rigid["wall_pressure"] == pytest.approx(rigid["tissue_pressure"], rel=0.05)
    assert "domain_radius" not in rigid
    gel = {"shape": "sphere", "radius": "12 um", "stiffness": "1 kPa"}
    soft = row_at_end(scene(domain=gel))
    assert soft["domain_radius"] > 12.5
    assert soft["cells"] > rigid["cells"]
    assert soft["wall_pressure"] == pytest.approx(
        gel_pressure(soft["domain_radius"] / 12.0, 1.0 / 3.0), rel=1e-6
    )
    assert soft["wall_pressure"] == pytest.approx(soft["tissue_pressure"], rel=0.05)


def test_fields_pass_a_spherical_wall():
    medium = {"oxygen": {"boundary": "0.28 mM", "diffusion": "2000 um^2/s"}}
    plain = scene(nutrients=medium, duration="1 h")
    simulation = Simulation(plain, threads=1)
    simulation.step()
    assert plain.box is None
    assert np.isfinite(simulation.history_row()["wall_pressure"])


@pytest.mark.parametrize(
    ("domain", "path", "words"),
    [
        ({"shape": "sphere"}, "domain.radius", "missing"),
        ({"shape": "sphere", "radius": "3 um"}, "domain.radius", "at least 5"),
        ({"shape": "sphere", "radius": "30 um", "x": [-9, 9]}, "domain.x", "no meaning"),
        ({"shape": "sphere", "radius": "30 um", "stiffness": "0 kPa"}, "domain.stiffness", "above"),
        ({"shape": "ball", "radius": "30 um"}, "domain.shape", "sphere"),
        ({"radius": "30 um"}, "domain.radius", "no meaning"),
        ({"stiffness": "30 kPa"}, "domain.stiffness", "no meaning"),
    ],
)  # fmt: skip
def test_wrong_input_is_refused_by_name(domain, path, words):
    with refused(path, words):
        scene(domain=domain)


def test_a_gel_needs_space_and_its_jacobian_is_full():
    gel = {"shape": "sphere", "radius": "30 um", "stiffness": "1 kPa"}
    entries = scene(domain=gel).to_dict() | {"dimensions": 2}
    del entries["compression"]
    with refused("domain.stiffness", "2 dimensions"):
        mc.Scene.from_dict(entries)
    problem = mc.ode_problem(scene(domain=gel), step=0)
    with pytest.raises(mc.SceneError, match="full matrix"):
        problem.sparsity()


def test_who_starts_outside_is_refused():
    far = scene(domain={"shape": "sphere", "radius": "6 um"})
    with refused("domain.radius", "too small"):
        Simulation(far, threads=1)
