"""Expected work of networks: counts by SciPy's LSODA, and words."""

import math

import pytest
from network_models import BRUSSELATOR, DECAY

import multicell as mc
from multicell.networks.expected import network_evaluations
from multicell.networks.network import Network
from multicell.report.explain.cost import cost_of_step, network_cost
from multicell.report.explain.networks import network_words


def scene_of(**network):
    return mc.load_scene("hypoxia-invasion").with_changes(
        {f"networks.hypoxia.{key}": value for key, value in network.items()}
    )


def test_a_network_at_rest_takes_few_and_one_that_swings_many():
    still, swinging = (
        network_evaluations(DECAY, 1.0, 1e-4),
        network_evaluations(BRUSSELATOR, 60.0, 1e-4),
    )
    assert 1 <= still < 100 < swinging
    # so many that they are not counted to the end: by the part that was
    assert network_evaluations(BRUSSELATOR, 600.0, 1e-4) == pytest.approx(10.0 * swinging, rel=0.2)
    assert network_evaluations(BRUSSELATOR, 60.0, 1e-8) > 1.5 * swinging


@pytest.mark.parametrize("fault", ["raises", "no number"])
def test_rates_that_fail_have_no_known_cost(fault):
    def rates(t, y, u, p, out):
        out[0] = 1.0 / (t - t) if fault == "raises" else math.nan

    names = {"name": "bad", "states": ("A",), "start": (1.0,), "inputs": (), "defaults": ()}
    bad = Network(
        **names, parameters=(), values=(), observed=(), rates=rates, observe=None, source=fault
    )
    assert math.isnan(network_evaluations(bad, 1.0, 1e-4))


def test_the_cost_is_of_the_cells_that_have_it():
    scene = scene_of()
    count, whole = network_cost(scene, "hypoxia")
    part = scene.networks["hypoxia"]
    assert count == network_evaluations(part.model, scene.coupling_step / part.seconds(), 1e-4)
    assert f"about {count:,.3g} evaluations a cell" in network_words(scene, "hypoxia")
    bare = scene.with_changes({"networks": {}, "responses": {}})
    assert cost_of_step(scene)[1] == pytest.approx(cost_of_step(bare)[1] + whole)
    kinds = {"types.other": {"fraction": 3.0}, "networks.hypoxia.cells": "tumour"}
    some = scene.with_changes({**kinds, "responses": {}})
    assert network_cost(some, "hypoxia")[1] == pytest.approx(0.25 * whole)


def test_steps_of_a_fixed_length_are_counted():
    scene = scene_of(method="rk4", step="10 s")
    assert network_cost(scene, "hypoxia")[0] == pytest.approx(4.0 * scene.coupling_step / 10.0)
