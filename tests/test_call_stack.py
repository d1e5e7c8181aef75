"""Calls of Python that find room: none asks the system for memory, at whatever depth it stands."""

import sys

import pytest

from multicell.host.call_stack import call_with_room

resource = pytest.importorskip("resource")

CALLS = 300

pytestmark = pytest.mark.skipif(
    sys.implementation.name != "cpython", reason="other Pythons keep frames elsewhere"
)


def nothing():
    pass


def faults_of_a_loop():
    """Return how many pages a loop of calls has asked the system for."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(CALLS):
        nothing()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def at_depth(depth):
    return faults_of_a_loop() if depth == 0 else at_depth(depth - 1)


def worst():
    """Return the most of all depths: a chunk of 16 KB is full after some 150 calls."""
    return max(at_depth(depth) for depth in range(400))


def test_no_depth_makes_a_loop_of_calls_ask_for_memory():
    assert call_with_room(worst) < CALLS / 10


def test_without_room_some_depth_does():
    """Reason of the module: where Python no longer does so, it can go."""
    assert worst() >= CALLS


def test_values_and_errors_come_through():
    assert call_with_room(lambda: 3) == 3
    with pytest.raises(KeyError):
        call_with_room({}.popitem)
    assert call_with_room(lambda: call_with_room(lambda: sys.getrecursionlimit())) > 0
