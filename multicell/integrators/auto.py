"""The method that should cost least for a coupling step, from its stiffness and tolerance.

Most coupling steps are mild, and there a measurement of stiffness costs as much as the step
itself. So most are begun by Adams-Bashforth of order 2 under error control, which needs one
evaluation a step. Only where that would take more than ``PATIENCE`` evaluations, as its own steps
show after a few of them, is the largest decay rate measured, and the cheapest method goes over
the coupling step from its beginning. With many cells, or where evaluations are dear, a product J v
(:func:`at_a_glance`) may predict that the attempt would fail; with few a choice would
cost more than a method that is not the best, and Adams-Bashforth's own steps decide, unless λΔt is
large by the order of magnitude of λ: then it is measured at once.

Only methods that can hold the scene, by their own ``info``, are chosen from. The choice depends on
the state at the beginning of the coupling step and on the options, on nothing else: a run that is
resumed chooses as the uninterrupted one. Costs are counted in evaluations of the velocity,
calibrated with ``tests/benchmarks/calibrate_auto.py``: coupling
steps of 20 to 1,350 cells at rest, growing, freshly divided and some minutes after, z = λΔt from
17 to 10⁶, tolerances from 0.001 to 0.3 µm. With θ = (atol + rtol r) / 0.01 µm, n cells, and δ the
way that fast modes carry the fastest cell, its speed over λ, in tolerances:

- ``ab2-adaptive``: as many as it expects itself, if those are fewer than the least that RKC2 gets
  by with, √(8 z) + 15. Else stability holds its steps down, and a first estimate made among the
  short steps of its start is several times too high: 1.2 z, or 0.3 of what it expects if that is
  more, times 1.8, since lists are built more often for modes at the edge of stability;
- ``dopri5``: 6 max(12 θ^-0.1, z / 3), 2.5 times that where stability limits the step at a loose
  tolerance: modes at the edge of stability then rattle, and lists are built at every step. At a
  loose tolerance its order does not pay where contacts form and break;
- ``rkc2``: a (√(1 + 1.54 z / a) + 3) + 6 with a = 4 z^0.14 θ^-0.07 n^0.14 (1 + δ)^0.37 steps;
- ``rosenbrock``: p (1.2 + 110 / n) + 2900 / n with p products. Where there are fast modes to follow
  (δ > 0.3) an implicit method is further off at the same tolerances and gets a tenth of them; where
  there are none (δ < 0.001) the whole. With the δ and θ of those p is in the first case the product
  of 3 z^0.11 n^0.22 (1 + δ)^0.3 steps and 6 z^0.07 in each, in the second that of
  1 + 0.6 z^0.02 θ^-0.17 n^0.17 and 8.5 z^0.18 n^0.08 θ^-0.19; geometric means between. Steady
  tissue that grows takes a few steps, however stiff it is, one with fresh daughters nearly as many
  as an explicit method. All that times 1.25: what an implicit method is off by differs more;
- ``cvode``, where friction between cells rules ``rosenbrock`` out:
  a ((6 + 2.5 lg z) θ^0.1 + 2000 / n) with a = 8 z^0.22 θ^-0.25 steps, at the same part of the
  tolerances.

Where there are no fast modes to follow CVODE takes fewer evaluations than the Rosenbrock method at
the same tolerance, but steps over what moves: at 0.1 µm its error in quiet tissue of 100 and 1,000
cells is up to a radius and more, that of the Rosenbrock method below 0.1 % of one.

What runs through Python at every evaluation costs the explicit methods 300 / n evaluations more.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from multicell.integrators.adams_bashforth import AdaptiveAdams
from multicell.integrators.base import ErrorControl, Integrator, MethodInfo, Outcome
from multicell.integrators.cvode import Cvode
from multicell.integrators.rkc import Rkc2
from multicell.integrators.rosenbrock import Rosenbrock
from multicell.integrators.runge_kutta import Dopri5

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

_ITERATIONS = 6
PATIENCE = 150  # evaluations up to which nothing but Adams-Bashforth is tried, by many cells
_CHOICE = 5.0e3  # evaluations times cells that a choice by the measured decay rate costs
_LOOK_FROM = 200  # number of cells from which a product J v is cheaper than a failed attempt
_SUSPECT = 60.0  # λΔt, by the order of magnitude of λ, from which on such a look is worth while
_IN_VAIN = 1.5
"""λΔt over the patience from which on an attempt is in vain: Adams-Bashforth would take λΔt / 0.8
evaluations, and λ itself is measured for less than is lost."""
_TENS = 10.0  # δ of a tissue of which nothing is known but that it is stiff
_TIGHT = 0.03  # θ up to which a method of order 5 may cost less than Adams-Bashforth
_CALL = 2.0e3  # evaluations times cells that the calls of Python in a step of CVODE cost
_PRODUCT = 110.0  # the same of a product in the Rosenbrock method
_START = 2900.0  # the same of its start
_STAGE = 300.0  # the same for an evaluation of an explicit method that goes through Python
_AS_EXACT = 0.1
"""Tolerance at which implicit methods are about as exact as RKC2 where there are fast modes to
follow, over that of RKC2."""
_CAUTION = 1.25  # by how much an implicit method has to be cheaper: what it is off by differs more
_QUIET, _SHAKEN = 1e-3, 0.3
"""δ up to which there are no fast modes to follow, and from which on there are."""


@final
@dataclass(frozen=True)
class Choice:
    """The chosen method and the reasons for it.

    - ``rate``, float: estimate of the largest decay rate λ, 1/s
    - ``stiffness``, float: λ times the length of the coupling step
    - ``costs``, name -> float: predicted cost of each candidate, in evaluations
    - ``finer``, float: part of the tolerances that an implicit method is given
    """

    rate: float
    stiffness: float
    costs: dict[str, float]
    finer: float = 1.0

    @property
    def method(self) -> str:
        """The cheapest of the candidates."""
        return self.order[0]

    @property
    def order(self) -> list[str]:
        """The candidates, the cheapest first."""
        return sorted(self.costs, key=lambda name: self.costs[name])

    @property
    def clear(self) -> bool:
        """Whether the best costs less than half of any other."""
        first, second, *_ = sorted(self.costs.values())
        return 2.0 * first < second


@final
@dataclass(frozen=True)
class Auto(ErrorControl):
    """Chooses for each coupling step between explicit methods, RKC2 and an implicit method.

    The steps by each method are counted in ``Work``. If a method cannot continue, the next
    one starts from the beginning of the coupling step. Parameters as for
    :class:`~multicell.integrators.base.ErrorControl`.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "auto", "ab2-adaptive, dopri5, rkc2 or an implicit method, chosen for each coupling step",
        "tolerance", remembers=True, colour="#22303c", marker="*",
    )  # fmt: skip

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        outcome, choice = self.begin(system, position)
        if choice is None:
            return outcome
        for name in choice.order:
            before = system.work.steps
            outcome = self.method(name, choice.finer).integrate(system, position)
            _count(system, name, before)
            if outcome.done:
                break
        return outcome

    def begin(self, system: Mechanics, position: FloatArray) -> tuple[Outcome, Choice | None]:
        """Go over a mild coupling step; of another one return what to do instead."""
        from multicell.integrators.driver import needs_python
        from multicell.integrators.limits import stiffness_scale

        n = max(len(system), 1)
        able = candidates(system)
        dear = needs_python(system)
        length = system.motion.end - system.motion.begin
        patience = PATIENCE + _CHOICE / n
        scale = stiffness_scale(system) * length
        if n < _LOOK_FROM and scale > _IN_VAIN * patience and not dear:
            choice = choose(system, position, self.rtol, self.atol, able=able)
            if choice.stiffness > _IN_VAIN * patience:
                return Outcome(system.motion.begin, position, "it is not mild"), choice
        if scale > _SUSPECT and (n >= _LOOK_FROM or dear):
            choice = at_a_glance(system, position, self.rtol, self.atol, able)
            if choice.method not in (MILD, Dopri5.info.name):
                if n >= _LOOK_FROM and not choice.clear:
                    choice = choose(system, position, self.rtol, self.atol, able=able)
                return Outcome(system.motion.begin, position, "it is not mild"), choice
        if MILD not in able:
            choice = choose(system, position, self.rtol, self.atol, able=able)
            return Outcome(system.motion.begin, position, "nothing else is tried"), choice
        before = system.work.steps
        first = AdaptiveAdams(
            self.rtol, self.atol, self.max_steps, self.max_displacement, int(patience)
        )
        outcome, expected = first.attempt(system, position)
        _count(system, MILD, before)
        if outcome.done:
            return outcome, None
        if expected > 0.0 and not dear:
            # stability limits Adams-Bashforth, so its steps bound z from above
            theta = (self.atol + self.rtol * float(system.motion.radius.mean())) / 0.01
            z = expected / 1.2
            costs = predict_costs(n, z, theta, _TENS, expected, able=able)
            if min(costs.values()) < _CHOICE / n:
                return outcome, Choice(z / length, z, costs, _finer(_TENS))
        return outcome, choose(system, position, self.rtol, self.atol, expected, able=able)

    def method(self, name: str, finer: float = 1.0) -> Integrator:
        """Return a candidate with these options; an implicit one with finer tolerances."""
        kind = CANDIDATES[name]
        finer = finer if kind.info.implicit else 1.0
        return kind(finer * self.rtol, finer * self.atol, self.max_steps, self.max_displacement)


METHODS = (Auto,)
CANDIDATES: dict[
    str, type[AdaptiveAdams] | type[Dopri5] | type[Rkc2] | type[Rosenbrock] | type[Cvode]
] = {kind.info.name: kind for kind in (AdaptiveAdams, Dopri5, Rkc2, Rosenbrock, Cvode)}
"""What is chosen from."""
MILD = AdaptiveAdams.info.name  # what every coupling step is begun by


def candidates(system: Mechanics) -> list[str]:
    """Return the names of those methods that can hold a system, by their own ``info``."""
    n, friction = len(system), max(system.friction) > 0.0
    return [
        name for name, kind in CANDIDATES.items() if kind.info.refusal(n, friction=friction) is None
    ]


def _count(system: Mechanics, name: str, before: int) -> None:
    """Count the steps since ``before`` as those of a method."""
    work = system.work
    counter = f"steps_{name.replace('-', '_')}"
    setattr(work, counter, getattr(work, counter) + work.steps - before)


def choose(
    system: Mechanics,
    position: FloatArray,
    rtol: float,
    atol: float,
    expected: float = 0.0,
    *,
    able: Collection[str] | None = None,
) -> Choice:
    """Return the cheapest method for the coupling step of ``system`` at its beginning.

    ``expected`` is the number of evaluations that ``ab2-adaptive`` expects; without it that method
    is no candidate. ``able`` are the :func:`candidates`, if they are known.
    """
    from multicell.integrators.driver import needs_python

    motion = system.motion
    rate = decay_rate(system, position)
    z = max(rate * (motion.end - motion.begin), 1.0)
    n = max(len(system), 1)
    tolerance = atol + rtol * float(motion.radius.mean() if len(system) else 1.0)
    theta = tolerance / 0.01
    called = _STAGE / n if needs_python(system) else 0.0
    fast = _fastest(system, position) / rate / tolerance if rate > 0.0 else 0.0
    able = candidates(system) if able is None else able
    costs = predict_costs(n, z, theta, fast, expected, called=called, able=able)
    return Choice(rate, z, costs, _finer(fast))


def at_a_glance(
    system: Mechanics, position: FloatArray, rtol: float, atol: float, able: Collection[str]
) -> Choice:
    """Return what :func:`choose` would if |J v| / |v| were the largest decay rate.

    With fresh daughters it is, since nothing else moves; in quiet tissue it is far below.
    """
    from multicell.integrators.driver import needs_python
    from multicell.mechanics.motion import StateRejected

    motion = system.motion
    n, length = max(len(system), 1), motion.end - motion.begin
    velocity, image = np.zeros_like(position), np.zeros_like(position)
    try:
        system.velocity(motion.begin, position, velocity)
        system.linearise(motion.begin, position)
        system.jacobian_product(velocity, image)
    except StateRejected:
        velocity[:] = 0.0
    speed = np.sqrt(np.square(velocity).sum(axis=1).max(initial=0.0))
    rate = float(np.sqrt(np.square(image).sum(axis=1).max(initial=0.0)) / speed) if speed else 0.0
    z = max(rate * length, 1.0)
    tolerance = atol + rtol * float(motion.radius.mean() if len(system) else 1.0)
    fast = float(speed) / rate / tolerance if rate > 0.0 else 0.0
    called = _STAGE / n if needs_python(system) else 0.0
    costs = predict_costs(n, z, tolerance / 0.01, fast, 4.4 * z, called=called, able=able)
    return Choice(rate, z, costs, _finer(fast))


def predict_costs(
    n: int, z: float, theta: float, fast: float, expected: float = 0.0,
    *, called: float = 0.0, able: Collection[str] | None = None,
) -> dict[str, float]:  # fmt: skip
    """Return what each candidate that can hold the scene is expected to cost, in evaluations.

    - ``n``, ``z``, ``theta``, ``fast``: n, z, θ and δ of the module's description
    - ``expected``: what ``ab2-adaptive`` expects; zero where it is no candidate
    - ``called``: share by which an evaluation through Python costs an explicit method more
    - ``able``: names of the methods that can hold the scene; without them all
    """
    able = CANDIDATES if able is None else able
    accurate, stable = 12.0 * theta**-0.1, z / 3.0
    rattle = 2.5 if stable > accurate and theta > _TIGHT else 1.0
    dopri5 = 6.0 * max(accurate, stable) * rattle
    steps = 4.0 * z**0.14 * theta**-0.07 * n**0.14 * (1.0 + fast) ** 0.37
    rkc2 = steps * (math.sqrt(1.0 + 1.54 * z / steps) + 3.0) + 6.0
    explicit = {"dopri5": dopri5, "rkc2": rkc2}
    if expected > 0.0:
        mild = expected < math.sqrt(8.0 * z) + 15.0
        explicit["ab2-adaptive"] = expected if mild else max(2.2 * z, 0.5 * expected)
        if theta > _TIGHT:
            explicit["dopri5"] = max(dopri5, 1.01 * explicit["ab2-adaptive"])
    costs = {name: cost * (1.0 + called) for name, cost in explicit.items()}
    finer = _finer(fast)
    if "rosenbrock" not in able:
        theta *= finer
        steps = 8.0 * z**0.22 * theta**-0.25
        costs["cvode"] = steps * ((6.0 + 2.5 * math.log10(z)) * theta**0.1 + _CALL / n)
    else:
        costs["rosenbrock"] = _CAUTION * _rosenbrock(n, z, finer * theta, fast / finer)
    return {name: cost for name, cost in costs.items() if name in able}


def _shaken(fast: float) -> float:
    """Return 0 where there are no fast modes to follow, 1 where there are, by δ."""
    span = math.log(_SHAKEN / _QUIET)
    return min(max(math.log(max(fast, 1e-99) / _QUIET) / span, 0.0), 1.0)


def _finer(fast: float) -> float:
    """Return the part of the tolerances at which an implicit method is as exact as RKC2."""
    return float(_AS_EXACT ** _shaken(fast))


def _rosenbrock(n: int, z: float, theta: float, fast: float) -> float:
    """Return the evaluations that the Rosenbrock method is expected to cost."""
    shaken = _shaken(fast)
    products = 3.0 * z**0.11 * n**0.22 * (1.0 + fast) ** 0.3 * 6.0 * z**0.07
    quiet = (1.0 + 0.6 * z**0.02 * theta**-0.17 * n**0.17) * 8.5 * z**0.18 * n**0.08 * theta**-0.19
    return float(products**shaken * quiet ** (1.0 - shaken) * (1.2 + _PRODUCT / n) + _START / n)


def _fastest(system: Mechanics, position: FloatArray) -> float:
    """Return the speed of the fastest cell, µm/s; zero where it cannot be evaluated."""
    from multicell.mechanics.motion import StateRejected

    velocity = np.empty_like(position)
    try:
        system.velocity(system.motion.begin, position, velocity)
    except StateRejected:
        return 0.0
    return float(np.sqrt(np.square(velocity).sum(axis=1).max())) if len(position) else 0.0


def decay_rate(system: Mechanics, position: FloatArray) -> float:
    """Return an estimate of the largest |eigenvalue| of J, 1/s, from a few products.

    Power iteration in the scalar product of the drag coefficients, in which J is symmetric;
    the start is fixed. The estimate is from below: a random start of 3n numbers finds the upper
    end of a dense spectrum to a tenth or so.
    """
    from multicell.mechanics.motion import StateRejected

    if len(system) < 2 and system.walls is None:
        return 0.0
    weight = system.motion.radius[:, None]
    vector = np.random.default_rng(0).normal(size=position.shape)
    image = np.empty_like(vector)
    rate = 0.0
    try:
        system.linearise(system.motion.begin, position)
        for _ in range(_ITERATIONS):
            vector /= math.sqrt(float((weight * vector * vector).sum()))
            system.jacobian_product(vector, image)
            rate = math.sqrt(float((weight * image * image).sum()))
            if rate == 0.0:
                return 0.0
            vector, image = image, vector
    except StateRejected:
        return 0.0
    return rate
