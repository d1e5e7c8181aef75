"""Published results of networks in cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

import multicell as mc
from multicell.cells import Cells

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
def test_a_pattern_grows_where_the_theory_of_collier_says(a):
    # neighbours that alternate have the opposite deviation: growth where F'(D) G'(N) < -1, at the
    # rate -1 + sqrt(-F' G') in the inner cells of a row; both end cells have one neighbour
    found, slope = grown(a, 4.0)
    time = np.array([t for t, _, _ in found])
    size = np.array([np.abs(delta[4:8] - d).max() for _, d, delta in found])
    rate = np.polyfit(time[8:], np.log(size[8:]), 1)[0]
    want = -1.0 + math.sqrt(-slope)
    assert (slope < -1.0) == (a == 0.01)
    assert rate == pytest.approx(want, abs=0.1)


def test_the_pattern_of_lateral_inhibition_alternates():
    found, _ = grown(0.01, 48.0)
    delta = found[-1][2]
    high = delta > 0.5
    assert (high[1:] != high[:-1]).all()
    assert (np.abs(delta[high] - 1.0) < 0.05).all()
    assert (delta[~high] < 0.05).all()


def test_a_switched_medium_is_followed_as_an_exponential():
    # HIF is made at a constant rate and lost at one that oxygen raises
    made, slow, fast = 2e-4, 1e-4, 2e-2

    @mc.network(states={"HIF": 0.0}, inputs={"oxygen": 0.0}, amounts=("HIF",))
    def hif(t, y, u, p, out):
        out[0] = 2e-4 - (1e-4 + 2e-2 * u[0]) * y[0]

    part = {"network": hif, "inputs": {"oxygen": "oxygen"}, "start": "steady", "tolerance": 1e-8}
    scene = mc.load_scene("growth").with_changes({
        "duration": "4 h", "initial.count": 1, "growth": None, "coupling_step": "7 min",
        "networks": {"hif": part},
        "nutrients": {"oxygen": {"boundary": 0.2, "uptake": 0.0, "spacing": 20.0,
                                 "media": [["1 h", 0.01]]}},
    })  # fmt: skip
    simulation = mc.Simulation(scene, threads=1)
    normal, low = slow + fast * 0.2, slow + fast * 0.01
    assert simulation.cells.inside[0, 0] == pytest.approx(made / normal, rel=1e-3)
    while not simulation.finished:
        simulation.step()
        since = max(0.0, simulation.time - 3600.0)
        want = made / low + (made / normal - made / low) * math.exp(-low * since)
        assert simulation.cells.inside[0, 0] == pytest.approx(want, rel=2e-3)


TYSON = """
// J. J. Tyson, PNAS 88 (1991) 7328, Table 1 and its six equations; time in minutes
model tyson
  unit minute = 60 second
  unit time_unit = minute
  species C2 = 0, CP = 0.75, pM = 0.25, M = 0, Y = 0, YP = 0
  k1 = 0.015; k3 = 200; k4 = 180; k4p = 0.018; k6 = 1; k7 = 0.6; k8 = 1e6; k9 = 1e3
  CT := C2 + CP + pM + M
  J1: -> Y; k1
  J3: CP + Y -> pM; k3 * CP * Y
  J4: pM -> M; pM * (k4p + k4 * (M/CT)^2)
  J6: M -> C2 + YP; k6 * M
  J7: YP -> ; k7 * YP
  J8: C2 -> CP; k8 * C2
  J9: CP -> C2; k9 * CP
end
"""


def cycling(table, after, **changes):
    """Return a scene of one cell that divides when a condition comes true."""
    length = {"G1": "5 min", "S": "5 min", "G2": "5 min", "M": "15 min"}
    phases = {name: {"duration": time} for name, time in length.items()}
    phases["G1"]["after"] = after
    return mc.load_scene("growth").with_changes({
        "initial.count": 1, "initial.stage": "birth", "contact.surface_energy": 0.0,
        "growth.restriction": False, "growth.cycle_time": None, "growth.phases": phases,
        "growth.hypertrophy": False, "networks": {"cycle": table}, **changes,
    })  # fmt: skip


def births_of(simulation):
    """Return the times at which cells were born, each once, s."""
    times, known = {}, set()
    while not simulation.finished:
        simulation.step()
        cells = simulation.cells
        for row in np.flatnonzero(cells.parent >= 0):
            if int(cells.id[row]) not in known:
                times.setdefault(int(cells.parent[row]), simulation.time - cells.age[row])
        known |= set(cells.id.tolist())
    return np.sort(list(times.values()))


def test_the_cycle_of_tyson_1991_divides_cells(tmp_path):
    pytest.importorskip("antimony")
    file = tmp_path / "tyson.ant"
    file.write_text(TYSON)
    table = {"file": str(file), "dilution": False}
    scene = cycling(table, "cycle.M > 0.1", duration="200 min", coupling_step="4 min")
    times = births_of(mc.Simulation(scene, threads=1)) / 60.0
    # one cell, two, four, eight: all of a generation at the same time. The paper has a period of
    # 35 min; SciPy's LSODA at 1e-9 35.60
    each = np.unique(np.round(times, 2))
    assert len(each) == 5
    assert [int(np.sum(np.abs(times - x) < 0.05)) for x in each] == [1, 2, 4, 8, 16]
    assert each[0] == pytest.approx(48.88, abs=0.05)  # the pulse before that comes in G2
    np.testing.assert_allclose(np.diff(each), 35.60, atol=0.05)


@mc.network(
    states={"x": 0.9, "y": 0.01, "z": 0.0, "m": 5.0, "u": 1.0}, inputs={"P": 1.0},
    parameters={"a1": 0.05, "c1": 0.1, "cancer": 0.0}, time_unit=60.0,
)  # fmt: skip
def alarcon(t, y, u, p, out):
    """T. Alarcon, H. M. Byrne, P. K. Maini, J. theor. Biol. 229 (2004) 395; normal cells.

    x: Cdh1-APC, y: cyclin-CDK, z: p27, m: mass, u: RBNP; P: oxygen.
    """
    x, c, z, m, r = y[0], y[1], y[2], y[3], y[4]
    out[0] = (1.0 + 10.0 * r) * (1.0 - x) / (1.04 - x) - 5.5 * m * x * c / (0.04 + x)
    out[1] = 0.04 - (p[0] + x + 0.25 * z) * c
    made = p[1] * (1.0 - (1.0 - p[2]) * m / 10.0)
    out[2] = made - 0.01 * u[0] * z / (0.01 + u[0])
    out[3] = 0.01 * m * (1.0 - m / 10.0)
    out[4] = 0.01 - (0.1 + 0.01 * c) * r


def reference_cycles(level, threshold, count=2, **values):
    """Return the lengths of cycles by SciPy, h; infinite where a cell does not come to its end."""
    from scipy.integrate import solve_ivp

    p = np.array(list({"a1": 0.05, "c1": 0.1, "cancer": 0.0, **values}.values()))

    def rates(t, y):
        out = np.empty(5)
        alarcon.rates(t, y, (level,), p, out)
        return out

    def ends(t, y):
        return y[0] - threshold

    ends.terminal, ends.direction = True, -1
    y, found = np.array([0.9, 0.01, 0.0, 5.0, 1.0]), []
    for _ in range(count):
        end = solve_ivp(rates, (0.0, 6000.0), y, "LSODA", events=ends, rtol=1e-10, atol=1e-12)
        found.append(end.t[-1] / 60.0 if end.status == 1 else math.inf)
        y = end.y[:, -1] * np.array([1.0, 1.0, 1.0, 0.5, 1.0])
    return found


OXYGEN = {"diffusion": 2000.0, "uptake": 0.0, "spacing": 20.0}


def alarcon_scene(level, after, parameters=None, **changes):
    table = {"network": alarcon, "inputs": {"P": "oxygen"}, "dilution": False,
             "divide": {"m": "halve"}, "parameters": parameters or {}}  # fmt: skip
    nutrients = {"oxygen": {**OXYGEN, "boundary": level}}
    return cycling(table, after, nutrients=nutrients, coupling_step="10 min", **changes)


@pytest.mark.parametrize("level", [1.0, 0.1, 0.02, 0.005])
def test_oxygen_sets_the_cycle_of_alarcon_2004(level):
    first, second = reference_cycles(level, 0.004)
    if level == 1.0:  # what another program's tests have of it, by another solver
        assert first == pytest.approx(9.286356, abs=1e-4)
    simulation = mc.Simulation(
        alarcon_scene(level, "cycle.x < 0.004", duration=3600.0 * (first + second + 0.5)),
        threads=1,
    )
    times = births_of(simulation) / 3600.0
    assert len(simulation.cells) == 4
    np.testing.assert_allclose(times, [first, first + second, first + second], atol=2e-3)


@pytest.mark.parametrize("level", [0.02, 0.002])
def test_cancer_cells_without_oxygen_are_arrested(level):
    # z comes to rest at c1 (B + P) / (c2 P): so much p27 that x stays above the threshold
    values = {"a1": 0.04, "c1": 0.007, "cancer": 1.0}
    first, _ = reference_cycles(level, 0.04, **values)
    assert (first == math.inf) == (level == 0.002)
    duration = "90 h" if level == 0.002 else "3 h"
    scene = alarcon_scene(level, "cycle.x < 0.04", parameters=values, duration=duration)
    simulation = mc.Simulation(scene, threads=1)
    times = births_of(simulation) / 3600.0
    if level == 0.002:
        assert not len(times)
        z = simulation.cells.inside[0, 2]
        assert z == pytest.approx(0.007 * 0.012 / (0.01 * 0.002), rel=1e-3)
    else:
        assert times[0] == pytest.approx(first, abs=2e-3)
