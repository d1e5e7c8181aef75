"""Reactions of the user's own: compiled, checked, solved for, refused in words."""

import math
import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from pde import CartesianGrid

import multicell as mc
from multicell.errors import SceneError
from multicell.nutrient.reactions.own_kernels import Cell
from multicell.testing import check_reaction

WALL = {"derivative": 0.0}
HALF = 0.1


def saturated(c):
    return c * c / (HALF * HALF + c * c)


@mc.reaction(fields=("v", "u"))
def predation(concentrations, cell):
    v, u = concentrations
    eaten = 0.02 * u * saturated(v) * cell.tissue
    return 0.5 * eaten - 0.01 * v * math.sqrt(v + 1e-3), -eaten


@mc.reaction(fields=("a", "b"))
def binding(concentrations, cell):
    a, b = concentrations
    return -a * b, -a * b


def test_good_ones_pass_the_conformance_test():
    check_reaction(predation)
    check_reaction(binding)
    with pytest.raises(AssertionError, match="not made by"):
        check_reaction(saturated)


def test_found_derivatives_are_those_of_the_formula():
    rng = np.random.default_rng(0)
    v, u = c = 10.0 ** rng.uniform(-5, 0, (2, 50))
    tissue = rng.random(50)
    rates, slope = predation.evaluate(c, tissue)
    squares = HALF**2 + v * v
    rise = 2.0 * HALF**2 * v / squares**2
    np.testing.assert_allclose(rates[1], -0.02 * u * v * v / squares * tissue, rtol=1e-12)
    np.testing.assert_allclose(slope[1, 0], -0.02 * u * rise * tissue, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(slope[1, 1], -0.02 * v * v / squares * tissue, rtol=1e-6)
    zero, steep = predation.evaluate(np.zeros((2, 1)), np.ones(1))
    assert not zero.any()
    assert steep[0, 0, 0] == pytest.approx(-0.01 * math.sqrt(1e-3), rel=1e-6)
    below, _ = predation.evaluate(np.array([[-0.1], [0.0]]), np.ones(1))
    assert below[0, 0] == pytest.approx(0.001 * math.sqrt(1e-3), rel=1e-6)


def test_fixed_forms_and_own_ones_add_up():
    grid = CartesianGrid([(0, 40)] * 2, 4)
    substances = {name: mc.Substance(50.0, {"*": WALL}) for name in ("u", "v", "w")}
    both = {"eat": predation, "fade": {"rate": 0.1, "consumes": {"u": 1}, "produces": {"w": 1}}}
    tissue = np.full(16, 0.5)
    made = mc.FieldEquation(grid, substances, reactions=both, tissue=tissue)
    u, v, w = made.rates(np.full((3, 4, 4), 0.2), 0.0)[0]
    dv, du = predation((0.2, 0.2), Cell(0.5))
    np.testing.assert_allclose(u, du - 0.02, rtol=1e-9)
    np.testing.assert_allclose(v, dv, rtol=1e-9)
    np.testing.assert_allclose(w, 0.02, rtol=1e-9)


def takes_from_nothing(concentrations, cell):
    return -1e-3, 0.0


def jumps(concentrations, cell):
    a, _b = concentrations
    return (-a if a > 0.3 else 0.0), 0.0


def runs_off(concentrations, cell):
    a, _b = concentrations
    return 1.0 / a, 0.0


def too_few(concentrations, cell):
    return (0.0,)


def other_arguments(c, cell):
    return 0.0, 0.0


def not_numbers(concentrations, cell):
    return -concentrations[0] * globals()["HALF"], 0.0


def fine(concentrations, cell):
    return -concentrations[0], 0.0


@pytest.mark.parametrize(
    ("rate", "options", "words"),
    [
        (takes_from_nothing, {}, "takes 0.001 mM/s of a where there is none"),
        (jumps, {}, "has no derivative that can be found: that of a jumps at a = 0.(29|30)"),
        (runs_off, {}, "is not finite at a = 0 mM"),
        (too_few, {}, "returns 1 rates for 2 fields"),
        (other_arguments, {}, r"must have \(concentrations, cell\)"),
        (not_numbers, {}, "cannot be compiled: TypingError"),
        (fine, {"upto": 0.0}, "upto: is 0.0"),
        (fine, {"fields": "ab"}, "must be a list of names"),
    ],
)
def test_what_breaks_a_promise_is_refused(rate, options, words):
    with pytest.raises(SceneError, match=words):
        mc.reaction(**{"fields": ("a", "b"), **options})(rate)


@pytest.mark.slow
def test_compiled_code_is_found_again_in_another_process(tmp_path):
    source = """
        import multicell as mc
        from multicell.nutrient.reactions.own_kernels import all_nodes

        @mc.reaction(fields=("a",))
        def fade(concentrations, cell):
            return (-FACTOR * concentrations[0],)

        print(sum(all_nodes.stats.cache_hits.values()), fade.evaluate([[1.0]])[0][0, 0])
    """
    file, cache = tmp_path / "mine.py", tmp_path / "cache"
    told = []
    for factor in ("0.25", "0.25", "0.5"):
        file.write_text(f"FACTOR = {factor}\n" + textwrap.dedent(source))
        done = subprocess.run(
            [sys.executable, str(file)], capture_output=True, text=True, check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        )  # fmt: skip
        told.append(done.stdout.split())
    assert told == [["0", "-0.25"], ["1", "-0.25"], ["0", "-0.5"]]


# --- in runs --------------------------------------------------------------------------------------

WALLS = {"*": {"type": "derivative", "derivative": 0.0}}


def scene(**changes):
    fields = {
        name: {"uptake": 0.0, "boundary": level, "sides": WALLS, "spacing": 20.0}
        for name, level in (("a", 0.1), ("b", 0.05), ("c", 0.0))
    }
    box = {axis: [-50, 50] for axis in "xyz"}
    entries = {"duration": 1200.0, "initial": {"count": 4}, "nutrients": fields, "domain": box}
    return mc.Scene.from_dict({**entries, **changes})


@pytest.mark.slow
def test_a_run_with_an_own_reaction_is_that_with_the_same_of_fixed_form(tmp_path):
    fixed = {"x": {"rate": 1.0, "consumes": {"a": 1, "b": 1}}}
    theirs = mc.run(scene(reactions=fixed)).frames[-1]
    ours = mc.run(scene(), reactions={"x": binding}, output=tmp_path / "run", report=False)
    for name in "abc":
        np.testing.assert_allclose(
            ours.frames[-1].fields[name].values, theirs.fields[name].values, rtol=1e-9
        )
    ledger = ours.summary()["ledger"]
    assert ledger["relative_remainder"] <= 1e-8
    assert ledger["a"]["used"] == pytest.approx(ledger["b"]["used"], rel=1e-8)
    problem = mc.field_problem(scene(), ours.frames[-1], reactions={"x": binding})
    balance = problem.equation.balance(problem.state, problem.time)["a"]
    assert balance["used"] > balance["made"] == 0.0
    with pytest.raises(SceneError, match=r"reactions: of the run .* are not the same for a"):
        mc.resume(tmp_path / "run", frame=0, output=tmp_path / "again", report=False)
    again = mc.resume(
        tmp_path / "run", frame=0, output=tmp_path / "again", report=False,
        reactions={"x": binding},
    )  # fmt: skip
    assert np.array_equal(
        again.frames[-1].fields["a"].values, ours.frames[-1].fields["a"].values
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "reactions", "words"),
    [
        ({}, {"x": predation}, "depends on v, which is not a field"),
        ({"nutrients.b.spacing": 10.0}, {"x": binding}, "share one grid"),
        ({"nutrients": None, "domain": None}, {"x": binding}, "has no fields"),
    ],
)
def test_own_reactions_that_do_not_fit_a_scene_are_refused(changes, reactions, words):
    with pytest.raises(SceneError, match=words):
        mc.Simulation(scene().with_changes(changes), reactions=reactions)
