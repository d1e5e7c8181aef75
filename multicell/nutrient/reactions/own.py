"""Reactions of the user's own: a Python function of concentrations becomes a reaction.

>>> import multicell as mc
>>> @mc.reaction(fields=("u", "v"))
... def predation(concentrations, cell):
...     u, v = concentrations
...     eaten = 0.02 * u * v
...     return -eaten, 0.5 * eaten
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from inspect import signature
from typing import Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.nutrient.reactions.own_kernels import Cell, Rate, all_nodes, type_of
from multicell.plugins.named import own_fault

_ARGUMENTS = ("concentrations", "cell")


@final
@dataclass(frozen=True, eq=False)
class OwnReaction:
    """A reaction made by :func:`reaction`.

    Attributes
    ----------
    fields
        Names of the fields that it depends on and changes.
    rate
        The function.
    upto : float, mM
        Largest concentration that it was made for.
    """

    fields: tuple[str, ...]
    rate: Rate
    upto: float
    _type: Any

    def evaluate(
        self, c: FloatArray, tissue: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return rates and derivative as :meth:`~.kinetics.Kinetics.evaluate`."""
        c = np.ascontiguousarray(c, dtype=np.float64)
        m, nodes = c.shape
        filled = np.zeros(nodes) if tissue is None else np.ascontiguousarray(tissue).ravel()
        out, slope = np.empty((m, nodes)), np.empty((m, m, nodes))
        all_nodes(self._type(1.0), c, filled, out, slope)
        return out, slope

    def __call__(self, concentrations: Sequence[float], cell: Cell | None = None) -> FloatArray:
        """Return the rates at a place, by plain Python, (m,) mM/s."""
        given = tuple(float(x) for x in concentrations)
        return np.asarray(self.rate(given, cell or Cell(1.0)), dtype=float)


def reaction(*, fields: Sequence[str], upto: float = 1.0) -> Callable[[Rate], OwnReaction]:
    """Make a reaction of a function of bare floats.

    The function is called as ``rate(concentrations, cell)`` with a tuple of the concentrations of
    ``fields`` in mM, none below zero, and ``cell.tissue``, the part of the place that is tissue. It
    returns what becomes of each field in mM/s, a tuple of as many floats. It is compiled:
    arithmetic on floats, :mod:`math` and other such functions are what it may use. Its derivative
    is found by central differences with steps of 1e-5 of each concentration.

    Parameters
    ----------
    fields
        Names of the fields, in the order of the concentrations.
    upto : float, mM
        Largest concentration that it is meant for: up to there it is tried.

    Returns
    -------
    What :class:`multicell.FieldEquation` and :func:`multicell.run` take as a reaction.

    Raises
    ------
    SceneError
        For a function with other arguments or of which another number of rates comes, that is not
        finite, cannot be compiled, takes of a field where there is none, or whose derivative is not
        found, since its rates jump.
    """

    def make(rate: Rate) -> OwnReaction:
        path = f"reaction.{getattr(rate, '__name__', 'rate')}"
        _check_form(path, rate, fields, upto)
        made = OwnReaction(tuple(fields), rate, upto, type_of(rate, fields))
        _compile(path, made)
        from multicell.nutrient.reactions.check import problems

        found = problems(made)
        if found:
            raise SceneError(path, found[0], " ".join(found[1:]))
        return made

    return make


def _check_form(path: str, rate: Any, fields: Sequence[str], upto: float) -> None:
    if isinstance(fields, str) or not fields or len(set(fields)) != len(fields):
        raise SceneError(f"{path}.fields", f"are {fields!r}, must be a list of names, each once")
    if tuple(signature(rate).parameters) != _ARGUMENTS:
        given = ", ".join(signature(rate).parameters)
        raise SceneError(path, f"has the arguments ({given}), must have (concentrations, cell)")
    if not (math.isfinite(upto) and upto > 0.0):
        raise SceneError(f"{path}.upto", f"is {upto!r}, must be a concentration above zero")


def _compile(path: str, made: OwnReaction) -> None:
    """Compile a reaction, and refuse one that cannot be, or gives another number of rates."""
    try:
        count = len(made([0.5 * made.upto] * len(made.fields)))
        if count != len(made.fields):
            problem = f"returns {count} rates for {len(made.fields)} fields"
            raise SceneError(path, problem)
        made.evaluate(np.full((len(made.fields), 1), 0.5 * made.upto), np.ones(1))
    except SceneError:
        raise
    except Exception as error:
        fault = own_fault(error, lambda file: True, made.rate)
        hint = "It may use arithmetic on floats and such functions as those of math."
        raise SceneError(
            path, f"cannot be compiled: {type(error).__name__}: {fault}", hint
        ) from error
