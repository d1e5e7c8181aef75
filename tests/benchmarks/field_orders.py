"""Errors of fields at cells by the spacing, as tables: python tests/benchmarks/field_orders.py

One secreting cell is compared with closed forms, a tissue with a grid far finer than its cells.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from multicell.nutrient.cartesian import Box
from multicell.nutrient.diffusion import Diffusion
from multicell.nutrient.field import NutrientField
from multicell.nutrient.fitness import discretisation_error
from multicell.nutrient.grid import BoxLayout, ShellLayout
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.spherical import Shells
from multicell.scene.nutrient import Nutrient

CONFORMAL = 0.5393526  # radius of a square of side 1 seen from its middle (Pólya & Szegő 1951)
HARMONIC = 0.5 * 1.14445  # of a cube
SPACINGS = (1.0, 2.0 / 3.0, 0.5, 1.0 / 3.0, 0.25, 0.2)


def order(spacings, errors):
    """Return the order of an error in the spacing, by regression."""
    return float(np.polyfit(np.log(spacings), np.log(errors), 1)[0])


def own(kind, spacings=SPACINGS, side=8.0):
    """Return spacings and relative errors of the mean over a secreting cell of radius 1.

    The outside is at zero, D is 1, and so is what the cell secretes. The regular part of Green's
    function is harmonic: its means over cell and cell are its value in the middle.
    """
    h = side / np.rint(side / np.asarray(spacings))
    if kind == "cubes":
        exact = (1.2 - 1.0 / (HARMONIC * side)) / (4.0 * np.pi)
    elif kind == "squares":
        exact = (math.log(CONFORMAL * side) + 0.25) / (2.0 * np.pi)
    else:
        exact = (1.2 - 1.0 / side) / (4.0 * np.pi)
    return h, np.array([abs(_found(kind, step, side) / exact - 1.0) for step in h])


def _found(kind, h, side):
    cell = np.zeros((1, 3)), np.ones(1)
    if kind == "shells":
        layout = ShellLayout.to(np.zeros(3), side, h)
        sink = layout.scatter(cell[0], np.ones(1), cell[1])
        shells = Shells(layout.radius, layout.count, 1.0, 0.0)
        c = shells.solve_linear(np.zeros(layout.count), sink * layout.volumes)
        return layout.gather(cell[0], c, cell[1])[0]
    n = round(side / h)
    flat = kind == "squares"
    shape, low = (n, n, 1 if flat else n), -0.5 * side
    box = Box((low, low, -0.5 * h if flat else low), shape, h, 1.0 if flat else None)
    layout = BoxLayout(box)
    density = layout.scatter(cell[0], np.ones(1), cell[1])
    c, _ = Diffusion(box, 1.0, 0.0 if not flat else sides()).invert(density, 0.0)
    return layout.gather(cell[0], c, cell[1])[0]


def sides():
    return {axis + end: {"value": 0.0} for axis in "xy" for end in "-+"}


def tissue(count, radius=5.5):
    """Return positions and radii of a ball of cells that touch, shaken out of a lattice."""
    rng, reach = np.random.default_rng(0), int((2 * count) ** (1.0 / 3.0)) + 2
    whole = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3), axis=-1).reshape(-1, 3)
    whole = whole[whole.sum(axis=1) % 2 == 0]
    place = whole * (1.95 * radius / math.sqrt(2.0)) + rng.normal(0.0, 0.1 * radius, whole.shape)
    nearest = np.argsort((place**2).sum(axis=1))[:count]
    return np.ascontiguousarray(place[nearest]), rng.uniform(0.87, 1.13, count) * radius


def solved(spacing, cells, estimate=True, **changes):
    """Return a steady field of oxygen of a tissue, what its cells find, and the reported error."""
    given = {
        "diffusion": 2000.0,
        "uptake": 20.0,
        "half_saturation": 5e-3,
        "boundary": 0.1,
        "margin": 25.0,
        "geometry": "box",
        "regime": "steady",
    }
    parameters = FieldParameters(Nutrient(**(given | changes)), spacing, 10.0, "steady", 3)
    field, (position, radius) = NutrientField("oxygen", parameters), cells
    capacity = np.full(len(position), 20.0)
    report = field.solve(position, capacity, radius=radius)
    own = field.uptake(position, capacity, radius).sum()
    left = max(abs(report.inflow - own), abs(report.uptake - own)) / own
    about = _Cells(position, radius)
    error = discretisation_error(field, parameters, about, capacity, None, 0.0) if estimate else 0.0
    return field, field.sample(position, radius), error, left


class _Cells(SimpleNamespace):
    def __init__(self, position, radius):
        super().__init__(position=position, radius=radius)

    def __len__(self):
        return len(self.position)


def oxygen(count, spacings, fine, geometry="box"):
    """Return errors at the cells of a tissue, compared with a fine grid, and what is reported."""
    cells = tissue(count)
    found = [solved(h, cells, geometry=geometry) for h in spacings]
    reference = solved(fine, cells, estimate=False, geometry=geometry)
    # what the fine grid is off by, for it is of second order
    steps = [field.layout.spacing for field, *_ in (*found, reference)]
    ratio = (steps[-2] / steps[-1]) ** 2
    exact = reference[1] + (reference[1] - found[-1][1]) / (ratio - 1.0)
    away = np.array([c - exact for _, c, *_ in found])
    return SimpleNamespace(
        spacing=np.array(steps[:-1]),
        rms=np.sqrt((away**2).mean(axis=1)),
        largest=np.abs(away).max(axis=1),
        reported=np.array([e for _, _, e, _ in found]),
        lowest=min(field.values.min() for field, *_ in found),
        remainder=max(left for *_, left in found),
    )


def medium(count, spacings):
    """Return oxygen at the centre of a tissue in a medium that diffuses three times as fast."""
    cells = tissue(count)
    there = {"diffusion_medium": 6000.0, "half_saturation": 1e-6, "margin": 40.0}
    found = [solved(h, cells, **there) for h in spacings]
    shells = solved(0.5, cells, estimate=False, geometry="radial", **there)
    return SimpleNamespace(
        spacing=np.array([field.layout.spacing for field, *_ in found]),
        centre=np.array([c[0] for _, c, *_ in found]),
        fine_on_shells=float(shells[1][0]),
        reported=np.array([e for _, _, e, _ in found]),
    )


def _row(*entries):
    print("| " + " | ".join(entries) + " |")


def main():
    for kind in ("cubes", "squares", "shells"):
        spacings, errors = own(kind, (2.0, *SPACINGS, 0.125))
        print(f"\nown concentration of one cell, {kind}: order {order(spacings, errors):.2f}")
        for h, error in zip(spacings, errors, strict=True):
            _row(f"{h:.3f} radii", f"{error:.2%}")
    for geometry in ("box", "radial"):
        found = oxygen(1500, (10.0, 7.0, 5.0, 3.5, 2.5), 1.25, geometry)
        print(f"\noxygen of 1,500 cells, {geometry}: order {order(found.spacing, found.rms):.2f}")
        for row in zip(found.spacing, found.rms, found.largest, found.reported, strict=True):
            _row(f"{row[0]:.2f} um", *(f"{x:.2e} mM" for x in row[1:]))
    found = medium(3000, (9.5, 6.4, 4.8, 3.4))
    print(f"\nfaster diffusion in the medium: shells of 0.5 um have {found.fine_on_shells:.5f} mM")
    for row in zip(found.spacing, found.centre, found.reported, strict=True):
        _row(f"{row[0]:.2f} um", f"{row[1]:.5f} mM", f"reported {row[2]:.2e} mM")


if __name__ == "__main__":
    main()
