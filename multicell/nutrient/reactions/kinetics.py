"""Rates of reactions between fields, and their derivatives, at all nodes of a grid.

A reaction of a scene proceeds at ``rate`` times c^n of each field that it consumes. Below zero,
where only a solver's iterates and its error can be, rates go on along their tangent at zero: what
is not there is then not consumed, and what a reaction would have taken too much comes back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.compiling import KERNEL, typed
from multicell.errors import SceneError
from multicell.scene.reactions import Reaction
from multicell.schema import build_part, near_miss
from multicell.units import shown

if TYPE_CHECKING:
    from multicell.nutrient.reactions.own import OwnReaction

_jit = typed(**KERNEL)

_PLACES = {"everywhere": 0, "tissue": 1, "medium": 2}


def kinetics_of(names: Sequence[str], reactions: Mapping[str, Any]) -> Kinetics:
    """Return the rates of reactions that are given as parts of a scene, tables or functions.

    - ``reactions``: name -> :class:`~multicell.scene.reactions.Reaction`, a table of its keys, or a
      reaction of the user's own
    """
    listed: list[Reaction] = []
    own: list[OwnReaction] = []
    for name, given in reactions.items():
        path = f"reactions.{name}"
        reaction: Any = given
        if isinstance(given, Mapping):
            reaction = build_part(Reaction, given, path)
        if not isinstance(reaction, Reaction) and not hasattr(reaction, "evaluate"):
            problem = f"is {shown(given)}, must be a reaction"
            raise SceneError(path, problem, "A function becomes one by multicell.reaction.")
        for field in reaction.fields:
            if field not in names:
                raise SceneError(
                    f"{path}.{field}", "is not one of the fields", near_miss(field, names)
                )
        if isinstance(reaction, Reaction):
            listed.append(reaction)
        else:
            own.append(reaction)
    return Kinetics(names, listed, own)


@final
class Kinetics:
    """Rates of reactions between the fields of a grid.

    - ``names``: of the fields, in the order of the rows
    - ``listed``, ``own``: reactions as a scene has them, and those of the user's own

    - ``placed``, ``needs_tissue``: whether a scene's, and whether any may depend on what is tissue
    """

    def __init__(
        self, names: Sequence[str], listed: Sequence[Reaction], own: Sequence[OwnReaction] = ()
    ) -> None:
        self.names = list(names)
        self._own = [(each, [self.names.index(name) for name in each.fields]) for each in own]
        self.placed = any(r.where != "everywhere" for r in listed)
        self.needs_tissue = self.placed or bool(own)
        consumed = [reaction.consumes or {} for reaction in listed]
        self._first = np.cumsum([0, *map(len, consumed)])
        flat = [(self.names.index(name), n) for found in consumed for name, n in found.items()]
        self._field = np.array([field for field, _ in flat], dtype=np.int64)
        self._power = np.array([power for _, power in flat], dtype=np.float64)
        self._rate = np.array([r.rate for r in listed], dtype=np.float64)
        self._place = np.array([_PLACES[r.where] for r in listed], dtype=np.int64)
        self._change = np.array(
            [[r.changes.get(name, 0.0) for name in self.names] for r in listed], dtype=np.float64
        ).reshape(len(listed), len(self.names))

    def evaluate(
        self, c: FloatArray, tissue: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the production of each field by reactions and its derivative.

        - ``c``, (m, nodes), mM
        - ``tissue``, (nodes,): part of each place that is tissue, 0 to 1; needed where
          ``needs_tissue``

        Returns (m, nodes), mM/s; (m, m, nodes), 1/s: of the rate of the first by the concentration
        of the second.
        """
        c = np.ascontiguousarray(c, dtype=np.float64)
        m, nodes = c.shape
        filled = np.zeros(nodes) if tissue is None else np.ascontiguousarray(tissue).ravel()
        out, slope = np.empty((m, nodes)), np.empty((m, m, nodes))
        react(
            c,
            filled,
            self._rate,
            self._place,
            self._first,
            self._field,
            self._power,
            self._change,
            out,
            slope,
        )
        for each, rows in self._own:
            rates, derivative = each.evaluate(c[rows], tissue)
            out[rows] += rates
            slope[np.ix_(rows, rows)] += derivative
        return out, slope


@_jit
def react(
    c: FloatArray,
    tissue: FloatArray,
    rate: FloatArray,
    place: Any,
    first: Any,
    field: Any,
    power: FloatArray,
    change: FloatArray,
    out: FloatArray,
    slope: FloatArray,
) -> None:
    """Write the gain of each field by reactions (mM/s) and its derivative (1/s).

    - ``rate``, (r,): of each reaction, mM^(1 - n)/s or mM/s
    - ``place``, (r,): 0 everywhere, 1 in proportion to tissue, 2 to what is none
    - ``first``, (r + 1,): first factor of each reaction
    - ``field``, ``power``, (factors,): row of the field that a factor depends on, and its exponent
    - ``change``, (r, m): how many of each field a reaction makes
    """
    m, nodes = c.shape
    value, steep = np.empty(field.size), np.empty(field.size)
    for x in range(nodes):
        for i in range(m):
            out[i, x] = 0.0
            for j in range(m):
                slope[i, j, x] = 0.0
        for r in range(rate.size):
            speed = rate[r]
            if place[r] == 1:
                speed *= tissue[x]
            elif place[r] == 2:
                speed *= 1.0 - tissue[x]
            product = speed
            for k in range(first[r], first[r + 1]):
                v, n = max(c[field[k], x], 0.0), power[k]
                below = v ** (n - 1.0)
                value[k], steep[k] = v * below, n * below
                product *= value[k]
            for i in range(m):
                out[i, x] += change[r, i] * product
            for k in range(first[r], first[r + 1]):
                partial = speed * steep[k]
                for other in range(first[r], first[r + 1]):
                    if other != k:
                        partial *= value[other]
                for i in range(m):
                    slope[i, field[k], x] += change[r, i] * partial
        for j in range(m):
            if c[j, x] < 0.0:
                for i in range(m):
                    out[i, x] += slope[i, j, x] * c[j, x]
