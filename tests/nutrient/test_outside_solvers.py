"""Fields of runs by solvers of py-pde's registry: results, accounts, refusals."""

import itertools

import numpy as np
import pytest
from pde import CartesianGrid, FieldCollection, SphericalSymGrid
from pde.solvers.euler import EulerSolver

import multicell as mc
from multicell.errors import NutrientFailed
from multicell.nutrient.balance import BALANCE_COLUMNS, SIGNS
from multicell.nutrient.equations import outside
from multicell.nutrient.equations.outside import bring, settle
from multicell.nutrient.equations.solvers import MarchFieldSolver
from multicell.report.explain.scene import explain
from multicell.scene.field_solvers import expected_steps, longest_step
from multicell.simulation import Simulation

FIXED = ("euler", "explicit", "runge-kutta", "adams-bashforth", "implicit", "crank-nicolson")
CHOOSING = ("scipy", "multicell-implicit")
GRIDS = {
    "box": CartesianGrid([(-25.0, 25.0)] * 3, 5),
    "plane": CartesianGrid([(-25.0, 25.0)] * 2, 5),
    "shells": SphericalSymGrid(30.0, 6),  # fewer nodes than an account has entries
}


def equation(kind, medium=0.2, names=("oxygen", "drug"), **more):
    """Return fields round a few cells that take up and secrete."""
    rng = np.random.default_rng(3)
    position = rng.uniform(-8.0, 8.0, (6, 3)) * (1.0, 1.0, kind != "plane")
    substances = {
        name: mc.Substance(
            20.0,
            medium,
            0.05,
            medium=medium,
            capacity=np.full(6, 5.0),
            production=np.full(6, 2.0 * i),
            decay=0.01 * i,
            perfusion=0.02,
            **more,
        )
        for i, name in enumerate(names)
    }
    if kind == "shells":
        from multicell.nutrient.equations.grid import layout_on

        layout = layout_on(GRIDS[kind])
        return mc.FieldEquation(GRIDS[kind], substances, position, layout=layout)
    return mc.FieldEquation(GRIDS[kind], substances, position, radius=np.full(6, 5.0))


def nodes(problem, value=0.1):
    return np.full((len(problem.names), *problem.layout.shape), value)


def brought(problem, solver, end=7.0, tolerance=1e-6):
    data = nodes(problem)
    return data, bring(
        problem, solver, data, 0.0, end, tolerance=tolerance, scales=np.full(len(data), 0.2)
    )


@pytest.mark.parametrize("kind", GRIDS)
def test_fastest_bounds_the_eigenvalues_of_the_rates(kind):
    """The derivative of the rates, column by column, is symmetric in the nodes' volumes."""
    problem = equation(kind, names=("oxygen",))
    data = nodes(problem, 0.0)
    columns = []
    for i in range(data.size):
        more = data.copy()
        more.flat[i] = 1e-7
        found = problem.rates(more, 0.0)[0] - problem.rates(data, 0.0)[0]
        columns.append(found.ravel() / 1e-7)
    largest = -np.linalg.eigvals(np.array(columns).T).real.min()
    assert largest <= problem.fastest(data) <= 2.5 * largest


@pytest.mark.parametrize(("kind", "solver"), itertools.product(GRIDS, FIXED + CHOOSING))
def test_solvers_agree_with_the_march_and_close_the_account(kind, solver):
    problem = equation(kind)
    state = problem.state(dict.fromkeys(problem.names, 0.1))
    exact = problem.solve(
        state, 7.0, solver="multicell-implicit", rtol=1e-10, tracker=None
    ).data.reshape(nodes(problem).shape)
    start, found = brought(problem, solver)
    # of first order in time is half of them, with 4 to 40 steps for the slowest deviation
    assert np.abs(found.data - exact).max() < (1e-5 if solver in CHOOSING else 6e-3)
    gained = np.sum((found.data - start) * problem.layout.volumes, axis=tuple(range(1, start.ndim)))
    signs = np.array([SIGNS.get(name, 0.0) for name in BALANCE_COLUMNS])
    turnover = np.abs(found.amounts[:, :-1]).sum(axis=1)
    assert turnover.min() > 100.0
    # CVODE solves its equations to its tolerance only
    left = 1e-6 if solver == "multicell-implicit" else 1e-12
    np.testing.assert_allclose(found.amounts @ signs, gained, rtol=0.0, atol=left * turnover.max())
    assert found.steps >= 1
    assert not found.lifted.any()


@pytest.mark.parametrize("kind", GRIDS)
@pytest.mark.parametrize("solver", ["euler", "runge-kutta", "multicell-implicit"])
def test_marching_to_rest_ends_at_the_steady_state(kind, solver):
    problem = equation(kind)
    exact, reports = problem.steady_state(nodes(problem), 0.0)
    found, costs = settle(problem, solver, nodes(problem), 0.0, np.full(2, 0.2))
    np.testing.assert_allclose(found, exact, rtol=1e-8)
    for name in problem.names:
        assert costs[name].uptake == pytest.approx(reports[name].uptake, rel=1e-8)
        assert costs[name].residual <= 1e-8 * costs[name].uptake
        assert costs[name].newton > 0


def test_a_medium_that_jumps_is_followed_to_the_moment():
    """Perfusion alone: c' = k (medium - c), with a medium that jumps in the middle."""
    wall = {"*": {"derivative": 0.0}}
    times, levels = np.array([0.0, 4.0]), np.array([0.0, 1.0])
    jump = mc.Schedule(times, levels, np.zeros(2))
    substance = mc.Substance(20.0, wall, 0.05, medium=jump, perfusion=0.3)
    problem = mc.FieldEquation(GRIDS["plane"], {"drug": substance})
    exact = 1.0 - np.exp(-0.3 * 3.0)
    seen = []
    for solver, error in (("runge-kutta", 1e-7), ("euler", 0.02), ("scipy", 1e-7)):
        found = bring(
            problem,
            solver,
            nodes(problem, 0.0),
            0.0,
            7.0,
            tolerance=1e-7,
            scales=np.ones(1),
            watch=lambda t, data: seen.append((t, float(data.max()))),
        )
        np.testing.assert_allclose(found.data, exact, rtol=error)
    assert seen[0] == (0.0, 0.0)
    assert seen[-1][0] == 7.0
    before = [level for time, level in seen if time <= 4.0]
    assert max(before) == 0.0


class Sinking(EulerSolver):
    """A solver of a user's own, which ends below zero."""

    name = "sinking"

    def make_stepper(self, state, dt=None):
        """Return a function that takes too much."""

        def stepper(state, t_start, t_end):
            state.data[0] -= 0.1 + 1e-3
            return t_end

        return stepper


def test_below_zero_is_refused_beyond_rounding():
    with pytest.raises(NutrientFailed, match=r"sinking took oxygen below zero, to -0\.001 mM"):
        brought(equation("plane"), "sinking")


def test_too_many_steps_are_refused_before_the_first():
    with pytest.raises(
        NutrientFailed, match=r"need \d+,\d{3},\d{3} steps of euler, each of 0\.\d+ s"
    ):
        brought(equation("plane"), "euler", end=5e6)


def test_fixed_point_iterations_contract_at_their_step():
    """At twice the share that is taken py-pde's implicit solver does not converge any more."""
    problem = equation("plane")
    fastest = problem.fastest(nodes(problem))
    assert longest_step("implicit", fastest) == pytest.approx(0.5 / fastest)
    assert longest_step("euler", fastest) == pytest.approx(1.0 / fastest)
    assert longest_step("scipy", fastest) == np.inf
    _, found = brought(problem, "implicit", end=1.0)
    assert found.steps == pytest.approx(2.0 * fastest, abs=1.0)


# --- in scenes -----------------------------------------------------------------------------------

FEW = {
    "initial.count": 8,
    "duration": "20 s",
    "coupling_step": "10 s",
    "output.every": "10 s",
    "nutrients.oxygen.diffusion": "200 um^2/s",
    "nutrients.oxygen.regime": "transient",
}


def few(**more):
    return mc.load_scene("spheroid").with_changes(FEW | more)


@pytest.mark.sample("explicit-0.001-transient")
@pytest.mark.parametrize("regime", ["steady", "transient"])
@pytest.mark.parametrize(("solver", "error"), [("runge-kutta", 1e-5), ("explicit", 1e-3)])
def test_a_run_by_another_solver_equals_the_default_within_its_error(regime, solver, error):
    scene = few(**{"nutrients.oxygen.regime": regime, "nutrients.oxygen.time_tolerance": 1e-6})
    other = scene.with_changes({"nutrients.oxygen.solver": solver})
    one, two = mc.run(scene), mc.run(other)
    exact, found = (r.frames[-1].fields["oxygen"].values for r in (one, two))
    np.testing.assert_allclose(found, exact, rtol=1e-8 if regime == "steady" else error)
    assert abs(two.summary()["ledger"]["relative_remainder"]) < 1e-10


BOX = {"x": ["-30 um", "30 um"], "y": ["-30 um", "30 um"], "z": ["-30 um", "30 um"]}
PLANE = {"dimensions": 2, "nutrients.oxygen.height": "100 um"}


@pytest.mark.parametrize(
    "space",
    [
        {"domain": {**BOX, "periodic": ["x", "y"]}},
        {"domain": {"x": BOX["x"], "y": BOX["y"], "periodic": ["x"]}, **PLANE},
        PLANE,
        {"nutrients.oxygen.geometry": "radial"},
    ],
    ids=["periodic box", "periodic plane", "plane", "shells"],
)
def test_any_space_is_solved_with_a_closed_account(space):
    spacing = {"nutrients.oxygen.spacing": "10 um", "nutrients.oxygen.time_tolerance": 1e-6}
    scene = few(**space, **spacing)
    one, two = mc.run(scene), mc.run(scene.with_changes({"nutrients.oxygen.solver": "explicit"}))
    exact, found = (r.frames[-1].fields["oxygen"] for r in (one, two))
    assert found.values.std() > 1e-4 * found.values.mean()
    np.testing.assert_allclose(found.values, exact.values, rtol=1e-3)
    assert abs(two.summary()["ledger"]["relative_remainder"]) < 1e-10


@pytest.mark.parametrize("medium", [None, {"volume": "1e9 um^3"}], ids=["plenty", "finite"])
@pytest.mark.parametrize("space", [PLANE, {"domain": BOX}], ids=["plane", "domain"])
def test_the_state_of_a_run_is_one_of_py_pde(space, medium, monkeypatch):
    states, advance = [], MarchFieldSolver.make_stepper

    def noting(self, state, dt=None):
        states.append((state, "_grid" in vars(state)))
        return advance(self, state, dt)

    monkeypatch.setattr(MarchFieldSolver, "make_stepper", noting)
    run = Simulation(few(**space, **{"nutrients.oxygen.finite_medium": medium}), threads=1)
    run.step()
    run.step()
    (group,) = run._run.field_system.groups
    grids = []
    for state, made in states:
        assert isinstance(state, FieldCollection)
        assert not made  # the march asks for no grid
        grids.append(state.grid)
        assert next(iter(state)).label == "oxygen"
        assert state[0].data.shape == state.grid.shape
        assert np.shares_memory(state[0].data, state.data)
    assert isinstance(grids[0], CartesianGrid)
    assert grids[0].num_axes == (2 if "dimensions" in space else 3)
    assert (grids[0] is grids[-1]) == (grids[0] == grids[-1])
    if "domain" in space:
        assert grids[0] is grids[-1]
    np.testing.assert_array_equal(states[-1][0][0].data.ravel(), group.nodes.ravel())
    view = run.fields["oxygen"].to_pde(copy=False)
    assert np.shares_memory(view.data, run._run.field_system.fields["oxygen"].values)
    assert view.grid is grids[-1]


@pytest.mark.slow
def test_resumed_runs_have_the_same_bits(tmp_path):
    scene = few(**{"nutrients.oxygen.solver": "adams-bashforth"})
    whole = mc.run(scene)
    short = scene.with_changes({"duration": "10 s"})
    part = mc.run(short, output=tmp_path / "part", report=False)
    again = mc.resume(tmp_path / "part", changes={"duration": "20 s"}, report=False)
    assert part.frames[-1].time == 10.0
    one, two = (r.frames[-1].fields["oxygen"].values for r in (whole, again))
    assert one.tobytes() == two.tobytes()


def test_scenes_refuse_what_no_solver_can_do():
    medium = {"volume": "1e9 um^3"}
    cases = (
        ({"nutrients.oxygen.solver": "eulr"}, r"is 'eulr', no solver.*'euler'"),
        ({"nutrients.oxygen.solver": "explicit_mpi"}, "a run is one process"),
        ({"nutrients.oxygen.solver": "milstein"}, "equations with noise, and fields have none"),
        (
            {"nutrients.oxygen.solver": "euler", "nutrients.oxygen.diffusion": "1e8 um^2/s"},
            r"about [1-9]\d*,\d{3},\d{3} steps of .* s in a coupling step, more than 1,000,000",
        ),
        ({"nutrients.oxygen.solver": "multicell-steady"}, "but the field is transient"),
        (
            {"nutrients.oxygen.solver": "euler", "nutrients.oxygen.finite_medium": medium},
            "solved for together",
        ),
    )
    for changes, words in cases:
        with pytest.raises(mc.SceneError, match=words):
            few(**changes)


def test_steps_until_a_field_rests_are_foreseen(monkeypatch):
    counted, rest = [], outside.settle

    def counting(*given):
        found, reports = rest(*given)
        counted.append(reports["oxygen"].newton)
        return found, reports

    monkeypatch.setattr(outside, "settle", counting)
    changes = {"nutrients.oxygen.solver": "explicit", "nutrients.oxygen.regime": "steady"}
    scene = few(**changes)
    Simulation(scene, threads=1)  # from the medium everywhere
    expected = expected_steps(scene, "oxygen")
    assert 0.3 * expected < counted[0] < 3.0 * expected
    assert f"about {expected:,} until it rests" in str(explain(scene))


def test_explain_says_how_many_steps_a_solver_takes():
    fixed, choosing = (
        few(**{"nutrients.oxygen.solver": "euler"}),
        few(**{"nutrients.oxygen.solver": "scipy"}),
    )
    words = str(explain(fixed))
    assert "solved by euler in steps of" in words
    assert "a coupling step" in words
    assert "solved by scipy, which chooses its steps" in str(explain(choosing))
