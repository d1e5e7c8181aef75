"""Cell types of a scene: whether they fit together, and what they give each cell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.parameters import near_miss

if TYPE_CHECKING:
    from multicell.parts import CellType
    from multicell.scene import Scene

FloatArray = NDArray[np.float64]


def check_types(scene: Scene) -> None:
    """Raise ``SceneError`` for types that do not fit together or to the rest of the scene."""
    types = scene.types
    if types and not sum(kind.fraction for kind in types.values()) > 0.0:
        raise SceneError("types", "have fractions that add up to 0, must have some cells")
    for name, kind in types.items():
        if kind.surface_energy is not None:
            _check_energies(scene, f"types.{name}.surface_energy", kind)
        if kind.sticks and scene.adhesion is None:
            path = f"types.{name}.{'receptor' if any(v for _, v in kind.receptor) else 'ligand'}"
            hint = "An [adhesion] table says how strongly receptors bind."
            raise SceneError(path, "has no effect: the scene has no adhesion", hint)
    if scene.adhesion is not None and not any(kind.sticks for kind in types.values()):
        hint = "Give types.<name>.receptor and types.<name>.ligand."
        raise SceneError("adhesion", "has no effect: no type carries receptors or ligands", hint)


def _check_energies(scene: Scene, path: str, kind: CellType) -> None:
    """Check one row of the matrix of surface energies: names, completeness, symmetry."""
    assert kind.surface_energy is not None
    own = path.split(".")[1]
    if not hasattr(scene.contact, "surface_energy"):
        raise SceneError(path, "needs a contact law with a surface energy", "Such as law = 'jkr'.")
    for other in kind.surface_energy:
        if other not in scene.types:
            raise SceneError(
                f"{path}.{other}", "is not a type of this scene", near_miss(other, scene.types)
            )
    for other, partner in scene.types.items():
        back = (partner.surface_energy or {}).get(own)
        there = kind.surface_energy.get(other)
        if there is None or back is None:
            missing = f"{path}.{other}" if there is None else f"types.{other}.surface_energy.{own}"
            raise SceneError(missing, "is missing", "Every pair of types needs a surface energy.")
        if there != back:
            problem = (
                f"is {there:g} nN/um, but types.{other}.surface_energy.{own} is {back:g} nN/um: "
                "surface energies must be symmetric"
            )
            raise SceneError(f"{path}.{other}", problem)


def surface_energies(scene: Scene) -> FloatArray | None:
    """Return the matrix of surface energies, nN/µm, in the order of the types, or None."""
    rows = [kind.surface_energy for kind in scene.types.values()]
    if not any(rows):
        return None
    names = list(scene.types)
    return np.array([[(row or {})[name] for name in names] for row in rows])


def bonds(scene: Scene, kind: NDArray[np.int16], begin: float, end: float) -> FloatArray | None:
    """Return receptors and ligands at ``begin`` and their rates up to ``end``, (n, 4), or None.

    Between the two times they run linearly, so that a course with a kink between two coupling
    times is cut there.
    """
    if scene.adhesion is None:
        return None
    now = np.array([part.bonds(begin) for part in scene.types.values()])
    then = np.array([part.bonds(end) for part in scene.types.values()])
    rate = (then - now) / (end - begin) if end > begin else np.zeros_like(now)
    return np.ascontiguousarray(np.hstack([now, rate])[kind])
