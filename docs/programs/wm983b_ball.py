"""Oxygen in WM983b spheroids by their measured radii alone: the uptake that gives hypoxic radii.

A ball at rest has the measured outer radius, and a core of the measured necrotic radius that takes
nothing up. In the tissue between them and in a layer of still medium round it oxygen c follows

    D (r² c')' / r² = q(c),    no flow at the core,    that of the medium beyond the layer

and the hypoxic radius is where c is 10 mmHg, which is what pimonidazole marks. The laws of uptake
q are fitted to the measured hypoxic radii in air and in 2 % oxygen; those after the switch are
predicted. Finite volumes and Newton's method; no cells, and no code of the package's fields.

Data      docs/data/wm983b-oxygen.csv and wm983b-switched.csv, means of spheroids of a day
Command   python docs/programs/wm983b_ball.py    prints rms of (model - mean) / sd for each law, and
          the oxygen at the edges of the measured core and of the inhibited region
Cost      a minute
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.optimize import least_squares
from wm983b_regimes import measured_columns, rms

Array = NDArray[np.float64]

SHELLS = 200
TISSUE, MEDIUM = 2000.0, 2600.0
"""Coefficients of diffusion, um²/s, as in the scene."""
PER_MMHG = 1.403e-3
"""Oxygen in medium at 37 °C, mM/mmHg."""
HYPOXIC = 10.0 * PER_MMHG
AIR, LOW = 149.7 * PER_MMHG, 14.26 * PER_MMHG
"""21 and 2 % oxygen above medium at 37 °C, below 760 mmHg less those of water (47)."""
REGIMES = ("air", "hypoxia", "switched")
COLUMNS = ("outer", "inhibited", "necrotic", "pimonidazole")
DEPTH = np.array([1.0, 0.0, 0.0, -1.0])
"""Of the columns: how far below the surface hypoxia begins."""
MOST = 0.1
"""Largest uptake that a fit may find, mM/s: three times that of the scene `wm983b`."""

Uptake = Callable[[Array], Array]


@dataclass(frozen=True)
class Law:
    """A law of uptake with its parameters.

    - ``says``: in words
    - ``ranges``: of parameters, all fitted by their logarithms: largest uptake (mM/s), layer of
      still medium (um), and what else the law has
    - ``of``: the uptake (mM/s) over concentration (mM) for parameters, and whether it is in 2 %
    """

    says: str
    ranges: dict[str, tuple[float, float]]
    of: Callable[[Array, bool], Uptake]


_SHARED = {"largest uptake / mM/s": (0.005, MOST), "layer / um": (0.1, 3000.0)}
_HALF = 0.005  # mM, half saturation where it is not fitted: that of the scene

LAWS = (
    Law("constant but where there is next to none", _SHARED, lambda p, _: _saturated(p[0], _HALF)),
    Law(
        "saturation from far above hypoxia on",
        _SHARED | {"half saturation / mM": (1e-3, 1.0)},
        lambda p, _: _saturated(p[0], p[2]),
    ),
    Law(
        "less in all cells of spheroids in 2 %",
        _SHARED | {"part that is left": (0.01, 1.0)},
        lambda p, low: _saturated(p[0] * (p[2] if low else 1.0), _HALF),
    ),
    Law(
        "less in the cells that are hypoxic",
        _SHARED | {"part that is left": (1e-3, 1.0), "level / mM": (0.002, 0.1)},
        lambda p, _: _falling(p[0], p[2], p[3]),
    ),
)


def main() -> None:
    """Print the fit of each law, and null predictions."""
    for law in LAWS:
        best = fitted(law)
        values = ", ".join(f"{k} {v:.2g}" for k, v in zip(law.ranges, best, strict=True))
        found = ", ".join(f"{regime} {rms(off(law, best, regime)):.2f}" for regime in REGIMES)
        print(f"{law.says}: {found}\n    {values}")
        for regime in REGIMES:
            edges = np.array([at_edges(law, best, regime, row) for row in rows(regime)[1]])
            text = ["  ".join(f"{c / PER_MMHG:5.1f}" for c in column) for column in edges.T]
            print(
                f"    {regime:9s} mmHg at the core: {text[0]}; at the inhibited region: {text[1]}"
            )
    for regime in ("air", "hypoxia"):
        _, mean, sd = rows("switched")
        depth = float(np.mean(rows(regime)[1] @ DEPTH))
        missed = (mean @ DEPTH - depth) / sd[:, 3]
        print(f"as deep as in {regime}, {depth:.0f} um: switched {rms(missed):.2f}")


def rows(regime: str) -> tuple[Array, Array, Array]:
    """Return days (k,), measured radii and deviations (um), each (k, 4), as `COLUMNS`."""
    return measured_columns(regime, COLUMNS)


def fitted(law: Law) -> Array:
    """Return the parameters that fit the hypoxic radii in air and in 2 % best."""
    ends = np.log(np.array(list(law.ranges.values())))

    def misfit(x: Array) -> Array:
        return np.concatenate([off(law, np.exp(x), regime) for regime in ("air", "hypoxia")])

    tries = [  # a radius does not change where all of the tissue is hypoxic, so that some end early
        least_squares(
            misfit, ends[:, 0] + share * (ends[:, 1] - ends[:, 0]), bounds=ends.T, diff_step=1e-3
        )
        for share in np.random.default_rng(1).uniform(0.05, 0.95, (12, len(ends)))
    ]
    best: Array = min(tries, key=lambda found: found.cost).x
    return np.exp(best)


def off(law: Law, values: Array, regime: str) -> Array:
    """Return (hypoxic radius of the ball - measured) / sd on the days of a regime, (k,)."""
    _, mean, sd = rows(regime)
    return np.array([
        (hypoxic_radius(*profile(law, values, regime, row)) - row[3]) / deviation[3]
        for row, deviation in zip(mean, sd, strict=True)
    ])  # fmt: skip


def at_edges(law: Law, values: Array, regime: str, row: Array) -> tuple[float, float]:
    """Return the concentration at the edges of core and inhibited region, mM."""
    r, c = profile(law, values, regime, row)
    return float(np.interp(row[2], r, c)), float(np.interp(row[1], r, c))


def profile(law: Law, values: Array, regime: str, row: Array) -> tuple[Array, Array]:
    """Return radii (um) and concentrations (mM) from the core's edge to the surface."""
    low = regime != "air"
    return solve(law.of(values, low), row[2], row[0], values[1], LOW if low else AIR)


def hypoxic_radius(r: Array, c: Array) -> float:
    """Return the radius within which there is less than 10 mmHg; 0 where there is not, um."""
    return 0.0 if c[0] > HYPOXIC else float(np.interp(HYPOXIC, c, r))


def solve(
    uptake: Uptake, core: float, radius: float, layer: float, medium: float
) -> tuple[Array, Array]:
    """Return radii (um) and concentrations (mM) in a ball at rest.

    The first and the last value are those at the core's edge and at the surface.
    """
    faces = np.linspace(core, radius, SHELLS + 1)
    r, h = 0.5 * (faces[1:] + faces[:-1]), faces[1] - faces[0]
    volume = np.diff(faces**3) / 3.0
    inner = TISSUE * faces[1:-1] ** 2 / h
    half = 0.5 * h / (TISSUE * radius**2)
    outer = 1.0 / (half + (1.0 / radius - 1.0 / (radius + layer)) / MEDIUM)

    def lacking(c: Array) -> Array:
        flow = np.concatenate([[0.0], inner * np.diff(c), [outer * (medium - c[-1])]])
        return np.diff(flow) - volume * uptake(c)

    # every law rises with c, so that there is one solution, and shortened steps come to it
    c = np.full(SHELLS, medium)
    left = lacking(c)
    for _ in range(200):
        step = 1e-6 * c
        slope = (uptake(c + step) - uptake(c - step)) / (2.0 * step)
        bands = np.zeros((3, SHELLS))
        bands[0, 1:] = bands[2, :-1] = -inner
        bands[1] = np.append(inner, outer) + np.append(0.0, inner) + volume * slope
        way = solve_banded((1, 1), bands, left)
        part = 1.0
        new = np.where(c + way > 0.0, c + way, 0.1 * c)
        while np.linalg.norm(lacking(new)) > np.linalg.norm(left) and part > 1e-4:
            part *= 0.5
            new = np.where(c + part * way > 0.0, c + part * way, 0.1 * c)
        change = np.abs(new - c).max()
        c, left = new, lacking(new)
        if change < 1e-9 * medium:
            surface = c[-1] + half * outer * (medium - c[-1])
            # nothing flows at the core's edge: a parabola through the two innermost
            edge = max(c[0] - (c[1] - c[0]) / 8.0, 0.0)
            return np.concatenate([[core], r, [radius]]), np.concatenate([[edge], c, [surface]])
    raise ArithmeticError(f"No field at rest in a ball of {radius:g} um with a core of {core:g} um")


def _saturated(largest: float, half: float) -> Uptake:
    return lambda c: largest * c / (half + c)


def _falling(largest: float, left: float, level: float) -> Uptake:
    def uptake(c: Array) -> Array:
        hypoxic = 1.0 / (1.0 + (c / level) ** 4)
        return largest * c / (_HALF + c) * (1.0 - (1.0 - left) * hypoxic)

    return uptake


if __name__ == "__main__":
    main()
