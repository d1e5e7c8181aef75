"""Small grids: transforms as matrices against SciPy."""

import math

import numpy as np
import pytest
from numba import njit
from scipy import fft
from scipy.fft import next_fast_len
from scipy.sparse import csr_array
from scipy.sparse.linalg import spsolve

from multicell.nutrient import dense, stencil
from multicell.nutrient.cartesian import Box, _fast
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.steady import solve_steady

D = 1000.0


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 3, 1), (5, 4, 7), (9, 9, 9), (48, 3, 11)])
@pytest.mark.parametrize("values", [(True, True, True), (False, False, False), (True, False, True)])
def test_the_inverse_is_that_of_scipy(shape, values):
    rng = np.random.default_rng(1)
    y = rng.normal(size=shape).astype(np.float32)
    u, room = y.copy(), np.empty((2, y.size), np.float32)
    halves, of = zip(*(dense.halves(n, v) for n, v in zip(shape, values, strict=True)), strict=True)
    product = dense._invert(u, 0.2, 0.7, room, *halves, *of)
    spectrum = y.astype(float)
    for axis, v in enumerate(values):
        spectrum = (fft.dst if v else fft.dct)(spectrum, type=2, axis=axis, norm="ortho")
    ax, ay, az = (dense.eigenvalues(n, (v, v)) for n, v in zip(shape, values, strict=True))
    spectrum /= 0.7 * (ax[:, None, None] + ay[:, None] + az) + 0.2
    for axis, v in enumerate(values):
        spectrum = (fft.idst if v else fft.idct)(spectrum, type=2, axis=axis, norm="ortho")
    np.testing.assert_allclose(u, spectrum, rtol=0, atol=3e-6 * np.abs(spectrum).max())
    assert product == pytest.approx(float(np.sum(y * spectrum)), rel=1e-5)


@pytest.mark.parametrize("half", [1e-3, 0.05])
def test_a_steady_field_of_few_nodes_is_that_of_a_direct_solver(half):
    """Against Newton's method with SciPy's sparse factors, and matrices made entry by entry."""
    n, h, level = 9, 10.0, 0.07
    operator = Diffusion(Box((0.0, 0.0, 0.0), (n, n, n), h), D, level)
    rng = np.random.default_rng(5)
    sink = np.where(rng.random((n, n, n)) < 0.3, 0.05 * rng.random((n, n, n)), 0.0)
    c, report = solve_steady(operator, sink, half, np.full((n, n, n), level))
    line = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    line[0, 0] = line[-1, -1] = 3.0
    one = np.eye(n)
    matrix = sum(
        np.kron(np.kron(a, b), d)
        for a, b, d in ((line, one, one), (one, line, one), (one, one, line))
    ) * (D / h**2)  # fmt: skip
    at_ends = np.zeros(n)
    at_ends[[0, -1]] = 2.0 * level * D / h**2
    source = (at_ends[:, None, None] + at_ends[:, None] + at_ends).ravel()
    exact, most = np.full(n**3, level), sink.ravel()
    for _ in range(30):
        left = source - matrix @ exact - most * exact / (half + exact)
        slope = np.diag(most * half / (half + exact) ** 2)
        step = spsolve(csr_array(matrix + slope), left)
        exact = np.maximum(exact + step, 1e-3 * exact)
        if np.abs(step).max() < 1e-15:
            break
    np.testing.assert_allclose(c.ravel(), exact, rtol=0, atol=1e-9 * level)
    taken = float((most * exact / (half + exact)).sum()) * h**3
    assert report.uptake == pytest.approx(taken, rel=1e-8)
    assert report.inflow == pytest.approx(taken, rel=1e-8)
    assert report.residual < 2e-9 * taken


def test_a_single_node_meets_the_root_of_its_balance():
    """12 D/h² (c₀ - c) = q c / (K + c), for rates, sizes and levels over orders of magnitude."""
    rng, shape = np.random.default_rng(0), (1, 1, 1)
    for _ in range(3000):
        h, level = 10.0 ** rng.uniform(0.0, 2.0), 10.0 ** rng.uniform(-4.0, 1.0)
        operator = Diffusion(Box((0.0, 0.0, 0.0), shape, h), 10.0 ** rng.uniform(1.0, 4.0), level)
        half, quick = level * 10.0 ** rng.uniform(-4.0, 2.0), 12.0 * operator.stiffness
        most = operator.stiffness * level * 10.0 ** rng.uniform(-6.0, 4.0)
        start = np.full(shape, level * rng.choice([0.0, 1.0, 10.0, rng.random()]))
        c, _ = solve_steady(operator, np.full(shape, most), half, start)
        b, q = quick * (half - level) + most, quick * level * half
        root = math.sqrt(b * b + 4.0 * quick * q)
        exact = 2.0 * q / (b + root) if b > 0.0 else (root - b) / (2.0 * quick)
        assert c.item() == pytest.approx(exact, rel=1e-6, abs=1e-12 * level)


@pytest.mark.parametrize("varied", [False, True])
def test_one_compiled_call_takes_the_steps_of_transforms(varied):
    """Conjugate gradients with matrix products in one call, and with SciPy's transforms."""
    shape, level = (9, 8, 7), 0.07
    rng = np.random.default_rng(6)
    coefficient = 0.5 + rng.random(shape) if varied else None
    operator = Diffusion(Box((0.0, 0.0, 0.0), shape, 10.0), D, level, varied=coefficient)
    sink = np.where(rng.random(shape) < 0.3, 2.0 * rng.random(shape), 0.0)
    start = np.full(shape, level)
    first, one = solve_steady(operator, sink, 0.005, start)
    operator.dense = None
    second, other = solve_steady(operator, sink, 0.005, start)
    assert (one.newton, one.cg) == (other.newton, other.cg)
    assert one.cg > one.newton > 1
    np.testing.assert_allclose(first, second, rtol=0, atol=1e-9 * level)


@njit
def _by_planes(c, law, residual, rate, parts, x):
    return dense._imbalance(c, law, law[6], law[7], residual, rate, parts, x)


@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (1, 5, 4), (4, 1, 5), (4, 5, 1), (2, 2, 2), (5, 6, 7)]
)
def test_imbalances_of_planes_have_the_bits_of_rows(shape):
    rng = np.random.default_rng(3)
    c, sink, source, x = rng.random((4, *shape))
    law = sink, source, 0.1, 3.0, 0.2, rng.uniform(-1.0, 1.0, 6), None, None, 0.0
    expected, found = np.empty((2, 2, *shape)), np.empty((5, 1))
    sums = stencil.write_imbalance(c, *law, *expected[0])
    product = _by_planes(c, law, *expected[1], found, x.ravel())
    assert expected[1].tobytes() == expected[0].tobytes()
    assert found[:, 0].tolist() == list(sums)
    assert product == stencil.flat_dot(expected[0, 0].ravel(), x.ravel())


def test_numbers_of_nodes_are_those_that_scipy_transforms_fast():
    for needed in range(1, 2500):
        assert _fast(float(needed)) == next_fast_len(max(2, needed), real=False)


@pytest.mark.parametrize("values", [True, False])
@pytest.mark.parametrize("n", [1, 2, 3, 8, 13, 48])
def test_halves_are_the_transform_of_scipy(n, values):
    whole = (fft.dst if values else fft.dct)(np.eye(n), type=2, axis=0, norm="ortho")
    found, of = dense.halves(n, values)
    half = (n + 1) // 2
    np.testing.assert_allclose(found[0], whole[0::2, :half], atol=1e-7)
    odd = found[1][: n // 2, : n // 2]
    np.testing.assert_allclose(odd, whole[1::2, : n // 2][:, ::-1], atol=1e-7)
    np.testing.assert_array_equal(found[2], found[0].T)
    np.testing.assert_array_equal(found[3], found[1].T)
    # the matrix that is diagonalised: a second difference between two ends
    matrix = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    matrix[0, 0] += 1.0 if values else -1.0
    matrix[-1, -1] += 1.0 if values else -1.0
    np.testing.assert_allclose(np.sort(of), np.linalg.eigvalsh(matrix), atol=1e-13)


@pytest.mark.parametrize("side", [{"value": 0.07}, {"derivative": 1e-3}], ids=["value", "slope"])
def test_a_resized_operator_is_one_of_the_new_box(side):
    """A run takes over what a shape of its grid has in common with the last one."""
    faces = ("x-", "x+", "y-", "y+", "z-", "z+")
    conditions = {face: side if face == "y+" else {"value": 0.05} for face in faces}
    shape, at = (6, 7, 8), (0.0, 0.0, 0.0)
    before = Diffusion(Box(at, shape, 10.0), D, conditions)
    box, other = Box((1.0, 2.0, 3.0), shape, 9.3), {**conditions, "x-": {"value": 0.01}}
    for sides in (conditions, other):
        found, new = before.resized(box, sides), Diffusion(box, D, sides)
        assert (found.stiffness, found.volumes) == (new.stiffness, new.volumes)
        for name in ("ghost", "const", "source"):
            np.testing.assert_array_equal(getattr(found, name), getattr(new, name))
        sink, start = np.full(shape, 1e-3), np.full(shape, 0.05)
        one, two = (solve_steady(each, sink, 0.01, start)[0] for each in (found, new))
        np.testing.assert_array_equal(one, two)
    assert before.spacing == 10.0
    again = Diffusion(Box(at, shape, 10.0), D, conditions)
    np.testing.assert_array_equal(before.source, again.source)
