"""The fields of runs are equations of py-pde's, brought forward by solvers that it knows."""

import numpy as np
import pytest
from pde.solvers.base import SolverBase
from running import finished

from multicell.biology.initial import initial_cells
from multicell.nutrient.fields import FieldSystem
from multicell.scene.scene import Scene


def scene(nutrient, **changes):
    entries = {"duration": 1800.0, "coupling_step": 600.0, "initial": {"count": 20}}
    return Scene.from_dict({**entries, "nutrients": {"a": nutrient}, **changes})


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
    ],
)  # fmt: skip
def test_a_run_takes_its_solver_from_the_registry_of_py_pde(nutrient, solver, equation):
    described = scene(nutrient)
    system, cells = FieldSystem(described), initial_cells(described)
    system.begin(cells, 0.0)
    system.advance(cells, 0.0, 600.0)
    (group,) = system.groups
    registered = SolverBase.from_name(solver, None)
    assert group.info["class"] == type(registered).__name__
    assert group.info["pde_class"] == equation


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
    run = finished(
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
