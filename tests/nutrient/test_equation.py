"""The fields' equation: rates and solvers compared with py-pde's and closed forms, bad input."""

from dataclasses import replace

import numpy as np
import pytest
from pde import (
    CallbackTracker,
    CartesianGrid,
    DiffusionPDE,
    FieldCollection,
    ScalarField,
    SphericalSymGrid,
    VectorField,
)

import multicell as mc
from multicell.errors import NutrientFailed
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.substance import Substance

D = 2000.0
SUPPLY = {"derivative": 2e-4}
WALL = {"derivative": 0.0}
KINDS = ["cubes", "squares", "shells"]


def grid_of(kind):
    if kind == "cubes":
        return CartesianGrid([(-80, 80)] * 3, 16)
    return CartesianGrid([(-90, 90)] * 2, 24) if kind == "squares" else SphericalSymGrid(100, 40)


def cells_of(kind, n=60, radius=50.0):
    rng = np.random.default_rng(3)
    away = rng.normal(size=(n, 3))
    position = radius * rng.random((n, 1)) ** (1 / 3) * away / np.linalg.norm(away, axis=1)[:, None]
    return position * [1.0, 1.0, 0.0] if kind == "squares" else position


def sides(kind, first, rest):
    return first if kind == "shells" else {"x-": first, "*": rest}


def equation_of(kind, n=60, rest=SUPPLY, **changes):
    """Return an equation with one substance that a ball or disc of cells lives on."""
    made = {"capacity": np.full(n, 40.0), "production": np.linspace(0.0, 3.0, n), "decay": 0.02}
    conditions = sides(kind, {"value": 0.07}, rest)
    oxygen = Substance(D, conditions, 0.005, **(made | changes))
    return FieldEquation(grid_of(kind), {"oxygen": oxygen}, cells_of(kind, n))


def random_state(equation, seed=1):
    rng = np.random.default_rng(seed)
    return equation.state({name: 0.1 * rng.random(equation.grid.shape) for name in equation.names})


# --- the rates ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_rates_are_pdes_laplacian_and_the_sum_of_all_terms(kind):
    equation = equation_of(kind, perfusion=0.01, medium=0.05)
    state, term = random_state(equation), equation.substances["oxygen"]
    c = state.data
    conditions = sides(kind, {"value": 0.07}, SUPPLY)
    if kind == "shells":
        # py-pde's finite volumes by hand: its operator takes seconds to compile
        h, r = 2.5, 2.5 * np.arange(41)
        ghost = np.concatenate([c[:1], c, [0.14 - c[-1]]])
        laplace = np.diff(r**2 * np.diff(ghost) / h) / (np.diff(r**3) / 3.0)
    else:
        laplace = state.laplace(conditions, backend="scipy").data
    sink, secreted = (x.reshape(c.shape) for x in (term.sink, term.secreted))
    expected = D * laplace - sink * c / (0.005 + c) + secreted - 0.02 * c + 0.01 * (0.05 - c)
    size = np.abs(expected).max()
    np.testing.assert_allclose(equation.evolution_rate(state).data, expected, atol=1e-13 * size)
    np.testing.assert_allclose(equation.rates(c, 0.0)[0], expected, atol=1e-13 * size)
    volumes = np.broadcast_to(equation.grid.cell_volumes, c.shape)
    height = equation.layout.spacing if kind == "squares" else 1.0
    assert np.sum(volumes * height * sink) == pytest.approx(60 * 40.0, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_rates_follow_a_changing_medium(kind):
    steps = mc.Schedule.steps([(0.0, 0.07), (5.0, 0.02)])
    ramp = mc.Schedule(np.array([0.0, 4.0]), np.array([1.0, 3.0]), np.array([0.5, 0.0]))

    def conditions(level):
        return sides(kind, {"value": level}, {"derivative": 0.01 * level})

    n = 60
    rng = np.random.default_rng(5)
    substances = {
        "oxygen": Substance(D, conditions, 0.005, medium=steps, capacity=np.full(n, 40.0)),
        "glucose": Substance(
            600.0, conditions, 0.04, perfusion=0.1, medium=ramp, capacity=np.full(n, 9.0),
            varied=rng.uniform(0.5, 2.0, grid_of(kind).shape),
        ),
    }  # fmt: skip
    equation = FieldEquation(grid_of(kind), substances, cells_of(kind))
    assert equation.explicit_time_dependence
    assert equation.switches(0.0, 9.0) == [4.0, 5.0]
    state = random_state(equation)
    for t in (0.0, 3.0, 4.5, 5.0, 8.0):
        ours = equation.evolution_rate(state, t).data
        size = np.abs(ours).max()
        np.testing.assert_allclose(equation.rates(state.data, t)[0], ours, atol=1e-13 * size)
        levels = {"oxygen": steps.at(t), "glucose": ramp.at(t)}
        fixed = {
            name: replace(s, conditions=conditions(levels[name]), medium=levels[name])
            for name, s in substances.items()
        }
        alone = FieldEquation(grid_of(kind), fixed, cells_of(kind)).rates(state.data, 0.0)[0]
        np.testing.assert_allclose(ours, alone, atol=1e-13 * size)
    assert [ramp.at(t) for t in (-1.0, 0.0, 2.0, 4.0, 9.0)] == [0.5, 1.0, 2.0, 3.0, 3.0]
    assert [steps.at(t) for t in (4.999, 5.0)] == [0.07, 0.02]


# --- our solvers beside py-pde's ------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_pdes_explicit_solver_comes_to_rest_where_ours_says(kind):
    most = np.full(60, 80.0 if kind == "squares" else 900.0)
    equation = equation_of(kind, rest={"value": 0.05}, capacity=most)
    state = equation.state({"oxygen": 0.07})
    ours = equation.solve(state, 1.0, solver="multicell-steady", tracker=None)
    h = equation.layout.spacing
    dt = 0.8 * h**2 / ({"cubes": 6.0, "squares": 4.0, "shells": 3.0}[kind] * D)
    rested = equation.solve(state, 24.0, dt=dt, solver="euler", backend="numpy", tracker=None)
    # the slowest mode decays at 0.8/s or faster: less than 1e-8 of the start is left
    np.testing.assert_allclose(rested.data, ours.data, atol=1e-8)
    assert ours.data.min() >= 0.0
    assert ours.data.min() < 0.05
    balance = equation.balance(ours)["oxygen"]
    assert abs(balance["stored"]) < 1e-8 * balance["uptake"]
    implicit = equation.solve(state, 50.0, solver="multicell-implicit", rtol=1e-8, tracker=None)
    np.testing.assert_allclose(implicit.data, ours.data, atol=1e-8)


@pytest.mark.parametrize(
    ("solver", "order"),
    [
        ("euler", 1),
        ("runge-kutta", 4),
        ("adams-bashforth", 2),
        ("implicit", 1),
        ("crank-nicolson", 2),
        ("scipy", 4),
    ],
)
def test_every_solver_of_pdes_solves_it(solver, order):
    equation = equation_of("shells")
    rng = np.random.default_rng(8)
    state = equation.state({"oxygen": 0.05 + 0.04 * rng.random(40)})
    ours = equation.solve(state, 0.05, solver="multicell-implicit", rtol=1e-9, tracker=None)
    settings = {
        "implicit": {"maxerror": 1e-10},
        "crank-nicolson": {"maxerror": 1e-10},
        "scipy": {"rtol": 1e-9, "atol": 1e-11},
    }
    dt = None if solver == "scipy" else 2e-4
    theirs = equation.solve(
        state, 0.05, dt=dt, solver=solver, backend="numpy", tracker=None, **settings.get(solver, {})
    )
    # steps of a fifth of the explicit limit, over noise that decays: what is left at the end
    bound = {1: 1e-4, 2: 1e-5, 4: 1e-7}[order]
    assert np.abs(theirs.data - ours.data).max() < bound
    assert np.abs(ours.data - state.data).max() > 0.01


def test_a_medium_that_jumps_is_met_on_time():
    """Where all is stirred at once c follows k (medium - c): a closed form through a jump."""
    steps = mc.Schedule.steps([(0.0, 1.0), (2.0, 0.25)])
    stirred = Substance(D, {"*": WALL}, perfusion=3.0, medium=steps)
    equation = FieldEquation(grid_of("squares"), {"drug": stirred})
    state = equation.state({"drug": 0.0})
    first = 1.0 - np.exp(-6.0)
    last = 0.25 + (first - 0.25) * np.exp(-3.0)
    times, values = [], []

    def see(state, time):
        times.append(time)
        values.append(state.data.max())

    for tracker in (None, CallbackTracker(see, np.array([0.5, 2.0, 2.5]))):
        found = equation.solve(state, 3.0, solver="multicell-implicit", rtol=1e-8, tracker=tracker)
        np.testing.assert_allclose(found.data, last, rtol=1e-6)
    np.testing.assert_allclose(times[:2], [0.5, 2.0])
    np.testing.assert_allclose(values[:2], [1.0 - np.exp(-1.5), first], rtol=1e-6)
    rest = equation.solve(state, (0.0, 2.0), solver="multicell-steady", tracker=None)
    np.testing.assert_allclose(rest.data, 0.25, rtol=1e-9)


# --- clocks, trackers, refusals of our solvers ----------------------------------------------------

GRID = CartesianGrid([(0.0, 40.0)] * 2, 4)
CLOSED = {"*": WALL}
RISING = {"perfusion": 1e-11, "medium": 1e11}  # by 1 mM/s


def closed(**terms):
    """Return a closed box in which nothing differs from place to place, empty at first."""
    equation = mc.FieldEquation(GRID, {"drug": mc.Substance(1000.0, CLOSED, **terms)})
    return equation, equation.state({"drug": 0.0})


def test_trackers_may_change_the_state():
    """c' = 1 mM/s is set back to zero each second."""
    equation, state = closed(**RISING)

    def clear(state, t):
        state.data[...] = 0.0

    tracker = CallbackTracker(clear, np.array([1.0, 2.0]))
    end = equation.solve(state, 2.7, solver="multicell-implicit", tracker=tracker)
    np.testing.assert_allclose(end.data, 0.7, rtol=1e-9)


@pytest.mark.parametrize("solver", ["multicell-implicit", "multicell-march"])
def test_time_runs_from_any_start(solver):
    """A medium that rises from the tenth day on is followed within microseconds."""
    start, rate = 864000.0, 1e6
    rising = mc.Schedule(np.array([start]), np.zeros(1), np.ones(1))
    equation, state = closed(perfusion=rate, medium=rising)
    exact = {"multicell-implicit": {"rtol": 1e-8}, "multicell-march": {"tolerance": 1e-6}}[solver]
    end = equation.solve(state, (start, start + 2.0), solver=solver, tracker=None, **exact)
    np.testing.assert_allclose(end.data, 2.0 - 1.0 / rate, rtol=1e-7)


def test_rates_that_are_not_finite_are_refused_by_name():
    fields = {name: mc.Substance(1000.0, CLOSED) for name in ("calm", "wild")}
    equation = mc.FieldEquation(GRID, fields)
    values = {"calm": 1.0, "wild": np.where(np.arange(16) == 5, np.inf, 1.0)}
    with (
        np.errstate(invalid="ignore"),
        pytest.raises(NutrientFailed, match="rate of wild is not finite at t = 0"),
    ):
        equation.solve(equation.state(values), 1.0, solver="multicell-implicit", tracker=None)


def test_what_cannot_be_solved_is_said():
    equation, state = closed(**RISING)
    implicit, march = "multicell-implicit", "multicell-march"
    for solver, options, words in (
        (implicit, {"rtol": 0.0}, r"rtol: is 0\.0, must be above zero"),
        (march, {"tolerance": np.nan}, "tolerance: is nan"),
    ):
        with pytest.raises(mc.SceneError, match=words):
            equation.solve(state, 1.0, solver=solver, tracker=None, **options)
    with pytest.raises(NutrientFailed, match="too many steps"):
        equation.solve(state, 1.0, solver=implicit, tracker=None, max_steps=1)
    both = FieldCollection([state, state])
    for solver in (implicit, march, "multicell-steady"):
        with pytest.raises(mc.SceneError, match="equation: is DiffusionPDE, but multicell's"):
            DiffusionPDE().solve(ScalarField(GRID, 1.0), 1.0, solver=solver, tracker=None)
        with pytest.raises(mc.SceneError, match="state: has 2 fields"):
            equation.solve(both, 1.0, solver=solver, tracker=None)


# --- bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        (CartesianGrid([(0, 10), (0, 20)], 4), "spacings that differ"),
        (CartesianGrid([(0, 10)], 4), "1 axes"),
        (SphericalSymGrid((2, 10), 4), "hollow ball"),
    ],
)
def test_grids_on_which_cells_have_no_place_are_refused(grid, words):
    with pytest.raises(mc.SceneError, match=words):
        FieldEquation(grid, {"oxygen": Substance(D, 0.07)})


def test_numbers_that_make_no_sense_are_refused():
    grid = grid_of("squares")
    for name, value in (("diffusion", 0.0), ("decay", -1.0), ("half_saturation", np.nan)):
        with pytest.raises(mc.SceneError, match=f"{name}: is"):
            Substance(**({"diffusion": D, "conditions": 0.07} | {name: value}))
    for name in ("capacity", "production"):
        wrong = {"oxygen": Substance(D, 0.07, **{name: np.array([1.0, -1.0])})}
        with pytest.raises(mc.SceneError, match=f"{name}: of some cell is negative"):
            FieldEquation(grid, wrong, np.zeros((2, 3)))
    with pytest.raises(mc.SceneError, match="are none"):
        FieldEquation(grid, {})
    with pytest.raises(mc.SceneError, match=r"expected \(n, 3\)"):
        FieldEquation(grid, {"oxygen": Substance(D, 0.07)}, np.zeros((3, 2)))
    with pytest.raises(mc.SceneError, match=r"oxygen.capacity: has shape \(2,\)"):
        FieldEquation(grid, {"oxygen": Substance(D, 0.07, capacity=np.ones(2))}, np.zeros((3, 3)))
    with pytest.raises(mc.SceneError, match=r"position: .* lies outside"):
        FieldEquation(grid, {"oxygen": Substance(D, 0.07)}, np.array([[500.0, 0.0, 0.0]]))
    with pytest.raises(mc.SceneError, match="times that rise"):
        mc.Schedule.steps([(1.0, 0.1), (1.0, 0.2)])


@pytest.mark.parametrize(
    ("kind", "conditions", "words"),
    [
        ("squares", {"x": {"value": 1.0}}, "say nothing of the side 'y-'"),
        ("squares", {"*": {"curvature": 1.0}}, "have .* on the side"),
        ("squares", {"*": {"value": np.ones(7)}}, "expected a finite number"),
        ("squares", {"*": {"type": "mixed", "value": 0.1, "const": 0.1}}, "have .* on the side"),
        ("squares", "auto_periodic_neumann", "expected a finite number"),
        ("shells", {"curvature": 1.0}, "say nothing of the side 'r\\+'"),
        ("shells", {"r+": {"curvature": 1.0}}, "on the side"),
        ("shells", {"value": np.nan}, "have nan, expected a finite number"),
    ],
)
def test_conditions_that_fields_do_not_know_are_refused(kind, conditions, words):
    with pytest.raises(mc.SceneError, match=words):
        FieldEquation(grid_of(kind), {"oxygen": Substance(D, conditions)})


def test_conditions_may_be_said_in_several_ways():
    for kind, ways in {
        "squares": [0.07, {"value": 0.07}, {"*": {"value": 0.07}}],
        "shells": [0.07, {"value": 0.07}, {"r+": {"value": 0.07}, "r-": WALL}],
    }.items():
        rates = []
        for way in ways:
            equation = FieldEquation(grid_of(kind), {"oxygen": Substance(D, way)})
            rates.append(equation.evolution_rate(random_state(equation)).data)
        np.testing.assert_array_equal(rates[1], rates[0])
        np.testing.assert_array_equal(rates[2], rates[0])


def test_states_of_something_else_are_refused():
    equation = equation_of("squares")
    with pytest.raises(mc.SceneError, match=r"are of \['sugar'\], expected \['oxygen'\]"):
        equation.state({"sugar": 1.0})
    with pytest.raises(mc.SceneError, match=r"the grid has \(24, 24\)"):
        equation.state({"oxygen": np.ones(7)})
    other = ScalarField(grid_of("cubes"), 1.0)
    two = FieldCollection([ScalarField(equation.grid, 1.0)] * 2)
    vector = VectorField(equation.grid, 1.0)
    for wrong, words in ((other, "lives on"), (two, "has 2 fields"), (vector, "one scalar field")):
        with pytest.raises(mc.SceneError, match=words):
            equation.evolution_rate(wrong)
        with pytest.raises(mc.SceneError, match=words):
            equation.solve(wrong, 1.0, solver="multicell-implicit", tracker=None)


@pytest.mark.parametrize("kind", KINDS)
def test_amounts_add_up(kind):
    equation = equation_of(kind, perfusion=0.01, medium=0.05)
    balance = equation.balance(random_state(equation))["oxygen"]
    gained = balance["inflow"] + balance["secreted"]
    lost = balance["uptake"] + balance["decayed"]
    assert balance["secreted"] == pytest.approx(90.0, rel=1e-12)
    size = max(abs(x) for x in balance.values())
    assert balance["stored"] == pytest.approx(gained - lost, abs=1e-11 * size)


@pytest.mark.parametrize("kind", KINDS)
def test_pdes_explicit_solver_takes_the_same_course(kind):
    equation = equation_of(kind)
    rng = np.random.default_rng(8)
    state = equation.state({"oxygen": 0.05 + 0.04 * rng.random(equation.grid.shape)})
    explicit = {"solver": "runge-kutta", "backend": "numpy", "adaptive": True, "tolerance": 1e-9}
    for time in (0.05, 0.6):
        theirs = equation.solve(state, time, dt=1e-4, tracker=None, **explicit)
        errors = []
        for rtol in (1e-4, 1e-7):
            ours = equation.solve(state, time, solver="multicell-implicit", rtol=rtol, tracker=None)
            errors.append(np.abs(ours.data - theirs.data).max())
        assert errors[0] < 3e-3 * 0.09
        assert errors[1] < 3e-6 * 0.09


def test_a_closed_box_keeps_what_it_holds_and_follows_its_ode():
    """Without sides the content falls by decay and rises by secretion, wherever the cells are."""
    equation = equation_of("cubes", decay=0.3, capacity=None)
    closed = Substance(
        D, {"*": WALL}, decay=0.3, production=equation.substances["oxygen"].substance.production
    )
    equation = FieldEquation(equation.grid, {"oxygen": closed}, cells_of("cubes"))
    state = random_state(equation)
    volume = 160.0**3
    start, gained = state.data.mean(), 90.0 / volume
    end = equation.solve(state, 4.0, solver="multicell-implicit", rtol=1e-8, tracker=None)
    expected = gained / 0.3 + (start - gained / 0.3) * np.exp(-0.3 * 4.0)
    assert end.data.mean() == pytest.approx(expected, rel=1e-6)
    still = FieldEquation(equation.grid, {"oxygen": Substance(D, {"*": WALL})})
    end = still.solve(state, 5.0, solver="multicell-implicit", tracker=None)
    assert end.data.mean() == pytest.approx(start, rel=1e-9)
