"""Fields in space that repeats: the operator against sines, cells near borders against copies."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pde import CartesianGrid, ScalarField
from plain_pde import uncompiled

from multicell.nutrient import stencil
from multicell.nutrient.cartesian import Box
from multicell.nutrient.dense import halves
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.grid import BoxLayout
from multicell.nutrient.operators import linearised

H, D = 5.0, 40.0
WALL = {"derivative": 0.0}
SIDES = {face: {"value": 0.3} for face in ("x-", "x+", "y-", "y+", "z-", "z+")}
CASES = [(True, True, True), (True, False, False), (False, True, True), (False, False, True)]


def layout_of(repeats, shape=(8, 6, 7), origin=(-3.0, 4.0, 10.0), height=None):
    return BoxLayout(Box(origin, shape, H, height, repeats))


def random(shape, seed=0):
    return np.random.default_rng(seed).uniform(0.5, 2.0, shape)


def laplacian(repeats, c, varied=None):
    """Return minus the flow between neighbours, node by node, zero on other faces."""
    out, v = np.zeros_like(c), np.ones_like(c) if varied is None else varied
    for axis in range(3):
        n = c.shape[axis]
        for k in range(n):
            a = np.take(c, k, axis)
            for step in (-1, 1):
                m = k + step
                if 0 <= m < n or repeats[axis]:
                    b, u = (np.take(x, m % n, axis) for x in (c, v))
                    own = np.take(v, k, axis)
                    part = 2 * own * u / (own + u) * (a - b)
                else:
                    part = 2.0 * np.take(v, k, axis) * a
                np.moveaxis(out, axis, 0)[k] += part
    return D / H**2 * out


@pytest.mark.parametrize("varied", [False, True])
@pytest.mark.parametrize("repeats", CASES)
def test_the_operator_takes_neighbours_at_the_other_end(repeats, varied):
    layout = layout_of(repeats)
    v = random(layout.shape, 3) if varied else None
    operator = Diffusion(layout.box, D, SIDES, varied=v)
    c = random(layout.shape, 1)
    found = linearised(operator, c, np.zeros_like(c))
    np.testing.assert_allclose(found, laplacian(repeats, c, v), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("shape", [(8, 6, 7), (60, 5, 9), (1, 2, 3)])
@pytest.mark.parametrize("repeats", CASES)
def test_the_inverse_is_that_of_the_operator(repeats, shape):
    """By matrices up to 48 nodes, in single precision, and by fast transforms beyond."""
    operator = Diffusion(layout_of(repeats, shape).box, D, SIDES)
    y = random(shape, 2)
    u, product = operator.invert(y.copy(), 0.02)
    np.testing.assert_allclose(linearised(operator, u, np.full(shape, 0.02)), y, rtol=1e-10)
    assert product == pytest.approx((u * y).sum(), rel=1e-10)
    single, product = operator.invert(y.astype(np.float32), 0.02)
    np.testing.assert_allclose(single, u, rtol=2e-4)
    assert product == pytest.approx((u * y).sum(), rel=1e-4)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 9, 16])
def test_the_transform_of_a_circle_is_orthogonal(n):
    parts, of = halves(n, None)
    even, odd = parts[0], parts[1][: n // 2, : n // 2]
    # a row of the middle of an odd number is met once, all others twice
    weight = np.where(2 * np.arange(len(even)) == n - 1, 1.0, 2.0)
    np.testing.assert_allclose(even * weight @ even.T, np.eye(len(even)), atol=1e-6)
    np.testing.assert_allclose(2 * odd @ odd.T, np.eye(n // 2), atol=1e-6)
    circle = 2 * np.eye(n) - np.roll(np.eye(n), 1, 0) - np.roll(np.eye(n), -1, 0)
    np.testing.assert_allclose(np.sort(of), np.linalg.eigvalsh(circle), atol=1e-12)


@pytest.mark.parametrize("repeats", [(True, True, True), (False, True, True)])
def test_sines_decay_at_their_rate(repeats):
    """Eigenfunctions: -D ∇² sin(2πy/L) = D (4 / h²) sin²(π h / L) sin."""
    layout = layout_of(repeats, (4, 12, 9))
    y = layout.box.axes()[1]
    length = 12 * H
    wave = np.broadcast_to(np.sin(2 * np.pi * (y - 1.7) / length)[None, :, None], layout.shape)
    sides = {**SIDES, "x-": WALL, "x+": WALL}
    operator = Diffusion(layout.box, D, sides)
    rate = 4 * D / H**2 * np.sin(np.pi * H / length) ** 2
    found = linearised(operator, np.ascontiguousarray(wave), np.zeros(layout.shape))
    np.testing.assert_allclose(found, rate * wave, atol=1e-12)
    assert rate == pytest.approx(D * (2 * np.pi / length) ** 2, rel=0.025)


def test_nothing_flows_over_sides_that_are_none():
    layout = layout_of((True, True, False))
    operator = Diffusion(layout.box, D, {**SIDES, "z-": WALL})
    c = random(layout.shape)
    inward, outward = operator.flows(c)
    step = 2.0 * (0.3 - c[:, :, -1]) * operator.stiffness * operator.volumes
    assert inward == pytest.approx(np.maximum(step, 0).sum(), rel=1e-12)
    assert outward == pytest.approx(np.maximum(-step, 0).sum(), rel=1e-12)


@pytest.mark.parametrize("size", [0.0, 4.0, 13.0, 30.0])
@pytest.mark.parametrize("repeats", CASES)
def test_cells_read_and_spread_over_the_border(repeats, size):
    """Reading is the transpose of spreading, and is that of three copies of the field."""
    layout, rng = layout_of(repeats), np.random.default_rng(5)
    low, length = np.array(layout.box.origin), H * np.array(layout.shape)
    place = low + length * rng.uniform(0, 1, (30, 3))
    place[:6] = low
    place[6:12] = low + length - 1e-9
    values, radius = random(layout.shape), np.full(30, size)
    conditions = dict.fromkeys(SIDES, WALL)
    found = layout.read(place, values, conditions, radius)
    assert values.min() - 1e-12 <= found.min() <= found.max() <= values.max() + 1e-12
    np.testing.assert_allclose(
        layout.read(place + length * np.array(repeats) * [3, -2, 1], values, conditions, radius),
        found, rtol=1e-10,
    )  # fmt: skip
    amount = rng.uniform(0, 1, 30)
    density = layout.scatter(place, amount, radius)
    assert density.sum() * layout.volumes == pytest.approx(amount.sum(), rel=1e-12)
    gathered = layout.gather(place, values, radius)
    assert (density * values).sum() * layout.volumes == pytest.approx(amount @ gathered, rel=1e-12)
    if all(repeats):
        wide = BoxLayout(Box(tuple(low - 3 * length), tuple(7 * n for n in layout.shape), H))
        exact = wide.read(place, np.tile(values, (7, 7, 7)), conditions, radius)
        np.testing.assert_allclose(found, exact, rtol=1e-11)
        slopes = wide.gradient(place, np.tile(values, (7, 7, 7)))
        np.testing.assert_allclose(layout.gradient(place, values), slopes, atol=1e-12)


@settings(max_examples=100, deadline=None)
@given(st.data(), st.sampled_from(CASES), st.sampled_from([0.0, 1e-9, 2.5, 13.0]))
def test_cells_on_borders_read_what_they_feed(data, repeats, size):
    """On a face, next to it by rounding, and whole periods away: amounts are kept to rounding."""
    layout = layout_of(repeats)
    low, length = np.array(layout.box.origin), H * np.array(layout.shape)

    def coordinate(axis):
        begin, end = low[axis], low[axis] + length[axis]
        near = [begin, np.nextafter(begin, end), end, np.nextafter(end, begin), begin + 0.5 * H]
        if repeats[axis]:
            near += [
                np.nextafter(begin, -99.0),
                np.nextafter(end, 99.0),
                begin - 1e-13,
                end + 1e-13,
                begin - 0.5 * H,
                end + 7.0 * length[axis],
            ]
        return data.draw(st.sampled_from(near))

    place = np.array([[coordinate(axis) for axis in range(3)] for _ in range(6)])
    radius, values = np.full(6, size), random(layout.shape)
    amount = np.arange(1.0, 7.0)
    density = layout.scatter(place, amount, radius)
    assert density.min() >= 0.0
    assert density.sum() * layout.volumes == pytest.approx(amount.sum(), rel=1e-12)
    gathered = layout.gather(place, values, radius)
    assert (density * values).sum() * layout.volumes == pytest.approx(amount @ gathered, rel=1e-12)
    conditions = dict.fromkeys(SIDES, WALL)
    found = layout.read(place, values, conditions, radius)
    assert values.min() - 1e-12 <= found.min() <= found.max() <= values.max() + 1e-12
    # a cell a bit beyond a face reads what one on it does
    inside = np.clip(place, low, low + length)
    near = (np.abs(inside - place) < 1e-9).all(axis=1)
    same = layout.read(inside, values, conditions, radius)
    np.testing.assert_allclose(found[near], same[near], rtol=1e-10)


def test_a_steady_field_on_many_nodes_is_found_by_transforms():
    """One mode of secretion: c = s / (m + rate), on more nodes than multigrid begins with."""
    layout = layout_of((True, True, True), (60, 40, 36))
    x = layout.box.axes()[0]
    wave = np.sin(2 * np.pi * x / (60 * H))[:, None, None] * np.ones(layout.shape)
    supply, decay = 0.01 * (1.0 + 0.5 * wave), 0.05
    operator = Diffusion(layout.box, D, SIDES)
    c, report = operator.solve(
        np.zeros(layout.shape), 1.0, np.full(layout.shape, 0.1), linear=decay, supply=supply
    )
    rate = 4 * D / H**2 * np.sin(np.pi / 60) ** 2
    exact = 0.01 / decay + 0.005 * wave / (decay + rate)
    np.testing.assert_allclose(c, exact, rtol=1e-6)
    assert report.inflow == 0.0


def test_py_pde_takes_the_same_neighbours():
    grid = CartesianGrid([[0, 40], [0, 30]], [8, 6], periodic=[True, False])
    layout = layout_of((True, False, False), (8, 6, 1), (0.0, 0.0, -2.5), H)
    c = random((8, 6))
    operator = Diffusion(layout.box, D, {"x-": WALL, "x+": WALL, "y-": WALL, "y+": WALL})
    found = linearised(operator, c[:, :, None].copy(), np.zeros((8, 6, 1)))[:, :, 0]
    with uncompiled():
        exact = -D * ScalarField(grid, c).laplace({"x": "periodic", "y": {"derivative": 0}}).data
    np.testing.assert_allclose(found, exact, rtol=1e-11, atol=1e-12)


def test_nodes_below_zero_take_their_balance_from_the_other_end():
    layout = layout_of((True, False, False), (3, 1, 1))
    operator = Diffusion(layout.box, D, dict.fromkeys(SIDES, WALL))
    c = np.array([-0.1, 0.2, 0.4]).reshape(3, 1, 1)
    left = stencil.balance_negative(
        c, np.zeros((3, 1, 1)), np.zeros((3, 1, 1)), 1.0, operator.stiffness, 0.0,
        operator.ghost, None, None, 0.0, 0.0, 10,
    )  # fmt: skip
    assert left == 0
    assert c[0, 0, 0] == pytest.approx(0.3)
