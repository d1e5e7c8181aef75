"""Growth of PhysiCell's cells, whose water follows their solids, by the one rate of a volume.

Solids s of nucleus and cytoplasm go to their targets at their own rates, and water F follows them,
dF/dt = k (φ V - F) with V = F + s: by k (1 - φ), 1/80 min with PhysiCell's entries. Where a rule
lets cells divide by their volume it decides how often. Cells that always divide into halves at the
same volume are compared: the expected number of divisions is one over the time T between two,
which is solved for with PhysiCell's course of V, and then for the rate r of V' = r (K - V) that
gives the same T.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from multicell.roots import brent_root

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.importing.physicell.model import CellDefinition

_NODES: Final = 64  # of Gauss and Legendre, for the integral over a time between divisions


class DivisionRate(NamedTuple):
    """Rate at which cells divide by a rule about their volume, a Hill function.

    - ``least``, ``most``: of the smallest and the largest cells, 1/min
    - ``half``: volume half-way between them, µm³
    - ``power``: Hill power
    """

    least: float
    most: float
    half: float
    power: float

    def at(self, volume: FloatArray) -> FloatArray:
        """Return the rates, 1/min, at volumes in µm³."""
        return self.least + (self.most - self.least) / (1.0 + (self.half / volume) ** self.power)


def rate_with_water(kind: CellDefinition, chance: DivisionRate) -> float | None:
    """Return the rate r, 1/min, by which cells divide as often as PhysiCell's.

    - ``chance``: of division, which rises with the volume

    None where cells of PhysiCell have no water or nothing else, where their cytoplasm or their
    water does not grow, and where they divide however small they are.
    """
    fluid = kind.number_of("volume/fluid_fraction", 0.75)
    change = kind.number_of("volume/fluid_change_rate", 0.05)
    nucleus = min(kind.number_of("volume/nuclear", 540.0), kind.volume)
    rate = kind.number_of("volume/cytoplasmic_biomass_change_rate", 0.0045)
    drain, target = change * (1.0 - fluid), kind.volume
    most = float(chance.at(np.array([target]))[0])
    if not (0.0 < fluid < 1.0 and drain > 0.0 and rate > 0.0 and most > 0.0):
        return None
    nuclear = kind.number_of("volume/nuclear_biomass_change_rate", 0.0055)
    solids = (
        ((1.0 - fluid) * nucleus, nuclear),
        ((1.0 - fluid) * (target - nucleus), rate),
    )
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    places = 0.5 * (nodes + 1.0)

    def beyond(volume: FloatArray, time: float) -> float:
        """Return the expected divisions over a time, less one."""
        return 0.5 * time * float(weights @ chance.at(volume)) - 1.0

    def theirs(time: float) -> float:
        return beyond(_with_water(solids, drain, change * fluid, time, places * time), time)

    high = 20.0 / most
    while theirs(high) < 0.0:
        high *= 2.0
    low = high
    while theirs(low) > 0.0:
        low *= 0.5
    time = brent_root(theirs, low, high, rtol=1e-12, xtol=1e-9)

    def ours(pace: float) -> float:
        return beyond(_relaxing(target, pace, time, places * time), time)

    ends = 1e-6 / time, 1e3 / time
    if ours(ends[0]) >= 0.0 or ours(ends[1]) <= 0.0:
        return None
    return brent_root(ours, *ends, rtol=1e-12, xtol=0.0)


def _relaxing(target: float, rate: float, period: float, t: FloatArray) -> FloatArray:
    """Return a volume at times t that relaxes, doubles in a period and is halved then."""
    falls = math.exp(-rate * period)
    first = target * (1.0 - falls) / (2.0 - falls)
    return np.asarray(target - (target - first) * np.exp(-rate * t))


def _with_water(
    solids: tuple[tuple[float, float], ...],
    drain: float,
    fill: float,
    period: float,
    t: FloatArray,
) -> FloatArray:
    """Return the volume of a cell that doubles in a period and is halved then, at times t.

    - ``solids``: target (µm³) and rate (1/min) of each part
    - ``drain``, ``fill``: k (1 - φ) and k φ of dF/dt = -k (1 - φ) F + k φ s, 1/min
    """

    def came(t: FloatArray) -> FloatArray:
        """Return the water that came in since the beginning and is still there."""
        total = np.zeros_like(t)
        for target, rate in solids:
            away = target - _relaxing(target, rate, period, np.zeros(1))[0]
            apart = drain - rate
            shared = t if apart == 0.0 else -np.expm1(-apart * t) / apart
            total += fill * (
                -target * np.expm1(-drain * t) / drain - away * np.exp(-rate * t) * shared
            )
        return total

    first = float(came(np.array([period]))[0]) / (2.0 - math.exp(-drain * period))
    solid = sum(_relaxing(target, rate, period, t) for target, rate in solids)
    return np.asarray(solid + first * np.exp(-drain * t) + came(t))
