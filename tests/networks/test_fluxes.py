"""Uptake and secretion of networks: accounts of fields, and the order of their coupling."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import multicell as mc
from multicell.errors import SceneError
from multicell.networks.custom import network


def _seen(t, y, u, p, out):
    out[0] = p[0] * u[0] * y[0]


@network(states={"E": 1.0}, inputs={"food": 0.0}, parameters={"k": 40.0, "made": 2e-4},
         observed=("eaten",), observe=_seen)  # fmt: skip
def eater(t, y, u, p, out):
    """A species that food makes, and that takes up food."""
    out[0] = p[1] * (1.0 - y[0]) + p[1] * 10.0 * u[0]


def _scene(step="10 min", *, field=None, **part):
    own = {"network": eater, "inputs": {"food": "food"}, "fluxes": {"food": "uptake: eaten"},
           "tolerance": 1e-9, **part}  # fmt: skip
    return mc.load_scene("growth").with_changes({
        "duration": "4 h", "initial.count": 20, "growth": None, "coupling_step": step,
        "output.every": "2 h", "networks": {"eater": own},
        "nutrients": {"food": {"boundary": 0.5, "uptake": 0.0, "spacing": 20.0, **(field or {})}},
    })  # fmt: skip


def _done(scene):
    simulation = mc.Simulation(scene, threads=1)
    while not simulation.finished:
        simulation.step()
    return simulation


FIELDS = {
    "steady": {},
    "steady in a finite medium": {"finite_medium": {"volume": "3e6 um^3"}},
    "transient": {"regime": "transient", "initial": "steady"},
}


RATES = {"steady": 4000.0, "steady in a finite medium": 400.0, "transient": 4000.0}
"""The rate at which one cell eats."""


def _order(make):
    """Return the orders of a state and of the field by halving the step of one cell."""
    found, orders = [], []
    for step in (1200.0, 600.0, 300.0, 150.0):
        # one cell, which does not move
        simulation = _done(make(step).with_changes({"initial.count": 1}))
        found.append((simulation.cells.inside[0, 0], simulation.concentrations["food"][0]))
    for one in zip(*found, strict=True):
        change = [abs(a - b) for a, b in itertools.pairwise(one)]
        orders.append(np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(change), 1)[0])
    return orders


@pytest.mark.slow
@pytest.mark.parametrize("case", RATES)
def test_fluxes_are_coupled_with_order_two(case):
    orders = _order(
        lambda step: _scene(step, field=FIELDS[case], parameters={"k": RATES[case]})
    )  # fmt: skip
    assert orders == pytest.approx([2.0, 2.0], abs=0.35)


@pytest.mark.parametrize("case", ["steady", "transient"])
def test_responses_of_fields_to_networks_are_coupled_with_order_two(case):
    eats = {"behaviour": "uptake of food", "signal": "eater.E", "half": 1.0, "power": 2.0}
    orders = _order(
        lambda step: _scene(step, field={"uptake": 2000.0, **FIELDS[case]}, fluxes=None)
        .with_changes({"responses": {"eats": eats}})
    )  # fmt: skip
    assert orders == pytest.approx([2.0, 2.0], abs=0.1)


def test_a_response_of_the_uptake_to_a_network_is_its_value():
    eats = {"behaviour": "uptake of food", "signal": "eater.E", "half": 1.0, "power": 2.0}
    scene = _scene(field={"uptake": 2000.0}, fluxes=None)
    simulation = _done(scene.with_changes({"responses": {"eats": eats}}))
    assert "splitting_networks_error" in simulation.history_row()
    level = simulation.cells.inside[:, 0]
    found, made = simulation.field_system.demand("food", simulation.cells)
    np.testing.assert_allclose(found, 2000.0 * level**2 / (1.0 + level**2), rtol=1e-12)
    assert made is None


@pytest.mark.parametrize("step", ["10 min", "40 min"])
def test_a_medium_that_jumps_is_followed_within_the_step(step):
    # diffusion takes seconds: what the cell finds is the medium, less what it takes up
    field = {"regime": "transient", "initial": "steady", "uptake": 1e-6,
             "media": [["1 h", 2.0], ["2 h", 0.1]]}  # fmt: skip
    scene = _scene(step, field=field, fluxes=None).with_changes({"initial.count": 1})
    e, made, hour = 1.0, 2e-4, 3600.0
    for level, time in ((0.5, hour), (2.0, hour), (0.1, 2.0 * hour)):
        rest = 1.0 + 10.0 * level
        e = rest + (e - rest) * np.exp(-made * time)
    assert _done(scene).cells.inside[0, 0] == pytest.approx(e, rel=2e-3)


@pytest.mark.parametrize("case", FIELDS)
def test_accounts_are_closed(case):
    simulation = _done(_scene(field=FIELDS[case]))
    account = simulation.summary()["ledger"]["food"]
    assert account["uptake"] > 0.0
    assert abs(account["relative_remainder"]) < 1e-9


def test_what_is_taken_up_is_the_rate_of_the_network():
    simulation = _done(_scene())
    fields, networks = simulation.field_system, simulation.plan.networks
    rate = networks.fluxes("food", simulation.cells, simulation.time)[0]
    capacity, made = fields.demand("food", simulation.cells)
    taken = fields.fields["food"].uptake(simulation.cells.position, capacity,
                                         simulation.cells.radius)  # fmt: skip
    np.testing.assert_allclose(taken, rate, rtol=1e-9)
    want = 40.0 * simulation.concentrations["food"] * simulation.cells.inside[:, 0]
    np.testing.assert_allclose(rate, want, rtol=1e-4)
    assert not made.any()


def test_a_flux_empties_a_finite_medium_and_nothing_is_below_zero():
    scene = _scene(field={"finite_medium": {"volume": "2e6 um^3"}}, parameters={"k": 4000.0})
    simulation = _done(scene)
    account = simulation.summary()["ledger"]["food"]
    assert abs(account["relative_remainder"]) < 1e-9
    found = simulation.concentrations["food"]
    assert (found >= 0.0).all()
    assert found.max() < 1e-3 * 0.5
    held = simulation.field_system.fields["food"].well_mixed.concentration
    assert 0.0 <= held < 1e-3 * 0.5


def test_a_secretion_comes_from_the_network():
    def always(t, y, u, p, out):
        out[0] = 3.0

    @network(states={"E": 1.0}, observed=("made",), observe=always, units={"made": "amol/min"})
    def source(t, y, u, p, out):
        out[0] = 0.0

    part = {"network": source, "fluxes": {"food": "secretion: made"}}
    scene = mc.load_scene("growth").with_changes({
        "duration": "2 h", "initial.count": 5, "growth": None, "networks": {"s": part},
        "nutrients": {"food": {"boundary": 0.5, "uptake": 0.0, "spacing": 20.0}},
    })  # fmt: skip
    account = _done(scene).summary()["ledger"]["food"]
    assert account["secreted"] == pytest.approx(5 * 3.0 / 60.0 * 7200.0, rel=1e-9)


def test_runs_with_fluxes_are_resumed_with_the_same_bits(tmp_path):
    scene = _scene(field=FIELDS["transient"])
    whole = mc.run(scene, output=tmp_path / "whole", threads=1, report=False)
    again = mc.resume(whole.folder, 1, output=tmp_path / "again", threads=1, report=False)
    one, other = whole.frames[-1], again.frames[-1]
    assert one.cells.inside.tobytes() == other.cells.inside.tobytes()
    assert one.concentrations["food"].tobytes() == other.concentrations["food"].tobytes()


def test_a_rate_that_is_none_is_refused():
    with pytest.raises(SceneError, match=r"fluxes\.food.*'eatn'.*eaten"):
        _scene(fluxes={"food": "uptake: eatn"})

    @network(states={"E": 1.0}, observed=("v",), observe=_seen, units={"v": "mM"})
    def wrong(t, y, u, p, out):
        out[0] = 0.0

    with pytest.raises(SceneError, match="amount per time"):
        _scene(network=wrong, inputs={}, fluxes={"food": "uptake: v"})
