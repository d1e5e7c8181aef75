"""The check of networks of the user's own: it passes good ones and names what is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from network_models import BRUSSELATOR, DECAY, ROBERTSON

import multicell as mc
from multicell.networks.conformance import fastest_rate
from multicell.report.explain.scene import explain


def test_good_networks_pass():
    mc.testing.check_network(BRUSSELATOR)
    mc.testing.check_network(ROBERTSON, invariants=[{"A": 1.0, "B": 1.0, "C": 1.0}], duration=0.1)


def test_a_sum_that_changes_is_named():
    with pytest.raises(AssertionError, match="sum over A, B goes"):
        mc.testing.check_network(ROBERTSON, invariants=[{"A": 1.0, "B": 1.0}], duration=0.1)


def test_faults_are_named():
    @mc.network(states={"A": 0.0})
    def infinite(t, y, u, p, out):
        out[0] = 1.0 / y[0]

    with pytest.raises(AssertionError, match="rate of A is no finite number"):
        mc.testing.check_network(infinite)

    @mc.network(states={"A": 1.0})
    def writes(t, y, u, p, out):
        out[0] = -y[0]
        y[0] = 2.0

    with pytest.raises(AssertionError, match="writes into its states"):
        mc.testing.check_network(writes)

    @mc.network(states={"A": 1.0})
    def jumps(t, y, u, p, out):
        out[0] = 1.0 if y[0] > 1.00001 else -1.0

    with pytest.raises(AssertionError, match="no derivative"):
        mc.testing.check_network(jumps)


def test_a_function_with_other_arguments_is_refused():
    with pytest.raises(TypeError, match="t, y, u, p, out"):

        @mc.network(states={"A": 1.0})
        def wrong(y, out):
            out[0] = 0.0


def test_what_numba_cannot_compile_is_refused_with_the_name():
    @mc.network(states={"A": 1.0})
    def opens(t, y, u, p, out):
        out[0] = float(str(y[0]).encode().decode())

    with pytest.raises(mc.SceneError, match="opens"):
        mc.testing.check_network(opens)


def test_the_fastest_rate_is_the_largest_eigenvalue():
    assert fastest_rate(DECAY) == pytest.approx(2.0, rel=1e-6)
    eigenvalues = np.linalg.eigvals(
        [[2 * 1.5 * 3.0 - 4.0, 1.5**2], [3.0 - 2 * 1.5 * 3.0, -(1.5**2)]]
    )
    assert fastest_rate(BRUSSELATOR) == pytest.approx(np.abs(eigenvalues).max(), rel=1e-5)


def test_explain_says_what_a_network_is():
    @mc.network(states={"H": 1.0}, inputs=("pressure",))
    def held(t, y, u, p, out):
        out[0] = -1e-2 * y[0]

    scene = mc.load_scene("growth").with_changes(
        {"networks": {"hif": {"network": held, "inputs": {"pressure": "pressure"}}}}
    )
    (words,) = (x["what"] for x in explain(scene)["parts"] if x["part"] == "networks.hif")
    assert "states H" in words
    assert "pressure = pressure" in words
    assert "fastest time scale at the start 100 s of 600 s a step" in words
    assert "no unit of pressure is stated" in words
