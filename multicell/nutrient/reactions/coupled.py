"""Fields that react with each other: one implicit step of all of them together, by Newton.

For fields c_i on one grid, with the rates f of the reactions,

    (c_i - b_i) / dt = ∇·(D_i ∇c_i) - m_i c_i - q_i c_i / (K_i + c_i) + s_i + f_i(c),

where b is the state before; the steady state is that of dt = ∞. Newton's linear systems go to GMRES
with the inverse of :mod:`multicell.nutrient.reactions.inverse`.

**No concentration is negative.** A reaction takes nothing of what is not there, so that the exact
solution of a step is not negative. A node that the solver's tolerance leaves below zero (as a rule
at about -1e-13 of the field's largest value) is brought to its own balance, with the others as they
are: its sinks are then zero or proportional to it, the equations of all such nodes are an M-matrix,
and what they gain is not negative (:func:`multicell.nutrient.operators.lifted`). After that the
balance of all is judged anew. Nothing is clipped: a step that does not come out is refused.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.operators import lifted, linearised, source_imbalance
from multicell.nutrient.reactions.inverse import apply_node_blocks, gmres, inverse_of_blocks
from multicell.nutrient.steady import StepRefused

if TYPE_CHECKING:
    from multicell.nutrient.equations.placed import PlacedSubstance
    from multicell.nutrient.reactions.kinetics import Kinetics

COUPLED_TOLERANCE = 1e-12
"""Bound on the sum of all nodes' imbalances of a field, relative to what happens to it."""

_MAX_NEWTON = 30  # Newton steps; a state not found by then is no solution
_MAX_BACKTRACKS = 8  # halvings of a Newton step
_MAX_LIFTS = 8  # times that a state is carried out of a place without a way down
_POLISH = 2  # more steps where rounding would let a state pass whose sums are not exact
_SWEEPS = 1000  # sweeps of such a lift over the nodes
_FORCING = 1e-3  # part of the imbalance that GMRES may leave over
_LARGEST = 1e12  # mM, beyond anything: where an iterate is lost


@final
class Coupled:
    """Fields on one grid with the reactions between them, as they are at a time in s.

    - ``kinetics``: the reactions
    - ``tissue``, (nodes,), optional: part of each place that is tissue

    - ``operators``: diffusion of each field, with its conditions
    - ``sinks``, ``supplies``, (m, nodes), mM/s: largest uptake, and what nodes gain besides, not
      negative
    """

    def __init__(
        self,
        substances: list[PlacedSubstance],
        kinetics: Kinetics,
        tissue: FloatArray | None,
        t: float,
    ) -> None:
        self.kinetics, self.tissue = kinetics, tissue
        levels = [each.schedule.at(t) for each in substances]
        pairs = list(zip(substances, levels, strict=True))
        self.operators = [each.at(level) for each, level in pairs]
        self.sinks = np.array([each.sink.ravel() for each in substances])
        self.supplies = np.array([each.supply(level).ravel() for each, level in pairs])
        self.half = np.array([each.substance.half_saturation for each in substances])
        self.linear = np.array([each.linear for each in substances])
        self.m, self.nodes = self.sinks.shape
        self.shape = substances[0].shape
        self.volumes = np.broadcast_to(np.ravel(self.operators[0].volumes), (self.nodes,))
        self.newton = self.linear_steps = 0

    def sources(self) -> FloatArray:
        """Return the gain of nodes by supply and over the sides, (m, nodes) mM/s."""
        faces = np.array([op.brought().ravel() for op in self.operators])
        return np.asarray(faces + self.supplies)

    def implicit_euler(self, before: FloatArray, start: FloatArray, dt: float) -> FloatArray:
        """Return the state a step of ``dt`` s later, or the steady state where that is infinite.

        - ``before``, ``start``, (m, nodes), mM: state before, not negative, and first guess
        """
        return _Newton(self, before, dt).solve(start)

    def _balance(
        self, c: FloatArray, sources: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return ∂c/∂t, slopes of all sinks (m, nodes), and rates of reactions and slopes."""
        made, slope = self.kinetics.evaluate(c, self.tissue)
        out, sinks = np.empty_like(c), np.empty_like(c)
        for i, op in enumerate(self.operators):
            nodes, sink, source = (x[i].reshape(self.shape) for x in (c, self.sinks, sources))
            rate, each = source_imbalance(op, nodes, sink, source, self.half[i], self.linear[i])
            out[i], sinks[i] = rate.ravel() + made[i], each.ravel()
        return out, sinks, made, slope


@final
class _Newton:
    """The equations of one step, and their solution."""

    def __init__(self, coupled: Coupled, before: FloatArray, dt: float) -> None:
        self.coupled, self.before = coupled, before
        self.rate = 0.0 if math.isinf(dt) else 1.0 / dt
        self.gained = coupled.supplies + self.rate * before
        self.sources = coupled.sources() + self.rate * before
        quick = [op.fastest() for op in coupled.operators]
        self.quick = np.array(quick) + coupled.linear + self.rate

    def solve(self, start: FloatArray) -> FloatArray:
        c, lifts, polished = np.array(start), 0, 0
        self._evaluate(c)
        for _ in range(_MAX_NEWTON):
            if not np.isfinite(self.sizes).all() or not float(np.abs(c).max()) < _LARGEST:
                break
            if (self.sizes <= self.targets).all():
                if c.min() >= 0.0:
                    if polished == _POLISH or (self.sums <= self.exact).all():
                        return c
                    trial, polished = c + self._correction(c), polished + 1
                    self._evaluate(trial)
                    if not (self.sizes <= self.targets).all():
                        return c
                    c = trial
                    continue
                if lifts == _MAX_LIFTS:
                    break
                c, lifts = self._lift(c), lifts + 1
                self._evaluate(c)
                continue
            c = self._improve(c)
        raise StepRefused

    def _evaluate(self, c: FloatArray) -> None:
        """Find the imbalances of a state, their sums, and what these may be, amol/s.

        ``sizes`` are sums of absolute values, of which rounding is a part, ``sums`` are not.
        """
        coupled, v = self.coupled, self.coupled.volumes
        rate, self.slopes, made, self.derivative = coupled._balance(c, self.sources)
        self.residual = rate - self.rate * c
        self.sizes = np.sum(np.abs(self.residual) * v, axis=1)
        # what passes a side to and fro is no measure: the net of it may be far less
        pulled = self.pulled(c)
        happening = np.abs(made) + (self.slopes + self.rate) * np.abs(c) - pulled + self.gained
        gross = np.einsum("ijx,jx->ix", np.abs(self.derivative), np.abs(c))
        rounding = self.quick[:, None] * np.abs(c) + gross + np.abs(self.sources) + pulled
        floor = 16.0 * float(np.finfo(float).eps) * np.sum(rounding * v, axis=1)
        self.exact = COUPLED_TOLERANCE * np.sum(happening * v, axis=1)
        self.targets = np.maximum(self.exact, floor)
        self.sums = np.abs(np.sum(self.residual * v, axis=1))

    def pulled(self, c: FloatArray) -> FloatArray:
        """Return the loss of nodes to the medium with which they exchange, (m, nodes) mM/s."""
        out = np.zeros_like(c)
        for i, op in enumerate(self.coupled.operators):
            if isinstance(op, Diffusion) and op.exchange is not None:
                out[i] = op.exchange.ravel() * np.abs(c[i])
        return out

    def _improve(self, c: FloatArray) -> FloatArray:
        """Return a state with smaller imbalances."""
        correction = self._correction(c)
        worst, share = self._measure(), 1.0
        for _ in range(_MAX_BACKTRACKS):
            trial = c + share * correction
            self._evaluate(trial)
            now = self._measure()
            if now < worst * (1.0 - 1e-4 * share) or (self.sizes <= self.targets).all():
                return trial
            share *= 0.5
        raise StepRefused

    def _measure(self) -> float:
        found = float((self.sizes / self.scale).max())
        return found if math.isfinite(found) else math.inf

    def _correction(self, c: FloatArray) -> FloatArray:
        """Solve Newton's linear system."""
        coupled, m, n = self.coupled, self.coupled.m, self.coupled.nodes
        self.scale = np.where(self.targets > 0.0, self.targets, 1.0) / COUPLED_TOLERANCE
        # each field in a unit of its own, so that none is lost beside the others
        size = np.maximum(np.abs(c).max(axis=1), np.abs(self.residual).max(axis=1) / self.quick)
        size = np.where(size > 0.0, size, float(size.max()) or 1.0)[:, None]
        blocks = -self.derivative
        for i in range(m):
            blocks[i, i] += self.slopes[i] + self.rate
        inverse = inverse_of_blocks(coupled.operators, blocks)
        none = np.zeros(coupled.shape)

        def product(x: FloatArray) -> FloatArray:
            v = x.reshape(m, n) * size
            out = apply_node_blocks(blocks, v)
            for i, op in enumerate(coupled.operators):
                out[i] += linearised(op, v[i].reshape(coupled.shape), none).ravel()
            return (out / size).ravel()

        def about(r: FloatArray) -> FloatArray:
            return (inverse(r.reshape(m, n) * size) / size).ravel()

        right = (self.residual / size).ravel()
        x, taken = gmres(product, about, right, _FORCING)
        coupled.linear_steps += taken
        coupled.newton += 1
        return x.reshape(m, n) * size

    def _lift(self, c: FloatArray) -> FloatArray:
        """Return the state with no node below zero, unless that takes too many sweeps."""
        coupled = self.coupled
        kept = np.maximum(c, 0.0)
        made, _ = coupled.kinetics.evaluate(kept, coupled.tissue)
        out = c.copy()
        for i, op in enumerate(coupled.operators):
            if not c[i].min() < 0.0:
                continue
            gain = np.maximum(made[i], 0.0) + self.sources[i]
            loss = np.maximum(-made[i], 0.0) / np.where(kept[i] > 0.0, kept[i], 1.0)
            nodes, sink, source, taken = (
                x.reshape(coupled.shape) for x in (c[i], coupled.sinks[i], gain, loss)
            )
            linear = coupled.linear[i] + self.rate
            found = lifted(op, nodes, sink, source, coupled.half[i], linear, taken, _SWEEPS)
            out[i] = found.ravel()
        return out


def settle_fields(coupled: Coupled, c: FloatArray, most: int = 200) -> FloatArray:
    """Return the state in which fields rest, reached from ``c`` (m, nodes) in mM.

    Steps of implicit Euler that lengthen from one to the next, the last one without end: from where
    they start they follow the true course, and do not end in states that are unstable.
    """
    rates = np.sum(np.abs(coupled._balance(c, coupled.sources())[0]) * coupled.volumes, axis=1)
    held = np.sum(np.abs(c) * coupled.volumes, axis=1)
    quick = float((rates / np.where(held > 0.0, held, held.max() or 1.0)).max())
    dt = 0.1 / quick if quick > 0.0 else math.inf
    for _ in range(most):
        try:
            after = coupled.implicit_euler(c, c, dt)
        except StepRefused:
            dt *= 0.1
            continue
        if math.isinf(dt):
            return after
        size = np.abs(after).max(axis=1, keepdims=True)
        change = float((np.abs(after - c) / np.where(size > 0.0, size, 1.0)).max())
        c = after
        # at rest to a part in a million, or still on the way
        dt = math.inf if change < 1e-6 else dt * min(10.0, max(2.0, 0.3 / change))
    raise NutrientFailed(
        f"no steady state of {', '.join(coupled.kinetics.names)} was found",
        "Perhaps there is none: let them be transient (regime = 'transient')",
    )
