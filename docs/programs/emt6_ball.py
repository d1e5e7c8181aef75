"""A ball of EMT6/Ro tissue as two equations along its radius: what emt6.py fits with.

Oxygen o and glucose g diffuse into a ball of tissue of radius R through a layer of medium that is
not stirred; living tissue takes them up, the core within radius a does not:

    q_o = V_o (1 + e h / (h + g)) o / (K_o + o)         (Crabtree effect)
    q_g = V_g (1 + e' h' / (h' + o)) g / (K_g + g)      (Pasteur effect)
    D (r² c')' / r² = q,                                no flow at a

Lactate is made at 2 q_g. With the ATP made, P = 5 q_o + 2 q_g, the core ends, by ``rule``, where

    either   oxygen or glucose is at a threshold of its own
    ATP      P is at its least value
    lactate  P is at its least value, or lactate at its highest
    time     cells have been below the least P for a time T
    damage   they have accumulated ∫ (1 - P / P_least) dt = T

A spheroid grows in its living part by ln 2 / T_c P / (K_P + P), and loses what is dead with a time
τ. For the last two rules cells sink below its surface as it swells:

    dV/dt = G(R) - V_core / τ,    G(r) = ∫ ln 2 / T_c P / (K_P + P) dV out to r
    depth' = R' - (G(r) - V_core / τ) / (4 π r²)

Finite volumes and Newton's method for both fields at once. No code of the package is used but
numba's cache: the tests compare the two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SHELLS = 64
HOUR = 3600.0
SOLUBILITY = 1.403e-3
"""Oxygen in medium at 37 °C, mM/mmHg."""
RULES = ("either", "ATP", "lactate", "time", "damage")
_MOST_NEWTON = 100


@dataclass(frozen=True)
class Tissue:
    """Parameters of tissue: amounts for a volume of tissue, gaps included, not of cells.

    Attributes
    ----------
    oxygen, glucose : mM/s
        Largest uptake V; of oxygen where there is much glucose, of glucose where there is much
        oxygen.
    crabtree, half, pasteur, pasteur_half : 1, mM, 1, mM
        e, h, e', h'.
    layer : µm
    diffusion : µm²/s
        Of oxygen in tissue, where it dissolves as in medium.
    least, growth_half : mM/s
        P at which cells die, and K_P.
    lactate : mM µm²/s
        At which cells die, times its coefficient of diffusion.
    harm : h
        T of the rules of time and damage.
    cycle, lysis : h
        T_c and τ.
    cell : µm³
        Tissue for each living cell.
    start : µm
        Radius at the start.
    low_oxygen, low_glucose : mM
        Thresholds of the rule "either".
    """

    oxygen: float = 0.0111
    glucose: float = 0.03
    crabtree: float = 2.2
    half: float = 0.25
    layer: float = 49.0
    diffusion: float = 1350.0
    least: float = 0.126
    pasteur: float = 0.0
    pasteur_half: float = 0.1
    lactate: float = 2100.0
    harm: float = 5.0
    low_oxygen: float = 1e-3
    low_glucose: float = 1e-2
    rule: str = "ATP"
    growth_half: float = 0.19
    cycle: float = 20.0
    lysis: float = 60.0
    cell: float = 3700.0
    start: float = 82.0
    half_oxygen: float = 0.00464
    half_glucose: float = 0.04
    diffusion_glucose: float = 105.0
    medium: tuple[float, float, float] = (2600.0, 650.0, 1300.0)
    diffusion_lactate: float = 210.0

    @classmethod
    def of(cls, scene, packing: float) -> Tissue:
        """Return the tissue of a scene whose cells fill this part of it."""
        o, g, w = (scene.nutrients[name] for name in ("oxygen", "glucose", "lactate"))
        crabtree, pasteur = o.uptake_on["glucose"], g.uptake_on["oxygen"]
        made = cls(
            packing * o.uptake_per_volume, packing * g.uptake_per_volume, crabtree.effect,
            crabtree.half, o.layer, o.diffusion, packing * scene.energy.necrosis, pasteur.effect,
            pasteur.half, w.necrosis_above * w.diffusion, rule="lactate",
            half_oxygen=o.half_saturation, half_glucose=g.half_saturation,
            diffusion_glucose=g.diffusion, diffusion_lactate=w.diffusion,
            medium=(o.diffusion_medium, g.diffusion_medium, w.diffusion_medium),
        )  # fmt: skip
        if scene.growth is None:
            return made
        death, mean = scene.death, 0.7285 * 4.0 * np.pi / 3.0 * scene.cells.division_radius**3
        # what is left of a cell when it is removed, over what it was when it died
        left = death.removal_fraction / (2.0 * 0.7285)
        return replace(
            made, growth_half=packing * scene.energy.growth_half_saturation, cell=mean / packing,
            cycle=scene.growth.mean_cycle / HOUR, lysis=death.lysis_time / HOUR * (1.0 - left),
            start=(3.0 / (4.0 * np.pi) * scene.initial.count * mean / packing) ** (1.0 / 3.0),
        )  # fmt: skip

    @property
    def packed(self) -> Array:
        """The parameters as the kernels read them."""
        return np.array([
            self.oxygen, self.glucose, self.half_oxygen, self.half_glucose, self.crabtree,
            self.half, self.pasteur, self.pasteur_half, self.diffusion, self.diffusion_glucose,
            *self.medium[:2], self.layer, self.least, RULES.index(self.rule), self.low_oxygen,
            self.low_glucose, self.lactate, self.diffusion_lactate / self.medium[2],
            self.harm * HOUR, np.log(2.0) / (self.cycle * HOUR), self.growth_half,
            self.lysis * HOUR,
        ])  # fmt: skip


@numba.njit(cache=True)
def _uptake(p: Array, o: float, g: float):
    """Return both uptakes, and derivatives: o by o, o by g, g by o, g by g."""
    f, e = 1.0 + p[4] * p[5] / (p[5] + g), 1.0 + p[6] * p[7] / (p[7] + o)
    share, other = o / (p[2] + o), g / (p[3] + g)
    return (
        p[0] * f * share, p[1] * e * other, p[0] * f * p[2] / (p[2] + o) ** 2,
        -p[0] * p[4] * p[5] / (p[5] + g) ** 2 * share,
        -p[1] * p[6] * p[7] / (p[7] + o) ** 2 * other, p[1] * e * p[3] / (p[3] + g) ** 2,
    )  # fmt: skip


@numba.njit(cache=True)
def _made(p: Array, o: float, g: float) -> float:
    """Return the ATP made, mM/s."""
    found = _uptake(p, o, g)
    return 5.0 * found[0] + 2.0 * found[1]


@numba.njit(cache=True)
def _newton(p: Array, a: float, radius: float, medium: Array, o: Array, g: Array) -> float:
    """Change o and g by a Newton step; return the largest change over the medium's value.

    Blocks of two by two, eliminated from the core outwards.
    """
    n = len(o)
    h, between = (radius - a) / n, 1.0 / radius - 1.0 / (radius + p[12])
    upper, right = np.empty((n, 2, 2)), np.empty((n, 2))
    d, c = p[8:10], (o, g)
    m, r = np.empty((2, 2)), np.empty(2)
    for i in range(n):
        low, high = a + i * h, a + (i + 1) * h
        volume = (high**3 - low**3) / 3.0
        found = _uptake(p, o[i], g[i])
        m[0, 0], m[0, 1], m[1, 0], m[1, 1] = found[2], found[3], found[4], found[5]
        up = high * high / h if i < n - 1 else 0.0
        for k in range(2):
            m[k, 0] *= volume
            m[k, 1] *= volume
            r[k] = -volume * found[k]
            if i > 0:
                left = d[k] * low * low / h
                m[k, k] += left
                r[k] += left * (c[k][i - 1] - c[k][i] + right[i - 1, k])
                for j in range(2):
                    m[k, j] -= left * upper[i - 1, k, j]
            if i < n - 1:
                m[k, k] += d[k] * up
                r[k] += d[k] * up * (c[k][i + 1] - c[k][i])
            else:
                outer = 1.0 / (0.5 * h / (d[k] * radius * radius) + between / p[10 + k])
                m[k, k] += outer
                r[k] += outer * (medium[k] - c[k][i])
        det = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
        right[i, 0] = (m[1, 1] * r[0] - m[0, 1] * r[1]) / det
        right[i, 1] = (m[0, 0] * r[1] - m[1, 0] * r[0]) / det
        upper[i, 0, 0], upper[i, 0, 1] = m[1, 1] * d[0] * up / det, -m[0, 1] * d[1] * up / det
        upper[i, 1, 0], upper[i, 1, 1] = -m[1, 0] * d[0] * up / det, m[0, 0] * d[1] * up / det
    x, worst = np.zeros(2), 0.0
    for i in range(n - 1, -1, -1):
        x[0], x[1] = (
            right[i, 0] + upper[i, 0, 0] * x[0] + upper[i, 0, 1] * x[1],
            right[i, 1] + upper[i, 1, 0] * x[0] + upper[i, 1, 1] * x[1],
        )  # fmt: skip
        for k in range(2):
            new = c[k][i] + x[k] if c[k][i] + x[k] > 0.0 else 0.1 * c[k][i]
            worst = max(worst, abs(new - c[k][i]) / medium[k])
            c[k][i] = new
    return worst


@numba.njit(cache=True)
def _lactate(p: Array, a: float, radius: float, o: Array, g: Array) -> float:
    """Return lactate at the core's surface times its coefficient of diffusion, mM µm²/s."""
    n = len(o)
    h, flow, level = (radius - a) / n, 0.0, 0.0
    for i in range(n):
        low, high = a + i * h, a + (i + 1) * h
        gained = 2.0 * _uptake(p, o[i], g[i])[1] * (high**3 - low**3) / 3.0
        level += (flow + 0.5 * gained) * h / (0.25 * (low + high) ** 2)
        flow += gained
    return level + flow * (1.0 / radius - 1.0 / (radius + p[12])) * p[18]


@numba.njit(cache=True)
def _harm(p: Array, a: float, radius: float, o: Array, g: Array) -> float:
    """Return the harm that cells have taken when they reach the core, s."""
    n = len(o)
    h, within, harm = (radius - a) / n, np.zeros(n + 1), 0.0
    for i in range(n):  # what grows between the core and each face
        low, high = a + i * h, a + (i + 1) * h
        made = _made(p, o[i], g[i])
        within[i + 1] = within[i] + p[20] * made / (p[21] + made) * (high**3 - low**3) / 3.0
    lost = a**3 / (3.0 * p[22])
    swells = (within[n] - lost) / radius**2
    for i in range(n):
        r = a + (i + 0.5) * h
        sinks = swells - (0.5 * (within[i] + within[i + 1]) - lost) / r**2
        lack = 1.0 - _made(p, o[i], g[i]) / p[13]
        if p[14] == 3:  # all or nothing, but for a tenth of the threshold
            lack = min(max(0.5 + 10.0 * lack, 0.0), 1.0)
        if lack > 0.0:
            harm += lack * h / max(sinks, 1e-9)
    return harm


@numba.njit(cache=True)
def _excess(p: Array, a: float, radius: float, medium: Array, o: Array, g: Array) -> float:
    """Solve for both fields round a core of radius a; return by how much cells there can live."""
    for _attempt in range(2):
        for _ in range(_MOST_NEWTON):
            if _newton(p, a, radius, medium, o, g) < 1e-9:
                # nothing flows there: a parabola through the two innermost
                inner_o = max(o[0] - (o[1] - o[0]) / 8.0, 0.0)
                inner_g = max(g[0] - (g[1] - g[0]) / 8.0, 0.0)
                if p[14] == 0:
                    return min(inner_o / p[15], inner_g / p[16]) - 1.0
                if p[14] >= 3:
                    return 1.0 - _harm(p, a, radius, o, g) / p[19]
                left = _made(p, inner_o, inner_g) / p[13] - 1.0
                if p[14] == 2:
                    left = min(left, 1.0 - _lactate(p, a, radius, o, g) / p[17])
                return left
        o[:] = medium[0]
        g[:] = medium[1]
    return np.nan


@numba.njit(cache=True)
def _core(p: Array, radius: float, medium: Array, o: Array, g: Array) -> float:
    """Return the radius of the core, µm, zero without one; o and g are the fields round it."""
    low, high = 1e-3, 0.985 * radius
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
    _excess(p, high, radius, medium, o, g)
    return high


@numba.njit(cache=True)
def _totals(p: Array, a: float, radius: float, o: Array, g: Array):
    """Return uptake of oxygen, mM/s µm³, and growth, µm³/s."""
    h, taken, grown = (radius - a) / len(o), 0.0, 0.0
    for i in range(len(o)):
        volume = 4.0 * np.pi / 3.0 * ((a + (i + 1) * h) ** 3 - (a + i * h) ** 3)
        made = _made(p, o[i], g[i])
        taken += volume * _uptake(p, o[i], g[i])[0]
        grown += volume * p[20] * made / (p[21] + made)
    return taken, grown


@dataclass(frozen=True)
class Ball:
    """A ball at rest: radius of the core and of all, µm, and concentrations of its shells, mM."""

    tissue: Tissue
    core: float
    radius: float
    medium: tuple[float, float]
    oxygen: Array
    glucose: Array

    @property
    def rim(self) -> float:
        """Thickness of living tissue, µm."""
        return self.radius - self.core

    @property
    def consumption(self) -> float:
        """Oxygen taken up by a volume of the living rim, mM/s."""
        taken, _ = _totals(
            self.tissue.packed, self.core, self.radius, self.oxygen, self.glucose
        )  # fmt: skip
        return float(taken * 3.0 / (4.0 * np.pi * (self.radius**3 - self.core**3)))

    def pressure(self, depth: Array) -> Array:
        """Return oxygen below the surface (µm; negative: outside of it), mmHg."""
        tissue, h = self.tissue, self.rim / SHELLS
        out = 1.0 / self.radius - 1.0 / (self.radius + tissue.layer)
        step = 0.5 * h / (tissue.diffusion * self.radius**2)
        flow = (self.medium[0] - self.oxygen[-1]) / (step + out / tissue.medium[0])
        surface = self.oxygen[-1] + flow * step
        r = self.core + (np.arange(SHELLS) + 0.5) * h
        inside = np.interp(
            self.radius - depth, np.append(r, self.radius), np.append(self.oxygen, surface)
        )
        beyond = np.minimum(self.radius - depth, self.radius + tissue.layer)
        outside = surface + flow / tissue.medium[0] * (1.0 / self.radius - 1.0 / beyond)
        return np.where(depth > 0.0, inside, outside) / SOLUBILITY


def ball(tissue: Tissue, oxygen: float, glucose: float, radius: float = 370.0) -> Ball:
    """Return a ball at rest in a medium (mM)."""
    o, g = np.full(SHELLS, oxygen), np.full(SHELLS, glucose)
    core = float(_core(tissue.packed, radius, np.array([oxygen, glucose]), o, g))
    return Ball(tissue, core, radius, (oxygen, glucose), o, g)


def course(
    tissue: Tissue, hours: float, medium: tuple[float, float] = (0.2, 5.5), step: float = 0.5
) -> tuple[Array, Array, Array, Array]:
    """Return times (h), living cells, diameter and rim (µm) of a spheroid that grows."""
    radii = np.concatenate([np.linspace(50.0, 300.0, 14), np.linspace(330.0, 900.0, 14)])
    cores, gains = [], []
    for radius in radii:
        one = ball(tissue, *medium, float(radius))
        cores.append(one.core)
        gains.append(_totals(tissue.packed, one.core, one.radius, one.oxygen, one.glucose)[1])
    gains, cubes = HOUR * np.array(gains), np.array(cores) ** 3
    radius = tissue.start
    volume, rows = radius**3, []
    for time in np.arange(0.0, hours + step, step):
        radius = min(max(volume, 50.0**3) ** (1.0 / 3.0), radii[-1])
        rows.append((time, radius, float(np.interp(radius, radii, cores))))
        grown = 3.0 / (4.0 * np.pi) * float(np.interp(radius, radii, gains))
        volume += step * (grown - float(np.interp(radius, radii, cubes)) / tissue.lysis)
    times, outer, inner = np.array(rows).T
    living = 4.0 * np.pi / 3.0 * (outer**3 - inner**3) / tissue.cell
    return times, living, 2.0 * outer, outer - inner
