"""Reactions between the fields of a run: closed forms, conservation, accounts, growth."""

import numpy as np
import pytest
from running import finished

import multicell as mc
from multicell.errors import StepFailed
from multicell.scene.scene import Scene

WALLS = {"*": {"type": "derivative", "derivative": 0.0}}
CLOSED = {"uptake": 0.0, "sides": WALLS, "spacing": 20.0, "time_tolerance": 1e-4}
BOX = {axis: [-50.0, 50.0] for axis in "xyz"}
BINDING = {
    "bind": {"rate": "10 1/(mM s)", "consumes": {"a": 1, "b": 1}, "produces": {"c": 1}},
    "part": {"rate": 0.1, "consumes": {"c": 1}, "produces": {"a": 1, "b": 1}},
}


def scene(fields, reactions, **changes):
    entries = {"duration": 1800.0, "coupling_step": 600.0, "initial": {"count": 8}}
    return Scene.from_dict({**entries, "nutrients": fields, "reactions": reactions, **changes})


def values(simulation, name):
    return np.asarray(simulation.fields[name].values)


# --- closed forms ---------------------------------------------------------------------------------


def test_binding_comes_to_its_equilibrium_and_keeps_what_does_not_react():
    fields = {
        "a": {**CLOSED, "boundary": 0.1},
        "b": {**CLOSED, "boundary": 0.05, "diffusion": 20.0},
        "c": {**CLOSED, "boundary": 0.0, "diffusion": 5.0},
    }
    run = finished(scene(fields, BINDING, domain=BOX))
    a, b, c = (values(run, name) for name in "abc")
    np.testing.assert_allclose(10.0 * a * b, 0.1 * c, rtol=1e-7)
    # c² - (a0 + b0 + K) c + a0 b0 = 0
    total = 0.1 + 0.05 + 0.01
    bound = 0.5 * (total - np.sqrt(total**2 - 4.0 * 0.1 * 0.05))
    np.testing.assert_allclose(c, bound, rtol=1e-7)
    np.testing.assert_allclose(a + c, 0.1, rtol=1e-8)
    np.testing.assert_allclose(b + c, 0.05, rtol=1e-8)


# --- accounts -------------------------------------------------------------------------------------

MIXED = {
    "o": {"boundary": 0.1, "uptake": 20.0},
    "l": {"boundary": 0.0, "uptake": 0.0, "secretion": 5.0, "diffusion": 200.0},
    "c": {"boundary": 0.0, "uptake": 0.0, "diffusion": 50.0, "decay": 1e-3},
}


@pytest.mark.slow
@pytest.mark.parametrize(("geometry", "regime", "where"), [
    ("box", "transient", "tissue"), ("radial", "transient", "everywhere"),
    ("radial", "steady", "medium"), ("auto", "steady", "tissue"), ("auto", "transient", "medium"),
])  # fmt: skip
def test_growing_tissue_accounts_for_every_molecule(geometry, regime, where):
    fields = {name: {**f, "geometry": geometry, "regime": regime} for name, f in MIXED.items()}
    law = {"rate": "5 1/mM/s", "consumes": {"o": 1, "l": 1}, "produces": {"c": 1}, "where": where}
    run = finished(scene(fields, {"x": law}, growth={"cycle_time": "12 h"}))
    ledgers = run.ledger
    for name, ledger in ledgers.items():
        assert ledger.relative_remainder <= 1e-8
        assert values(run, name).min() >= 0.0
    assert ledgers["c"].made == pytest.approx(ledgers["o"].used, rel=1e-8)
    assert ledgers["c"].made == pytest.approx(ledgers["l"].used, rel=1e-8)
    assert ledgers["c"].made > 0.0


@pytest.mark.parametrize("geometry", ["box", "radial"])
def test_what_passes_open_sides_to_and_fro_is_no_excuse(geometry):
    """A slow loss of what diffuses fast: the net inflow is far less than the exchange."""
    fields = {"a": {"uptake": 0.0, "boundary": 0.01, "geometry": geometry}}
    slow = {"x": {"rate": "1e-6 1/s", "consumes": {"a": 1}}}
    ledger = finished(scene(fields, slow, coupling_step=60.0, duration=1200.0)).ledger["a"]
    assert ledger.used == pytest.approx(1e-6 * 1200.0 * ledger.content, rel=1e-2)
    assert ledger.relative_remainder <= 1e-10


@pytest.mark.slow
def test_what_is_used_up_falls_to_zero_and_not_below():
    """Fast annihilation of two fields that meet in a front: each all but vanishes on one side."""
    sides = {name: {"type": "value", "value": 0.1} for name in ("x-", "x+")}
    fields = {
        "a": {"uptake": 0.0, "boundary": 0.0, "sides": {**WALLS, "x-": sides["x-"]}},
        "b": {"uptake": 0.0, "boundary": 0.0, "sides": {**WALLS, "x+": sides["x+"]}},
    }
    for field in fields.values():
        field.update({"spacing": 5.0, "diffusion": 100.0})
    kill = {"x": {"rate": "1e5 1/mM/s", "consumes": {"a": 1, "b": 1}}}
    flat = {"dimensions": 2, "domain": {"x": [-50, 50], "y": [-20, 20]}, "duration": 600.0}
    run = finished(scene(fields, kill, **flat))
    for name in "ab":
        c = values(run, name)
        assert c.min() >= 0.0
        assert c.min() < 1e-8
        assert run.ledger[name].relative_remainder <= 1e-8
    assert run.ledger["a"].used == pytest.approx(run.ledger["b"].used, rel=1e-8)
    # at rest both are straight lines that meet in the middle
    middle = values(run, "a")[:, 4, 0]
    x = -47.5 + 5.0 * np.arange(20)
    np.testing.assert_allclose(middle[x < -15], -0.1 * x[x < -15] / 50.0, atol=2e-3)


# --- runs -----------------------------------------------------------------------------------------


def test_fields_that_react_have_one_equation():
    law = {"rate": 0.5, "consumes": {"o": 1, "l": 1}, "produces": {"c": 1}, "where": "tissue"}
    run = mc.Simulation(scene(MIXED, {"x": law}))
    with pytest.raises(mc.SceneError, match="hold o but not l, with which it reacts"):
        mc.field_problem(run.scene, run.frame(), ["o", "c"])


# --- growth without bound -------------------------------------------------------------------------


@pytest.mark.slow
def test_a_field_that_explodes_is_named():
    """Nothing is there at first, so that nothing tells of it before cells begin to secrete."""
    fields = {"a": {**CLOSED, "boundary": 0.0, "secretion": 100.0, "time_tolerance": 1e-2}}
    law = {"x": {"rate": "10 1/mM/s", "consumes": {"a": 2}, "produces": {"a": 3}}}
    run = mc.Simulation(scene(fields, law, domain=BOX))
    with pytest.raises(StepFailed, match=r"a would need steps of .* s at t = "):
        run.step()
    assert run.time == 0.0
    assert values(run, "a").max() == 0.0
