"""Networks whose solution is known keep what is asked of the user's own."""

import pytest
from network_models import BRUSSELATOR, DECAY, FORCED, ROBERTSON

import multicell as mc
from multicell.testing import NetworkTests


class TestNetworks(NetworkTests):
    @pytest.fixture(params=[BRUSSELATOR, DECAY, FORCED], ids=lambda network: network.name)
    def network(self, request):
        return request.param


class TestRobertson(NetworkTests):
    invariants = ({"A": 1.0, "B": 1.0, "C": 1.0},)
    duration = 0.1

    @pytest.fixture
    def network(self):
        return ROBERTSON


def test_a_class_that_states_a_sum_that_changes_fails():
    class Wrong(TestRobertson):
        invariants = ({"A": 1.0, "B": 1.0},)

    with pytest.raises(AssertionError, match="sum over A, B"):
        Wrong().test_network_keeps_its_promises(ROBERTSON)


def test_two_things_of_one_name_are_named():
    network = mc.network(states={"A": 1.0}, parameters={"k": 1.0})(decays)
    TestNetworks().test_states_have_names_of_their_own(network)
    twice = mc.network(states={"A": 1.0}, parameters={"k": 1.0})(decays)
    object.__setattr__(twice, "observed", ("A",))
    with pytest.raises(AssertionError, match="'A' is the name of two things"):
        TestNetworks().test_states_have_names_of_their_own(twice)


def decays(t, y, u, p, out):
    out[0] = -p[0] * y[0]
