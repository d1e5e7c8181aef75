"""How far a substance reaches into the tissue of the start, by the forecast's shells.

All cells are active, as in the first field of a run that gives their states: later some rest and
take up less. Far from the rim of a plane only perfusion feeds, which has a closed form.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from multicell.cells import SPHERE
from multicell.report.explain.cost import placed
from multicell.report.explain.course import SHELLS, Profile
from multicell.report.explain.items import Number
from multicell.scene import scales
from multicell.scene.sizes import typical_radius

if TYPE_CHECKING:
    from multicell.scene.nutrient import Nutrient
    from multicell.scene.scene import Scene

_FACES: Final = {2: 1.0787, 3: 1.14445}
"""Radius of the disc (ball) that feeds its middle as the square (cube) does, over half its edge:
the conformal radius of a square, and the harmonic one of a cube."""

_FINE: Final = 4000  # points along the radius at which a profile is compared with a threshold
_NOTED_SHARE: Final = 0.01  # part of the tissue whose death at the start is worth a note


def start_radius(scene: Scene, name: str) -> float | None:
    """Return the radius of the ball or disc of tissue at the start that takes a field up, µm.

    None where that is not as simple: in a domain, with conditions of its own on a side, and where
    nothing is taken up.
    """
    nutrient = scene.nutrients[name]
    simple = scene.domain is None and not nutrient.sides and nutrient.takes_up
    if not simple or scene.initial.count == 0 or nutrient.medium(0.0) == 0.0:
        return None
    cells = placed(scene)
    if cells is None:
        return float(typical_radius(scene) * scene.initial.count ** (1.0 / scene.dimensions))
    from multicell.results.observables import diameter

    return 0.5 * diameter(cells, scene.dimensions)


def reach_numbers(scene: Scene, name: str) -> list[Number]:
    """Return which part of the tissue of the start a field does not reach."""
    radius, nutrient = start_radius(scene, name), scene.nutrients[name]
    if radius is None:
        return []
    numbers = []
    if nutrient.perfusion > 0.0:
        demand = float(nutrient.largest_uptake(SPHERE * typical_radius(scene) ** 3))
        d = scene.dimensions
        room = math.pi * radius**2 * scales.height(scene, name) if d == 2 else SPHERE * radius**3
        left = above(nutrient, scene.initial.count * demand / room)
        meaning = "what perfusion alone leaves cells at full uptake, far from rim or surface"
        numbers.append(Number(f"{name}: supply by perfusion", left, "mM", meaning))
    shape = "disc" if scene.dimensions == 2 else "ball"
    for what, value in _thresholds(nutrient).items():
        meaning = (
            f"part of the tissue of the start, a {shape} of {radius:.3g} um, with less than "
            f"{value:g} mM while all cells are active"
        )
        numbers.append(Number(f"{name}: below {what}", below(scene, name, value), "", meaning))
    return numbers


def above(nutrient: Nutrient, demand: float) -> float:
    """Return what perfusion alone leaves far from the rim, mM: k (c₀ - c) = q c / (K + c)."""
    medium, half = nutrient.medium(0.0), nutrient.half_saturation
    b = medium - half - demand / nutrient.perfusion
    root = math.hypot(b, 2.0 * math.sqrt(half * medium))
    return 0.5 * (b + root) if b > 0.0 else 2.0 * half * medium / (root - b)


def below(scene: Scene, name: str, threshold: float) -> float:
    """Return the part of the tissue of the start with less than a concentration in mM."""
    radius, nutrient, d = start_radius(scene, name), scene.nutrients[name], scene.dimensions
    if radius is None:
        return 0.0
    if nutrient.layer is None:  # shells round the tissue in place of a grid's square or cube
        layer = _FACES[d] * (radius + nutrient.margin) - radius
        nutrient = replace(nutrient, layer=layer)
    profile = Profile(nutrient, d, scales.height(scene, name))
    shells = np.linspace(0.0, radius, SHELLS + 1)
    each = radius / scene.initial.count ** (1.0 / d)
    others = {
        other: np.full(SHELLS, scene.nutrients[other].medium(0.0)) for other in nutrient.uptake_on
    }
    levels = profile.solve(shells, 0.0, 0.0, SPHERE * each**3, others)
    fine = radius * (np.arange(_FINE) + 0.5) / _FINE
    found = np.interp(fine, 0.5 * (shells[1:] + shells[:-1]), levels)
    volumes = fine ** (d - 1)
    return float(volumes[found < threshold].sum() / volumes.sum())


def _thresholds(nutrient: Nutrient) -> dict[str, float]:
    given = {"quiescence": nutrient.quiescence, "necrosis": nutrient.necrosis}
    return {what: value for what, value in given.items() if value is not None}


def reach_notes(scene: Scene) -> list[str]:
    """Return remarks on tissue that starves as soon as a run starts."""
    notes = []
    for name, nutrient in scene.nutrients.items():
        lost = 0.0 if nutrient.necrosis is None else below(scene, name, nutrient.necrosis)
        if lost > _NOTED_SHARE:
            notes.append(
                f"While all cells are active {100.0 * lost:.2g} % of the tissue of the start has "
                f"less {name} than necrosis ({nutrient.necrosis:g} mM) and would die at once."
            )
    return notes
