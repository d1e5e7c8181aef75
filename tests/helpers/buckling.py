"""A chain of three cells between walls, pressed so that it buckles."""

import math

import numpy as np
from strategies import mechanics

from multicell import Hertz
from multicell.contact.law import compliance
from multicell.mechanics.walls import Walls

RADIUS, DISTANCE, SOFT, VISCOSITY, TINY = 5.0, 8.0, 0.5, 2.0, 1e-3


def contact_force(h):
    """Hertz between two of these cells, nN: E* = E / (1 - ν²) / 2, r = R / 2."""
    modulus = 1.0 / 0.75 / 2.0
    return 4.0 / 3.0 * modulus * math.sqrt(0.5 * RADIUS) * max(h, 0.0) ** 1.5


def wall_force(h):
    soft = compliance(np.ones(1), np.full(1, 0.5))[0] + SOFT
    return math.sqrt(RADIUS) / soft * max(h, 0.0) ** 1.5


class Chain:
    """Three cells between two walls, written by hand: nothing of the package but constants."""

    drag = 6.0 * math.pi * VISCOSITY * RADIUS
    force = contact_force(2.0 * RADIUS - DISTANCE)
    indentation = (force / wall_force(1.0)) ** (2.0 / 3.0)
    wall = DISTANCE + RADIUS - indentation
    rate = 3.0 * force / (DISTANCE * drag)
    """Across the chain J is F / (d Γ) times the graph's Laplacian, with eigenvalues 0, 1, 3."""

    def __call__(self, time, y):
        x = y.reshape(3, 2)
        out = np.zeros_like(x)
        for i, j in ((0, 1), (1, 2), (0, 2)):
            line = x[j] - x[i]
            d = np.linalg.norm(line)
            push = contact_force(2.0 * RADIUS - d) * line / d
            out[i] -= push
            out[j] += push
        for i in range(3):
            out[i, 0] += wall_force(RADIUS - (x[i, 0] + self.wall))
            out[i, 0] -= wall_force(RADIUS - (self.wall - x[i, 0]))
        return (out / self.drag).ravel()


LENGTH = 40.0 / Chain.rate


def chain(length=LENGTH):
    """Return the chain pressed straight, but for a tiny zigzag, ready for a coupling step."""
    inf = np.inf
    walls = Walls(np.array([-Chain.wall, -inf, -inf]), np.array([Chain.wall, inf, inf]), SOFT)
    system = mechanics(
        np.full(3, RADIUS), np.ones(3), Hertz(), viscosity=VISCOSITY, walls=walls, duration=length
    )
    zigzag = TINY * RADIUS * np.array([0.5, -1.0, 0.5])
    return system, np.stack([DISTANCE * np.array([-1.0, 0.0, 1.0]), zigzag, np.zeros(3)], axis=1)
