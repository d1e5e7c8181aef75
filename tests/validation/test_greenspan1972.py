"""Balls that consume: the starved core and the layer outside, after Greenspan (1972)."""

import exact_balls
import numpy as np

from multicell.nutrient.spherical import Shells

SUBJECT, SOURCE = "fields", "greenspan1972"
D = 1000.0


def order(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def test_a_starved_core_in_160_shells(compare):
    r, surface = exact_balls.RADII, exact_balls.SURFACE
    found = exact_balls.shells(exact_balls.UPTAKE, 1e-9, surface)
    off = abs(found - exact_balls.starved(r)).max() / surface
    compare.deviation("starved core: c over the surface", "q/(6D) (r² − 3 a² + 2 a³/r)", off, 2e-4)
    d, outer = exact_balls.D, exact_balls.R
    share = 6 * d * surface / (exact_balls.UPTAKE * outer**2)
    closed = outer * (0.5 + np.cos((2 * np.pi - np.arccos(2 * share - 1)) / 3))
    spacing = outer / exact_balls.SHELLS
    edge = outer - (found > 1e-5 * surface).sum() * spacing
    compare.value(
        "starved core: radius by the trigonometric root", closed, edge, 1.5 * spacing, "µm"
    )


COUNTS = (20, 40, 80, 160)


def radial_errors(exact, sink_of, half, boundary, radius=150.0):
    errors = []
    for n in COUNTS:
        shells = Shells(radius, n, D, boundary)
        r = (np.arange(n) + 0.5) * radius / n
        c, _ = shells.solve(sink_of(r), half, np.full(n, 0.1))
        errors.append(np.sqrt(np.average((c - exact(r)) ** 2, weights=shells.volumes)))
    return errors


def test_a_ball_with_a_starved_core_at_second_order(compare):
    """Uptake of zeroth order ends at the necrotic radius: c = c' = 0 there."""
    q, radius, inner = 0.02, 150.0, 60.0
    surface = q / (6 * D) * (radius**2 - 3 * inner**2 + 2 * inner**3 / radius)

    def exact(r):
        return np.where(r > inner, q / (6 * D) * (r**2 - 3 * inner**2 + 2 * inner**3 / r), 0.0)

    errors = radial_errors(exact, lambda r: np.full_like(r, q), 1e-9, surface)
    found = -order(COUNTS, errors)
    compare.value("starved core: order in the spacing", 2.0, found, 0.3)
    shells = Shells(radius, 320, D, surface)
    c, _ = shells.solve(np.full(320, q), 1e-9, np.full(320, 0.1))
    edge = np.flatnonzero(c > 1e-5 * surface)[0] * radius / 320
    compare.value("starved core in 320 shells: radius", inner, edge, 0.03 * inner, "µm")


def test_a_layered_ball_with_a_boundary_layer_at_second_order(compare):
    """Tissue to 100 µm with uptake of zeroth order, medium with D times 2.5 to 150 µm."""
    q, tissue, outer, ratio, medium = 0.004, 100.0, 150.0, 2.5, 0.3
    flow = q * tissue**3 / 3.0
    at_edge = medium - flow / (ratio * D) * (1 / tissue - 1 / outer)
    errors = []
    for n in (15, 30, 60, 120):
        r = (np.arange(n) + 0.5) * outer / n
        inside = r < tissue
        shells = Shells(outer, n, D, medium, varied=np.where(inside, 1.0, ratio))
        c, _ = shells.solve(np.where(inside, q, 0.0), 1e-10, np.full(n, medium))
        exact = np.where(
            inside,
            at_edge - q / (6 * D) * (tissue**2 - r**2),
            medium - flow / (ratio * D) * (1 / r - 1 / outer),
        )
        errors.append(np.abs(c - exact).max())
    found = -order([15, 30, 60, 120], errors)
    compare.value("ball in a layer of medium: order in the spacing", 2.0, found, 0.15)
