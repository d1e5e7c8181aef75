"""Events of networks: times by roots, order, and what simultaneous ones do."""

from __future__ import annotations

import math

import numpy as np
import pytest
from network_models import CLOCK, network, rows

from multicell.networks.network import Event
from multicell.networks.solver import NetworkFailed, NetworkSolver


def _run(model, end, steps=1, **options):
    solver = NetworkSolver(model, relative=1e-8, **options)
    inside, span = solver.begin(1), end / steps
    for step in range(steps):
        inside = solver.advance(inside, rows(1), rows(1), step * span, span)
    return inside, solver


@pytest.mark.parametrize("method", ["auto", "rodas3", "rodas4", "dormand-prince"])
@pytest.mark.parametrize("steps", [1, 3, 17])
def test_a_value_that_is_reset_counts_its_rounds(method, steps):
    inside, solver = _run(CLOCK, 10.0, steps, method=method)
    assert inside.y[0].tolist() == pytest.approx([10.0 % 0.7, math.floor(10.0 / 0.7)], abs=1e-9)
    assert solver.work[3] == 14


def test_the_time_of_an_event_is_a_root():
    def fall(t, y, u, p, out):
        out[0] = y[1]
        out[1] = -9.81

    def ground(t, y, u, p):
        return -y[0]

    def bounce(t, y, u, p, y_then, p_then):
        y[0] = 0.0
        y[1] = -0.5 * y_then[1]

    ball = network(fall, {"height": 1.0, "speed": 0.0}, events=(Event("bounce", ground, bounce),))
    first = math.sqrt(2.0 / 9.81)
    speed = 0.5 * 9.81 * first
    second = first + 2.0 * speed / 9.81
    end = 0.5 * (first + second)
    inside, _ = _run(ball, end)
    assert inside.y[0, 1] == pytest.approx(speed - 9.81 * (end - first), abs=1e-8)
    inside, solver = _run(ball, second + 0.05)
    assert solver.work[3] == 2
    assert inside.y[0, 1] == pytest.approx(0.5 * speed - 9.81 * 0.05, abs=1e-7)


def _idle(t, y, u, p, out):
    out[:] = 0.0


def _late(t, y, u, p):
    return t - 1.0


def test_a_pulse_within_a_long_step_is_seen():
    def on(t, y, u, p):
        return 1.0 if 4.2 < t < 6.9 else -1.0

    def count(t, y, u, p, y_then, p_then):
        y[0] = y_then[0] + 1.0

    inside, _ = _run(network(_idle, {"n": 0.0}, events=(Event("on", on, count),)), 10.0)
    assert inside.y[0, 0] == 1.0


def _pair(first, second, **options):
    return network(
        _idle,
        {"x": 1.0, "y": 2.0},
        events=(Event("one", _late, first, **options), Event("two", _late, second)),
    )


def test_simultaneous_events_take_values_from_before_both():
    def first(t, y, u, p, y_then, p_then):
        y[0] = y_then[1]

    def second(t, y, u, p, y_then, p_then):
        y[1] = y_then[0]

    inside, _ = _run(_pair(first, second), 2.0)
    assert inside.y[0].tolist() == [2.0, 1.0]  # they are swapped


def test_the_event_with_priority_is_first_and_the_last_one_stays():
    def first(t, y, u, p, y_then, p_then):
        y[0] = 5.0

    def second(t, y, u, p, y_then, p_then):
        y[0] = 1.0  # what it has been before both

    assert _run(_pair(first, second), 2.0)[0].y[0, 0] == 1.0
    assert _run(_pair(first, second, priority=1.0), 2.0)[0].y[0, 0] == 1.0
    later = network(
        _idle,
        {"x": 1.0},
        events=(Event("one", _late, first), Event("two", _late, second, priority=1.0)),
    )
    assert _run(later, 2.0)[0].y[0, 0] == 5.0


@pytest.mark.parametrize(("persistent", "want"), [(True, 7.0), (False, 2.0)])
def test_an_event_whose_condition_another_one_undoes(persistent, want):
    def once(t, y, u, p):
        return min(t - 1.0, 0.5 - y[0])

    def shut(t, y, u, p, y_then, p_then):
        y[0] = 1.0

    def write(t, y, u, p, y_then, p_then):
        y[1] = 7.0

    model = network(
        _idle,
        {"x": 0.0, "y": 2.0},
        events=(
            Event("shut", _late, shut, priority=1.0),
            Event("write", once, write, persistent=persistent),
        ),
    )
    assert _run(model, 2.0)[0].y[0, 1] == want


@pytest.mark.parametrize(("initial", "want"), [(True, 0.0), (False, 1.0)])
def test_a_condition_that_holds_at_the_start(initial, want):
    def always(t, y, u, p):
        return 1.0

    def count(t, y, u, p, y_then, p_then):
        y[0] = y_then[0] + 1.0

    model = network(_idle, {"n": 0.0}, events=(Event("start", always, count, initial=initial),))
    assert _run(model, 2.0, steps=4)[0].y[0, 0] == want


def test_one_event_sets_off_another_and_parameters_stay_changed():
    def first(t, y, u, p, y_then, p_then):
        p[0] = 3.0

    def high(t, y, u, p):
        return p[0] - 2.0

    def second(t, y, u, p, y_then, p_then):
        y[0] = 10.0 * p_then[0]

    model = network(
        _idle,
        {"x": 0.0},
        parameters={"k": 1.0},
        events=(Event("one", _late, first), Event("two", high, second)),
    )
    inside, _ = _run(model, 2.0, steps=3)
    assert (inside.y[0, 0], inside.p[0, 0]) == (30.0, 3.0)


def test_an_input_that_jumps_between_steps_fires():
    def high(t, y, u, p):
        return u[0] - 0.5

    def count(t, y, u, p, y_then, p_then):
        y[0] = y_then[0] + 1.0

    model = network(_idle, {"n": 0.0}, inputs={"x": 0.0}, events=(Event("high", high, count),))
    solver = NetworkSolver(model)
    inside = solver.advance(solver.begin(2), rows(2, 0.0), rows(2, 0.0), 0.0, 1.0)
    inside = solver.advance(inside, np.array([[1.0], [0.0]]), np.array([[1.0], [0.0]]), 1.0, 1.0)
    assert inside.y[:, 0].tolist() == [1.0, 0.0]


def test_events_that_set_off_each_other_are_an_error_in_words():
    def low(t, y, u, p):
        return min(t - 1.0, 0.5 - y[0])

    def high(t, y, u, p):
        return min(t - 1.0, y[0] - 0.5)

    def up(t, y, u, p, y_then, p_then):
        y[0] = 1.0

    def down(t, y, u, p, y_then, p_then):
        y[0] = 0.0

    model = network(_idle, {"x": 0.0}, events=(Event("up", low, up), Event("down", high, down)))
    with pytest.raises(NetworkFailed, match="each other"):
        _run(model, 2.0)
