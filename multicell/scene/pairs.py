"""Pairs of cells of a scene: their laws and drag, before anything is run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import FloatArray, stokes_drag
from multicell.contact.law import PairLaw, effective_modulus, effective_radius
from multicell.contact.pair import Pair
from multicell.scene.sizes import birth_radius, division_radius, mean_scale, radius_scales

if TYPE_CHECKING:
    from multicell.mechanics.compression import TissueCompression
    from multicell.scene.scene import Scene


def law_by_types(scene: Scene) -> tuple[PairLaw, FloatArray | None]:
    """Return the law between cells, and its entry for every two types; None where all are alike.

    The entries, in the order of the types, are surface energies in nN/µm of a law that has one,
    else factors of its attraction.
    """
    law, kinds = scene.contact, scene.types
    if any(kind.surface_energy for kind in kinds.values()):
        rows, own = [kind.surface_energy or {} for kind in kinds.values()], law.surface_energy
        return law, np.array([[row.get(name, own) for name in kinds] for row in rows])
    if not any(kind.adhesion_with for kind in kinds.values()):
        return law, None
    factors = np.array([[adhesion_with(scene, a, b) for b in kinds] for a in kinds])
    scaled = law.scaled_by_pairs()
    return (law, factors * law.surface_energy) if scaled is None else (scaled, factors)


def adhesion_with(scene: Scene, a: str, b: str) -> float:
    """Return the factor of the adhesion of two types, which one of them may state for both."""
    one, other = (scene.types[name].adhesion_with or {} for name in (a, b))
    return one.get(b, other.get(a, 1.0))


def largest_energy(scene: Scene) -> float:
    """Return the largest surface energy of a contact of a scene without responses, nN/µm."""
    law, entries = law_by_types(scene)
    if entries is None or not law.is_sticky:
        return scene.contact.surface_energy
    return float(entries.max())


def largest_adhesion(scene: Scene, factor: float = 1.0) -> PairLaw:
    """Return the law between the two types that stick to each other most.

    - ``factor``: on surface energies, as responses may set it
    """
    law, entries = law_by_types(scene)
    if entries is not None:
        return law.for_pair(factor * float(entries.max()))
    return law if factor == 1.0 else law.for_pair(factor * law.surface_energy)


def compression(scene: Scene) -> TissueCompression | None:
    """Return the resistance to compression beside contacts; nothing is loaded where it is zero."""
    part = scene.compression
    if part is None:
        return None
    from multicell.mechanics.compression import TissueCompression

    return TissueCompression(part.bulk_modulus, part.onset)


def drag(scene: Scene, radius: float) -> float:
    """Return the Stokes drag 6πηr of a cell in nN·s/µm."""
    return stokes_drag(scene.drag.viscosity) * radius


def daughters_stiffness(scene: Scene) -> float:
    """Return dF/dh in nN/µm of two daughters that have just separated.

    They stand at ±r(1 - 2^(-1/3)) about the centre of their mother of radius r. That of types of
    another size is taken over their size as that of a mean cell is: so it compares with its drag.
    """
    mother, daughter = division_radius(scene), birth_radius(scene)
    overlap = 2.0 * daughter - 2.0 * (mother - daughter)
    sizes = ((pair, pair.rest / (2.0 * daughter)) for _, pair in type_pairs(scene, daughter))
    return float(max(pair.stiffness(overlap * size) / size for pair, size in sizes))


def explicit_limit(scene: Scene) -> float:
    """Return drag over stiffness of two fresh daughters, s; infinite where none acts on another."""
    stiffness = daughters_stiffness(scene)
    return drag(scene, birth_radius(scene)) / stiffness if stiffness else math.inf


def type_pairs(scene: Scene, radius: float, time: float = 0.0) -> Iterator[tuple[str, Pair]]:
    """Yield the name and the pair of cells in the same stage for every two types of a scene.

    - ``radius``: of a cell of the mean size at this stage, µm; types may be smaller or larger

    The name is empty where all cells are alike, else for example ``"cohesive-loose"``.
    """
    names, mean = list(scene.types), mean_scale(scene)
    own = [radius * (scale / mean) for scale in radius_scales(scene)]
    for i, j in combinations_with_replacement(range(max(len(names), 1)), 2):
        label = f"{names[i]}-{names[j]}" if names else ""
        yield label, pair_of(scene, i, j, own[i], own[j], time)


def pair_of(
    scene: Scene,
    i: int,
    j: int,
    radius_i: float,
    radius_j: float,
    time: float = 0.0,
    young: tuple[float, float] | None = None,
) -> Pair:
    """Return a pair.

    - ``scene``: what there is
    - ``i``, ``j``: index of the cells' types; without effect where the scene has no types
    - ``radius_i``, ``radius_j``: radii of the cells, µm
    - ``time``: time in s at which receptors and ligands are taken
    - ``young``: Young's moduli in kPa, by default the means of the types
    """
    kinds = list(scene.types.values())
    law, entries = law_by_types(scene)
    if entries is not None:
        law = law.for_pair(float(entries[i, j]))
    if young is None:
        means = [
            kinds[k].young or scene.cells.young if kinds else scene.cells.young for k in (i, j)
        ]
        young = (means[0], means[1])
    bonds = 0.0
    if scene.adhesion is not None:
        (receptor_i, ligand_i), (receptor_j, ligand_j) = (kinds[k].bonds(time) for k in (i, j))
        bonds = 0.5 * (receptor_i * ligand_j + ligand_i * receptor_j) * scene.adhesion.strength
    poisson = scene.cells.poisson
    return Pair(
        law,
        float(effective_modulus(young[0], poisson, young[1], poisson)),
        float(effective_radius(radius_i, radius_j)),
        radius_i + radius_j,
        bonds,
    )
