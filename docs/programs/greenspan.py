"""Greenspan's model of a spheroid along its radius (Stud. Appl. Math. 51, 1972, 317).

Nutrient is used up at a constant rate and diffuses in; cells die where it falls below a level.
Waste is made by living cells and diffuses out; cells stop dividing where it exceeds a level. Both
fields are at rest. Dividing tissue makes volume at the rate s, dead tissue loses it at the rate
`loss`:

    dR/dt = R / 3 [s (1 - phi^3) - loss eta^3]
    (R_n / R)^2 = (1 - eta)^2 (1 + 2 eta)                        for R > R_n, else eta = 0
    (R_i / R)^2 = 1 - phi^2 - 2 eta^3 (1 / phi - 1)              for R > R_i, else phi = 0

with R_n and R_i the radii at which the core and the inhibited region begin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, least_squares

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Greenspan:
    """Parameters: radius at the first day, um; rates, 1/d; radii at which the regions begin, um."""

    first: float
    growth: float
    loss: float
    necrotic: float
    inhibited: float

    def structure(self, radius: float) -> tuple[float, float]:
        """Return phi and eta at a radius in um."""
        eta = 0.0
        if radius > self.necrotic:
            ratio = (self.necrotic / radius) ** 2
            eta = brentq(lambda e: (1 - e) ** 2 * (1 + 2 * e) - ratio, 0.0, 1.0)
        if radius <= self.inhibited:
            return 0.0, eta
        ratio = (self.inhibited / radius) ** 2

        def excess(phi: float) -> float:
            return 1 - phi**2 - 2 * eta**3 * (1 / phi - 1) - ratio

        inner = max(eta, 1e-9)  # nothing divides in the core
        return (brentq(excess, inner, 1.0) if excess(inner) > 0 else eta), eta

    def course(self, days: Array, volume: float = 1.0) -> Array:
        """Return R, phi and eta at given days, (days, 3), of ``volume`` times the tissue."""

        def rate(_: float, state: Array) -> list[float]:
            phi, eta = self.structure(state[0])
            return [state[0] / 3 * (self.growth * (1 - phi**3) - self.loss * eta**3)]

        start = [self.first * volume ** (1 / 3)]
        span = (days[0], days[-1])
        found = solve_ivp(rate, span, start, t_eval=days, rtol=1e-6, atol=1e-4)
        return np.array([[radius, *self.structure(radius)] for radius in found.y[0]])


def fit(days: Array, mean: Array, sd: Array, starts: int = 20) -> Greenspan:
    """Return the model that fits means of R, phi and eta best, (days, 3), with their deviations."""

    def off(logarithms: Array) -> Array:
        model = Greenspan(*np.exp(logarithms))
        return ((model.course(days) - mean) / sd).ravel()

    guess = np.log([mean[0, 0], 0.3, 0.3, 230.0, 180.0])
    random = np.random.default_rng(0)
    tried = [
        least_squares(off, guess + 0.3 * random.standard_normal(5) * (k > 0)) for k in range(starts)
    ]
    return Greenspan(*np.exp(min(tried, key=lambda found: found.cost).x))
