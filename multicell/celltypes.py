"""Cell types of a scene: whether they fit together, and what they give each cell."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, Phase
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
        _check_responses(scene, f"types.{name}", kind)
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


def bonds(
    scene: Scene,
    cells: Cells,
    concentrations: Mapping[str, FloatArray],
    begin: float,
    end: float,
) -> FloatArray | None:
    """Return receptors and ligands at ``begin`` and their rates up to ``end``, (n, 4), or None.

    At ``begin`` they are those of the cells. At ``end`` they are the type's course at that time,
    times the factor of the cell's phase and those of the concentrations that it finds at
    ``begin``. Between the two times they run linearly, so that a course with a kink between two
    coupling times is cut there.
    """
    if scene.adhesion is None:
        return None
    now = np.stack([cells.receptor, cells.ligand], axis=1)
    then = bond_levels(scene, cells, concentrations, end)
    rate = (then - now) / (end - begin) if end > begin else np.zeros_like(now)
    return np.ascontiguousarray(np.hstack([now, rate]))


def bond_levels(
    scene: Scene, cells: Cells, concentrations: Mapping[str, FloatArray], time: float
) -> FloatArray:
    """Return the receptors and ligands that cells have at a time in these conditions, (n, 2).

    Concentrations that are not known yet have no effect.
    """
    levels = np.array([part.bonds(time) for part in scene.types.values()])[cells.kind]
    for number, part in enumerate(scene.types.values()):
        if not part.responds:
            continue
        own = np.flatnonzero(cells.kind == number)
        by = ((part.receptor_by_phase, part.receptor_by), (part.ligand_by_phase, part.ligand_by))
        for column, (by_phase, by_field) in enumerate(by):
            factor = np.array([(by_phase or {}).get(phase.name, 1.0) for phase in Phase])
            levels[own, column] *= factor[cells.phase[own]]
            for name, curve in (by_field or {}).items():
                if name in concentrations:
                    x, y = np.array(curve).T
                    levels[own, column] *= np.interp(concentrations[name][own], x, y)
    return np.asarray(levels)


def _check_responses(scene: Scene, path: str, kind: CellType) -> None:
    """Check that a programme of adhesion refers to phases and fields that there are."""
    for key in ("receptor_by_phase", "ligand_by_phase"):
        for phase in getattr(kind, key) or ():
            if phase not in Phase.__members__:
                hint = near_miss(phase, Phase.__members__)
                raise SceneError(f"{path}.{key}.{phase}", "is not a phase of the cycle", hint)
            if scene.growth is None or not scene.growth.phases:
                hint = "growth.phases gives them."
                raise SceneError(f"{path}.{key}", "has no effect: the scene has no phases", hint)
    for key in ("receptor_by", "ligand_by"):
        for name in getattr(kind, key) or ():
            if name not in scene.nutrients:
                hint = near_miss(name, scene.nutrients)
                raise SceneError(f"{path}.{key}.{name}", "is not a field of this scene", hint)
