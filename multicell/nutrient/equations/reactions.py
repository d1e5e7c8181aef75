"""Reactions between the substances of a field equation."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import NutrientFailed, SceneError
from multicell.nutrient.equations.placed import PlacedSubstance
from multicell.nutrient.reactions.coupled import Coupled, settle_fields
from multicell.nutrient.reactions.inverse import inverse_of_blocks
from multicell.nutrient.reactions.kinetics import Kinetics, kinetics_of
from multicell.nutrient.steady import SolveReport, StepRefused
from multicell.scene.nutrient import MAX_CONCENTRATION

Nodes = Mapping[str, FloatArray]


@final
class Reactions:
    """Reactions that make and use the substances of an equation besides cells.

    - ``substances``: the substances on the grid
    - ``reactions``: see :class:`multicell.FieldEquation`
    - ``tissue``, shape of the grid, optional: part of each place that is tissue

    Raises SceneError for a reaction that names no substance of the equation, or that cannot be
    used, and where tissue is needed and not given.
    """

    def __init__(
        self,
        substances: list[PlacedSubstance],
        reactions: Mapping[str, Any] | Kinetics,
        tissue: FloatArray | None,
    ) -> None:
        self.substances = substances
        names = [each.name for each in substances]
        if isinstance(reactions, Mapping):
            reactions = kinetics_of(names, reactions)
        self.kinetics = reactions
        if self.kinetics.placed and tissue is None:
            hint = "Give the part of each node that is tissue, 0 to 1."
            raise SceneError("tissue", "is missing: a reaction depends on it", hint)
        self.tissue = None
        if tissue is not None:
            filled = np.asarray(tissue, dtype=float)
            nodes = math.prod(substances[0].shape)
            if filled.size != nodes or not ((filled >= 0) & (filled <= 1)).all():
                problem = f"must have {nodes} values from 0 to 1, one for each node"
                raise SceneError("tissue", problem)
            self.tissue = filled.ravel()

    def made(self, nodes: Nodes) -> FloatArray:
        """Return the production of all substances by reactions, (m, ...) mM/s."""
        found, _ = self.kinetics.evaluate(self._flat(nodes), self.tissue)
        return found.reshape(len(self.substances), *self.substances[0].shape)

    def fastest(self, nodes: Nodes) -> float:
        """Return the largest sum of rates of one field at one node, 1/s."""
        _, derivative = self.kinetics.evaluate(self._flat(nodes), self.tissue)
        return float(np.abs(derivative).sum(axis=1).max(initial=0.0))

    def shifted_inverse(
        self, nodes: Nodes, slopes: Nodes
    ) -> Callable[[FloatArray, float], FloatArray]:
        """Return a function of r and a shift (1/s) that gives about (shift - J)⁻¹ r.

        ``slopes`` are those of all other sinks, 1/s.
        """
        _, derivative = self.kinetics.evaluate(self._flat(nodes), self.tissue)
        others = self._flat(slopes)
        operators = [each.operator for each in self.substances]
        last: dict[float, Callable[[FloatArray], FloatArray]] = {}

        def inverse(r: FloatArray, shift: float) -> FloatArray:
            if shift not in last:
                blocks = -derivative
                for i, slope in enumerate(others):
                    blocks[i, i] += slope + shift
                last.clear()
                last[shift] = inverse_of_blocks(operators, blocks)
            return last[shift](r.reshape(len(self.substances), -1)).reshape(r.shape)

        return inverse

    def solution(
        self, start: Nodes, t: float, dt: float, before: Nodes | None
    ) -> tuple[FloatArray, dict[str, SolveReport]]:
        """Return the state of rest with what holds at ``t``, or that ``dt`` s after ``before``."""
        coupled = Coupled(self.substances, self.kinetics, self.tissue, t)
        first = self._flat(start)
        if before is None:
            c = settle_fields(coupled, np.maximum(first, 0.0))
        else:
            c = coupled.implicit_euler(self._flat(before), first, dt)
            if float(c.max()) > MAX_CONCENTRATION:
                names = ", ".join(each.name for each in self.substances)
                problem = f"one of {names} became denser than water"
                raise NutrientFailed(problem, "Look at what is secreted and made of it")
        reports, (made, _) = {}, self.kinetics.evaluate(c, self.tissue)
        volumes = coupled.volumes
        for i, each in enumerate(self.substances):
            nodes, own = (x[i].reshape(each.shape) for x in (c, made))
            a = each.flows(nodes, each.schedule.at(t), own)
            spent = each.linear * float(np.sum(volumes * c[i]))
            supplied = float(np.sum(volumes * coupled.supplies[i]))
            left = abs(a.inflow + supplied + a.made - a.used - a.uptake - spent)
            newton, cg = (coupled.newton, coupled.linear_steps) if i == 0 else (0, 0)
            reports[each.name] = a._replace(newton=newton, cg=cg, residual=left)
        return c, reports

    def ahead(self, nodes: Nodes, begin: float, end: float) -> FloatArray:
        """Return about the most that is there of each substance at the end of a time, (m,) mM.

        By one step through it all. Errors relative to what is there would ask for steps as short
        as the time that has passed since there was nothing.
        """
        c = self._flat(nodes)
        with contextlib.suppress(StepRefused):
            coupled = Coupled(self.substances, self.kinetics, self.tissue, begin)
            c = coupled.implicit_euler(c, c, end - begin)
        return np.asarray(c.max(axis=1))

    def _flat(self, nodes: Nodes) -> FloatArray:
        return np.array([np.ravel(nodes[each.name]) for each in self.substances])
