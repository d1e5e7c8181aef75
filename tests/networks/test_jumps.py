"""Rates that jump: an ``if`` on a state is crossed with the right numbers, or refused in words."""

from __future__ import annotations

import numpy as np
import pytest
from network_models import network, rows

from multicell.networks.loop import CELL_STEPS
from multicell.networks.network import Event
from multicell.networks.solver import NetworkFailed, NetworkSolver

METHODS = ["auto", "rodas3", "rodas4", "dormand-prince"]


def _relay(t, y, u, p, out):
    out[0] = -1.0 if y[0] < 1.0 else -1000.0


RELAY = network(_relay, {"A": 1.5})


@pytest.mark.parametrize("relative", [1e-3, 1e-4, 1e-7, 1e-10])
@pytest.mark.parametrize("method", METHODS)
def test_a_relay_is_crossed_at_its_time(method, relative):
    # y = 1 is reached after (start - 1) / 1000; then it falls at the rate 1
    starts = 1.0 + np.geomspace(1e-13, 0.5, 400)
    solver = NetworkSolver(RELAY, method=method, relative=relative)
    inside = solver.begin(len(starts))
    inside.y[:, 0] = starts
    inside = solver.advance(inside, rows(len(starts)), rows(len(starts)), 0.0, 0.75)
    want = 1.0 - (0.75 - (starts - 1.0) / 1000.0)
    # an explicit estimate hardly sees a jump near the end of a step
    most = 80.0 if method.startswith("rodas") else 200.0
    np.testing.assert_allclose(inside.y[:, 0], want, atol=most * relative)
    assert solver.work[CELL_STEPS] < 150 * len(starts)


@pytest.mark.parametrize("method", ["rodas3", "rodas4"])
def test_a_jump_within_the_difference_of_a_jacobian_holds_no_state(method):
    starts = 1.0 + np.array([-1e-8, -1e-9, -1e-10, -1e-12, 0.0, 1e-12, 1e-10, 1e-9, 1e-8])
    solver = NetworkSolver(RELAY, method=method, relative=1e-6)
    inside = solver.begin(len(starts))
    inside.y[:, 0] = starts
    inside = solver.advance(inside, rows(len(starts)), rows(len(starts)), 0.0, 0.5)
    np.testing.assert_allclose(inside.y[:, 0], 0.5, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_a_stiff_neighbour_does_not_stall_at_a_relay(method):
    def rates(t, y, u, p, out):
        out[0] = 1.0 if y[0] < 0.5 else 3.0
        out[1] = -1e4 * (y[1] - y[0])

    solver = NetworkSolver(network(rates, {"A": 0.0, "B": 0.0}), method=method, relative=1e-5)
    inside = solver.advance(solver.begin(1), rows(1), rows(1), 0.0, 1.0)
    assert inside.y[0] == pytest.approx([2.0, 2.0 - 3e-4], abs=2e-4)


@pytest.mark.parametrize("method", METHODS)
def test_hysteresis_by_two_events_has_its_period(method):
    # y' = k (on) or -k (off); on below 1, off above 2: a period of 2 / k
    def rates(t, y, u, p, out):
        out[0] = p[0]

    def low(t, y, u, p):
        return 1.0 - y[0]

    def high(t, y, u, p):
        return y[0] - 2.0

    def up(t, y, u, p, y_then, p_then):
        p[0] = 3.0

    def down(t, y, u, p, y_then, p_then):
        p[0] = -3.0

    events = (Event("low", low, up), Event("high", high, down))
    model = network(rates, {"A": 1.5}, parameters={"k": 3.0}, events=events)
    solver = NetworkSolver(model, method=method, relative=1e-8)
    inside, seen = solver.begin(1), []
    for step in range(30):
        inside = solver.advance(inside, rows(1), rows(1), 0.7 * step, 0.7)
        seen.append(inside.y[0, 0])
    times = 0.7 * np.arange(1, 31) + 1.0 / 6.0
    want = 1.0 + np.abs((3.0 * times) % 2.0 - 2.0 * ((3.0 * times) % 2.0 > 1.0))
    np.testing.assert_allclose(seen, want, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("span", [1.0, 1e3, 1e6])
def test_sliding_is_followed_or_refused_within_bounded_work(method, span):
    def rates(t, y, u, p, out):
        out[0] = 1.0 if y[0] < 1.0 else -2.0

    solver = NetworkSolver(network(rates, {"A": 0.5}), method=method, relative=1e-6)
    with pytest.raises(NetworkFailed, match="jump to and fro") as failed:
        solver.advance(solver.begin(500), rows(500), rows(500), 0.0, span)
    assert failed.value.row == 0
    assert failed.value.time == pytest.approx(0.5, rel=0.2)
