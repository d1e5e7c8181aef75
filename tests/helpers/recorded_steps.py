"""Recorded coupling steps at which methods fail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from buckling import Chain, chain
from strategies import mechanics

import multicell as mc
from multicell import JKR
from multicell.comparison.stability_limits.recorded import RecordedState
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.mechanics.walls import Walls

_FILE = Path(__file__).parents[1] / "integrators" / "passed-contacts.npz"


def _recorded(name, system, start):
    scene = mc.load_scene("growth")
    return RecordedState(name, scene, system, system.motion, start, np.arange(len(start)))


def motile_state(name="loose"):
    """Return a step of 51 cells that move by themselves, of which two graze each other at 731 s.

    ``packed`` is another step, in which cells part from each other at 101 s. See
    tests/integrators/test_passed_contacts.py.
    """
    with np.load(_FILE) as stored:
        names = [key for key in stored if key.startswith(f"{name}_")]
        cells = {key.removeprefix(f"{name}_"): stored[key] for key in names}
    energy, viscosity = cells["medium"]
    system = Mechanics(JKR(surface_energy=float(energy)), float(viscosity))
    radii = (cells[name] for name in ("radius", "radius_rate", "young", "poisson"))
    system.begin(Motion(*radii, *map(float, cells["span"]), push=cells["push"]))
    return _recorded("motile", system, cells["start"])


def motile_end():
    """Return where these cells end, (n, 3) µm, by LSODA at 1e-9 on another right-hand side."""
    with np.load(_FILE) as stored:
        return stored["loose_end"]


def chain_state(length, scale):
    """Return the chain of tests/helpers/buckling.py.

    - ``length``: of the step over the time in which its zigzag grows e-fold
    - ``scale``: of the zigzag
    """
    system, start = chain(length / Chain.rate)
    start = start * np.array([1.0, scale, 1.0])
    return _recorded("chain", system, start)


def pulled_state(viscosity=0.1, until=0.95, step=600.0):
    """Return two cells between walls that a growing force pulls apart until their contact breaks.

    - ``until``: part of the step after which the force is the largest that the contact holds
    """
    radius, law = 5.0, JKR(surface_energy=0.1)
    h = np.linspace(0.01, 4.0, 8000)
    force = np.array([float(law.force(x, 1.0 / 1.5, 0.5 * radius)) for x in h])
    rest, most = h[np.flatnonzero(force > 0.0)[0]], -force.min()
    place, inf = radius - 0.5 * rest, np.inf
    low = np.array([-(place + radius + 1.5), -inf, -inf])
    system = mechanics(
        np.full(2, radius), np.ones(2), law, viscosity=viscosity, duration=step,
        walls=Walls(low, -low, 0.5),
    )  # fmt: skip
    push = np.zeros((2, 6))
    push[:, 0] = 0.5 * most * np.array([-1.0, 1.0])
    push[:, 3] = push[:, 0] / (until * step)
    system.begin(replace(system.motion, push=push))
    start = place * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    return _recorded("pulled", system, start)
