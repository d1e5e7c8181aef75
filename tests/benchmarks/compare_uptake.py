"""Cost of uptake at the nodes in accuracy, and of uptake at the cells in sign.

Problem: 3000 cells at random in a ball of 150 µm with 50 µm of medium round it, shells, D = 2000
µm²/s, K = 0.005 mM, 0.05 mM outside, 100 or 1000 amol/s each, or absurd 1e7. Two schemes on the
same shells: node g takes up Q_g c_g/(K + c_g), with Q_g the cells' uptake spread over the nodes
(the package's), or cell i takes up q c(x_i)/(K + c(x_i)), with c interpolated at the cell, spread
over the nodes (written here, solved by Newton's method). Given are the largest errors at the cells
against the second scheme in shells of 0.25 µm, and the least concentration of any node.
Cost: a second.
Command: python tests/benchmarks/compare_uptake.py
"""

import numpy as np
from scipy.linalg import solve_banded

from multicell.nutrient.grid import ShellLayout
from multicell.nutrient.spherical import Shells

CELLS, RADIUS, MARGIN = 3000, 150.0, 50.0
DIFFUSION, HALF, OUTSIDE = 2000.0, 0.005, 0.05
FINEST = 0.25


def cells():
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(CELLS, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return RADIUS * np.cbrt(rng.random(CELLS))[:, None] * direction


def laid(position, spacing):
    count = round((RADIUS + MARGIN) / spacing)
    layout = ShellLayout(np.zeros(3), (RADIUS + MARGIN) / count, count)
    return layout, Shells(layout.radius, count, DIFFUSION, OUTSIDE)


def at_nodes(position, most, spacing):
    layout, shells = laid(position, spacing)
    sink = layout.scatter(position, np.full(CELLS, most))
    c, _ = shells.solve(sink, HALF, layout.filled(OUTSIDE))
    return c, layout.gather(position, c)


def at_cells(position, most, spacing):
    """Newton's method on the tridiagonal system; below zero uptake continues along its tangent."""
    layout, shells = laid(position, spacing)
    inner, outer, weight = layout._weights(position)
    c, n = layout.filled(OUTSIDE), layout.count
    g = shells.conductance

    def uptake(c):
        here = (1.0 - weight) * c[inner] + weight * c[outer]
        kept = np.maximum(here, 0.0)
        slope = most * HALF / (HALF + kept) ** 2
        taken = most * kept / (HALF + kept) + slope * (here - kept)
        spread = np.bincount(inner, taken * (1.0 - weight), n)
        return spread + np.bincount(outer, taken * weight, n), slope

    for _ in range(500):
        spent, slope = uptake(c)
        left = shells.gain(c) - spent
        if np.abs(left).sum() < 1e-8 * spent.sum():
            return c, layout.gather(position, c)
        bands = np.zeros((3, n))
        bands[1, :-1] += g
        bands[1, 1:] += g
        bands[1, -1] += shells._outer * (1.0 - shells._factor)
        bands[1] += np.bincount(inner, slope * (1.0 - weight) ** 2, n)
        bands[1] += np.bincount(outer, slope * weight**2, n)
        same = inner == outer
        bands[1] += np.bincount(inner[same], (2.0 * slope * weight * (1.0 - weight))[same], n)
        mixed = np.bincount(inner[~same], (slope * weight * (1.0 - weight))[~same], n)[:-1]
        bands[0, 1:] = bands[2, :-1] = mixed - g
        change = solve_banded((1, 1), bands, left)
        share, wanted = 1.0, float(left @ change)
        # the residual is the gradient of a convex energy: go on while it falls along the step
        for _ in range(40):
            there = shells.gain(c + share * change) - uptake(c + share * change)[0]
            if float(there @ change) > -0.9 * wanted:
                break
            share *= 0.5
        c = c + share * change
    raise RuntimeError("Newton's method did not converge")


def main():
    position = cells()
    print("| uptake | spacing (um) | error at the nodes (mM) | error at the cells (mM) "
          "| least c, nodes (mM) | least c, cells (mM) |\n|---|---|---|---|---|---|")  # fmt: skip
    for most in (100.0, 1000.0, 1e7):
        _, exact = at_cells(position, most, FINEST)
        for spacing in (20.0, 10.0, 5.0, 2.5):
            mine, here = at_nodes(position, most, spacing)
            other, there = at_cells(position, most, spacing)
            errors = [np.abs(found - exact).max() for found in (here, there)]
            print(f"| {most:g} amol/s | {spacing:g} | {errors[0]:.2e} | {errors[1]:.2e} "
                  f"| {mine.min():.1e} | {other.min():.1e} |")  # fmt: skip


if __name__ == "__main__":
    main()
