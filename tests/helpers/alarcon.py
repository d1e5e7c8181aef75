"""The cell cycle under oxygen of Alarcón, Byrne and Maini, J. Theor. Biol. 229 (2004), 395."""

from __future__ import annotations

import multicell as mc

START = {"Cdh1": 0.9, "CycCdk": 0.01, "p27": 0.0, "mass": 5.0, "RBNP": 1.0}
NORMAL = {"a1": 0.05, "a2": 1.0, "a3": 0.25, "a4": 0.04, "b3": 10.0, "b4": 5.5, "c1": 0.1,
          "c2": 0.01, "d1": 0.01, "d2": 0.1, "J3": 0.04, "J4": 0.04, "eta": 0.01, "largest": 10.0,
          "B": 0.01}  # fmt: skip
"""Parameters of normal cells, per minute where they are rates."""


@mc.network(states=START, inputs={"oxygen": 1.0}, parameters=NORMAL, time_unit=60.0)
def alarcon(t, y, u, p, out):
    """Complexes of Cdh1 and APC, cyclin-CDK, p27, mass, and the phosphorylated RB protein."""
    a1, a2, a3, a4, b3, b4, c1, c2, d1, d2, j3, j4, eta, largest, half = p
    cdh1, cyclin, p27, mass, rbnp = y
    on = (1.0 + b3 * rbnp) * (1.0 - cdh1) / (j3 + 1.0 - cdh1)
    out[0] = on - b4 * mass * cdh1 * cyclin / (j4 + cdh1)
    out[1] = a4 - (a1 + a2 * cdh1 + a3 * p27) * cyclin
    out[2] = c1 * (1.0 - mass / largest) - c2 * u[0] * p27 / (half + u[0])
    out[3] = eta * mass * (1.0 - mass / largest)
    out[4] = d1 - (d2 + d1 * cyclin) * rbnp


def alarcon_scene(**changes):
    """Return a few cells that stand still and have this network."""
    own = {"network": alarcon, "dilution": False}
    return mc.load_scene("growth").with_changes({
        "duration": "2 h", "initial.count": 4, "growth": None, "output.every": "1 h",
        "networks": {"cycle": own}, **changes,
    })  # fmt: skip
