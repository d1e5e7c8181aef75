"""Reactions in the fields' equation: rates, py-pde's solvers beside ours, other references."""

import numpy as np
import pytest
from pde import CartesianGrid, SphericalSymGrid
from scipy.integrate import solve_bvp

import multicell as mc
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.operators import linearised
from multicell.nutrient.reactions.inverse import gmres, inverse_of_blocks
from multicell.nutrient.reactions.kinetics import Kinetics, kinetics_of

WALL = {"derivative": 0.0}
BINDING = {
    "bind": {"rate": "5 1/mM/s", "consumes": {"a": 1, "b": 1}, "produces": {"c": 1}},
    "part": {"rate": "0.05 1/s", "consumes": {"c": 1}, "produces": {"a": 1, "b": 1}},
    "loss": {"rate": "0.2 1/mM/s", "consumes": {"a": 2}},
}  # fmt: skip


def equation(n=16, **changes):
    """Return three substances in a box with cells, which bind each other and decay."""
    rng = np.random.default_rng(0)
    cells = rng.uniform(-40.0, 40.0, (30, 3))
    low, high = {"x-": {"value": 0.1}, "*": WALL}, {"x+": {"value": 0.0}, "*": WALL}
    substances = {
        "a": mc.Substance(300.0, low, 0.01, capacity=np.full(30, 20.0)),
        "b": mc.Substance(100.0, {"*": WALL}, decay=1e-3, production=np.full(30, 5.0)),
        "c": mc.Substance(50.0, high),
    }
    grid = CartesianGrid([(-80, 80)] * 3, n)
    return mc.FieldEquation(grid, substances, cells, reactions=BINDING | changes)


def started(made):
    return made.state({"a": 0.1, "b": 0.0, "c": 0.0})


# --- rates ----------------------------------------------------------------------------------------


def written_out(a, b, c, tissue):
    """Return rates of the reactions of ``ALL`` for three fields, by hand."""
    bind, twice = 0.3 * a * b, 0.1 * b * b * (1.0 - tissue)
    triple = 2.0 * tissue * c**3
    return np.array([2.0 * triple - bind + 0.01, -bind - 2.0 * twice, bind - 3.0 * triple])


ALL = {
    "bind": {"rate": 0.3, "consumes": {"a": 1, "b": 1}, "produces": {"c": 1}},
    "triple": {"rate": 2.0, "consumes": {"c": 3}, "produces": {"a": 2}, "where": "tissue"},
    "twice": {"rate": 0.1, "consumes": {"b": 2}, "where": "medium"},
    "drip": {"rate": 0.01, "produces": {"a": 1}},
}  # fmt: skip


def test_fixed_forms_are_their_formulas_and_their_slopes_the_derivatives():
    rng = np.random.default_rng(1)
    c, tissue = rng.random((3, 200)), rng.random(200)
    c[:, 0] = 0.0
    kinetics = kinetics_of(["a", "b", "c"], ALL)
    made, slope = kinetics.evaluate(c, tissue)
    np.testing.assert_allclose(made, written_out(*c, tissue), rtol=1e-13, atol=1e-15)
    for j in range(3):
        up, down = c[:, 1:].copy(), c[:, 1:].copy()
        up[j] += 1e-6
        down[j] -= 1e-6
        rise = (written_out(*up, tissue[1:]) - written_out(*down, tissue[1:])) / 2e-6
        np.testing.assert_allclose(slope[:, j, 1:], rise, rtol=1e-6, atol=1e-8)


def test_below_zero_rates_go_on_along_their_tangent():
    kinetics = kinetics_of(["a", "b"], {"x": {"rate": 2.0, "consumes": {"a": 1, "b": 1}}})
    made, slope = kinetics.evaluate(np.array([[-0.1, -0.1, 0.3], [0.5, -0.2, 0.5]]))
    np.testing.assert_allclose(made[0], [0.1, 0.0, -0.3])
    np.testing.assert_allclose(slope[0, 0], [-1.0, 0.0, -1.0])


def test_rates_are_diffusion_and_reactions_added_up():
    made = equation()
    state = started(made)
    rng = np.random.default_rng(2)
    state.data = 0.1 * rng.random(state.data.shape)
    plain = {name: term.substance for name, term in made.substances.items()}
    without = mc.FieldEquation(made.grid, plain, made.position)
    kinetics = Kinetics("abc", [mc.Reaction(**r) for r in BINDING.values()])
    rates = kinetics.evaluate(state.data.reshape(3, -1))[0].reshape(state.data.shape)
    expected = without.evolution_rate(state).data + rates
    np.testing.assert_allclose(made.evolution_rate(state).data, expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(made.rates(state.data, 0.0)[0], expected, rtol=1e-9, atol=1e-12)
    for balance in made.balance(state).values():
        gained = balance["inflow"] + balance["secreted"] + balance["made"]
        lost = balance["uptake"] + balance["decayed"] + balance["used"]
        size = max(abs(x) for x in balance.values())
        assert balance["stored"] == pytest.approx(gained - lost, abs=1e-11 * size)


# --- the linear solver ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["cubes", "unlike sides", "varied", "shells"])
@pytest.mark.parametrize("fast", [1e-3, 1.0, 1e3])
def test_the_inverse_of_blocks_makes_gmres_short(kind, fast):
    """However fast reactions are, compared with diffusion; on shells it is exact."""
    rng = np.random.default_rng(3)
    grid = SphericalSymGrid(100, 30) if kind == "shells" else CartesianGrid([(0, 120)] * 3, 12)
    sides = [{"value": 0.1}, WALL if kind == "unlike sides" else {"value": 0.0}]
    varied = rng.uniform(0.5, 2.0, grid.shape) if kind == "varied" else None
    substances = {
        name: mc.Substance(d, side, varied=varied)
        for name, d, side in zip("ab", (500.0, 20.0), sides, strict=True)
    }
    made = mc.FieldEquation(grid, substances)
    operators = [term.operator for term in made.substances.values()]
    shape, n = made.substances["a"].shape, int(np.prod(grid.shape))
    c = rng.uniform(0.5, 1.0, (2, n))
    binding = {"x": {"rate": fast, "consumes": {"a": 1}, "produces": {"b": 1}},
               "y": {"rate": fast, "consumes": {"b": 2}, "produces": {"a": 2}}}  # fmt: skip
    blocks = -kinetics_of(["a", "b"], binding).evaluate(c)[1]
    blocks[0, 0] += 0.01
    blocks[1, 1] += 0.01

    def product(x):
        v = x.reshape(2, n)
        out = np.einsum("ijx,jx->ix", blocks, v)
        none = np.zeros(shape)
        for i, op in enumerate(operators):
            out[i] += linearised(op, v[i].reshape(shape), none).ravel()
        return out.ravel()

    inverse = inverse_of_blocks(operators, blocks)
    right = rng.normal(size=2 * n)
    x, taken = gmres(product, lambda r: inverse(r.reshape(2, n)).ravel(), right, 1e-8)
    assert np.linalg.norm(product(x) - right) <= 2e-8 * np.linalg.norm(right)
    assert taken <= (2 if kind == "shells" else 80 if kind == "unlike sides" else 25)


# --- solvers --------------------------------------------------------------------------------------


def test_pdes_solvers_agree_with_ours():
    """Explicit Runge-Kutta of py-pde's and SciPy's, without any of our solvers."""
    made = equation(n=12)
    state = started(made)
    ours = made.solve(state, 4.0, solver="multicell-implicit", rtol=1e-7, tracker=None)
    explicit = made.solve(
        state, 4.0, solver="runge-kutta", backend="numpy", adaptive=True, tolerance=1e-7,
        tracker=None,
    )  # fmt: skip
    scipys = made.solve(
        state, 4.0, solver="scipy", backend="numpy", method="RK45", rtol=1e-7, atol=1e-10,
        tracker=None,
    )  # fmt: skip
    for i in range(3):
        size = np.abs(scipys.data[i]).max()
        np.testing.assert_allclose(ours.data[i], scipys.data[i], atol=1e-5 * size)
        np.testing.assert_allclose(explicit.data[i], scipys.data[i], atol=1e-3 * size)


def test_the_steady_state_is_where_time_leads():
    made = equation(n=12)
    steady = made.solve(started(made), 1.0, solver="multicell-steady", tracker=None)
    assert steady.data.min() >= 0.0
    rates = np.abs(made.evolution_rate(steady).data).reshape(3, -1).max(axis=1)
    assert (rates <= 1e-8).all()
    later = made.solve(
        started(made), 5000.0, solver="multicell-implicit", rtol=1e-6, tracker=None
    )  # fmt: skip
    np.testing.assert_allclose(later.data, steady.data, rtol=1e-4)


LARGEST, HALF = 0.02, 0.05


@mc.reaction(fields=("a", "b"))
def converted(concentrations, cell):
    a, _b = concentrations
    taken = LARGEST * a * a / (HALF * HALF + a * a)
    return -taken, taken


def test_a_hill_front_at_rest_is_that_of_solve_bvp():
    """D (c'' + 2 c'/r) = V c²/(K² + c²) in a ball; the error falls with the square of spacing."""
    d, most, half, radius = 100.0, LARGEST, HALF, 100.0

    def rhs(r, y):
        taken = most * y[0] ** 2 / (half**2 + y[0] ** 2) / d
        return np.array([y[1], np.where(r > 0, taken - 2 * y[1] / np.maximum(r, 1e-9), taken / 3)])

    r = np.linspace(0.0, radius, 400)
    guess = np.array([0.3 * np.exp((r - radius) / 40.0), 0.3 / 40 * np.exp((r - radius) / 40.0)])
    exact = solve_bvp(rhs, lambda a, b: np.array([a[1], b[0] - 0.3]), r, guess, tol=1e-8)
    assert exact.success
    errors = []
    for count in (40, 80):
        grid = SphericalSymGrid(radius, count)
        substances = {"a": mc.Substance(d, 0.3), "b": mc.Substance(2 * d, 0.0)}
        made = mc.FieldEquation(grid, substances, reactions={"x": converted})
        rested = made.solve(
            made.state({"a": 0.3, "b": 0.0}), 1.0, solver="multicell-steady", tracker=None
        )
        middles = grid.axes_coords[0]
        errors.append(np.abs(rested[0].data - exact.sol(middles)[0]).max())
        # a/1 and 2b diffuse alike and make up for each other
        np.testing.assert_allclose(rested[0].data + 2.0 * rested[1].data, 0.3, rtol=1e-8)
    assert errors[0] < 3e-4
    assert errors[1] < 0.3 * errors[0]


# --- bad input ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_growth_without_bound_is_named():
    """dc/dt = k c² ends at t = 1/(k c0) = 1 s."""
    grid = CartesianGrid([(0, 40)] * 2, 4)
    law = {"x": {"rate": 10.0, "consumes": {"a": 2}, "produces": {"a": 3}}}
    made = mc.FieldEquation(grid, {"a": mc.Substance(10.0, {"*": WALL})}, reactions=law)
    state = made.state({"a": 0.1})
    with pytest.raises(NutrientFailed, match=r"rate of a is not finite at t = 0\.99"):
        made.solve(state, 20.0, solver="multicell-implicit", tracker=None)
    with pytest.raises(NutrientFailed, match="no steady state of a was found"):
        made.solve(state, 20.0, solver="multicell-steady", tracker=None)


@pytest.mark.parametrize(
    ("reactions", "words"),
    [
        ({"x": {"rate": 1.0, "consumes": {"q": 1}}}, "q: is not one of the fields"),
        ({"x": lambda c: -c}, "must be a reaction"),
        ({"x": {"rate": 1.0, "consumes": {"a": 1}, "where": "tissue"}}, "tissue: is missing"),
    ],
)
def test_what_is_no_reaction_is_refused(reactions, words):
    grid = CartesianGrid([(0, 40)] * 2, 4)
    with pytest.raises(SceneError, match=words):
        mc.FieldEquation(grid, {"a": mc.Substance(10.0, {"*": WALL})}, reactions=reactions)
