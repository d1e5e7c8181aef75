"""Networks that divide the cells that they are in, for tests and benchmarks."""

from __future__ import annotations

import numpy as np

import multicell as mc


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
