"""Stiffness λΔt of a scene, and its place in the diagram of ``docs/which-integrator.md``.

λ is the largest decay rate of the Jacobian and Δt the coupling step. It is estimated for a close
packing at rest: the largest eigenvalue of a lattice of springs k is 8 k in space (fcc, at the edge
of its zone) and 6 k in a plane (hexagons), over the drag of a cell. Two daughters that have just
parted add 2 k of their own contact, half as much again with what their neighbours add: measured
λΔt of the scenes growth, grow-2000 and spheroid lie within a third of both.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from multicell.report.explain.items import Number
from multicell.scene.pairs import daughters_stiffness, drag, type_pairs
from multicell.scene.sizes import birth_radius, typical_radius
from multicell.scene.steps import longest_coupling_step

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_LATTICE: Final = {2: 6.0, 3: 8.0}
_DAUGHTERS: Final = 3.0  # stiffnesses of their contact: two, and half as much by neighbours
_SIZES: Final = (100, 1000, 10_000, 100_000)  # cells of the tiles


def stiffness_of(scene: Scene) -> tuple[float, float]:
    """Return the estimates of λΔt for tissue at rest and just after a division; 0 without one."""
    radius, dt = typical_radius(scene), longest_coupling_step(scene)
    resting = max(
        pair.stiffness(pair.equilibrium_overlap()) / (pair.rest / (2.0 * radius))
        for _, pair in type_pairs(scene, radius)
    )
    rest = _LATTICE[scene.dimensions] * float(resting) / drag(scene, radius) * dt
    if scene.growth is None:
        return rest, 0.0
    young = daughters_stiffness(scene) / drag(scene, birth_radius(scene))
    return rest, max(rest, _DAUGHTERS * float(young) * dt)


def stiffness_numbers(scene: Scene) -> list[Number]:
    """Return λΔt at the start and after a division."""
    if not scene.contact.acts:
        return []
    rest, divided = stiffness_of(scene)
    start = 0.0 if scene.initial.count == 1 else rest
    meaning = "λΔt, largest decay rate times coupling step, of touching cells at rest"
    if scene.initial.count == 1:
        meaning = f"λΔt, largest decay rate times coupling step: one cell; {rest:.2g} in tissue"
    numbers = [Number("stiffness at the start", start, "", meaning)]
    if scene.growth is not None:
        meaning = "λΔt of two daughters that have just parted, in tissue"
        numbers.append(Number("stiffness after a division", divided, "", meaning))
    return numbers


def place_of(scene: Scene, cells: float) -> str:
    """Return which tile of the diagram a scene belongs to, and what follows for its method.

    - ``cells``: as many as the run is expected to end with
    """
    if scene.friction is not None or not scene.contact.acts:  # the tiles have none
        return ""
    rest, divided = stiffness_of(scene)
    state, value = ("quiet", rest) if scene.growth is None else ("typical", divided)
    if not value > 0.0:
        return ""
    decade = max(1, round(math.log10(value)))
    count = min(_SIZES, key=lambda size: abs(math.log(size / max(cells, 1.0))))
    tile = f"{state} tissue, {count:,} cells, λΔt of {10**decade:,}"
    return f". In the diagram of docs/which-integrator.md: {tile}. {_advice(state, decade)}"


def _advice(state: str, decade: int) -> str:
    """Return the cheapest methods of a tile, at an error of 1 % of the motion."""
    if decade <= 2:
        return "Explicit methods are cheapest there, such as ab2-adaptive; auto takes them."
    if decade <= 4 and not (state == "quiet" and decade == 4):
        return "The stabilised rkc2 is cheapest there; auto takes it."
    if decade <= 5 and state != "quiet":
        return "The stabilised rkc2 and the implicit rosenbrock are even there."
    return "Implicit methods are cheapest there, such as rosenbrock; auto takes them."
