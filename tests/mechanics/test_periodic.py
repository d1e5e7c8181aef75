"""Space that repeats: forces, their derivatives and lists against copies side by side."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.law import compliance
from multicell.contact.springs import LinearSpring
from multicell.integrators import registry as integrators
from multicell.mechanics import neighbours
from multicell.mechanics.compression import TissueCompression
from multicell.mechanics.jacobian import sparse_jacobian, sparsity
from multicell.mechanics.motion import Motion, StateRejected
from multicell.mechanics.system import Mechanics
from multicell.mechanics.walls import Walls
from multicell.scene.parts import Domain, IntegratorOptions
from multicell.vectors import nearest_differences, wrapped

pytestmark = pytest.mark.kernels

ALL = np.array([31.0, 34.0, 37.0])
"""Lengths of the box, µm: at least two interaction ranges of the largest cells."""


def tissue(n=48, seed=1, period=ALL):
    """Return cells all over a box, some beyond it, that overlap a little: places, radii, moduli."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*[np.arange(k) / k for k in (4, 4, 3)]), axis=-1).reshape(-1, 3)
    place = (grid[:n] + rng.normal(0.0, 0.03, (n, 3))) * ALL
    turns = rng.integers(-2, 3, (n, 3)) * (period > 0.0)
    return place + turns * period, rng.uniform(4.0, 5.4, n), rng.uniform(0.6, 1.4, n)


def system_of(radius, young, law=None, *, rate=None, push=None, touching=None, duration=100.0,
              **options):  # fmt: skip
    n = len(radius)
    system = Mechanics(law or JKR(surface_energy=0.1), 5.0, **options)
    system.begin(Motion(
        radius, np.zeros(n) if rate is None else rate, young, np.full(n, 0.5), 0.0, duration,
        push=push, touching=touching,
    ))  # fmt: skip
    return system


def copies(place, period):
    """Return three copies along each axis that repeats; the original in the middle."""
    inside = wrapped(place, period)
    shifts = [(0, -1, 1) if length > 0.0 else (0,) for length in period]
    return np.concatenate([inside + np.array(s) * period for s in itertools.product(*shifts)])


def threefold(place, radius, young, period, law=None, **options):
    """Return mechanics of the copies in open space, and their places."""
    there = copies(place, period)
    count = len(there) // len(place)
    return system_of(np.tile(radius, count), np.tile(young, count), law, **options), there


SOME = [ALL, ALL * [1, 0, 1], ALL * [0, 0, 1]]
LAWS = {
    "jkr": JKR(surface_energy=0.1),
    "hertz": Hertz(),
    "linear": LinearSpring(cutoff=1.2),
    "exact-jkr": ExactJKR(),
}


@pytest.mark.parametrize("period", SOME)
@pytest.mark.parametrize("law", LAWS)
def test_forces_are_those_of_a_threefold_copy(law, period):
    place, radius, young = tissue(period=period)
    there, places = threefold(place, radius, young, period, LAWS[law])
    exact = there.force(0.0, places)[: len(place)]
    system = system_of(radius, young, LAWS[law], period=period)
    assert np.abs(exact).max() > 1.0
    np.testing.assert_allclose(system.force(0.0, place), exact, rtol=1e-10, atol=1e-11)
    pressure = there.pressure(0.0, places)[: len(place)]
    np.testing.assert_allclose(system.pressure(0.0, place), pressure, rtol=1e-9, atol=1e-11)
    # pairs of a copy with another one are pairs across a border
    far = there.contacts(0.0, places) % len(place)
    assert {tuple(sorted(pair)) for pair in far.tolist()} >= set(
        map(tuple, system.contacts(0.0, place).tolist())
    )
    near = {
        tuple(sorted(pair))
        for pair in there.contacts(0.0, places).tolist()
        if min(pair) < len(place)
    }
    assert len(system.contacts(0.0, place)) == len(
        {tuple(sorted((a % len(place), b % len(place)))) for a, b in near}
    )


def test_forces_add_up_to_zero_and_are_minus_the_slope_of_the_energy():
    place, radius, young = tissue()
    system = system_of(radius, young, period=ALL)
    force = system.force(0.0, place)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-10)
    for cell, axis in ((0, 0), (13, 1), (47, 2)):
        step = np.zeros_like(place)
        step[cell, axis] = 1e-5
        slope = (system.energy(0.0, place + step) - system.energy(0.0, place - step)) / 2e-5
        assert force[cell, axis] == pytest.approx(-slope, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("friction", [(0.0, 0.0), (0.1, 0.04)])
def test_velocities_and_products_with_the_jacobian(friction):
    place, radius, young = tissue()
    there, places = threefold(place, radius, young, ALL, Hertz())
    system = system_of(radius, young, Hertz(), period=ALL, friction=friction)
    vector = np.random.default_rng(4).normal(size=place.shape)
    out = np.empty_like(place)
    system.linearise(0.0, place)
    system.jacobian_product(vector, out)
    if max(friction) == 0.0:
        exact = np.empty_like(places)
        there.linearise(0.0, places)
        there.jacobian_product(np.tile(vector, (27, 1)), exact)
        np.testing.assert_allclose(out, exact[: len(place)], rtol=1e-10, atol=1e-13)
        matrix = sparse_jacobian(system)
        np.testing.assert_allclose(matrix @ vector.ravel(), out.ravel(), rtol=1e-10, atol=1e-13)
        assert ((abs(matrix) > 0) > (sparsity(place, system, 0.2) != 0)).nnz == 0
    else:
        # Γ v of the solution is the force
        system.velocity(0.0, place, out)
        np.testing.assert_allclose(system.resistance(out), system.force(0.0, place), atol=1e-4)
        np.testing.assert_allclose(system.resistance(np.ones_like(out)).sum(),
                                   3 * system.drag * radius.sum(), rtol=1e-12)  # fmt: skip


def test_compression_is_that_of_a_threefold_copy():
    place, radius, young = tissue()
    part = TissueCompression(10.0, 0.9)
    there, places = threefold(place, 1.2 * radius, young, ALL, Hertz(), compression=part)
    system = system_of(1.2 * radius, young, Hertz(), period=ALL, compression=part)
    np.testing.assert_allclose(
        system.force(0.0, place), there.force(0.0, places)[: len(place)], rtol=1e-9, atol=1e-9
    )


def test_walls_stand_on_the_other_axes():
    place, radius, young = tissue(period=ALL * [1, 1, 0])
    low, high = np.array([-np.inf, -np.inf, 0.0]), np.array([np.inf, np.inf, ALL[2]])
    sides = Walls(low, high, float(compliance(1.0, 0.5)))
    place[:, 2] = np.clip(place[:, 2], 2.0, ALL[2] - 2.0)
    there, places = threefold(place, radius, young, ALL * [1, 1, 0], walls=sides)
    system = system_of(radius, young, period=ALL * [1, 1, 0], walls=sides)
    exact = there.force(0.0, places)[: len(place)]
    np.testing.assert_allclose(system.force(0.0, place), exact, rtol=1e-10, atol=1e-11)
    assert ((place[:, 2] < radius) | (place[:, 2] > ALL[2] - radius)).any()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1, 7, 2048]))
def test_lists_hold_each_near_pair_once(seed, chunk):
    """Also of cells on a border, to the bit, and beyond it by whole periods and by rounding."""
    rng = np.random.default_rng(seed)
    period = ALL * (rng.random(3) < 0.7)
    period[rng.integers(3)] = 37.0
    n = int(rng.integers(2, 40))
    place = rng.uniform(-1.0, 2.0, (n, 3)) * ALL
    edge = rng.choice([0.0, 1.0, -1.0, np.nextafter(0.0, -1), 1.0 - 1e-16, 5.0], (n, 3)) * ALL
    place = np.where(rng.random((n, 3)) < 0.5, edge, place)
    reach = rng.uniform(1.0, 0.25 * period[period > 0.0].min(), n)
    found = neighbours.build_periodic(place, reach, period, chunk)
    first, second = np.triu_indices(n, 1)
    way = nearest_differences(place[first], place[second], period)
    near = np.linalg.norm(way, axis=1) <= reach[first] + reach[second]
    exact = np.stack([first, second], axis=1)[near]
    sure = np.abs(np.linalg.norm(way, axis=1) - reach[first] - reach[second]) > 1e-12
    unsure = {tuple(pair) for pair in np.stack([first, second], axis=1)[~sure].tolist()}
    got = [tuple(pair) for pair in found.pairs().tolist()]
    assert set(got) - unsure == {tuple(pair) for pair in exact.tolist()} - unsure
    assert len(found) == len(got)
    for c, (start, inner, end) in enumerate(
        zip(found.start, found.inner_end, found.outer_end, strict=True)
    ):
        assert (found.first[start:end] // chunk == c).all()
        assert (found.second[start:inner] // chunk == c).all()
        assert (found.second[inner:end] // chunk != c).all()


@st.composite
def border_places(draw, period, n=8):
    """Return places (n, 3): many on faces, next to them by rounding, and whole periods away."""

    def coordinate(axis):
        if not period[axis]:
            return draw(st.floats(0.0, float(ALL[axis])))
        length = float(period[axis])
        near = st.sampled_from([
            0.0, -0.0, np.nextafter(0.0, -1.0), np.nextafter(0.0, 1.0), 5e-17, -1e-13, 1e-13,
            length, np.nextafter(length, 0.0), np.nextafter(length, 100.0), length - 1e-13,
            0.5 * length, np.nextafter(0.5 * length, 0.0), np.nextafter(0.5 * length, length),
        ])  # fmt: skip
        place = draw(st.one_of(near, st.floats(0.0, length)))
        return place + length * draw(st.sampled_from([0, 0, 1, -1, 3]))

    return np.array([[coordinate(axis) for axis in range(3)] for _ in range(n)])


@settings(max_examples=60, deadline=None)
@given(st.data(), st.sampled_from(SOME))
def test_forces_on_cells_at_borders_are_those_of_a_threefold_copy(data, period):
    """On a face, a bit below or above it, and half a period from another cell."""
    place = data.draw(border_places(period))
    radius, young = np.linspace(4.0, 5.4, len(place)), np.linspace(0.6, 1.4, len(place))
    inside = wrapped(place, period)
    first, second = np.triu_indices(len(place), 1)
    apart = np.linalg.norm(nearest_differences(inside[first], inside[second], period), axis=1)
    # cells at one place have no direction of their force; a pair at its range is in contact or not
    assume((apart > 0.1).all())
    assume((np.abs(apart - radius[first] - radius[second]) > 1e-9).all())
    there, places = threefold(place, radius, young, period, Hertz())
    system = system_of(radius, young, Hertz(), period=period)
    force = system.force(0.0, place)
    exact = there.force(0.0, places)[: len(place)]
    np.testing.assert_allclose(force, exact, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-10)
    assert len(system.contacts(0.0, place)) == (apart < radius[first] + radius[second]).sum()
    pressure = there.pressure(0.0, places)[: len(place)]
    np.testing.assert_allclose(system.pressure(0.0, place), pressure, rtol=1e-9, atol=1e-12)


@settings(max_examples=200, deadline=None)
@given(st.data(), st.integers(-7000, 7000).map(lambda sevenths: sevenths / 7.0))
def test_images_lie_inside(data, low):
    """Half open: no image lies on the upper side, whatever rounding does, and none moves."""
    domain = Domain(x=(low, low + 31.0), y=(low, low + 34.0), z=(-3.0, 4.0), periodic=("x", "y"))
    place = data.draw(border_places(domain.period)) + np.array([low, low, 0.0])
    inside = domain.inside(place)
    assert (inside[:, :2] >= low).all()
    assert (inside[:, 0] <= low + 31.0).all()
    assert (inside[:, 1] <= low + 34.0).all()
    np.testing.assert_array_equal(inside[:, 2], place[:, 2])
    turns = (place - inside)[:, :2] / [31.0, 34.0]
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-11)


METHODS = [
    "auto",
    "euler",
    "rk4-adaptive",
    "rkc2",
    "cvode",
    "rosenbrock",
    "backward-euler",
    "ab2-adaptive",
]


@pytest.mark.parametrize("method", METHODS)
def test_methods_carry_cells_as_those_in_a_threefold_copy(method):
    place, radius, young = tissue(n=24)
    system = system_of(radius, young, Hertz(), period=ALL, duration=30.0)
    there, places = threefold(place, radius, young, ALL, Hertz(), duration=30.0)
    solve = integrators.from_options(IntegratorOptions(method=method, atol=1e-5, step=0.5))
    reference = integrators.from_options(IntegratorOptions(method="rk4-adaptive", atol=1e-7))
    moved = solve.integrate(system, place)
    exact = reference.integrate(there, places)
    assert moved.done, moved.problem
    way = exact.position[: len(place)] - places[: len(place)]
    assert np.abs(way).max() > 0.1
    tolerance = 0.03 if method in ("euler", "backward-euler") else 2e-3
    np.testing.assert_allclose(moved.position - place, way, atol=tolerance)


def test_places_are_the_same_after_whole_periods():
    place, radius, young = tissue()
    system = system_of(radius, young, period=ALL)
    force = system.force(0.0, place)
    for turns in ([1, 0, 0], [-3, 2, 50]):
        np.testing.assert_allclose(system.force(0.0, place + turns * ALL), force, atol=1e-9)


def test_a_regular_lattice_feels_no_force():
    """Madelung's sum of contacts: six neighbours at one distance, energy 3 U a cell."""
    count, length = 4, 8.5
    grid = np.stack(np.meshgrid(*3 * [np.arange(count)]), axis=-1).reshape(-1, 3) * length
    n, law = len(grid), JKR(surface_energy=0.1)
    system = system_of(np.full(n, 4.5), np.ones(n), law, period=np.full(3, count * length))
    np.testing.assert_allclose(system.force(0.0, grid), 0.0, atol=1e-12)
    modulus = 1.0 / (2 * float(compliance(1.0, 0.5)))
    energy, force = (float(f(0.5, modulus, 2.25)) for f in (law.energy, law.force))
    assert system.energy(0.0, grid) == pytest.approx(3 * n * energy, rel=1e-12)
    pressure = 3 * force * length / (3 * 4 / 3 * np.pi * 4.5**3)
    np.testing.assert_allclose(system.pressure(0.0, grid), pressure, rtol=1e-10)


def rk4(system, place, gamma, h):
    """Return places after a time, s, by one classical step of Runge and Kutta."""
    speed = [system.force(0.0, place) / gamma]
    for part in (0.5, 0.5, 1.0):
        speed.append(system.force(0.0, place + part * h * speed[-1]) / gamma)
    return place + h / 6.0 * (speed[0] + 2.0 * speed[1] + 2.0 * speed[2] + speed[3])


def test_a_lattice_loses_its_energy_to_drag_and_keeps_its_place():
    """Σ γ v = 0 at all times, and the energy falls by ∫ Σ γ v² dt."""
    count, length = 4, 7.6
    grid = np.stack(np.meshgrid(*3 * [np.arange(count)]), axis=-1).reshape(-1, 3) * length
    place = grid + np.random.default_rng(2).normal(0.0, 0.4, grid.shape)
    radius, young = np.linspace(4.2, 4.8, len(grid)), np.ones(len(grid))
    system = system_of(radius, young, Hertz(), period=np.full(3, count * length), duration=1e4)
    gamma, spent, begin = system.drag * radius[:, None], 0.0, system.energy(0.0, place)
    h = 0.5
    for _ in range(40):
        places = [place, rk4(system, place, gamma, 0.5 * h), rk4(system, place, gamma, h)]
        forces = [system.force(0.0, at) for at in places]
        for force in forces:
            np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-10)
        power = [(force**2 / gamma).sum() for force in forces]
        spent += h / 6.0 * (power[0] + 4.0 * power[1] + power[2])
        place = places[-1]
    lost = begin - system.energy(0.0, place)
    assert lost > 0.05 * begin
    assert spent == pytest.approx(lost, rel=1e-5)


@pytest.mark.slow
def test_threads_give_the_same_bits():
    place, radius, young = tissue()
    found = []
    for threads in (1, 2, 16):
        system = system_of(radius, young, period=ALL, threads=threads, chunk=7, shared_chunks=2)
        found.append((system.force(0.0, place).tobytes(), system.energy(0.0, place)))
    assert found[0] == found[1] == found[2]


def test_cells_too_large_for_the_period_are_refused():
    radius = np.full(3, 10.0)
    system = system_of(radius, np.ones(3), period=np.array([31.0, 0.0, 0.0]))
    with pytest.raises(StateRejected, match="quarter of the domain's shortest period"):
        system.force(0.0, np.arange(9.0).reshape(3, 3))
