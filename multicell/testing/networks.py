"""Promises of networks inside cells."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, ClassVar

from multicell.testing.promises import fail_with

if TYPE_CHECKING:
    from multicell.networks.network import Network


def check_network(
    network: Network, *, invariants: Iterable[Mapping[str, float]] = (), duration: float = 1.0
) -> None:
    """Check a network; raise ``AssertionError`` with every requirement that it violates.

    At its start and at states around it, and over a time from there:

    - numba compiles it; rates and observed values are finite numbers, the same if asked twice, and
      states, inputs and parameters are left as they were;
    - compiled it gives what the function gives as plain Python;
    - rates have a derivative: differences of two lengths agree;
    - a Rosenbrock and an explicit method agree on the state after ``duration``;
    - sums that are stated not to change do not.

    Parameters
    ----------
    network
        Made by :func:`multicell.network`, or read from a file.
    invariants
        Name of a state -> its factor, for each sum over states that reactions leave as it is.
    duration
        Time over which it is solved, in its own unit.
    """
    from multicell.networks.conformance import faults_of

    fail_with(network.name, faults_of(network, invariants, duration))


class NetworkTests:
    """Tests of a network; a subclass gives it by a fixture of pytest, and what is known of it.

    ::

        class TestHypoxia(NetworkTests):
            duration = 10.0

            @pytest.fixture
            def network(self):
                return hypoxia
    """

    invariants: ClassVar[Iterable[Mapping[str, float]]] = ()
    """Name of a state -> its factor, for each sum over states that reactions leave as it is."""
    duration: ClassVar[float] = 1.0
    """Time over which it is solved, in its own unit."""

    def test_network_keeps_its_promises(self, network: Network) -> None:
        """All of :func:`check_network`, with the sums that do not change."""
        check_network(network, invariants=self.invariants, duration=self.duration)

    def test_states_have_names_of_their_own(self, network: Network) -> None:
        """States, inputs, parameters and observed values are found by their names."""
        names = [*network.states, *network.inputs, *network.parameters, *network.observed]
        twice = sorted({name for name in names if names.count(name) > 1})
        fail_with(network.name, [f"{name!r} is the name of two things" for name in twice])
