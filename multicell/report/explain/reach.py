"""How far a substance reaches into the tissue of the start, in closed form.

Every cell takes up at its full rate wherever there is any (zeroth order), so that the answer is a
lower bound: real uptake saturates, and resting cells take up less. With q the uptake per volume, a
ball (d = 3) or disc (d = 2) of radius R has c(r) = c(R) - q (R² - r²) / (2 d D) while its middle is
fed, and else a core without the substance, at whose surface both c and its slope vanish. Where
perfusion feeds from above there is no closed form, and the forecast's shells are solved for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

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

_NOTED: Final = 0.01  # part of the tissue whose death at the start is worth a note


@final
@dataclass(frozen=True)
class Tissue:
    """A ball or disc of tissue in its layer of medium.

    Attributes
    ----------
    dimensions
        2 or 3.
    radius, outer : float, µm
        Of the tissue, and to where the medium has its own concentration.
    demand : float, mM/s
        Uptake per volume.
    diffusion, outside : float, µm²/s
        In tissue, and in the layer round it.
    medium : float, mM
    """

    dimensions: int
    radius: float
    outer: float
    demand: float
    diffusion: float
    outside: float
    medium: float

    @property
    def depth(self) -> float:
        """How far from the surface or rim anything reaches, µm; the radius where all is fed."""
        return self.radius - self._within(0.0)

    def below(self, threshold: float) -> float:
        """Return the part of the tissue with less than a concentration in mM."""
        return (self._within(threshold) / self.radius) ** self.dimensions

    def _within(self, threshold: float) -> float:
        """Return the radius inside which there is at most a concentration."""
        from scipy.optimize import brentq

        r, surface = self.radius, self._surface(0.0)
        if surface >= self._rise(r, 0.0):  # the middle is fed
            if threshold >= surface:
                return r
            short = self._rise(r, 0.0) - (surface - threshold)
            return r * math.sqrt(short / self._rise(r, 0.0)) if short > 0.0 else 0.0
        if self._surface(r) <= self._rise(r, r):  # all but the surface starves, up to rounding
            return r
        core = brentq(lambda x: self._surface(x) - self._rise(r, x), 0.0, r)
        if self._rise(r, core) <= threshold:
            return r
        if self._rise(core, core) >= threshold:
            return float(core)
        return float(brentq(lambda x: self._rise(x, core) - threshold, core, r))

    def _surface(self, core: float) -> float:
        """Return the concentration at the surface when all outside a core takes up, mM."""
        r, d = self.radius, self.dimensions
        way = math.log(self.outer / r) if d == 2 else 1.0 / r - 1.0 / self.outer
        return self.medium - self.demand * (r**d - core**d) / d * way / self.outside

    def _rise(self, r: float, core: float) -> float:
        """Return the concentration at a radius where it and its slope vanish at a core, mM."""
        rate = self.demand / (2.0 * self.dimensions * self.diffusion)
        if self.dimensions == 3:
            bent = 2.0 * core**3 / r if r > 0.0 else 0.0
            return rate * (r * r + bent - 3.0 * core**2)
        bent = 2.0 * core**2 * math.log(r / core) if core > 0.0 else 0.0
        return rate * (r * r - core**2 - bent)


def tissue_of(scene: Scene, name: str) -> Tissue | None:
    """Return the tissue of a scene's start with a field; None where that is not as simple.

    So in a domain, with conditions of its own on a side, and where nothing is taken up.
    """
    nutrient = scene.nutrients[name]
    simple = scene.domain is None and not nutrient.sides and nutrient.takes_up
    if not simple or scene.initial.count == 0 or nutrient.medium(0.0) == 0.0:
        return None
    d, cells = scene.dimensions, placed(scene)
    radius = typical_radius(scene) * scene.initial.count ** (1.0 / d)
    if cells is not None:
        from multicell.results.observables import diameter

        radius = 0.5 * diameter(cells, d)
    own = SPHERE * typical_radius(scene) ** 3
    across = math.pi * radius**2 * scales.height(scene, name) if d == 2 else SPHERE * radius**3
    demand = scene.initial.count * float(nutrient.largest_uptake(own)) / across
    outer = radius + nutrient.layer if nutrient.layer is not None else 0.0
    return Tissue(
        d, radius, outer or _FACES[d] * (radius + nutrient.margin),
        demand, nutrient.diffusion,
        nutrient.diffusion_medium or nutrient.diffusion, nutrient.medium(0.0),
    )  # fmt: skip


def reach_numbers(scene: Scene, name: str) -> list[Number]:
    """Return how far a field reaches into the tissue of the start, and what lies beyond."""
    tissue = tissue_of(scene, name)
    if tissue is None:
        return []
    nutrient, numbers = scene.nutrients[name], []
    if nutrient.perfusion > 0.0:
        meaning = "what perfusion alone leaves cells at full uptake, far from rim or surface"
        numbers.append(
            Number(f"{name}: supply by perfusion", above(nutrient, tissue.demand), "mM", meaning)
        )
    else:
        shape, edge = ("disc", "rim") if tissue.dimensions == 2 else ("ball", "surface")
        words = (
            f"from the {edge} of a {shape} of {tissue.radius:.3g} um in an unstirred layer of "
            f"about {tissue.outer - tissue.radius:.3g} um, all cells at full uptake"
        )
        numbers.append(Number(f"{name}: fed depth at the start", tissue.depth, "um", words))
    for what, value in _thresholds(nutrient).items():
        meaning = f"part of the tissue of the start below {what} ({value:g} mM) at full uptake"
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
    tissue, nutrient = tissue_of(scene, name), scene.nutrients[name]
    if tissue is None:
        return 0.0
    if nutrient.perfusion == 0.0:
        return tissue.below(threshold)
    profile = Profile(nutrient, tissue.dimensions, scales.height(scene, name))
    shells = np.linspace(0.0, tissue.radius, SHELLS + 1)
    each = tissue.radius / scene.initial.count ** (1.0 / tissue.dimensions)
    others = {
        other: np.full(SHELLS, scene.nutrients[other].medium(0.0)) for other in nutrient.uptake_on
    }
    levels = profile.solve(shells, 0.0, 0.0, SPHERE * each**3, others)
    volumes = np.diff(shells**tissue.dimensions)
    return float(volumes[levels < threshold].sum() / volumes.sum())


def _thresholds(nutrient: Nutrient) -> dict[str, float]:
    given = {"quiescence": nutrient.quiescence, "necrosis": nutrient.necrosis}
    return {what: value for what, value in given.items() if value is not None}


def reach_notes(scene: Scene) -> list[str]:
    """Return remarks on tissue that starves as soon as a run starts."""
    notes = []
    for name, nutrient in scene.nutrients.items():
        lost = 0.0 if nutrient.necrosis is None else below(scene, name, nutrient.necrosis)
        if lost > _NOTED:
            notes.append(
                f"At full uptake {100.0 * lost:.2g} % of the tissue of the start has less {name} "
                f"than necrosis ({nutrient.necrosis:g} mM) and would die at once."
            )
    return notes
