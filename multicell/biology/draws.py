"""Random draws of each cell: durations, type, modulus, and place in the cycle at the start.

A newborn cell draws its durations from the distributions of the scene. The living cells of a
population that has grown for long are no sample of newborn ones. Where nothing limits growth, and
cells die at any age at the same rate, births grow as exp(λt), and with T the time from birth to
division and μ the sum of λ and the rate of deaths

    2 E[exp(-μT)] = 1                                                      (Euler and Lotka).

Cells of age a and duration T then have the density 2μ exp(-μa) f(T) for 0 < a < T, f that of
newborn cells: ages alone 2μ exp(-μa) P(T > a), durations alone 2 f(T) (1 - exp(-μT)), and at a
given duration an exponential distribution that is cut off at T. Deaths leave it as it is: they
take as many of the old as of the young.

References
----------
E. O. Powell, J. gen. Microbiol. 15 (1956) 492, https://doi.org/10.1099/00221287-15-3-492
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multicell import random
from multicell.cells import FloatArray, IntArray
from multicell.random import Purpose
from multicell.roots import brent_root
from multicell.scene.parts import CYCLE_PHASES

if TYPE_CHECKING:
    from multicell.biology.plan import BiologyPlan
    from multicell.cells import Cells
    from multicell.scene.parts import Growth, PhaseLength


def draw_lengths(plan: BiologyPlan, ids: IntArray, kind: NDArray[np.int16]) -> FloatArray:
    """Return the durations of G1, S, G2 and M of each cell, (n, 4) s.

    They depend on seed and identity only; founders of a stable population
    (:func:`multicell.biology.plan.founders`) have longer ones than newborn cells.
    """
    return _drawn(plan, ids, partial(_phases, plan)) * duration_factor(plan, kind)[:, None]


def draw_cycle_times(plan: BiologyPlan, ids: IntArray, kind: NDArray[np.int16]) -> FloatArray:
    """Return cycle times of new cells, (n,), s; infinite in a scene without growth.

    Those of founders are longer than those of newborn cells.
    """
    growth = plan.growth
    if growth is None:
        return np.full(len(ids), np.inf)

    def draw(ids: IntArray, attempt: int) -> FloatArray:
        mean, variation = growth.cycle_time, growth.cycle_variation
        return scatter_about(plan.seed, Purpose.CYCLE, attempt, ids, mean, variation)

    drawn = _drawn(plan, ids, draw)
    return drawn if plan.cycle_scale is None else drawn * duration_factor(plan, kind)


def stages(
    plan: BiologyPlan, ids: IntArray, kind: NDArray[np.int16], duration: FloatArray
) -> FloatArray:
    """Return the part of its cycle that each cell has behind it at the start, (n,).

    ``duration`` is the time from birth to division of each cell, (n,) s. Where all are alike, or
    daughters inherit them, ages have the density 2 ln2 / T 2^(-a/T).
    """
    if plan.stage == "birth":
        return np.zeros(len(ids))
    u = random.uniform(plan.seed, Purpose.STAGE, 0, ids)[:, 0]
    if plan.stage == "uniform":
        return u
    if plan.growth is None or not plan.varies:
        return np.asarray(-np.log2(1.0 - 0.5 * u))
    cycle = malthusian_rate(plan.growth) * duration / duration_factor(plan, kind)
    return np.asarray(-np.log1p(u * np.expm1(-cycle)) / cycle)


def malthusian_rate(growth: Growth) -> float:
    """Return μ, the rate at which an unlimited population without deaths grows, 1/s."""
    slowest = math.log(2.0) / growth.mean_cycle  # by Jensen's inequality
    if growth.phases:
        parts = [growth.phases[name] for name in CYCLE_PHASES]
        fixed = all(part.distribution == "fixed" for part in parts)
    else:
        parts, fixed = [], growth.cycle_variation == 0.0
    if fixed:
        return slowest

    def excess(rate: float) -> float:
        if not parts:
            return math.log(2.0) + _log_normal(rate * growth.cycle_time, growth.cycle_variation)
        return math.log(2.0) + sum(_log_laplace(part, rate) for part in parts)

    fastest = 2.0 * slowest
    while excess(fastest) > 0.0:
        fastest *= 2.0
    # a variation that makes no difference leaves rounding at the lower end
    if excess(slowest) <= 0.0:
        return slowest
    return float(brent_root(excess, slowest, fastest, rtol=1e-14, xtol=1e-300))


def duration_factor(plan: BiologyPlan, kind: NDArray[np.int16]) -> FloatArray:
    """Return the factor of each cell's type on durations, (n,)."""
    return np.ones(len(kind)) if plan.cycle_scale is None else plan.cycle_scale[kind]


def quantile(phase: PhaseLength, u: FloatArray) -> FloatArray:
    """Return the durations at which a phase's distribution has the probabilities ``u``, s."""
    from scipy import special

    mean, variation = phase.duration, phase.variation
    if phase.distribution == "fixed":
        return np.full(len(u), mean)
    shift = _shift(phase)
    # the variation is that of the whole duration, shift included
    shape = ((1.0 - shift) / variation) ** 2
    random = special.gammaincinv(shape, u) / shape
    return np.asarray(mean * (shift + (1.0 - shift) * random))


def scatter_about(
    seed: int, purpose: Purpose, event: int, ids: IntArray, mean: float, variation: float
) -> FloatArray:
    """Return positive numbers that scatter normally about ``mean``, (n,).

    The normal distribution with coefficient of variation ``variation`` is cut on both sides at
    three standard deviations, or at 90 % of the mean where that is nearer (variations above 0.3,
    whose spread is then somewhat narrower than asked). The cut is symmetric: the mean stays.
    """
    if variation == 0.0:
        return np.full(len(ids), mean)
    z = random.truncated_normal(seed, purpose, event, ids, _cut(variation))
    return np.asarray(mean * (1.0 + variation * z))


def _phases(plan: BiologyPlan, ids: IntArray, attempt: int) -> FloatArray:
    """Return one draw of the durations of all phases, (n, 4) s."""
    assert plan.growth is not None
    u = random.uniform(plan.seed, Purpose.PHASES, 0, ids, len(CYCLE_PHASES), attempt)
    columns = [quantile(plan.growth.phases[name], u[:, k]) for k, name in enumerate(CYCLE_PHASES)]
    return np.stack(columns, axis=1)


def _drawn(
    plan: BiologyPlan, ids: IntArray, draw: Callable[[IntArray, int], FloatArray]
) -> FloatArray:
    """Return durations: the first draw of newborn cells, a later one of founders.

    Founders have the density 2 f(T) (1 - exp(-μT)): they repeat the draw until a random number is
    below 1 - exp(-μT), twice on average.
    """
    out = draw(ids, 0)
    left = (ids < plan.founders).nonzero()[0]
    rate, attempt = 0.0, 0
    if left.size and plan.growth is not None:
        rate = malthusian_rate(plan.growth)
    while left.size:
        attempt += 1
        drawn = draw(ids[left], attempt)
        u = random.uniform(plan.seed, Purpose.STAGE, 0, ids[left], attempt=attempt)[:, 0]
        good = u < -np.expm1(-rate * drawn.reshape(len(left), -1).sum(axis=1))
        out[left[good]] = drawn[good]
        left = left[~good]
    return out


def _log_laplace(phase: PhaseLength, rate: float) -> float:
    """Return log E[exp(-rate L)] of the duration L of a phase."""
    x, variation = rate * phase.duration, phase.variation
    if phase.distribution == "fixed":
        return -x
    shift = _shift(phase)
    shape = ((1.0 - shift) / variation) ** 2
    return -x * shift - shape * math.log1p(x * (1.0 - shift) / shape)


def _log_normal(x: float, variation: float) -> float:
    """Return log E[exp(-x (1 + variation z))] of a standard normal z that is cut."""
    from scipy import special

    cut, shift = _cut(variation), x * variation
    whole = special.ndtr(cut) - special.ndtr(-cut)
    part = special.ndtr(shift + cut) - special.ndtr(shift - cut)
    return -x + 0.5 * shift**2 + math.log(part / whole)


def _cut(variation: float) -> float:
    """Return where a normal distribution is cut, in standard deviations."""
    return min(3.0, 0.9 / variation)


def _shift(phase: PhaseLength) -> float:
    """Return the part of the mean at which a phase's gamma distribution begins."""
    return phase.shift if phase.distribution == "shifted-gamma" else 0.0


def draw_kinds(plan: BiologyPlan, ids: IntArray) -> NDArray[np.int16]:
    """Return the type of each cell at the start, (n,): the scene's fractions, mixed at random.

    The numbers of cells are the fractions rounded, not drawn: only who is what is random.
    """
    if len(plan.types) < 2:
        return np.zeros(len(ids), dtype=np.int16)
    share = np.cumsum([kind.fraction for kind in plan.types.values()])
    ends = np.round(share / share[-1] * len(ids))
    place = np.empty(len(ids))
    place[np.argsort(random.uniform(plan.seed, Purpose.KIND, 0, ids)[:, 0])] = np.arange(len(ids))
    return np.searchsorted(ends, place, side="right").astype(np.int16)


def draw_moduli(plan: BiologyPlan, ids: IntArray, kind: NDArray[np.int16]) -> FloatArray:
    """Return Young's moduli of new cells, (n,), kPa."""
    mean, variation = plan.cells.young, plan.cells.young_variation
    drawn = scatter_about(plan.seed, Purpose.MODULI, 0, ids, mean, variation)
    return drawn if plan.young_ratio is None else np.asarray(drawn * plan.young_ratio[kind])


def drift(plan: BiologyPlan, daughters: Cells) -> None:
    """Let traits that daughters inherit drift: ln x changes by a normal number of the scene's sd.

    The mean of ln x stays, so that its variance grows by sd² in each generation. The normal
    distribution is cut at three standard deviations.
    """
    for place, (name, sd) in enumerate((plan.cells.drift or {}).items()):
        z = random.truncated_normal(plan.seed, Purpose.DRIFT, place, daughters.id, 3.0)
        setattr(daughters, name, getattr(daughters, name) * np.exp(sd * z))
