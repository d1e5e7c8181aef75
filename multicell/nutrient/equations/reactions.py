"""Reactions between the substances of a field equation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.nutrient.equations.term import Term
from multicell.nutrient.reactions.coupled import Coupled, settle
from multicell.nutrient.reactions.inverse import inverse_of_blocks
from multicell.nutrient.reactions.kinetics import FixedForms, growth_rate, kinetics_of
from multicell.nutrient.steady import SolveReport
from multicell.scene.nutrient import MOST

Nodes = Mapping[str, FloatArray]


@final
class Reactions:
    """What makes and uses the substances of an equation besides cells.

    Parameters
    ----------
    terms
        The substances on the grid.
    reactions
        See :class:`multicell.FieldEquation`.
    tissue : shape of the grid, optional
        Part of each place that is tissue.

    Raises
    ------
    SceneError
        For a reaction that names no substance of the equation, or that cannot be used, and where
        tissue is needed and not given.
    """

    def __init__(
        self, terms: list[Term], reactions: Mapping[str, Any], tissue: FloatArray | None
    ) -> None:
        self.terms = terms
        self.shape = terms[0].shape
        self.kinetics = kinetics_of([term.name for term in terms], reactions)
        if isinstance(self.kinetics, FixedForms) and self.kinetics.needs_tissue and tissue is None:
            hint = "Give the part of each node that is tissue, 0 to 1."
            raise SceneError("tissue", "is missing: a reaction depends on it", hint)
        self.tissue = None
        if tissue is not None:
            filled = np.asarray(tissue, dtype=float)
            if filled.size != np.prod(self.shape) or not ((filled >= 0) & (filled <= 1)).all():
                problem = f"must have {np.prod(self.shape)} values from 0 to 1, one for each node"
                raise SceneError("tissue", problem)
            self.tissue = filled.ravel()

    def made(self, nodes: Nodes) -> FloatArray:
        """Return what reactions make of all substances, (m, ...) mM/s."""
        found, _ = self.kinetics.evaluate(self._flat(nodes), self.tissue)
        return found.reshape(len(self.terms), *self.shape)

    def shifted_inverse(
        self, nodes: Nodes, slopes: Nodes
    ) -> Callable[[FloatArray, float], FloatArray]:
        """Return a function of r and a shift (1/s) that gives about (shift - J)⁻¹ r.

        ``slopes`` are those of all other sinks, 1/s.
        """
        _, derivative = self.kinetics.evaluate(self._flat(nodes), self.tissue)
        others = self._flat(slopes)
        operators = [term.operator for term in self.terms]
        last: dict[float, Callable[[FloatArray], FloatArray]] = {}

        def inverse(r: FloatArray, shift: float) -> FloatArray:
            if shift not in last:
                blocks = -derivative
                for i, slope in enumerate(others):
                    blocks[i, i] += slope + shift
                last.clear()
                last[shift] = inverse_of_blocks(operators, blocks)
            return last[shift](r.reshape(len(self.terms), -1)).reshape(r.shape)

        return inverse

    def steady(self, nodes: Nodes, t: float) -> tuple[FloatArray, dict[str, SolveReport]]:
        """Return the state of rest with what holds at a time in s, and what it took.

        Raises
        ------
        NutrientFailed
        """
        levels = [term.schedule.at(t) for term in self.terms]
        supplies = [
            term.secreted + term.supplied + term.substance.perfusion * level
            for term, level in zip(self.terms, levels, strict=True)
        ]
        coupled = Coupled(
            [term.operator_at(level) for term, level in zip(self.terms, levels, strict=True)],
            np.array([term.sink.ravel() for term in self.terms]),
            np.array([supply.ravel() for supply in supplies]),
            np.array([term.substance.half_saturation for term in self.terms]),
            np.array([term.linear for term in self.terms]),
            self.kinetics,
            self.tissue,
        )
        c = settle(coupled, np.maximum(self._flat(nodes), 0.0))
        reports = {}
        for i, (term, a) in enumerate(zip(self.terms, coupled.account(c), strict=True)):
            spent = term.linear * a.mass
            left = abs(a.inflow + a.supplied + a.made - a.used - a.uptake - spent)
            newton, linear = (coupled.newton, coupled.linear_steps) if i == 0 else (0, 0)
            reports[term.name] = SolveReport(
                newton, linear, left, a.inflow, a.uptake, spent, a.supplied, a.outflow
            )
        return c, reports

    def growing(self, nodes: Nodes) -> str:
        """Return which substance has grown beyond all that dissolves and how fast, in words."""
        c = self._flat(nodes)
        row, node = np.unravel_index(int(np.argmax(np.where(np.isfinite(c), c, -1.0))), c.shape)
        value = float(c[row, node])
        if not value > MOST:
            return ""
        tissue = None if self.tissue is None else self.tissue[node : node + 1]
        _, derivative = self.kinetics.evaluate(np.ascontiguousarray(c[:, node : node + 1]), tissue)
        losses = np.array([term.linear for term in self.terms])
        if not np.isfinite(derivative).all():
            return f"{self.terms[row].name} grows without bound, and is {value:.3g} mM"
        growth, field = growth_rate(derivative[:, :, 0], losses)
        if not growth > 0.0:
            return ""
        return (
            f"{self.terms[field].name} grows without bound: it has come to "
            f"{float(c[field, node]):.3g} mM, and reactions make it grow by {growth:.3g} 1/s more "
            "than decay and perfusion take"
        )

    def _flat(self, nodes: Nodes) -> FloatArray:
        return np.array([np.ravel(nodes[term.name]) for term in self.terms])
