"""Branching Brownian motion: the foremost descendant solves Fisher's equation (McKean 1975).

Of cells that divide at a rate r and diffuse with D, the foremost of a family that began at 0 is
beyond x at the time t with the chance u(x, t), where u_t = D u_xx + r u (1 - u) and u(x, 0) is a
step at 0. Its median lags behind 2 √(rD) t by 3/2 √(D/r) ln t (M. D. Bramson, Comm. Pure Appl.
Math. 31 (1978) 531) when t is large.
"""

import numpy as np
import pytest
from families import cycle_of, founders
from running import finished
from scipy import stats
from scipy.integrate import solve_ivp

import multicell as mc

SUBJECT, SOURCE = "biology", "mckean1975"
FAMILIES, HOURS = 1500, 40.0
RATE, D = 0.1 / 3600.0, 1.0  # 1/s and µm²/s: √(D/r) is 190 µm, 2 √(rD) 38 µm/h
ACROSS = np.sqrt(D / RATE)


def foremost(x):
    """Return u(x, t) at the end, by lines of central differences."""
    grid = np.arange(-8.0, 18.0, 0.02)  # in units of √(D/r), times in those of 1/r
    start = (grid < 0).astype(float)
    start[np.isclose(grid, 0.0)] = 0.5

    def change(_, u):
        bent = np.diff(np.concatenate([[1.0], u, [0.0]]), 2) / 0.02**2
        return bent + u * (1 - u)

    end = RATE * HOURS * 3600.0
    u = solve_ivp(change, (0, end), start, "LSODA", lband=1, uband=1, rtol=1e-7, atol=1e-9).y[:, -1]
    return np.interp(np.asarray(x) / ACROSS, grid, u)


@pytest.mark.slow
def test_the_foremost_of_a_family_solves_fishers_equation(compare):
    scene = mc.Scene.from_dict({
        "duration": f"{HOURS} h", "coupling_step": "30 min", "seed": 2, "contact": {"law": "none"},
        "dimensions": 2, "growth": {"restriction": False, "phases": cycle_of(1.0 / RATE, 1)},
        "motility": {"diffusion": D},
    })  # fmt: skip
    nothing = np.zeros(FAMILIES)
    run = finished(mc.Simulation(scene, cells={"x_um": nothing, "y_um": nothing}))
    known = founders(run)
    of = np.array([known[i][0] for i in run.cells.id.tolist()])
    most = np.full(FAMILIES, -np.inf)
    np.maximum.at(most, of, run.cells.position[:, 0])
    x = np.linspace(-5 * ACROSS, 15 * ACROSS, 4001)
    chance = foremost(x)
    median = np.interp(0.5, chance[::-1], x[::-1])
    density = -np.gradient(chance, x)
    error = 0.5 / np.interp(median, x, density) / np.sqrt(FAMILIES)
    what = f"foremost of {FAMILIES:,} families after 4 divisions on average"
    compare.value(f"{what}: median", round(median, 2), np.median(most), round(3.5 * error, 1), "µm")
    off = stats.kstest(most, lambda y: 1.0 - foremost(y)).statistic
    # Kolmogorov's distribution: 1 in 2,000 would be beyond
    limit = round(stats.kstwobign.isf(0.0005) / np.sqrt(FAMILIES), 4)
    compare.deviation(f"{what}: distribution", "Fisher's equation", off, limit)
    # without branching, or with independent cells, the median would be elsewhere
    free = stats.norm(scale=np.sqrt(2 * D * HOURS * 3600.0)).median()
    assert abs(np.median(most) - free) > 50 * error
