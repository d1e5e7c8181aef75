"""Removal of dead cells whose volume is all but gone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multicell.biology.growth import birth_volume
from multicell.cells import Cells, State

if TYPE_CHECKING:
    from multicell.scene import Scene


def remove_lysed(scene: Scene, cells: Cells) -> tuple[Cells, int]:
    """Remove necrotic cells smaller than ``removal_fraction`` of the birth volume.

    Parameters
    ----------
    scene
        Without ``death`` no cell is removed.
    cells
        The population; it is not changed.

    Returns
    -------
    cells
        The cells that remain, in their old order.
    removed
        Number of cells removed.
    """
    if scene.death is None:
        return cells, 0
    smallest = scene.death.removal_fraction * birth_volume(scene)
    gone = (cells.state == State.NECROTIC) & (cells.volume < smallest)
    removed = int(gone.sum())
    return (cells.take(~gone), removed) if removed else (cells, 0)
