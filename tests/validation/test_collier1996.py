"""Lateral inhibition in a row of cells: the model of Collier et al. (1996)."""

from __future__ import annotations

import math

import numpy as np
import pytest

import multicell as mc
from multicell.cells import Cells

SUBJECT, SOURCE = "networks", "collier1996"
STEP = 900.0  # s, for one unit of the model's time 3600 s


def collier(a, b=100.0, k=2, h=2, v=1.0):
    """Return the model of lateral inhibition and its homogeneous steady state.

    J. R. Collier, N. A. M. Monk, P. K. Maini, J. H. Lewis, J. theor. Biol. 183 (1996) 429: Notch N
    is made by F(mean Delta of the neighbours) = x^k / (a + x^k), Delta D by
    G(N) = 1 / (1 + b N^h).
    """

    @mc.network(
        states={"N": 0.5, "D": 0.5}, inputs={"around": 0.0},
        parameters={"a": a, "b": b, "v": v}, amounts=("N", "D"), time_unit=3600.0,
    )  # fmt: skip
    def notch(t, y, u, p, out):
        x = u[0] * u[0]
        out[0] = x / (p[0] + x) - y[0]
        out[1] = p[2] * (1.0 / (1.0 + p[1] * y[0] * y[0]) - y[1])

    low, high = 0.0, 1.0  # of D: D = G(F(D)) has one root, since the right side falls
    for _ in range(200):
        d = 0.5 * (low + high)
        n = d**k / (a + d**k)
        low, high = (d, high) if 1.0 / (1.0 + b * n**h) > d else (low, d)
    rise = k * a * d ** (k - 1) / (a + d**k) ** 2
    fall = -b * h * n ** (h - 1) / (1.0 + b * n**h) ** 2
    return notch, n, d, rise * fall


def row_of(count):
    """Return cells in a row that touch, as a table."""
    place = np.zeros((count, 3))
    place[:, 0] = 9.0 * np.arange(count)
    return {"position_x_um": place[:, 0], "position_y_um": place[:, 1],
            "position_z_um": place[:, 2], "radius_um": np.full(count, 5.0)}  # fmt: skip


def grown(a, hours, v=1.0, count=12, size=1e-3):
    """Return Delta of a row of cells after some time, from the steady state with a disturbance."""
    model, n, d, slope = collier(a, v=v)
    part = {"network": model, "inputs": {"around": "neighbours.notch.D"}, "tolerance": 1e-9}
    scene = mc.load_scene("growth").with_changes({
        "duration": hours * 3600.0, "coupling_step": STEP, "growth": None,
        "contact.surface_energy": 0.0, "networks": {"notch": part},
    })  # fmt: skip
    simulation = mc.Simulation(scene, cells=row_of(count), threads=1)
    cells: Cells = simulation.cells
    inside = cells.inside.copy()
    order = np.argsort(cells.position[:, 0])
    inside[:, 0] = n
    sign = np.where(np.arange(count) % 2, -1.0, 1.0)
    inside[order, 1] = d * (1.0 + size * sign)
    inside[order, 2] = d * (1.0 - size * sign)  # what neighbours have
    cells.inside = inside
    found = [(0.0, d, inside[order, 1])]
    while not simulation.finished:
        simulation.step()
        order = np.argsort(simulation.cells.position[:, 0])
        found.append((simulation.time / 3600.0, d, simulation.cells.inside[order, 1]))
    return found, slope


@pytest.mark.parametrize("a", [0.01, 10.0])
def test_a_pattern_grows_where_the_theory_of_collier_says(compare, a):
    # neighbours that alternate have the opposite deviation: growth where F'(D) G'(N) < -1, at the
    # rate -1 + sqrt(-F' G') in the inner cells of a row; both end cells have one neighbour
    found, slope = grown(a, 4.0)
    time = np.array([t for t, _, _ in found])
    size = np.array([np.abs(delta[4:8] - d).max() for _, d, delta in found])
    rate = np.polyfit(time[8:], np.log(size[8:]), 1)[0]
    want = -1.0 + math.sqrt(-slope)
    assert (slope < -1.0) == (a == 0.01)
    compare.value(
        f"lateral inhibition, a = {a:g}: growth rate of a pattern", want, rate, 0.1, "1/h"
    )


def test_the_pattern_of_lateral_inhibition_alternates(compare):
    found, _ = grown(0.01, 48.0)
    delta = found[-1][2]
    high = delta > 0.5
    assert (high[1:] != high[:-1]).all()
    off = np.abs(delta - high).max()
    compare.deviation("lateral inhibition, pattern after 48 h: Delta", "1, 0, 1, 0, …", off, 0.05)


def sheet_of(side):
    """Return a periodic sheet of hexagons, (table, domain, colours): three that do not meet."""
    column, line = (x.ravel() for x in np.mgrid[:side, :side])
    place = 9.0 * np.stack([column + 0.5 * (line % 2), math.sqrt(0.75) * line], axis=1)
    table = {
        "position_x_um": place[:, 0], "position_y_um": place[:, 1],
        "position_z_um": np.zeros(side**2), "radius_um": np.full(side**2, 5.0),
    }  # fmt: skip
    lengths = {"x": [0.0, 9.0 * side], "y": [0.0, 9.0 * math.sqrt(0.75) * side]}
    domain = {**lengths, "z": [-50.0, 50.0], "periodic": ["x", "y"]}
    return table, domain, (column - line // 2 - line) % 3


def spread(a, hours, deviation, side=6):
    """Return Delta in a sheet of cells in each step, from a disturbed steady state."""
    model, n, d, _ = collier(a)
    table, domain, colours = sheet_of(side)
    part = {"network": model, "inputs": {"around": "neighbours.notch.D"}, "tolerance": 1e-9}
    scene = mc.load_scene("growth").with_changes({
        "duration": hours * 3600.0, "coupling_step": STEP, "growth": None, "domain": domain,
        "contact.surface_energy": 0.0, "networks": {"notch": part},
    })  # fmt: skip
    simulation = mc.Simulation(scene, cells=table, threads=1)
    cells = simulation.cells
    row = cells.rows_of(np.arange(side**2))
    inside = cells.inside.copy()
    # the mean over the neighbours of the first colour is minus a half of it
    one = np.select([colours == 0, colours == 1], deviation, -sum(deviation))
    inside[:, 0] = n
    inside[row, 1], inside[row, 2] = d * (1.0 + one), d * (1.0 - 0.5 * one)
    cells.inside = inside
    found = []
    while not simulation.finished:
        simulation.step()
        row = simulation.cells.rows_of(np.arange(side**2))
        found.append(simulation.cells.inside[row, 1])
    return np.array(found), colours, d


def strength_of(slope):
    """Return the a at which the product of the slopes is this."""
    low, high = 0.1, 50.0
    for _ in range(100):
        a = math.sqrt(low * high)
        low, high = (a, high) if collier(a)[3] < slope else (low, a)
    return a


@pytest.mark.parametrize("slope", [-1.6, -2.4])
def test_a_sheet_is_unstable_where_the_theory_of_collier_says(compare, slope):
    # the sheet's lowest mode has three colours, and the mean of neighbours is -1/2 of a cell
    a = strength_of(slope)
    assert collier(a)[3] == pytest.approx(slope, rel=1e-6)
    found, colours, d = spread(a, 6.0, (1e-3, -5e-4))
    size = np.abs(found[:, colours == 0] - d).mean(axis=1)
    time = np.arange(1, len(found) + 1) * STEP / 3600.0
    rate = np.polyfit(time[8:], np.log(size[8:]), 1)[0]
    want = -1.0 + math.sqrt(-0.5 * slope)
    assert (rate > 0.0) == (slope < -2.0)
    compare.value(f"lateral inhibition on a sheet, F'G' = {slope:g}: growth rate", want, rate, 0.01,
                  "1/h")  # fmt: skip


def test_the_pattern_of_a_sheet_has_the_wavelength_of_its_lowest_mode(compare):
    found, _, _ = spread(0.01, 40.0, (0.9, -0.45))
    high = found[-1] > 0.5
    assert high.mean() == pytest.approx(1.0 / 3.0)
    place = np.stack([sheet_of(6)[0][f"position_{axis}_um"] for axis in "xy"], axis=1)[high]
    sizes = 9.0 * 6 * np.array([1.0, math.sqrt(0.75)])
    way = place[:, None] - place
    way -= sizes * np.round(way / sizes)
    apart = np.linalg.norm(way, axis=2) + 1e9 * np.eye(len(place))
    what = "lateral inhibition on a sheet: cells with Delta apart, over the distance of neighbours"
    compare.value(what, math.sqrt(3.0), float(apart.min(axis=1).mean()) / 9.0, 1e-9)
    assert np.ptp(apart.min(axis=1)) < 1e-9
