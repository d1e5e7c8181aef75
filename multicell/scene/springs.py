"""Springs between given pairs of cells, listed by identity."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.schema import id_pairs, parameters, quantity

if TYPE_CHECKING:
    from collections.abc import Mapping

    from multicell.cells import Cells


@final
@parameters
class Springs:
    """Springs between pairs of cells at any distance, besides the law of contacts.

    The tension is ``stiffness`` x (distance of the centres - ``rest``). A spring goes with the
    death of one of its cells. Where one of them divides, the daughter takes it over that is nearer
    to the other end.
    """

    stiffness: float = quantity("nN/um", above=0, doc="of each spring")
    rest: float | None = quantity(
        "um", default=None, at_least=0, doc="length at rest; absent: that at the start"
    )
    pairs: tuple[tuple[int, int], ...] | None = id_pairs(
        doc="identities of the cells of each spring"
    )

    def check(self) -> None:
        """Raise ``SceneError`` unless it is given who is joined."""
        if self.pairs is None:
            raise SceneError("pairs", "must be given", "For example pairs = [[0, 1], [1, 2]].")


def pairs_at_start(springs: Mapping[str, Springs], name: str, cells: Cells) -> NDArray[np.int64]:
    """Return the identities of the pairs of a table, (m, 2), smaller first, in their order.

    Raises
    ------
    SceneError
        For a cell that is not there.
    """
    pairs = np.array(sorted(springs[name].pairs or ()), dtype=np.int64)
    missing = np.setdiff1d(pairs, cells.id)
    if len(missing):
        problem = f"joins the cell {int(missing[0])}, which is not there at the start"
        raise SceneError(f"springs.{name}.pairs", problem)
    return pairs
