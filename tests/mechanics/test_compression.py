"""Resistance to compression against closed forms, differences, and an energy written down anew."""

import numpy as np
import pytest
from formulas import dense_jacobian, product_of, slope, velocity_of
from running import refused
from scipy.integrate import solve_ivp
from strategies import ONE_OF_A_KIND, cluster

import multicell as mc
from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.law import compliance
from multicell.integrators import registry as integrators
from multicell.mechanics.compression import CLOSE_PACKED, TissueCompression
from multicell.mechanics.jacobian import limited, sparse_jacobian
from multicell.mechanics.motion import Motion
from multicell.mechanics.preconditioners import Sweeps
from multicell.mechanics.system import Mechanics
from multicell.mechanics.walls import Walls
from multicell.scene.parts import IntegratorOptions
from multicell.simulation import Simulation

pytestmark = pytest.mark.kernels

HALF, WIDE = 14.0, 15.0
FELT = TissueCompression(10.0)


def walls(half=HALF):
    return Walls(np.full(3, -half), np.full(3, half), float(compliance(1.0, 0.5)))


def dense(n=40, seed=3, *, spacing=0.8, variation=0.2, law=None, half=None, felt=FELT, **more):
    """Return cells of unlike radii, pressed together until most resist, and their places."""
    position, radius, young = cluster(n, seed, spacing=spacing, variation=variation)
    sides = None
    if half is not None:
        position, sides = np.clip(position, 1.0 - half, half - 1.0), walls(half)
    system = Mechanics(law or Hertz(), 5.0, walls=sides, compression=felt, **more)
    system.begin(Motion(radius, np.full(n, 0.001), young, np.full(n, 0.5), 0.0, 50.0))
    return system, position


def energy_of(position, radius, *, modulus=10.0, onset=1.0, half=None):
    """Return Σ V f(s) by the words of the page, over all pairs."""
    n, volume = len(radius), 4.0 / 3.0 * np.pi * radius**3
    i, j = np.triu_indices(n, 1)
    h = radius[i] + radius[j] - np.linalg.norm(position[j] - position[i], axis=1)
    lens = np.pi * radius[i] * radius[j] / (radius[i] + radius[j]) * np.maximum(h, 0.0) ** 2
    taken = 0.5 * (np.bincount(i, lens, n) + np.bincount(j, lens, n))
    if half is not None:
        for gap in (position + half, half - position):
            h = np.maximum(radius[:, None] - gap, 0.0)
            taken += np.pi * radius * (h**2).sum(axis=1)
    y = 1.0 - (np.pi / np.sqrt(18.0) / onset) ** (1 / 3)
    steepness = modulus / (onset**3 * (6.0 * y * (1.0 - y) / onset) ** 2)
    x, blend = np.maximum(taken / volume - 9.0 * y**2, 0.0), 0.02
    rounded = np.where(
        x < blend,
        x**3 / (6 * blend),
        blend**2 / 6 + 0.5 * (x**2 - blend**2) - 0.5 * blend * (x - blend),
    )
    return float((volume * steepness * rounded).sum())


CASES = {
    "free": {},
    "walls": {"half": HALF},
    "jkr": {"law": JKR(surface_energy=0.1)},
    "chunks": {"half": HALF, "chunk": 16},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("time", [0.0, 30.0])
def test_forces_are_the_gradient_of_an_energy_written_down_anew(case, time):
    system, position = dense(**CASES[case])
    plain, _ = dense(**CASES[case], felt=None)
    radius = system.motion.radius + 0.001 * time
    known = {"half": CASES[case].get("half")}
    exact = energy_of(position, radius, **known)
    assert exact > 10.0
    found = system.energy(time, position) - plain.energy(time, position)
    assert found == pytest.approx(exact, rel=1e-9)
    force = system.force(time, position) - plain.force(time, position)
    for direction in np.random.default_rng(0).normal(size=(6, *position.shape)):
        change = slope(lambda x: energy_of(x, radius, **known), position, direction, 1e-5)
        assert -(force * direction).sum() == pytest.approx(change, rel=1e-6)
    if case in ("free", "jkr"):
        np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-10)


@pytest.mark.parametrize("case", CASES)
def test_the_jacobian_is_the_derivative_in_all_its_forms(case):
    system, position = dense(n=25, **CASES[case])
    exact = dense_jacobian(system, position)
    system.linearise(0.0, position)
    matrix = sparse_jacobian(system).toarray()
    np.testing.assert_allclose(matrix, exact, atol=2e-7 * np.abs(exact).max())
    v = np.random.default_rng(1).normal(size=position.shape)
    np.testing.assert_allclose(product_of(system, v).ravel(), matrix @ v.ravel(), atol=1e-12)
    # cells move those that they do not touch
    plain, _ = dense(n=25, **CASES[case], felt=None)
    plain.linearise(0.0, position)
    assert np.count_nonzero(matrix) > 1.5 * np.count_nonzero(sparse_jacobian(plain).toarray())
    weighed = system.rows[:, 3].repeat(3)[:, None] * matrix
    np.testing.assert_allclose(weighed, weighed.T, atol=1e-12 * np.abs(weighed).max())
    bound = system.stiffness_bound(0.0, position)
    assert -np.linalg.eigvals(matrix).real.min() <= bound


@pytest.mark.slow
@pytest.mark.parametrize("sweeps", [True, False])
def test_preconditioners_are_definite_and_shorten_the_way(sweeps):
    from scipy.sparse.linalg import LinearOperator, gmres

    system, position = dense(n=200, spacing=0.88, variation=0.05)
    system.linearise(0.0, position)
    linear, _ = limited(system, 0.5)
    gamma, size = 30.0, 3 * len(system)
    inverse = Sweeps(system) if sweeps else system
    inverse.setup_preconditioner(gamma, linear)

    def solve(b):
        out = np.empty_like(position)
        inverse.precondition(np.ascontiguousarray(b.reshape(-1, 3)), out)
        return out.ravel()

    def apply(x):
        return x - gamma * product_of(system, np.ascontiguousarray(x.reshape(-1, 3))).ravel()

    weight = system.rows[:, 3].repeat(3)
    for b in np.random.default_rng(2).normal(size=(5, size)):
        assert (weight * b * solve(b)).sum() > 0.0
    steps = []
    for help_ in (solve, lambda b: b):
        count = []
        gmres(
            LinearOperator((size, size), apply), b, rtol=1e-6, restart=200, maxiter=1,
            M=LinearOperator((size, size), help_), callback=count.append, callback_type="pr_norm",
        )  # fmt: skip
        steps.append(len(count))
    assert steps[0] < 0.95 * steps[1]


@pytest.mark.slow
def test_any_number_of_threads_gives_the_same_bits():
    found = []
    for threads in (1, 2):
        system, position = dense(n=300, half=24.0, threads=threads, chunk=32, shared_chunks=2)
        v = np.random.default_rng(1).normal(size=position.shape)
        force, pressure = system.force(10.0, position), system.pressure(10.0, position)
        system.linearise(10.0, position)
        found.append(np.concatenate([force, product_of(system, v), pressure[:, None]], axis=1))
    np.testing.assert_array_equal(found[0], found[1])


def test_below_the_threshold_all_bits_are_those_without_it():
    position, radius, young = cluster(60, 1, spacing=0.95)
    out = []
    for felt in (FELT, None):
        system = Mechanics(Hertz(), 5.0, compression=felt)
        system.begin(Motion(radius, 0 * radius, young, 0 * radius + 0.5, 0.0, 1.0))
        system.linearise(0.0, position)
        v = np.random.default_rng(1).normal(size=position.shape)
        out.append([system.force(0.0, position), product_of(system, v)])
    assert np.abs(out[0][0]).max() > 0.1
    np.testing.assert_array_equal(out[0], out[1])


# a lattice


def lattice(fraction, kind):
    """Return places of a ball of a lattice of cells of radius 5 µm, the middle one first."""
    n = np.stack(np.meshgrid(*[np.arange(-4, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    if kind == "fcc":
        n = n[n.sum(axis=1) % 2 == 0]
    per_volume = {"fcc": 0.5, "sc": 1.0}[kind]
    edge = (per_volume * 4.0 / 3.0 * np.pi * 125.0 / fraction) ** (1 / 3)
    return edge * n[np.argsort((n**2).sum(axis=1), kind="stable")]


def lattice_pressure(fraction, kind, felt):
    """Return the pressure of the tissue in the middle of a lattice, kPa."""
    position = lattice(fraction, kind)
    n = len(position)
    system = Mechanics(Hertz(), 5.0, compression=felt)
    system.begin(
        Motion(np.full(n, 5.0), np.zeros(n), np.ones(n), np.full(n, 0.5), 0.0, 1.0)
    )  # fmt: skip
    return fraction * system.pressure(0.0, position)[0]


@pytest.mark.parametrize("kind", ["fcc", "sc"])
@pytest.mark.parametrize("fraction", [0.8, 1.01, 1.1, 1.3])
def test_the_pressure_of_a_lattice_is_the_derivative_of_its_energy_by_volume(kind, fraction):
    """P = -dU/dV of one cell, by a sum over neighbours that the package has no part in."""
    vectors = lattice(1.0, kind)[1:]

    def energy(volume):
        d = np.linalg.norm(vectors, axis=1) * (volume / (4 / 3 * np.pi * 125.0)) ** (1 / 3)
        h = np.maximum(10.0 - d, 0.0)
        hertz = 0.5 * (0.4 * (1 / 1.5 / 0.75) * np.sqrt(2.5) * h**2.5).sum() * 0.75 / 0.75
        s = (0.5 * np.pi * 2.5 * h**2).sum() / (4 / 3 * np.pi * 125.0)
        threshold = 9 * (1 - CLOSE_PACKED ** (1 / 3)) ** 2
        x = max(s - threshold, 0.0)
        low = min(x, 0.02)
        y = 1 - CLOSE_PACKED ** (1 / 3)
        steep = 10.0 / (6 * y * (1 - y)) ** 2
        felt = steep * (low**3 / 0.12 + (x - low) * 0.01 + 0.5 * (x - low) ** 2)
        return hertz + 4 / 3 * np.pi * 125.0 * felt

    volume = 4 / 3 * np.pi * 125.0 / fraction
    expected = -(energy(volume * (1 + 1e-6)) - energy(volume * (1 - 1e-6))) / (2e-6 * volume)
    assert lattice_pressure(fraction, kind, FELT) == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("onset", [0.9, 1.0, 1.2])
def test_the_bulk_modulus_of_the_closest_packing_is_the_one_asked_for(onset):
    """B = φ dP/dφ; the part that resistance adds, beyond the rounded threshold."""
    felt = TissueCompression(7.0, onset)

    def extra(fraction):
        return lattice_pressure(fraction, "fcc", felt) - lattice_pressure(fraction, "fcc", None)

    assert extra(0.999 * onset) == 0.0
    at = onset * 1.08
    measured = at * (extra(at * (1 + 1e-5)) - extra(at * (1 - 1e-5))) / (2e-5 * at)

    # closed form: P = φ² f' s', with s = 9 y², s' = 6 y (1 - y)/φ, and f'' = C
    def steepness(fraction):
        y = 1.0 - (CLOSE_PACKED / fraction) ** (1 / 3)
        return y, 6.0 * y * (1.0 - y) / fraction

    y, rise = steepness(at)
    y0, rise0 = steepness(onset)
    scale = 7.0 / (onset**3 * rise0**2)
    excess = 9.0 * y**2 - 9.0 * y0**2 - 0.01
    bend = (2.0 * (1.0 - y) * (1.0 - 2.0 * y) - 6.0 * y * (1.0 - y)) / at**2
    expected = scale * (at**3 * rise**2 + excess * (2.0 * at**2 * rise + at**3 * bend))
    assert measured == pytest.approx(expected, rel=1e-5)
    # right above a sharp threshold the form is the modulus itself
    assert scale * onset**3 * rise0**2 == pytest.approx(7.0)


# integration


def mild():
    return dense(n=30, spacing=0.86, variation=0.05, half=WIDE)


@pytest.fixture(scope="module")
def settled():
    """SciPy's end of a motion whose forces are those of the energy."""
    system, position = mild()

    def velocity(t, y):
        return velocity_of(system, t)(y.reshape(-1, 3)).ravel()

    found = solve_ivp(velocity, (0.0, 50.0), position.ravel(), "DOP853", rtol=1e-10, atol=1e-10)
    return found.y[:, -1].reshape(-1, 3)


@pytest.mark.parametrize("method", ONE_OF_A_KIND)
def test_methods_agree_with_scipy(method, settled):
    system, position = mild()
    first = method in ("euler-adaptive", "multirate-euler")
    step = 0.25 if method == "backward-euler" else 0.05
    options = IntegratorOptions(method=method, rtol=1e-9, atol=1e-3 if first else 1e-5, step=step)
    outcome = integrators.from_options(options).integrate(system, position)
    assert outcome.done, outcome.problem
    bound = 0.02 if first or method in ("euler", "backward-euler") else 1e-3
    np.testing.assert_allclose(outcome.position, settled, atol=bound)


# scenes


def growing(**parts):
    entries = {
        "duration": "4 d", "coupling_step": "20 min", "seed": 1, "initial": {"count": 8},
        "cells": {"division_radius": "5 um", "young": "1 kPa"},
        "growth": {"critical_pressure": "0.1 kPa"}, "contact": {"law": "hertz"},
        "drag": {"viscosity": "0.5 kPa s"},
        "domain": {axis: ["-14 um", "14 um"] for axis in "xyz"},
    }  # fmt: skip
    return mc.Scene.from_dict(entries | parts)


def end(scene):
    simulation = Simulation(scene, threads=1)
    while simulation.time < scene.duration:
        simulation.step()
    return simulation


@pytest.mark.slow
def test_cells_that_grow_in_a_box_fill_it_and_no_more():
    """At a critical pressure of 0.1 kPa; wall and virial pressure agree."""
    row = end(growing(compression={})).history_row()
    assert 0.85 < row["volume_fraction"] < 1.1
    assert row["pressure_factor"] < 0.02
    assert row["wall_pressure"] == pytest.approx(row["tissue_pressure"], rel=0.01)
    assert row["wall_pressure"] > 0.08
    without = end(growing()).history_row()
    assert without["volume_fraction"] > 1.5


def test_wrong_input_is_refused_by_name():
    with refused("compression.onset", "0.85"):
        growing(compression={"onset": 0.74})
    flat = growing().to_dict() | {"compression": {}, "dimensions": 2}
    del flat["domain"]
    with refused("compression", "2 dimensions"):
        mc.Scene.from_dict(flat)
