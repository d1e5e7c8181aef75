"""Checks of a network by its functions alone: its promises, and how stiff it is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import product

import numpy as np

from multicell.cells import FloatArray
from multicell.networks.network import Network
from multicell.networks.solver import Inside, NetworkFailed, NetworkSolver

_AROUND = (1.0, 1.3, 0.7)
"""Factors on the start at which rates are asked for."""
_TIGHT, _AGREE, _SUM = 1e-8, 1e-5, 1e-6  # tolerances, agreement, invariants: in parts
_SLOPE = 1e-2  # in parts of the Jacobian


def faults_of(
    network: Network, invariants: Iterable[Mapping[str, float]], duration: float
) -> Iterator[str]:
    """Yield in words what is wrong with a network; see :func:`multicell.testing.check_network`."""
    solver = NetworkSolver(network, relative=_TIGHT)
    begin = solver.begin(len(_AROUND))
    factors = np.array(_AROUND)[:, None]
    inside = Inside(begin.y * factors, begin.p, begin.memory)
    u = np.tile(np.array(network.defaults, dtype=float), (len(_AROUND), 1))
    before = [x.copy() for x in (inside.y, u, inside.p)]
    found = solver.rates(inside, u, 0.0)
    if not all(map(np.array_equal, before, (inside.y, u, inside.p))):
        yield "it writes into its states, inputs or parameters"
        return
    if not np.isfinite(found).all():
        bad = network.states[int(np.argwhere(~np.isfinite(found))[0, 1])]
        yield f"the rate of {bad} is no finite number near the start"
        return
    if not np.array_equal(found, solver.rates(inside, u, 0.0)):
        yield "it does not give the same bits again"
    if not np.isfinite(solver.observe(inside, u, 0.0)).all():
        yield "an observed value is no finite number near the start"
    yield from _plain(network, inside, u, found)
    yield from _derivative(solver, inside, u)
    yield from _solutions(network, invariants, duration)


def _plain(network: Network, inside: Inside, u: FloatArray, found: FloatArray) -> Iterator[str]:
    """Compare the compiled rates with those of plain Python."""
    rates, out = getattr(network.rates, "py_func", network.rates), np.empty_like(found)
    for given in zip(inside.y.copy(), u.copy(), inside.p.copy(), out, strict=True):
        rates(0.0, *given)
    if not np.allclose(out, found, rtol=1e-9, atol=1e-300):
        yield "compiled, its rates are not those of plain Python"


def _derivative(solver: NetworkSolver, inside: Inside, u: FloatArray) -> Iterator[str]:
    """Compare differences of two lengths."""
    scale = np.abs(inside.y) + solver.absolute / solver.relative
    columns = []
    for part, place in product((1e-4, 5e-5), range(inside.y.shape[1])):
        ends = []
        for sign in (1.0, -1.0):
            y = inside.y.copy()
            y[:, place] += sign * part * scale[:, place]
            ends.append(solver.rates(Inside(y, inside.p, inside.memory), u, 0.0))
        columns.append((ends[0] - ends[1]) / (2.0 * part))
    wide, close = np.split(np.array(columns), 2)
    size = np.abs(close).max(initial=0.0) or 1.0
    if not np.abs(wide - close).max(initial=0.0) <= _SLOPE * size:
        yield "its rates have no derivative near the start: differences of two lengths disagree"


def _solutions(
    network: Network, invariants: Iterable[Mapping[str, float]], duration: float
) -> Iterator[str]:
    """Compare the state after some time by two methods, and sums with those of the start."""
    ends, u = [], np.array([network.defaults], dtype=float)
    for method in ("rodas4", "dormand-prince"):
        solver = NetworkSolver(network, method=method, relative=_TIGHT)
        try:
            ends.append(solver.advance(solver.begin(1), u, u, 0.0, duration).y[0])
        except NetworkFailed as failure:
            yield f"{method} cannot solve it up to {duration:g}: {failure.problem}"
            return
    scale = np.abs(ends[0]) + solver.absolute / solver.relative
    if not (np.abs(ends[0] - ends[1]) <= _AGREE * scale).all():
        yield "two methods do not agree on its solution: are its rates smooth?"
    for invariant in invariants:
        row = np.array([invariant.get(name, 0.0) for name in network.states])
        before, after = (float(row @ y) for y in (solver.begin(1).y[0], ends[0]))
        if not abs(after - before) <= _SUM * (np.abs(row) @ np.abs(ends[0])):
            yield f"the sum over {', '.join(invariant)} goes from {before:g} to {after:g}"


def fastest_rate(network: Network) -> float:
    """Return the size of the fastest rate at the start, in 1 over the network's unit of time."""
    solver = NetworkSolver(network)
    inside, u = solver.begin(1), np.array([network.defaults], dtype=float)
    scale = np.abs(inside.y[0]) + solver.absolute / solver.relative
    here = solver.rates(inside, u, 0.0)
    columns = []
    for place, width in enumerate(1e-6 * scale):
        y = inside.y.copy()
        y[0, place] += width
        moved = solver.rates(Inside(y, inside.p, inside.memory), u, 0.0)
        columns.append((moved - here)[0] / width)
    values = np.linalg.eigvals(np.array(columns).reshape(len(scale), len(scale)).T)
    return float(np.abs(values).max(initial=0.0))
