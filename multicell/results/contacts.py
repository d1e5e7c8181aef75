"""Which cells touch, and whether a run has to know."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell.behaviours.catalogue import needs_contacts
from multicell.cells import Cells
from multicell.results.observables import contact_rows

if TYPE_CHECKING:
    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene


def counts_contacts(scene: Scene) -> bool:
    """Return whether anything asks for the pairs in contact; to find them costs a little."""
    if remembers_contacts(scene) or len(scene.types) > 1 or scene.pull is not None:
        return True
    named = {name for part in scene.responses.values() for name in part.signals}
    named |= {name for part in scene.signals.values() for name in part.of}
    return any(map(needs_contacts, named))


def remembers_contacts(scene: Scene) -> bool:
    """Return whether the contact law needs to know which pairs were in contact."""
    return scene.contact.remembers


def touching(frame: Frame) -> NDArray[np.int64]:
    """Return the rows of the cells of each pair in contact: (m, 2).

    Where a run does not count its contacts, those whose spheres overlap.
    """
    pairs = contact_rows(frame.cells, frame.contacts)
    return pairs if len(pairs) else _overlapping(frame.cells)


def _overlapping(cells: Cells) -> NDArray[np.int64]:
    """Return the rows of all pairs of cells whose spheres overlap: (m, 2)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(cells.position)
    near = tree.query_pairs(2.0 * cells.radius.max(initial=0.0), output_type="ndarray")
    first, second = near.T
    apart = np.linalg.norm(cells.position[first] - cells.position[second], axis=1)
    near = near[apart < cells.radius[first] + cells.radius[second]].astype(np.int64)
    return np.asarray(near[np.lexsort((near[:, 1], near[:, 0]))])
