"""Pairs that feel only the overlap beyond a slack, so that sisters part smoothly.

Right after a division two daughters overlap deeply. In the law of a pair with slack s(t) the
overlap h = r_i + r_j - d is replaced by h - s(t): with s = h - h₀ (h₀ the law's overlap at rest)
the pair is at rest where it is, and as s runs to zero the rest distance r_i + r_j - h₀ - s grows
to that of any other pair. At a given time the force is minus the gradient of the energy
Σ U(h - s), as without slack; while s falls, the energy may rise by Σ F (-ds/dt): the work that the
division does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import FloatArray, IntArray
from multicell.mechanics import forces

LawOfPairs = Callable[[IntArray, IntArray], tuple[FloatArray, FloatArray, FloatArray]]

_NO_INDEX = np.empty(0, dtype=np.int64)
_NO_VALUES = np.empty(0)
_NONE = forces.SlackData(
    _NO_INDEX, _NO_INDEX, _NO_VALUES, _NO_VALUES, _NO_VALUES, np.empty((0, 0)), _NO_VALUES
)


@final
class Slack:
    """What :class:`~multicell.mechanics.system.Mechanics` keeps for the pairs with slack in a step.

    Attributes
    ----------
    data
        The pairs as the kernels take them.
    """

    def __init__(self, data: forces.SlackData) -> None:
        self.data = data
        self._pairs: forces.PairData | None = None
        self._places: tuple[IntArray, IntArray] = (_NO_INDEX, _NO_INDEX)

    @classmethod
    def of(
        cls,
        n: int,
        pairs: NDArray[Any] | None,
        slack: FloatArray | None,
        law: LawOfPairs,
        adhesion: float,
    ) -> Slack:
        """Return the pairs with slack of a coupling step among ``n`` cells.

        Parameters
        ----------
        n
            Number of cells.
        pairs, slack
            See :class:`~multicell.mechanics.system.Motion`.
        law
            Returns for the two cells of each pair what the law keeps for it; see
            :class:`~multicell.mechanics.forces.PairData`.
        adhesion
            √(6πσ) where the law keeps none for each pair.

        Raises
        ------
        ValueError
            If only one of the two is given, if a pair is no pair of cells, stands twice or has
            its larger index first, or if a slack is not finite or negative at the beginning.
        """
        if pairs is None and slack is None:
            return cls(_NONE)
        if pairs is None or slack is None:
            raise ValueError("slack_pairs and slack go together, only one is given")
        check(n, pairs, slack)
        if len(pairs) == 0:
            return cls(_NONE)
        own = np.concatenate([pairs[:, 0], pairs[:, 1]]).astype(np.int64)
        other = np.concatenate([pairs[:, 1], pairs[:, 0]]).astype(np.int64)
        order = np.lexsort((other, own))
        own, other = own[order], other[order]
        value, rate = np.concatenate([slack, slack])[order].T
        sticky, unit, onset = law(own, other)
        m = len(own)
        data = forces.SlackData(
            np.searchsorted(own, np.arange(n + 1)),
            other,
            np.array(value, dtype=float),
            np.array(rate, dtype=float),
            sticky if sticky.size else np.full(m, adhesion),
            unit if unit.size else np.zeros((2, m)),
            onset if onset.size else np.zeros(m),
        )
        return cls(data)

    def __bool__(self) -> bool:
        """Return whether any pair has slack."""
        return bool(self.data.other.size)

    def places(self, pairs: forces.PairData) -> tuple[IntArray, IntArray]:
        """Return the places of the pairs with slack in a neighbour list, and their entries."""
        if self._pairs is not pairs:
            self._places = forces.slack_places(pairs, self.data)
            self._pairs = pairs
        return self._places

    def listed(self, pairs: forces.PairData, elapsed: float) -> FloatArray:
        """Return the slack of each place of a neighbour list, µm; empty without any slack."""
        if not self:
            return _NO_VALUES
        places, entries = self.places(pairs)
        amounts = np.zeros(len(pairs.first))
        amounts[places] = forces.slack_of_places(self.data, entries, elapsed)
        return amounts


def check(n: int, pairs: NDArray[Any], slack: FloatArray) -> None:
    """Raise ValueError if pairs with slack have no meaning; see :meth:`Slack.of`."""
    if pairs.ndim != 2 or pairs.shape[1] != 2 or slack.shape != pairs.shape:
        raise ValueError(
            f"slack_pairs has shape {pairs.shape} and slack {slack.shape}, must both be (m, 2)"
        )
    low, high = pairs.T
    wrong = ~((low >= 0) & (low < high) & (high < n))
    if wrong.any():
        raise ValueError(
            f"{pairs[wrong][0].tolist()} in slack_pairs: must be two of {n} cells, "
            "smaller index first"
        )
    if len(np.unique(pairs, axis=0)) < len(pairs):
        raise ValueError("a pair stands twice in slack_pairs")
    wrong = ~(np.isfinite(slack).all(axis=1) & (slack[:, 0] >= 0.0))
    if wrong.any():
        k = int(wrong.argmax())
        raise ValueError(
            f"slack of {pairs[k].tolist()} is {slack[k, 0]:g} µm with rate {slack[k, 1]:g} µm/s: "
            "must be finite, and not below 0 at the beginning"
        )
