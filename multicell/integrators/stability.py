"""Check whether the fixed step of an explicit method stays below its limit of stability.

Beyond stable / λ, with the largest decay rate λ of the motion, an explicit method makes the fastest
motions grow, and contacts that open bound that growth: cells rattle about, and nothing else shows
it. λ is measured as a run begins, and again as often as a fiftieth of the counted cost allows; |J
v| / |v|, never above λ and an eighth of its cost, says when to look sooner. A step that is beyond
the limit at both ends of a coupling step is refused; one at one end only is marked.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np

from multicell.integrators.base import count_equal_steps, info_of
from multicell.integrators.shift import SHARE
from multicell.mechanics.decay_rate import RECORDED, largest_decay_rate
from multicell.mechanics.motion import StateRejected

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

_PASSES = RECORDED + 20
"""Evaluations that a measurement of λ costs with many cells: products, and two neighbour lists."""
_CALLS = 1.0e3  # the same times cells for each of these that is a call from Python
_FIRST = 2
"""Coupling steps at the beginning of a run before each of which λ is measured: cells that are
placed anew hardly press each other in the first."""
_GLANCE = 5  # evaluations that |J v| / |v| costs
NEAR_LIMIT = 0.8
"""|J v| / |v| over the limit from which on λ is measured; rattling cells have 0.88 to 0.96."""
_SAFE = 0.9  # part of the limit that is recommended


@final
class Stability(NamedTuple):
    """Results and cost of the measurements of λ in a run.

    - ``rate``, float, 1/s: λ as last measured
    - ``measured``, float: how often it was
    - ``beyond``, float: how often the step was beyond the limit, at the end of a coupling step too
    - ``latest``, ``largest``, float: the step over the limit: as last measured, and at most
    - ``total``, ``spent``, ``looked``, float: cost of all coupling steps so far, of the
      measurements, and of |J v| / |v|, in evaluations of one cell
    """

    rate: float = 0.0
    measured: float = 0.0
    beyond: float = 0.0
    latest: float = 0.0
    largest: float = 0.0
    total: float = 0.0
    spent: float = 0.0
    looked: float = 0.0

    def notes(self, name: str) -> list[str]:
        """Return the remark on a run some of whose steps were beyond the limit, for a person."""
        if not self.beyond:
            return []
        return [
            f"The fixed step of {name!r} was beyond its limit of stability {self.beyond:.0f} of "
            f"the {self.measured:.0f} times that this was measured, by a factor of up to "
            f"{self.largest:.3g}: cells may have rattled there. Choose a shorter integrator.step, "
            "or 'auto'."
        ]


def limit_of(method: Any) -> float:
    """Return the largest stable step times λ of an explicit method with a fixed step, or NaN."""
    info = info_of(method)
    stages: int = getattr(method, "stages", 0)
    if stages and info.variant is not None:
        info = info.variant(stages) or info
    fixed: bool = getattr(method, "step", 0.0) > 0.0
    return info.stable if fixed and math.isfinite(info.stable) else math.nan


def actual_step(method: Any, length: float) -> float:
    """Return how long the equal steps of a coupling step are, s."""
    return length / count_equal_steps(length, method.step)


def is_due(known: Stability, cells: int, product: float) -> bool:
    """Return whether λ is to be measured before a coupling step.

    ``product`` is the limit over the step, 1/s: as long as the last λ is above, every step is.
    """
    affordable = known.spent + _cost(cells, _PASSES) <= 0.5 * SHARE * known.total
    return known.measured < _FIRST or known.rate > product or affordable


def may_glance(known: Stability, cells: int) -> bool:
    """Return whether |J v| / |v| after a coupling step is affordable."""
    return known.looked + _cost(cells, _GLANCE) <= 0.5 * SHARE * known.total


def add_glance(known: Stability, cells: int) -> Stability:
    """Add an evaluation of |J v| / |v|, with its cost."""
    return known._replace(looked=known.looked + _cost(cells, _GLANCE))


def add_measurement(known: Stability, rate: float, product: float, cells: int) -> Stability:
    """Add a measurement of λ; see :func:`is_due`."""
    ratio = rate / product
    return known._replace(
        rate=rate,
        latest=ratio,
        largest=max(ratio, known.largest),
        measured=known.measured + 1.0,
        beyond=known.beyond + (ratio > 1.0),
        spent=known.spent + _cost(cells, _PASSES),
    )


def rate_at(system: Mechanics, time: float, position: FloatArray, dimensions: int) -> float:
    """Return λ at a state, 1/s, or 0 where there is none; no account counts what it takes.

    The system is left made ready for the coupling step.
    """
    counts = vars(system.work).copy()
    system.begin(system.motion)
    try:
        rate = largest_decay_rate(system, time, position, dimensions=dimensions)
    except StateRejected:
        # what integrates meets the same state, and has the words
        rate = 0.0
    vars(system.work).update(counts)
    system.begin(system.motion)
    return rate if rate > 0.0 else 0.0


def glance(system: Mechanics, time: float, position: FloatArray) -> float:
    """Return |J v| / |v| at a state for its velocity v, 1/s; no account counts what it takes."""
    counts = vars(system.work).copy()
    velocity, image = np.empty_like(position), np.empty_like(position)
    weight = system.motion.radius[:, None]
    try:
        system.velocity(time, position, velocity)
        system.linearise(time, position)
        system.jacobian_product(velocity, image)
    except StateRejected:
        return 0.0
    finally:
        vars(system.work).update(counts)
    speed = float((weight * velocity * velocity).sum())
    return math.sqrt(float((weight * image * image).sum()) / speed) if speed > 0.0 else 0.0


def refusal_words(method: Any, dt: float, limit: float, rate: float) -> tuple[str, str]:
    """Return the words for a step that is beyond the limit all through a coupling step."""
    name = info_of(method).name
    longest = limit / rate
    return (
        f"the step of {dt:.4g} s of {name!r} is beyond its limit of stability, {longest:.4g} s: "
        f"the fastest motion decays at {rate:.4g}/s, and that times the step must stay below "
        f"{limit:g}",
        f"Choose integrator.step = {_SAFE * longest:.2g} or shorter, or a method with error "
        "control such as 'auto'",
    )


def _cost(cells: int, passes: int) -> float:
    return passes * (cells + _CALLS)
