"""Predict collapse of tissue by attraction, and how densely it is packed.

Contacts act as far as cells overlap, or as far as an attractive law reaches. In the closest packing
nearest neighbours are at d and the second ones at √2 d (in a plane √3 d): once the rest distance of
a pair is below 2r/√2, second neighbours overlap and attract too, press the nearest ones together
and so bring the next ones into reach. At this bound the cells' volumes are π/(3√2) · √2³ = 2π/3
times the space that they fill (in a plane π/(2√3) · √3² = √3π/2).

Whether a law stands it is a matter of energy. Cells that fill space at random with the number
density ρ have ½ ρ ∫U dV each, with the pair energy U: if the integral is negative, the denser the
better, without end. Partial integration makes it (S/d) ∫F x^d dx in d dimensions, S the surface of
the unit ball: the attractive part of ∫F x^d dx must not exceed the repulsive one. For the
approximate JKR law that is h₀/2r <= 0.2906, nearly the 1 - 1/√2 = 0.2929 of second neighbours.

References
----------
D. Ruelle, *Statistical Mechanics: Rigorous Results* (1969), section 3.2 (stability of potentials);
M. R. D'Orsogna et al., Phys. Rev. Lett. 96 (2006) 104302 for the collapse of those that are not.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from multicell.contact.pair import Pair
from multicell.scene.pairs import type_pairs
from multicell.scene.sizes import birth_radius

if TYPE_CHECKING:
    from collections.abc import Iterator

    from multicell.cells import FloatArray
    from multicell.scene.scene import Scene


_PARTS, _NODES = 10, 20  # laws have kinks at first contact and at their cutoff
_ROUNDING = 0.005  # a single cell fills its own ball, and three digits are shown
_REMEDY = (
    "Take stiffer cells, a smaller surface energy, weaker adhesion, a smaller contact.cutoff, or "
    "contact.law = 'exact-jkr', whose overlap at rest is a third."
)
_TOUCHING = 4  # cells that are all nearest neighbours of each other: none is further away


def densest(dimensions: int) -> float:
    """Return the packing ratio at which second neighbours touch in the closest packing.

    2π/3 = 2.09 in space, √3π/2 = 2.72 in a plane.
    """
    return 2.0 * math.pi / 3.0 if dimensions == 3 else 0.5 * math.sqrt(3.0) * math.pi


@cache
def _nodes() -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of Gauss–Legendre integration over the parts of 0 ... 1.

    As many nodes without parts are eigenvalues of a matrix that takes LAPACK 10 ms.
    """
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    first = np.arange(_PARTS)[:, None]
    return (first + 0.5 * (node + 1.0)).ravel() / _PARTS, np.tile(0.5 * weight / _PARTS, _PARTS)


@lru_cache(maxsize=256)  # the runs of a study have the same pairs
def force_moments(pair: Pair, dimensions: int) -> tuple[float, float]:
    """Return the repulsive and the attractive part of ∫F x^d dx, x the distance of the centres.

    Where the second is larger, the pair energy integrated over space is negative. Both are
    positive, in nN µm^(d+1); without repulsion at any distance the first is zero.

    - ``pair``: two cells; a contact that forms and breaks at different distances (exact JKR) counts
      from where it forms
    - ``dimensions``: 3, or 2 in a plane
    """
    rest = max(pair.distance(), 0.0)
    end = pair.rest if pair.law.remembers else pair.rest + pair.reach()
    attraction = max(-_moment(pair, rest, end, dimensions), 0.0)
    return max(_moment(pair, 0.0, rest, dimensions), 0.0), attraction


def _moment(pair: Pair, begin: float, end: float, power: int) -> float:
    """Return the integral of F x^power over distances x from ``begin`` to ``end`` (µm)."""
    node, weight = _nodes()
    x = begin + (end - begin) * node
    return float((end - begin) * (weight * pair.force(pair.rest - x)) @ x**power)


@final
class Attraction(NamedTuple):
    """Attraction over repulsion of two cells, and their pair."""

    ratio: float
    pair: Pair


def strongest_attraction(scene: Scene) -> dict[str, Attraction]:
    """Return the attraction over the repulsion of each two types, by the name of their pair.

    Above 1 tissue collapses. For cells of one type it is the ratio of :func:`force_moments`. Cells
    i and j of two types, mixed as they like best, gain energy by packing densely where
    W_ij < -√(W_ii W_jj), with W = repulsion - attraction: what the like ones repel each other
    counts as repulsion. Newborn cells are taken, since small cells overlap most for their size, and
    receptors as they are when they bind most.
    """
    found: dict[str, Attraction] = {}
    for time in _times(scene):
        own = list(type_pairs(scene, birth_radius(scene), time))
        parts = [force_moments(pair, scene.dimensions) for _, pair in own]
        kinds = list(combinations_with_replacement(range(max(len(scene.types), 1)), 2))
        net = {
            i: max(repulsion - attraction, 0.0)
            for (i, j), (repulsion, attraction) in zip(kinds, parts, strict=True)
            if i == j
        }
        for (i, j), (label, pair), (repulsion, attraction) in zip(kinds, own, parts, strict=True):
            against = repulsion + (math.sqrt(net[i] * net[j]) if i != j else 0.0)
            ratio = attraction / against if against > 0.0 else math.inf
            if label not in found or ratio > found[label].ratio:
                found[label] = Attraction(ratio, pair)
    return found


def _times(scene: Scene) -> list[float]:
    """Return the times at which receptors and ligands may be most numerous, s."""
    if scene.adhesion is None:
        return [0.0]
    courses = [points for kind in scene.types.values() for points in (kind.receptor, kind.ligand)]
    knots = {min(max(time, 0.0), scene.duration) for points in courses for time, _ in points}
    return sorted(knots | {0.0, scene.duration})


def collapse_notes(scene: Scene) -> Iterator[str]:
    """Yield a remark on each two types whose cells attract each other too much."""
    if not scene.contact.acts or (scene.growth is None and scene.initial.count <= _TOUCHING):
        return
    if scene.compression is not None:  # its energy grows with the square of the density
        return
    for label, (ratio, pair) in strongest_attraction(scene).items():
        if not ratio > 1.0:
            continue
        near = pair.distance() / pair.rest
        rest = f"rest at {near:.3g} diameters" if near > 0.0 else "do not rest before they coincide"
        yield (
            f"Tissue of {label or 'these'} cells collapses: newborn ones {rest}, and their "
            f"attraction is {ratio:.3g} times their repulsion (integrated over space, at most 1 "
            f"is sound). {_REMEDY}"
        )


def packing_notes(scene: Scene, ratio: float | None, fraction: float | None = None) -> list[str]:
    """Return remarks on a run that ended so densely packed: what it shows, what is to come.

    - ``ratio``: sum of the cells' volumes over the volume of the ball round them; None without
      cells
    - ``fraction``: the same over the volume of a box with walls; None without one
    """
    expected = list(collapse_notes(scene))
    flat = scene.dimensions == 2
    what, where = ("areas", "disc") if flat else ("volumes", "ball")
    space = f"the {where} round them (packing_ratio)"
    if fraction is not None and (ratio is None or fraction > ratio):
        ratio, space = fraction, "the box (volume_fraction)"
    if ratio is None or not ratio > 1.0 + _ROUNDING:
        return expected
    limit = densest(scene.dimensions)
    found = (
        f"The cells' {what} add up to {ratio:.3g} times {space}: more than there is space, which "
        "only spheres that overlap can do. "
    )
    if ratio > limit:
        found += f"Above {limit:.3g} second neighbours overlap even in the closest packing. "
        if expected:
            return [f"{found}The tissue has collapsed.", *expected]
    found += "The cells are compressed: by attraction, by their start or by growth."
    return [found, *expected]
