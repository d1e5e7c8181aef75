"""Overlapping spheres of Osborne et al. (2017): springs of Chaste in a plane, and what starts them.

All numbers are those of the authors' programs (github.com/Chaste/CellBasedComparison2017, tests
``TestNodeBased...``), in diameters and hours.
"""

import numpy as np

import multicell as mc

HOUR, DIAMETER = 3600.0, 10.0  # s, µm
VISCOSITY = 1.0
SPRING = 50 * 6 * np.pi * VISCOSITY * DIAMETER / 2 / HOUR  # nN/µm: 50 drags of a cell in an hour
GROWING = {"duration": "1 h"}  # of daughters, to the full size


def tissue(cutoff=1.5, **parts):
    """Return the parts that all cases share: spheres in a plane, by springs of Chaste."""
    return {
        "dimensions": 2, "cells": {"division_radius": DIAMETER / 2, "young": "20 kPa"},
        "contact": {
            "law": "generalised-linear", "cutoff": cutoff, "stiffness_at_rest": SPRING,
        },
        "drag": {"viscosity": VISCOSITY}, "output": {"every": "1 h"}, **parts,
    }  # fmt: skip


def lattice(columns, lines):
    """Return the places of a hexagonal lattice of cells that touch, (n, 2) µm."""
    column, line = (x.ravel() for x in np.mgrid[:columns, :lines])
    return DIAMETER * np.stack([column + 0.5 * (line % 2), np.sqrt(0.75) * line], axis=1)


def disc(radius):
    """Return a lattice within a radius in diameters, about the origin, (n, 2) µm."""
    side = 2 * int(1.2 * radius)
    place = lattice(2 * side, 2 * side)
    place -= place[np.argmin(np.linalg.norm(place - place.mean(axis=0), axis=1))]
    return place[np.linalg.norm(place, axis=1) <= radius * DIAMETER + 1e-3]


def placed(scene, place):
    """Return a scene that begins with as many cells as places, (n, 2) µm, and their table."""
    x, y = place.T
    table = {"position_x_um": x, "position_y_um": y, "position_z_um": 0.0 * x}
    full = {**scene, "initial": {"count": len(x), **scene.get("initial", {})}}
    return mc.Scene.from_dict(full), table


def stays(formula, side, **keys):
    """Return a domain from -side to side, µm, and a field in it that hardly leaves its start."""
    domain = {axis: [f"{-side} um", f"{side} um"] for axis in "xy"}
    field = {
        "diffusion": "1e-6 um^2/s", "regime": "transient", "uptake": 0, "boundary": 0,
        "spacing": DIAMETER, "sides": {"*": {"type": "derivative", "derivative": 0}},
        "initial_formula": formula, **keys,
    }  # fmt: skip
    return domain, field


def begun(scene, place, values):
    """Return the simulation of a scene, cells at places, with the first states of its network.

    ``values`` are the states of the cells, (n, states); cells are of all ages.
    """
    full, table = placed({**scene, "initial": {"stage": "asynchronous"}}, place)
    run = mc.Simulation(full, cells=table, threads=1)
    inside = run.cells.inside.copy()
    inside[run.cells.rows_of(np.arange(len(place))), : values.shape[1]] = values
    run.cells.inside = inside
    return run
