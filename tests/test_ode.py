"""The equations of a coupling step, handed to SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import multicell as mc
from multicell.integrators.cvode import Cvode


@pytest.fixture(scope="module")
def problem():
    scene = mc.load_scene("growth").with_changes(
        {"initial.count": 12, "duration": "1 d", "coupling_step": "5 min"}
    )
    return mc.ode_problem(scene, step=3)


def test_scipy_meets_our_own_method(problem):
    span = (problem.t0, problem.t1)
    assert span == (900.0, 1200.0)
    assert problem.y0.shape == (36,)
    found = solve_ivp(problem.f, span, problem.y0, method="DOP853", rtol=1e-12, atol=1e-12)
    end = found.y[:, -1]
    assert np.abs(end - problem.y0).max() > 1e-3
    ours = Cvode(1e-12, 1e-10, 100_000).integrate(problem.system, problem.y0.reshape(-1, 3))
    np.testing.assert_allclose(ours.position.ravel(), end, atol=1e-7)
    implicit = solve_ivp(
        problem.f, span, problem.y0, method="BDF", rtol=1e-8, atol=1e-8, jac=problem.jacobian
    )
    np.testing.assert_allclose(implicit.y[:, -1], end, atol=1e-5)
    differences = solve_ivp(
        problem.f, span, problem.y0, method="Radau", rtol=1e-8, atol=1e-8,
        jac_sparsity=problem.sparsity(),
    )  # fmt: skip
    np.testing.assert_allclose(differences.y[:, -1], end, atol=1e-5)


def test_products_and_matrix_are_the_derivative(problem):
    rng = np.random.default_rng(1)
    t, y, v = 0.5 * (problem.t0 + problem.t1), problem.y0, rng.normal(size=36)
    step = 1e-6
    slope = (problem.f(t, y + step * v) - problem.f(t, y - step * v)) / (2.0 * step)
    np.testing.assert_allclose(problem.jv(t, y, v), slope, atol=1e-6 * np.abs(slope).max())
    matrix = problem.jacobian(t, y)
    np.testing.assert_allclose(matrix @ v, problem.jv(t, y, v), atol=1e-14)
    pattern = problem.sparsity()
    assert pattern.shape == (36, 36)
    outside = abs(matrix) - abs(matrix).multiply(pattern)
    assert abs(outside).max() == 0.0


def test_what_cannot_be_had_is_said():
    scene = mc.load_scene("settle").with_changes({"initial.count": 5, "duration": "3 min"})
    short = scene.with_changes({"coupling_step": "1 min"})
    with pytest.raises(mc.SceneError, match="the run ends after 3 coupling steps"):
        mc.ode_problem(short, step=3)
    for wrong in (-1, 1.5, True):
        with pytest.raises(mc.SceneError, match="whole number from 0 on"):
            mc.ode_problem(short, step=wrong)
    rough = mc.ode_problem(short.with_changes({"friction": {"normal": "0.1 nN s/um^3"}}))
    with pytest.raises(mc.SceneError, match="full matrix"):
        rough.sparsity()
    with pytest.raises(mc.SceneError, match="full matrix"):
        rough.jacobian(rough.t0, rough.y0)
    with pytest.raises(mc.StateRejected):
        rough.f(0.0, np.full(15, np.nan))
    assert np.isfinite(rough.jv(0.0, rough.y0, np.ones(15))).all()
