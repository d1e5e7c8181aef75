"""E-cadherin and beta-catenin in cells that lose contacts: the model of Ramis-Conde et al. (2008).

The equations and the corrected parameters are those that V. Andasari et al., PLoS ONE 7 (2012)
e33726, print (equations 7 to 12, table 1). There the contact area of each neighbour counts; here
each contact is the same part of a cell's surface, and is made and lost within the time ``lag``.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import multicell as mc
from multicell.networks.network import Event
from multicell.networks.solver import NetworkSolver

SUBJECT, SOURCE = "networks", "ramisconde2008"
VALUES = {
    "nu": 100.0,
    "kplus": 1.5,
    "kminus": 19.0,
    "k2": 1.0,
    "km": 14.0,
    "alpha": 2.0,
    "ct": 50.0,
    "rho": 200.0,
    "pt": 21.0,
    "et": 100.0,
    "area": 0.05,
    "lag": 0.1,
}


def rises(t, y, u, p):
    """Free catenin above the threshold."""
    return y[2] - p[6]


def has_risen(t, y, u, p, y_then, p_then):
    p[12] = 0.0


def falls(t, y, u, p):
    """Free catenin below the threshold."""
    return p[6] - y[2]


def has_fallen(t, y, u, p, y_then, p_then):
    p[12] = 1.0


@mc.network(
    states={"Ec": 0.0, "EB": 100.0, "B": 20.0, "C": 14.0, "seen": 0.0},
    inputs={"contacts": 0.0},
    parameters={**VALUES, "below": 1.0},
    time_unit=60.0,
    events=[Event("rises", rises, has_risen), Event("falls", falls, has_fallen)],
)
def cadherin(t, y, u, p, out):
    """Ec: cadherin in the cytoplasm, EB: bound to catenin at the surface, B: catenin, C: with the
    proteasome; nM and minutes.
    """
    nu, kplus, kminus, k2, km, alpha, _, rho, pt, et, area, lag, below = p
    change = (u[0] - y[4]) / lag
    made, lost = rho * area * max(change, 0.0), rho * area * max(-change, 0.0)
    bound = nu * (et - y[0] - y[1]) * y[2] if below == 1.0 else -alpha * y[1]
    taken = kplus * y[2] * (pt - y[3]) - kminus * y[3]
    out[0] = lost * y[1] - made * y[0]
    out[1] = bound - lost * y[1]
    out[2] = lost * y[1] - bound - taken + km
    out[3] = taken - k2 * y[3]
    out[4] = change


def rest_of(kplus, k2):
    """Return free catenin and that with the proteasome at rest, by hand."""
    c = VALUES["km"] / k2
    return (VALUES["kminus"] + k2) * c / (kplus * (VALUES["pt"] - c)), c


def solver_at(kplus, k2, count, **more):
    """Return a solver, and cells with all cadherin bound to catenin."""
    solver = NetworkSolver(cadherin, relative=1e-7, absolute=1e-7)
    values = np.tile(
        list({**VALUES, "kplus": kplus, "k2": k2, **more, "below": 1.0}.values()), (count, 1)
    )
    inside = solver.begin(count, values=values)
    inside.y[:] = [0.0, VALUES["et"], *rest_of(kplus, k2), 1.0]
    return solver, inside


@pytest.mark.parametrize(("kplus", "k2"), [(1.5, 1.0), (1.0, 1.0), (1.0, 0.95), (1.0, 1.05)])
def test_catenin_rests_below_the_threshold(compare, kplus, k2):
    solver, inside = solver_at(kplus, k2, 1)
    inside.y[:] = [0.0, 0.0, 1.0, 1.0, 1.0]
    full = np.ones((1, 1))
    free = solver.advance(inside, full, full, 0.0, 600.0).y[0, 2]
    assert free < VALUES["ct"]
    what = f"free catenin at rest, proteasome binds at {kplus:g}, degrades at {k2:g}"
    compare.value(what, rest_of(kplus, k2)[0], free, 1e-3, "nM")


def lost_by_scipy(loss, kplus, time):
    """Return bound cadherin some minutes after a part of the surface was lost in one minute."""
    nu, _, kminus, k2, km, alpha, ct, rho, pt, et, _, _ = VALUES.values()

    def rates(t, y):
        ec, eb, b, c = y
        d = rho * loss if t < 1.0 else 0.0
        a1 = nu * (et - ec - eb) * b if b < ct else -alpha * eb
        eq = kplus * b * (pt - c) - kminus * c
        return [d * eb, a1 - d * eb, -a1 + d * eb - eq + km, eq - k2 * c]

    y = [0.0, et, *rest_of(kplus, k2)]
    for begin, end in ((0.0, 1.0 - 1e-12), (1.0, time)):
        y = solve_ivp(rates, (begin, end), y, "Radau", rtol=1e-8, atol=1e-8, max_step=0.05).y[:, -1]
    return y


@pytest.mark.parametrize("kplus", [1.5, 1.0])
def test_catenin_of_lost_contacts_lets_go_of_the_others(compare, kplus):
    part = np.array([0.0004, 0.0008, 0.0012, 0.0024, 0.0048])
    solver, inside = solver_at(kplus, 1.0, len(part), area=1.0, lag=1e-4)
    before, after = np.ones((len(part), 1)), 1.0 - part[:, None]
    inside = solver.advance(inside, before, after, 0.0, 1.0)
    found = solver.advance(inside, after, after, 1.0, 4.0).y
    theirs = np.array([lost_by_scipy(x, kplus, 5.0) for x in part])
    gone = found[:, 1] < 0.5 * VALUES["et"] * np.exp(-VALUES["rho"] * part)
    # the less catenin is degraded, the smaller a loss takes a cell beyond the threshold
    assert gone.tolist() == [False, kplus == 1.0, kplus == 1.0, True, True]
    off = np.abs(found[:, :4] - theirs).max()
    what = f"four states after five losses of contact area, proteasome binds at {kplus:g}"
    compare.deviation(what, "solve_ivp (Radau, 1e-8)", off, 0.05, "nM")


def end_of(rho):
    """Return the least mean of bound cadherin in moving cells, and how far they have spread."""
    scene = mc.load_scene("hypoxia-invasion").with_changes(
        {
            "initial.count": 40,
            "duration": "8 h",
            "output.every": "4 h",
            "coupling_step": "5 min",
            "nutrients": {},
            "motility.force": "0.15 nN",
            "networks": {
                "cadherin": {
                    "network": cadherin,
                    "inputs": {"contacts": "neighbours"},
                    "parameters": {"rho": rho},
                }
            },
            "responses": {
                name: {
                    "behaviour": name,
                    "signal": "cadherin.EB",
                    "law": "linear",
                    "begin": 0.0,
                    "end": 100.0,
                }
                for name in ("receptors", "ligands")
            },
        }
    )
    history = mc.run(scene, report=False).history
    return history["network_mean_cadherin_EB"].min(), history["radius"][-1] / history["radius"][0]


@pytest.mark.slow
def test_moving_cells_detach_where_lost_contacts_release_catenin():
    # with rho = 0 catenin stays at the surface whatever cells lose
    bound, spread = end_of(0.0)
    assert bound == pytest.approx(VALUES["et"], abs=0.01)
    assert spread == pytest.approx(1.0, abs=0.1)
    least, wide = end_of(VALUES["rho"])
    assert least < 0.8 * bound
    assert wide > 1.4
