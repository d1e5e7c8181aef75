"""A ball of EMT6/Ro tissue as two equations along its radius: what docs/emt6.py fits with.

Oxygen o and glucose g diffuse into a ball of tissue of radius R through a layer of medium that is
not stirred; living tissue takes them up, the core within radius a does not:

    D_o (r² o')' / r² = V_o f(g) o / (K_o + o),    f = 1 + e h / (h + g)      (Crabtree effect)
    D_g (r² g')' / r² = V_g g / (K_g + g),         no flow at a

and the core ends where the ATP made, P = 5 q_o + 2 q_g, is the least that cells live on. For
comparison it may end where either field is below a threshold of its own, and uptake of glucose may
rise where oxygen is short, by 1 + e' h' / (h' + o) (Pasteur effect). A spheroid
grows by ln 2 / T P / (K_P + P) in its living part and loses what is dead with a time τ:

    dV/dt = ∫ ln 2 / T P / (K_P + P) dV - V_core / τ

Finite volumes and Newton's method, both fields at once; a rim takes 1 ms. No code of the package is
used but numba's cache: the tests compare the two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SHELLS = 64
HOUR = 3600.0
_MOST_NEWTON = 80


@dataclass(frozen=True)
class Tissue:
    """Parameters of tissue: amounts for a volume of tissue, gaps included, not of cells.

    Attributes
    ----------
    oxygen, glucose : mM/s
        Largest uptake V; of oxygen where there is much glucose.
    crabtree, half : 1, mM
        e and h.
    layer : µm
    least, growth_half : mM/s
        P at which cells die, and K_P.
    cycle : h
        ln 2 over the rate of growth that nothing limits.
    lysis : h
        τ.
    cell : µm³
        Tissue for each living cell.
    start : µm
        Radius at the start.
    thresholds : mM
        Of oxygen and glucose, for a core that ends where either is reached; or None.
    pasteur, pasteur_half : 1, mM
        e' and h'.
    """

    oxygen: float
    glucose: float
    crabtree: float
    half: float
    layer: float
    least: float
    growth_half: float = 0.2
    cycle: float = 20.0
    lysis: float = 60.0
    cell: float = 3400.0
    start: float = 82.0
    half_oxygen: float = 0.00464
    half_glucose: float = 0.04
    diffusion: tuple[float, float] = (1750.0, 105.0)
    medium: tuple[float, float] = (2600.0, 650.0)
    thresholds: tuple[float, float] | None = None
    pasteur: float = 0.0
    pasteur_half: float = 1.0

    @classmethod
    def of(cls, scene, packing: float) -> Tissue:
        """Return the tissue of a scene whose cells fill this part of it."""
        o, g, energy = scene.nutrients["oxygen"], scene.nutrients["glucose"], scene.energy
        crabtree = o.uptake_on["glucose"]
        made = cls(
            packing * o.uptake_per_volume, packing * g.uptake_per_volume, crabtree.effect,
            crabtree.half, o.layer, packing * energy.necrosis, half_oxygen=o.half_saturation,
            half_glucose=g.half_saturation, diffusion=(o.diffusion, g.diffusion),
            medium=(o.diffusion_medium, g.diffusion_medium),
        )  # fmt: skip
        if scene.growth is None:
            return made
        death, mean = scene.death, 0.7285 * 4.0 * np.pi / 3.0 * scene.cells.division_radius**3
        # what is left of a cell when it is removed, over what it was when it died
        left = death.removal_fraction / (2.0 * 0.7285)
        return replace(
            made, growth_half=packing * energy.growth_half_saturation, cell=mean / packing,
            cycle=scene.growth.mean_cycle / HOUR, lysis=death.lysis_time / HOUR * (1.0 - left),
            start=(3.0 / (4.0 * np.pi) * scene.initial.count * mean / packing) ** (1.0 / 3.0),
        )  # fmt: skip

    @property
    def packed(self) -> Array:
        """The parameters of the fields, as the kernels read them."""
        either = self.thresholds or (0.0, 0.0)
        return np.array([
            self.oxygen, self.glucose, self.half_oxygen, self.half_glucose, self.crabtree,
            self.half, *self.diffusion, *self.medium, self.layer, self.least,
            *either, self.pasteur, self.pasteur_half,
        ])  # fmt: skip


@numba.njit(cache=True)
def _uptake(p: Array, o: float, g: float):
    """Return both uptakes, and those derivatives that are not zero: o by o, o by g, g by g."""
    factor = 1.0 + p[4] * p[5] / (p[5] + g)
    change = -p[4] * p[5] / (p[5] + g) ** 2
    share, most = o / (p[2] + o), p[1] * (1.0 + p[14] * p[15] / (p[15] + o))
    return (
        p[0] * factor * share, most * g / (p[3] + g), p[0] * factor * p[2] / (p[2] + o) ** 2,
        p[0] * change * share, most * p[3] / (p[3] + g) ** 2,
    )  # fmt: skip


@numba.njit(cache=True)
def _made(p: Array, o: float, g: float) -> float:
    """Return the ATP made, mM/s."""
    found = _uptake(p, o, g)
    return 5.0 * found[0] + 2.0 * found[1]


@numba.njit(cache=True)
def _newton(p: Array, a: float, radius: float, medium: Array, o: Array, g: Array) -> float:
    """Change o and g by a Newton step; return the largest change over the medium's value.

    Glucose does not depend on oxygen: its system is solved first, then that of oxygen with it.
    """
    n = len(o)
    h, worst = (radius - a) / n, 0.0
    for field in (1, 0):
        c = g if field == 1 else o
        d, between = p[6 + field], (1.0 / radius - 1.0 / (radius + p[10])) / p[8 + field]
        outer = 1.0 / (0.5 * h / (d * radius * radius) + between)
        diagonal, right, upper = np.empty(n), np.empty(n), np.empty(n)
        for i in range(n):
            low, high = a + i * h, a + (i + 1) * h
            volume = (high**3 - low**3) / 3.0
            left = d * low * low / h if i > 0 else 0.0
            up = d * high * high / h if i < n - 1 else 0.0
            found = _uptake(p, o[i], g[i])
            taken, slope = (found[1], found[4]) if field == 1 else (found[0], found[2])
            diagonal[i] = left + up + volume * slope
            right[i] = -volume * taken
            if i > 0:
                right[i] += left * (c[i - 1] - c[i])
            if i < n - 1:
                right[i] += up * (c[i + 1] - c[i])
            else:
                diagonal[i] += outer
                right[i] += outer * (medium[field] - c[i])
            upper[i] = up
        for i in range(1, n):
            share = upper[i - 1] / diagonal[i - 1]
            diagonal[i] -= share * upper[i - 1]
            right[i] += share * right[i - 1]
        change = 0.0
        for i in range(n - 1, -1, -1):
            change = (right[i] + upper[i] * change) / diagonal[i]
            new = c[i] + change if c[i] + change > 0.0 else 0.1 * c[i]
            worst = max(worst, abs(new - c[i]) / medium[field])
            c[i] = new
    return worst


@numba.njit(cache=True)
def _excess(p: Array, a: float, radius: float, medium: Array, o: Array, g: Array) -> float:
    """Solve for both fields round a core of radius a; return P less the least at its surface."""
    for _attempt in range(2):
        for _ in range(_MOST_NEWTON):
            if _newton(p, a, radius, medium, o, g) < 1e-9:
                # nothing flows there: a parabola through the two innermost
                inner_o = max(o[0] - (o[1] - o[0]) / 8.0, 0.0)
                inner_g = max(g[0] - (g[1] - g[0]) / 8.0, 0.0)
                if p[12] > 0.0:
                    return min(inner_o / p[12], inner_g / p[13]) - 1.0
                return _made(p, inner_o, inner_g) - p[11]
        o[:] = medium[0]
        g[:] = medium[1]
    return np.nan


@numba.njit(cache=True)
def _core(p: Array, radius: float, medium: Array, o: Array, g: Array) -> float:
    """Return the radius of the core, µm, zero without one; o and g are the fields round it."""
    low, high = 1e-3, 0.995 * radius
    if _excess(p, high, radius, medium, o, g) < 0.0:
        return high
    if _excess(p, low, radius, medium, o, g) > 0.0:
        return 0.0
    while high - low > 0.02:
        middle = 0.5 * (low + high)
        if _excess(p, middle, radius, medium, o, g) > 0.0:
            high = middle
        else:
            low = middle
    return high


@numba.njit(cache=True)
def _profile(p: Array, radius: float, medium: Array, half: float, cycle: float):
    """Return the core's radius and by how much the ball grows, µm and µm³/h."""
    o, g = np.full(SHELLS, medium[0]), np.full(SHELLS, medium[1])
    a = _core(p, radius, medium, o, g)
    h, grown = (radius - a) / SHELLS, 0.0
    for i in range(SHELLS):
        volume = 4.0 * np.pi / 3.0 * ((a + (i + 1) * h) ** 3 - (a + i * h) ** 3)
        made = _made(p, o[i], g[i])
        grown += volume * np.log(2.0) / cycle * made / (half + made)
    return a, grown


def rim(tissue: Tissue, oxygen: float, glucose: float, radius: float = 370.0) -> float:
    """Return the viable rim of a ball in a medium (mM), µm: its radius where nothing starves."""
    medium = np.array([oxygen, glucose])
    o, g = np.full(SHELLS, oxygen), np.full(SHELLS, glucose)
    return radius - float(_core(tissue.packed, radius, medium, o, g))


def course(
    tissue: Tissue, hours: float, medium: tuple[float, float] = (0.2, 5.5), step: float = 0.5
) -> tuple[Array, Array, Array, Array]:
    """Return times (h), living cells, diameter and rim (µm) of a spheroid that grows."""
    radii = np.concatenate([np.linspace(50.0, 300.0, 14), np.linspace(330.0, 900.0, 14)])
    packed, around = tissue.packed, np.array(medium)
    found = [_profile(packed, r, around, tissue.growth_half, tissue.cycle) for r in radii]
    cores, gains = np.array(found).T
    radius = tissue.start
    volume, rows = radius**3, []
    for time in np.arange(0.0, hours + step, step):
        radius = min(max(volume, 50.0**3) ** (1.0 / 3.0), radii[-1])
        core = float(np.interp(radius, radii, cores))
        rows.append((time, radius, core))
        grown = 3.0 / (4.0 * np.pi) * float(np.interp(radius, radii, gains))
        volume += step * (grown - float(np.interp(radius, radii, cores**3)) / tissue.lysis)
    times, outer, inner = np.array(rows).T
    living = 4.0 * np.pi / 3.0 * (outer**3 - inner**3) / tissue.cell
    return times, living, 2.0 * outer, outer - inner
