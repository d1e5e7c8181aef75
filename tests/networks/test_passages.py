"""When a value of a network passes a level within a step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from network_models import BRUSSELATOR, CLOCK, network, rows

from multicell.networks.solver import NetworkSolver


def turning(t, y, u, p, out):
    """Write the rates of a point on a circle."""
    out[0], out[1] = y[1], -y[0]


def squared(t, y, u, p, out):
    out[0] = y[0] * y[0] + u[0]


CIRCLE = network(
    turning, {"s": 0.0, "c": 1.0}, inputs={"drive": 0.0}, parameters={"k": 3.0},
    observed=("square",), observe=squared,
)  # fmt: skip


def _met(name, sign, level, since=0.0, *, method="auto", relative=1e-6, span=8.0, solver=None):
    solver = solver or NetworkSolver(CIRCLE, method=method, relative=relative)
    waiting = np.array([[solver.place_of(name), sign, level, since]])
    begin = solver.begin(1)
    found = solver.advance(begin, rows(1, 0.0), rows(1, 4.0), 0.0, span, waiting=waiting)
    plain = solver.advance(begin, rows(1, 0.0), rows(1, 4.0), 0.0, span)
    assert found.y.tobytes() == plain.y.tobytes()  # who watches changes nothing
    assert found.memory.tobytes() == plain.memory.tobytes()
    return found.met[0]


@pytest.mark.parametrize("method", ["auto", "rodas3", "rodas4", "dormand-prince"])
@pytest.mark.parametrize(("name", "sign", "level", "since", "want"), [
    ("s", 1.0, 0.6, 0.0, math.asin(0.6)),
    ("s", 1.0, 0.6, 1.0, 1.0),  # it is beyond the level already
    ("s", 1.0, 0.6, 3.0, 2.0 * math.pi + math.asin(0.6)),
    ("s", -1.0, -0.6, 0.0, math.pi + math.asin(0.6)),
    ("s", 1.0, 1.1, 0.0, math.inf),
    ("s", 1.0, 0.6, 9.0, math.inf),
    ("s", 1.0, 0.6, math.inf, math.inf),
    ("c", 1.0, 0.5, 0.0, 0.0),
    ("drive", 1.0, 1.0, 0.0, 2.0),
    ("k", 1.0, 2.0, 0.5, 0.5),
    ("k", 1.0, 4.0, 0.5, math.inf),
])  # fmt: skip
def test_the_passage_of_a_circle_is_found(method, name, sign, level, since, want):
    assert _met(name, sign, level, since, method=method) == pytest.approx(want, abs=1e-4)


def test_an_observed_value_passes_with_its_input():
    # sin² t + t/2 = 1.2
    found = _met("square", 1.0, 1.2, relative=1e-9)
    assert math.sin(found) ** 2 + 0.5 * found == pytest.approx(1.2, abs=1e-6)


@pytest.mark.parametrize(("method", "order"), [("rk4", 4), ("euler", 1)])
def test_the_time_of_a_passage_has_the_order_of_the_method(method, order):
    lengths, errors = [0.2, 0.1, 0.05, 0.025], []
    for length in lengths:
        solver = NetworkSolver(CIRCLE, method=method, length=length)
        found = _met("s", -1.0, -0.6, solver=solver)
        errors.append(abs(found - math.pi - math.asin(0.6)))
    slope = np.polyfit(np.log(lengths), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.25)


def test_a_narrow_pulse_is_seen_and_each_cell_has_its_own_level():
    solver = NetworkSolver(BRUSSELATOR, relative=1e-5)
    u = rows(3, 0.0)
    levels = np.array([2.0, 3.0, 9.0])
    waiting = np.stack([np.zeros(3), np.ones(3), levels, np.full(3, 2.0)], axis=1)
    begin = solver.begin(3)
    whole = solver.advance(begin, u, u, 0.0, 10.0, waiting=waiting)
    assert np.isinf(whole.met[2])  # its pulse is lower
    for row in (0, 1):
        time = np.full(3, whole.met[row])
        end = solver.advance(begin, u, u, 0.0, time).y[row, 0]
        assert end == pytest.approx(levels[row], rel=1e-3)
    # in steps of another length the time is the same
    inside, met, t = begin, np.full(3, np.inf), 0.0
    while t < 10.0:
        inside = solver.advance(inside, u, u, t, 0.37, waiting=waiting)
        met, t = np.minimum(met, inside.met), t + 0.37
    np.testing.assert_allclose(met[:2], whole.met[:2], rtol=1e-3)


def test_what_an_event_changes_counts_from_then_on():
    solver = NetworkSolver(CLOCK, relative=1e-6)
    waiting = np.array([[solver.place_of("rounds"), 1.0, 0.5, 0.0]])
    none = np.empty((1, 0))
    found = solver.advance(solver.begin(1), none, none, 0.0, 1.0, waiting=waiting)
    assert found.met[0] == pytest.approx(0.7, abs=1e-6)


@pytest.mark.parametrize("threads", [1, 2])
def test_passages_have_the_same_bits_for_any_threads(threads):
    count = 600
    levels = np.linspace(-0.9, 0.9, count)
    waiting = np.stack([np.zeros(count), np.ones(count), levels, np.zeros(count)], axis=1)
    u = rows(count, 0.0)
    one, other = (
        NetworkSolver(CIRCLE, threads=k).advance(
            NetworkSolver(CIRCLE).begin(count), u, u, 0.0, 5.0, waiting=waiting
        )
        for k in (1, threads)
    )
    assert one.met.tobytes() == other.met.tobytes()
    np.testing.assert_allclose(one.met, np.where(levels > 0, np.arcsin(levels), 0.0), atol=1e-3)
