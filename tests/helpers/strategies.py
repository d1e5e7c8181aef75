"""Populations and pairs for tests, in one place."""

import numpy as np
from hypothesis import strategies as st

from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

SEED_SET = {"young": 1.0, "poisson": 0.5, "surface_energy": 0.1}
"""Parameters of the thesis: nN/µm², dimensionless, nN/µm."""

radii = st.floats(1.0, 12.0)
moduli = st.floats(0.1, 10.0)
poissons = st.floats(-0.5, 0.5)
energies = st.just(0.0) | st.floats(1e-9, 0.5)
laws = st.one_of(st.just(Hertz()), energies.map(lambda s: JKR(surface_energy=s)))
seeds = st.integers(0, 2**32 - 1)


ONE_OF_A_KIND = (
    "euler", "rk4-adaptive", "ab2-adaptive", "multirate-euler", "rkc2", "backward-euler", "cvode",
    "rosenbrock", "scipy-bdf",
)  # fmt: skip
"""A method of each loop and solver."""


def cluster(n, seed, spacing=0.85, variation=0.05):
    """Return centres, radii and moduli of a jittered close-packed ball, in random order."""
    rng = np.random.default_rng(seed)
    m = int(np.ceil(n ** (1 / 3))) + 3
    i, j, k = np.indices((m, m, m)).reshape(3, -1)
    lattice = np.stack(
        [
            i + 0.5 * ((j + k) % 2),
            np.sqrt(0.75) * (j + (k % 2) / 3),
            np.sqrt(2 / 3) * k,
        ],
        axis=1,
    )
    lattice -= lattice.mean(axis=0)
    ball = lattice[np.argsort((lattice**2).sum(axis=1), kind="stable")[:n]]
    position = 10.0 * spacing * ball + rng.normal(0.0, 0.3, (n, 3))
    order = rng.permutation(n)
    radius = 5.0 * (1.0 + variation * rng.uniform(-1, 1, n))
    young = 1.0 + variation * rng.uniform(-1, 1, n)
    return position[order], radius, young


def divided(position, radius, young, mothers, seed):
    """Return centres, radii and moduli after a division of some cells along random axes.

    Daughters stand at the mothers' places and at the end, within the spheres that these were.
    """
    axis = np.random.default_rng(seed).normal(size=(len(mothers), 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    small = radius[mothers] * 0.5 ** (1 / 3)
    aside = (radius[mothers] - small)[:, None] * axis
    sisters = position[mothers] - aside
    position, radius = position.copy(), radius.copy()
    position[mothers] += aside
    radius[mothers] = small
    return (
        np.concatenate([position, sisters]),
        np.concatenate([radius, small]),
        np.concatenate([young, young[mothers]]),
    )


def mechanics(radius, young, law=None, *, duration=100.0, rate=None, viscosity=5.0, **options):
    """Return the mechanics of cells with Poisson ratio ½ over a step from 0 to ``duration``."""
    n = len(radius)
    system = Mechanics(JKR(surface_energy=0.1) if law is None else law, viscosity, **options)
    rate = np.zeros(n) if rate is None else rate
    system.begin(
        Motion(np.asarray(radius), rate, np.asarray(young), np.full(n, 0.5), 0.0, duration)
    )
    return system
