"""The fields of runs are equations of py-pde's, brought forward by solvers that it knows."""

import subprocess
import sys

import numpy as np
import pytest
from pde.solvers.base import SolverBase

import multicell as mc
from multicell.biology.initial import initial_cells
from multicell.nutrient.fields import Feeding
from multicell.report.explain.scene import explain
from multicell.scene.nutrient import SOLVERS, STEPPING
from multicell.scene.scene import Scene

SLOW = {"diffusion": 20.0, "uptake": 0.2, "half_saturation": 0.005, "boundary": 0.07}
"""Oxygen a hundred times slower: the same steady field, and long explicit steps."""


def scene(nutrient, **changes):
    entries = {"duration": 1800.0, "coupling_step": 600.0, "initial": {"count": 20}}
    return Scene.from_dict({**entries, "nutrients": {"a": nutrient}, **changes})


def ran(described):
    simulation = mc.Simulation(described)
    while not simulation.finished:
        simulation.step()
    return simulation


def test_py_pde_is_loaded_by_a_run_with_a_field_and_by_no_other():
    program = (
        "import sys, multicell as mc\n"
        "for name in ('growth', 'spheroid'):\n"
        "    mc.Simulation(mc.load_scene(name)).step()\n"
        "    print('pde' in sys.modules)\n"
        "print('scipy.optimize._optimize' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    # what py-pde imports of SciPy and no field uses stays unloaded
    assert done.stdout.split() == ["False", "True", "False"], done.stderr


@pytest.mark.parametrize(
    ("nutrient", "solver", "equation"),
    [
        ({"regime": "steady"}, "multicell-steady", "FieldEquation"),
        ({"regime": "transient"}, "multicell-march", "FieldEquation"),
        (
            {"regime": "transient", "finite_medium": {"volume": 1e9}},
            "multicell-march",
            "WithMedia",
        ),
        ({"regime": "steady", "finite_medium": {"volume": 1e9}}, "multicell-march",
         "AtRestWithMedia"),
        ({**SLOW, "solver": "multicell-implicit"}, "multicell-implicit", "AccountedEquation"),
        ({**SLOW, "solver": "explicit"}, "euler", "AccountedEquation"),
    ],
)  # fmt: skip
def test_a_run_takes_its_solver_from_the_registry_of_py_pde(nutrient, solver, equation):
    described = scene(nutrient)
    feeding, cells = Feeding(described), initial_cells(described)
    feeding.begin(cells, 0.0)
    feeding.advance(cells, 0.0, 600.0)
    (group,) = feeding.groups
    registered = SolverBase.from_name(solver, None)
    assert group.info["class"] == type(registered).__name__
    assert group.info["pde_class"] == equation


def test_scenes_know_the_solvers_that_py_pde_knows():
    for name in SOLVERS:
        assert SolverBase.from_name({"explicit": "euler"}.get(name, name), None).info["class"]


def test_a_spheroid_by_explicit_steps_is_that_of_the_steady_solver():
    """Diffusion settles in three of the twenty minutes between two exchanges with the cells."""
    found = {}
    for solver in ("multicell-steady", "explicit"):
        slower = {"diffusion": 5.0, "uptake": 0.05}
        oxygen = {**SLOW, **slower, "spacing": 20.0, "quiescence": 0.02, "solver": solver}
        changes = {"nutrients": {"oxygen": oxygen}, "duration": "2 d", "coupling_step": "20 min"}
        found[solver] = ran(mc.load_scene("spheroid").with_changes(changes))
    steady, explicit = found.values()
    assert len(explicit.cells) == len(steady.cells) > 5
    np.testing.assert_allclose(
        explicit.concentrations["oxygen"], steady.concentrations["oxygen"], rtol=2e-3
    )
    account = explicit.ledger["oxygen"]
    assert account.relative_remainder < 1e-10
    assert account.uptake == pytest.approx(steady.ledger["oxygen"].uptake, rel=0.02)


@pytest.mark.parametrize("solver", [*STEPPING, "multicell-implicit"])
def test_all_solvers_agree_and_their_accounts_close(solver):
    nutrient = {
        **SLOW, "spacing": 20.0, "geometry": "radial", "decay": 1e-4, "perfusion": 2e-4,
        "secretion": 0.05, "media": [[900.0, 0.02]], "time_tolerance": 1e-4,
    }  # fmt: skip
    ours = ran(scene({**nutrient, "regime": "transient"}))
    theirs = ran(scene({**nutrient, "solver": solver}))
    np.testing.assert_allclose(
        theirs.fields["a"].values, ours.fields["a"].values, rtol=2e-3, atol=0.0
    )
    account, other = theirs.ledger["a"], ours.ledger["a"]
    # CVODE solves its equations as well as its tolerance asks for, the others to rounding
    assert account.relative_remainder < (1e-3 if solver == "multicell-implicit" else 1e-9)
    for name in ("inflow", "uptake", "decayed", "washed", "secreted", "stored"):
        assert getattr(account, name) == pytest.approx(getattr(other, name), rel=0.01)


def test_solvers_that_do_not_fit_are_refused():
    for nutrient, words in (
        ({"solver": "explicit", "regime": "steady"}, "is for transient fields"),
        ({"solver": "multicell-steady", "regime": "transient"}, "is for steady fields"),
        ({"solver": "euler"}, "solver"),
        ({"solver": "explicit", "finite_medium": {"volume": 1e9}}, "knows no finite medium"),
    ):
        with pytest.raises(mc.SceneError, match=words):
            scene(nutrient)
    quick = scene({"diffusion": 1e7, "spacing": 10.0, "solver": "explicit"}, coupling_step="1 h")
    with pytest.raises(mc.errors.StepFailed, match="is stable with steps up to"):
        mc.Simulation(quick).step()


def test_explain_says_the_limit_of_explicit_steps():
    described = scene({"diffusion": 2000.0, "spacing": 20.0, "solver": "explicit"})
    words = str(explain(described))
    # half of h² / 6 D
    assert "py-pde's explicit with steps of at most 0.017 s, 36,000 in a coupling step" in words


@pytest.mark.parametrize("regime", ["transient", "steady"])
def test_fields_in_finite_media_react_and_no_molecule_is_lost(regime):
    """Each of two drugs has a medium of its own; they bind, and what they make leaves."""
    fields = {
        "a": {"boundary": 0.1, "uptake": 1.0, "finite_medium": {"volume": 2e7}},
        "b": {"boundary": 0.05, "uptake": 0.0, "decay": 1e-5, "finite_medium": {"volume": 3e7},
              "media": [[900.0, 0.08]]},
        "c": {"boundary": 0.0, "uptake": 0.0},
    }  # fmt: skip
    common = {"diffusion": 500.0, "spacing": 20.0, "regime": regime}
    run = ran(
        Scene.from_dict({
            "duration": 1800.0, "coupling_step": 600.0, "initial": {"count": 5},
            "nutrients": {name: {**common, **entries} for name, entries in fields.items()},
            "reactions": {"bind": {
                "rate": "0.05 1/(mM s)", "consumes": {"a": 1, "b": 1}, "produces": {"c": 1},
            }},
        })
    )  # fmt: skip
    ledger = run.ledger
    for name in fields:
        assert ledger[name].relative_remainder < 1e-6
    used = [ledger["a"].used, ledger["b"].used, ledger["c"].made]
    np.testing.assert_allclose(used, used[0], rtol=1e-6)
    for name in "ab":
        account = ledger[name]
        whole = {"a": 2e7, "b": 3e7}[name]
        assert account.fresh > 0.0
        assert account.level * whole < account.fresh + 0.1 * whole
    assert ledger["a"].level < 0.1
    assert ledger["a"].uptake > 0.0
    assert ledger["a"].used > 0.0
