"""Our solvers on equations of py-pde's that know nothing of cells, and the inverse they need."""

import numpy as np
import pytest
from pde import (
    CartesianGrid,
    DiffusionPDE,
    FieldCollection,
    PDEBase,
    ScalarField,
    SphericalSymGrid,
    VectorField,
)

import multicell as mc
from multicell.errors import NutrientFailed
from multicell.nutrient.equations.transforms import inverse_on

OURS = {"implicit": mc.ImplicitFieldSolver, "steady": mc.SteadyFieldSolver}
VALUE, WALL = {"value": 0.0}, {"derivative": 0.0}


class Reaction(PDEBase):
    """Fields that diffuse and react; ``react`` maps their data (k, ...) to rates."""

    def __init__(self, react, diffusion, bc=None):
        super().__init__()
        self.react, self.diffusion, self.sides = react, diffusion, bc
        self.calls = 0

    def evolution_rate(self, state, t=0.0):
        self.calls += 1
        fields = list(state) if isinstance(state, FieldCollection) else [state]
        rates = np.array(self.react(np.array([field.data for field in fields]), t))
        for rate, field, d in zip(rates, fields, self.diffusion, strict=True):
            if d:
                rate += d * field.laplace(self.sides, backend="scipy").data
        found = state.copy()
        found.data = rates.reshape(state.data.shape)
        return found


def solve(equation, state, until, solver="implicit", **options):
    return equation.solve(
        state, until, solver=OURS[solver], backend="numpy", tracker=None, **options
    )


def laplace(field, sides):
    """Return second differences with py-pde's ghost values: its operator wants one spacing."""
    grid = field.grid
    full = np.zeros([n + 2 for n in grid.shape])
    inner = (slice(1, -1),) * grid.num_axes
    full[inner] = field.data
    grid.get_boundary_conditions(sides, rank=0).set_ghost_cells(full)
    total = np.zeros(grid.shape)
    for axis, h in enumerate(grid.discretization):
        middle = [slice(1, -1)] * grid.num_axes
        middle[axis] = slice(None)
        total += np.diff(full[tuple(middle)], 2, axis=axis) / h**2
    return total


# --- the inverse of diffusion ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("periodic", "bc"),
    [
        ([False] * 3, {"x": VALUE, "y": WALL, "z-": VALUE, "z+": WALL}),
        ([True, False, True], {"x": "periodic", "y-": WALL, "y+": VALUE, "z": "periodic"}),
        ([True] * 2, "periodic"),
        ([False], {"x-": WALL, "x+": VALUE}),
        ([False, True], None),
    ],
)
def test_inverse_is_that_of_pdes_laplacian(periodic, bc):
    shape = (6, 7, 5)[: len(periodic)]
    bounds = [(-1.0, length) for length in (2.0, 5.0, 3.0)]
    grid = CartesianGrid(bounds[: len(shape)], shape, periodic=periodic)
    r = np.random.default_rng(1).normal(size=shape)
    u = ScalarField(grid, inverse_on(grid, 0.7, bc)(r, 0.3))
    sides = bc or {"x": WALL, "y": "periodic"}
    back = 0.3 * u.data - 0.7 * laplace(u, sides)
    np.testing.assert_allclose(back, r, atol=1e-12)
    np.testing.assert_allclose(inverse_on(grid, 0.0, bc)(r, 4.0), r / 4.0)


@pytest.mark.parametrize("side", [VALUE, WALL])
def test_inverse_in_a_ball_is_that_of_its_shells(side):
    from multicell.nutrient.spherical import Shells

    grid = SphericalSymGrid(3.0, 8)
    r = np.random.default_rng(1).normal(size=8)
    u = inverse_on(grid, 0.7, side)(r, 0.3)
    shells = Shells(3.0, 8, 0.7, side)
    np.testing.assert_allclose(0.3 * u - shells.gain(u) / shells.volumes, r, atol=1e-12)
    assert inverse_on(SphericalSymGrid((1.0, 3.0), 8), 0.7) is None


# --- the transient solver -------------------------------------------------------------------------


def test_solvers_have_names():
    from pde.solvers.base import SolverBase

    for name, ours in zip(("multicell-implicit", "multicell-steady"), OURS.values(), strict=True):
        assert SolverBase._subclasses[name] is ours


def test_a_sine_decays_as_it_should():
    grid = CartesianGrid([(0.0, 1.0)], 50)
    state = ScalarField(grid, np.sin(np.pi * grid.axes_coords[0]))
    rate = 0.5 * (2.0 * 50 * np.sin(np.pi / 100)) ** 2
    equation = Reaction(lambda c, t: 0.0 * c, [0.5], {"value": 0.0})
    for rtol in (1e-4, 1e-8):
        end = solve(equation, state, 0.3, rtol=rtol, diffusivity=0.5, bc={"value": 0.0})
        np.testing.assert_allclose(end.data, np.exp(-0.3 * rate) * state.data, atol=5 * rtol)


def test_gray_scott_as_scipy_has_it_and_cheaper_with_diffusivities():
    grid = CartesianGrid([(0.0, 16.0)] * 2, 32, periodic=True)
    x, y = np.moveaxis(grid.cell_coords, -1, 0)
    spot = np.exp(-((x - 7.0) ** 2) / 4.0 - (y - 9.0) ** 2 / 6.0)
    fields = [ScalarField(grid, 1.0 - 0.5 * spot, label="u"), ScalarField(grid, 0.3 * spot)]
    fields[1].label = "v"

    def react(c, t):
        u, v = c
        return u * v * v * np.array([[[-1.0]], [[1.0]]]) + np.array([0.04 * (1.0 - u), -0.1 * v])

    equation = Reaction(react, [2.0, 1.0], "periodic")
    state = FieldCollection(fields, labels=["u", "v"])
    theirs = equation.solve(
        state, 20.0, solver="scipy", method="RK45", rtol=1e-8, atol=1e-10, backend="numpy",
        tracker=None,
    )  # fmt: skip
    calls = []
    for diffusivity in ({"u": 2.0, "v": 1.0}, None):
        equation.calls = 0
        ours = solve(equation, state, 20.0, rtol=1e-6, diffusivity=diffusivity, bc="periodic")
        np.testing.assert_allclose(ours.data, theirs.data, atol=2e-5)
        assert equation.diagnostics["solver"]["preconditioned"] is (diffusivity is not None)
        calls.append(equation.calls)
    assert calls[0] < 0.7 * calls[1]
    assert np.abs(ours.data - state.data).max() > 0.1


def test_trackers_and_hooks_may_change_the_state():
    """y' = 1 is set back to zero: by a hook at 0.5, or by a tracker each second."""
    from pde import CallbackTracker

    grid = CartesianGrid([(0.0, 1.0)], 4)
    equation = Reaction(lambda c, t: 1.0 + 0.0 * c, [0.0])

    def clear(state, t):
        state.data[...] = 0.0

    tracker = CallbackTracker(clear, np.array([1.0, 2.0]))
    end = equation.solve(
        ScalarField(grid), 2.7, solver="multicell-implicit", backend="numpy", tracker=tracker
    )
    np.testing.assert_allclose(end.data, 0.7, rtol=1e-9)

    class Hooked(Reaction):
        def make_post_step_hook(self, state, backend):
            def hook(data, t, kept):
                kept += data[0] > 0.5
                return np.minimum(data, 0.5), kept

            return hook, 0

    hooked = Hooked(lambda c, t: 1.0 + 0.0 * c, [0.0])
    end = solve(hooked, ScalarField(grid), 0.8)
    np.testing.assert_allclose(end.data, 0.5)
    assert hooked.diagnostics["solver"]["post_step_data"] > 0


def test_time_runs_from_any_start():
    """Steps of 1e-7 s at a clock that shows 10 days."""
    grid = CartesianGrid([(0.0, 1.0)], 4)
    start = 864000.0
    equation = Reaction(lambda c, t: -1e6 * (c - (t - start)), [0.0])
    end = solve(equation, ScalarField(grid, 1.0), (start, start + 2.0), rtol=1e-8)
    np.testing.assert_allclose(end.data, 2.0 - 1e-6, rtol=1e-8)


def test_a_reaction_that_runs_away_is_named():
    grid = CartesianGrid([(0.0, 1.0)], 4)
    state = FieldCollection(
        [ScalarField(grid, 1.0), ScalarField(grid, 1.0)], labels=["calm", "wild"]
    )
    equation = Reaction(lambda c, t: [0.0 * c[0], 1.0 / (1.0 - np.minimum(t, 1.0)) * c[1] ** 2],
                        [0.0, 0.0])  # fmt: skip
    with np.errstate(divide="ignore"), pytest.raises(NutrientFailed, match="rate of wild is not"):
        solve(equation, state, (1.0, 2.0))
    blows_up = Reaction(lambda c, t: c**2, [0.0])
    with np.errstate(over="ignore"), pytest.raises(NutrientFailed, match=r"t = 1\b|t = 0.99"):
        solve(blows_up, ScalarField(grid, 1.0), 2.0, max_steps=2000)


# --- the steady solver ----------------------------------------------------------------------------


def test_logistic_growth_ends_where_it_is_stable():
    """From a speck u = 1 is reached, though u = 0 rests too and is nearer."""
    grid = CartesianGrid([(0.0, 20.0)] * 2, 20)
    state = ScalarField(grid, 0.0)
    state.data[3:6, 7:9] = 0.05
    equation = Reaction(lambda c, t: c * (1.0 - c), [1.0], WALL)
    end = solve(equation, state, 1.0, "steady", diffusivity=1.0)
    np.testing.assert_allclose(end.data, 1.0, atol=1e-8)


def test_two_fields_come_to_rest_as_the_transient_solver_says():
    grid = CartesianGrid([(0.0, 8.0)] * 2, 16)
    sides = {"x-": {"value": 1.0}, "x+": {"value": 0.2}, "y": WALL}

    def react(c, t):
        a, b = c
        flow = a * b / (0.1 + a)
        return np.array([0.3 - flow, 0.2 * flow - 0.1 * b])

    equation = Reaction(react, [1.0, 0.3], sides)
    state = FieldCollection([ScalarField(grid, 0.5)] * 2, labels=["a", "b"])
    known = {"diffusivity": [1.0, 0.3], "bc": sides}
    rest = solve(equation, state, 1.0, "steady", **known)
    late = solve(equation, state, 400.0, rtol=1e-8, **known)
    np.testing.assert_allclose(rest.data, late.data, atol=1e-6)
    assert np.abs(equation.evolution_rate(rest).data).max() < 1e-7


def test_pdes_own_diffusion_says_its_diffusivity():
    grid = CartesianGrid([(0.0, 1.0)] * 2, 12)
    sides = {"x-": {"value": 1.0}, "x+": {"value": 3.0}, "y": WALL}
    equation = DiffusionPDE(0.4, bc=sides)
    rest = solve(equation, ScalarField(grid, 0.0), 1.0, "steady")
    expected = 1.0 + 2.0 * grid.cell_coords[..., 0]
    np.testing.assert_allclose(rest.data, expected, atol=1e-9)


# --- bad input ------------------------------------------------------------------------------------


def test_what_cannot_be_solved_is_said():
    grid = CartesianGrid([(0.0, 1.0)], 8)
    state = ScalarField(grid, 1.0)
    equation = Reaction(lambda c, t: 1.0 + 0.0 * c, [1.0], WALL)
    with pytest.raises(mc.SceneError, match="diffusivity: is not known for Reaction"):
        solve(equation, state, 1.0, "steady")
    with pytest.raises(NutrientFailed, match="no steady state was found in 20 steps"):
        solve(equation, state, 1.0, "steady", diffusivity=1.0, max_steps=20)
    with pytest.raises(mc.SceneError, match="diffusivity: has 3 numbers for 1 fields"):
        solve(equation, state, 1.0, diffusivity=[1.0, 2.0, 3.0])
    with pytest.raises(mc.SceneError, match="diffusivity: is of u, expected field 0"):
        solve(equation, state, 1.0, diffusivity={"u": 1.0})
    with pytest.raises(mc.SceneError, match=r"diffusivity: is \[-1.0\], must be zero or more"):
        solve(equation, state, 1.0, diffusivity=-1.0)
    with pytest.raises(mc.SceneError, match=r"rtol: is 0\.0, must be above zero"):
        solve(equation, state, 1.0, rtol=0.0)
    with pytest.raises(mc.SceneError, match="atol: has 2 numbers for 1 fields"):
        solve(equation, state, 1.0, atol=[1e-6, 1e-7])
    with pytest.raises(mc.SceneError, match="tolerance: is nan"):
        solve(equation, state, 1.0, "steady", tolerance=np.nan)
    with pytest.raises(mc.SceneError, match="has noise"):
        solve(DiffusionPDE(noise=1.0), state, 1.0)
    with pytest.raises(mc.SceneError, match="is complex"):
        solve(equation, ScalarField(grid, 1.0, dtype=complex), 1.0)
    with pytest.raises(mc.SceneError, match="not scalar"):
        solve(equation, VectorField(grid, 1.0), 1.0, diffusivity=1.0)
    with pytest.raises(NutrientFailed, match="too many steps"):
        solve(Reaction(lambda c, t: np.cos(1e4 * t) + 0.0 * c, [0.0]), state, 1.0, max_steps=50)
