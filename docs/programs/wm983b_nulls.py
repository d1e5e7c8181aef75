"""Predictions of spheroids that go from air to 2 % oxygen without a model of their cells."""

from __future__ import annotations

from dataclasses import replace

import greenspan
import numpy as np
import wm983b_regimes as regimes
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar
from wm983b_mechanisms import SWITCH

Array = NDArray[np.float64]


def predictions(days: Array) -> dict[str, Array]:
    """Return outer, inhibited and necrotic radius after the switch, um, (days, 3), by name."""
    air, low = (regimes.measured(regime) for regime in regimes.REGIMES)
    at_switch = air[1][air[0] == SWITCH][0]
    later = np.array([low[1][np.argmax(low[0] >= day)] for day in days])
    return {
        "as at the switch": np.tile(at_switch, (len(days), 1)),
        "as in air": between(days, air[0], air[1]),
        "as in 2 % oxygen": np.maximum(later, at_switch),
        "Greenspan, oxygen scaled": scaled_greenspan(days),
    }


def between(days: Array, known: Array, values: Array) -> Array:
    """Return values (k, 3) of known days at other days, by lines."""
    return np.stack([np.interp(days, known, column) for column in values.T], axis=1)


def scaled_greenspan(days: Array) -> Array:
    """Return Greenspan's model of air whose critical radii become those of 2 % at the switch.

    Its five parameters are fitted to air, and the factor of both radii to 2 % oxygen.
    """
    time, mean, sd = regimes.measured("air")
    ratio, deviation = mean / mean[:, :1], sd / mean[:, :1]
    ratio[:, 0], deviation[:, 0] = mean[:, 0], sd[:, 0]
    air = greenspan.fit(time, ratio, deviation, starts=3)
    low = regimes.measured("hypoxia")

    def poorer(factor: float) -> greenspan.Greenspan:
        return replace(air, necrotic=factor * air.necrotic, inhibited=factor * air.inhibited)

    def misfit(logarithm: float) -> float:
        model = replace(poorer(float(np.exp(logarithm))), first=float(low[1][0, 0]))
        return float((((lengths(model.course(low[0])) - low[1]) / low[2]) ** 2).sum())

    best = minimize_scalar(misfit, bounds=(np.log(0.05), 0.0), method="bounded")
    model = poorer(float(np.exp(best.x)))

    def rate(_: float, state: Array) -> list[float]:
        phi, eta = model.structure(state[0])
        return [state[0] / 3 * (model.growth * (1 - phi**3) - model.loss * eta**3)]

    first = [air.course(np.array([time[0], SWITCH + 1e-6]))[-1, 0]]
    found = solve_ivp(rate, (SWITCH, days[-1]), first, t_eval=days, rtol=1e-6, atol=1e-4)
    return lengths(np.array([[radius, *model.structure(radius)] for radius in found.y[0]]))


def lengths(course: Array) -> Array:
    """Return the three radii of R, phi and eta, (days, 3)."""
    return np.stack(
        [course[:, 0], course[:, 0] * course[:, 1], course[:, 0] * course[:, 2]], axis=1
    )
