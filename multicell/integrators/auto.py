"""The method that should cost least for a coupling step, from its stiffness and tolerance.

A step is judged by z = λΔt, λ being the largest decay rate. Its order of magnitude is known
without any evaluation; where that is small, or z as measured, the step is mild:

- ``ab2-adaptive`` takes mild steps, with one evaluation for each of its own. Beyond
  :data:`MILD_TO` stability limits its steps, and modes at the edge of stability carry errors as
  large as the tolerance;
- ``rk4-adaptive`` takes steps up to :data:`EXACT_TO` at tight tolerances, where order pays;
- ``rkc2`` takes what is stiffer: its stages grow as √z;
- ``rosenbrock``, or ``cvode`` where friction between cells rules it out or tissue resists
  compression, takes what is stiffer than :func:`implicit_from`. With m steps RKC2 needs
  √(1.54 m z) evaluations and an implicit method some products for each, so that the limit grows
  with m: where fresh daughters move it is forty times that of quiet tissue. Implicit methods get a
  tenth of the tolerances there, at which they are about as exact as RKC2, and the whole in quiet
  tissue.

The limits are those of ``tests/benchmarks/auto_regret.py`` and of the tiles of
docs/which-integrator.md. A method that cannot continue, or finds a mild step to be none, leaves the
coupling step to the next one, from its beginning. Only methods that can hold the scene, by their
own ``info``, are chosen from. The choice depends on the state at the beginning of the coupling step
and on the options, on nothing else: a run that is resumed chooses as the uninterrupted one.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, make_dataclass
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from multicell.integrators.adams_bashforth import AdaptiveAdams
from multicell.integrators.base import ErrorControl, Integrator, MethodInfo, Outcome
from multicell.integrators.cvode import Cvode
from multicell.integrators.rkc import Rkc2
from multicell.integrators.rosenbrock import Rosenbrock
from multicell.integrators.runge_kutta import AdaptiveRungeKutta4
from multicell.mechanics.motion import Work
from multicell.vectors import squares

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

_ITERATIONS = 6  # power iterations: λ may be read a fifth too low
PATIENCE = 300  # evaluations that Adams-Bashforth may expect to take, by many cells
_CHOICE = 2.0e3  # evaluations times cells that calls of Python cost when λ is measured
_SUSPECT, _MOVES = 25.0, 60.0
"""λΔt, by the order of magnitude of λ, from which on λ is measured in tissue at rest, and in tissue
that moves, which Adams-Bashforth goes through where its stability allows it."""
_TYPICAL = 0.6  # λ over its order of magnitude
MILD_TO, _STILL = 150.0, 0.3
"""λΔt up to which Adams-Bashforth costs less than RKC2, and the part of it up to which it does in
tissue at rest, which RKC2 goes through in a few steps."""
EXACT_FROM, EXACT_TO = 60.0, 500.0
"""λΔt from which on stability limits the steps of Adams-Bashforth at tight tolerances, and up to
which a method of order 4 costs less than RKC2 there."""
_TIGHT, _VERY_TIGHT, _MILDER = 0.015, 0.0003, 1.3
"""Tolerances in µm up to which a method of order 4 is taken: where stability limits the steps of
Adams-Bashforth, so that it costs little more, and in any step; and the power of λΔt by which the
first falls below that."""
_QUIET, _SHAKEN = 1e-3, 0.3
"""The way that fast modes carry the fastest cell, its speed over λ in tolerances: up to which there
are no fast modes to follow, and from which on there are."""
_IMPLICIT_FROM, _MOVING = 5e3, 40.0
"""λΔt from which on an implicit method costs less than RKC2 in quiet tissue of a hundred cells, and
by how much more where there are fast modes to follow."""
_AS_EXACT = 0.1
"""Tolerance at which implicit methods are about as exact as RKC2 where there are fast modes to
follow, over that of RKC2."""
_STAGE, _PRODUCT = 300.0, 110.0
"""Evaluations times cells that Python costs in an evaluation that goes through it, and in a product
of the Rosenbrock method."""


@final
@dataclass(frozen=True)
class Choice:
    """The chosen method and the reasons for it.

    - ``stiffness``, float: λ times the length of the coupling step
    - ``order``, tuple of str: the methods that can hold the scene, in the order they are tried in
    - ``finer``, float: part of the tolerances that an implicit method is given
    """

    stiffness: float
    order: tuple[str, ...]
    finer: float = 1.0

    @property
    def method(self) -> str:
        """The one that should cost least."""
        return self.order[0]


@final
@dataclass(frozen=True)
class Auto(ErrorControl):
    """Chooses for each coupling step between explicit methods, RKC2 and an implicit method.

    The steps by each method are counted in :data:`ChosenWork`. If a method cannot continue, the
    next one starts from the beginning of the coupling step.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "auto",
        "ab2-adaptive, rk4-adaptive, rkc2 or an implicit method, for each coupling step",
        "tolerance",
        remembers=True,
        colour="#22303c",
        marker="*",
    )

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate over the coupling step of ``system``; see :class:`Integrator`."""
        choice = self.choose(system, position)
        for name in choice.order:
            before = system.work.steps
            outcome = self.method(name, choice.finer, len(system)).integrate(system, position)
            _count(system, name, before)
            if outcome.done:
                break
        return outcome

    def choose(self, system: Mechanics, position: FloatArray) -> Choice:
        """Choose a method for the coupling step of ``system``, as at its beginning.

        λ is not measured in one that is surely mild.
        """
        from multicell.integrators.limits import stiffness_scale

        rate = stiffness_scale(system)
        scale = rate * (system.motion.end - system.motion.begin)
        able, n = candidates(system), max(len(system), 1)
        tolerance = _tolerance(system, self.rtol, self.atol)
        mild = EXACT if tolerance <= exact_below(_TYPICAL * scale) else MILD
        # of gels and of tissue that resists compression the order of magnitude says nothing
        gel = system.walls is not None and system.walls.shear is not None
        known = not gel and system.compression is None
        if (
            known
            and mild in able
            and (
                scale <= _SUSPECT + _CHOICE / n
                or (scale <= _MOVES and _shaken(system, position, rate, tolerance) > 0.5)
            )
        ):
            return Choice(scale, _first(mild, able))
        return self.by_measured_rate(system, position)

    def by_measured_rate(self, system: Mechanics, position: FloatArray) -> Choice:
        """Return the method that is cheapest for λ as measured."""
        from multicell.integrators.driver import needs_python
        from multicell.integrators.limits import stiffness_scale

        able = candidates(system)
        tolerance = _tolerance(system, self.rtol, self.atol)
        rate, grows = largest_rate(system, position)
        length = system.motion.end - system.motion.begin
        z = rate * length
        if z <= EXACT_TO and tolerance <= exact_below(z):
            return Choice(z, _first(EXACT, able))
        shaken = 1.0
        if z > _STILL * MILD_TO:
            shaken = _shaken(system, position, rate, tolerance)
        # contacts that are just forming grow faster than any relax, which limits no explicit step
        mild = min(z, stiffness_scale(system) * length) if grows else z
        if mild <= MILD_TO * _STILL ** (1.0 - shaken):
            return Choice(z, _first(MILD, able))
        implicit = z > implicit_from(len(system), shaken, python=needs_python(system))
        stable = [name for name in _STABLE if name in able and CANDIDATES[name].info.implicit]
        # with compression Rosenbrock's solves take three times as many products as CVODE's
        first = -1 if system.compression is not None else 0
        name = stable[first] if implicit and stable else Rkc2.info.name
        return Choice(z, _first(name, able), float(_AS_EXACT**shaken))

    def method(self, name: str, finer: float = 1.0, cells: int = 1) -> Integrator:
        """Return a candidate with these options; an implicit one with finer tolerances."""
        kind = CANDIDATES[name]
        finer = finer if kind.info.implicit else 1.0
        options = finer * self.rtol, finer * self.atol, self.max_steps, self.max_displacement
        if kind is AdaptiveAdams:
            return AdaptiveAdams(*options, int(PATIENCE + _CHOICE / max(cells, 1)))
        return kind(*options)


METHODS = (Auto,)
CANDIDATES: dict[
    str,
    type[AdaptiveAdams] | type[AdaptiveRungeKutta4] | type[Rkc2] | type[Rosenbrock] | type[Cvode],
] = {kind.info.name: kind for kind in (AdaptiveAdams, AdaptiveRungeKutta4, Rkc2, Rosenbrock, Cvode)}
"""What is chosen from."""
COUNTERS = {name: f"steps_{name.replace('-', '_')}" for name in CANDIDATES}
"""Name of each of them -> where its steps are counted."""
ChosenWork: type[Work] = make_dataclass(
    "ChosenWork",
    [(counter, int, field(default=0)) for counter in COUNTERS.values()],
    bases=(Work,),
    namespace={"__module__": __name__, "__doc__": "Counts of work, with the steps of each method."},
)
MILD, EXACT = AdaptiveAdams.info.name, AdaptiveRungeKutta4.info.name
_STABLE = (Rkc2.info.name, Rosenbrock.info.name, Cvode.info.name)
"""What is tried after another method, in this order."""


def candidates(system: Mechanics) -> list[str]:
    """Return the names of those methods that can hold a system, by their own ``info``."""
    n, friction = len(system), max(system.friction) > 0.0
    return [
        name for name, kind in CANDIDATES.items() if kind.info.refusal(n, friction=friction) is None
    ]


def _first(name: str, able: Collection[str]) -> tuple[str, ...]:
    """Return a method and those that are tried after it, as far as they can hold the scene."""
    return tuple(n for n in dict.fromkeys((name, *_STABLE, EXACT, MILD)) if n in able)


def _count(system: Mechanics, name: str, before: int) -> None:
    """Count the steps since ``before`` as those of a method."""
    counts = vars(system.work)
    counts[COUNTERS[name]] = counts.get(COUNTERS[name], 0) + system.work.steps - before


def _tolerance(system: Mechanics, rtol: float, atol: float) -> float:
    """Return the tolerance of a cell of mean radius, µm."""
    return atol + rtol * (system.motion.mean_radius if len(system) else 1.0)


def exact_below(z: float) -> float:
    """Return the tolerance in µm up to which a method of order 4 is taken in a mild step."""
    return float(max(_VERY_TIGHT, _TIGHT * min(1.0, z / EXACT_FROM) ** _MILDER))


def implicit_from(n: int, shaken: float, *, python: bool = False) -> float:
    """Return the λΔt from which on an implicit method costs less than RKC2.

    - ``n``: number of cells
    - ``shaken``: 0 where there are no fast modes to follow, 1 where there are
    - ``python``: whether evaluations go through Python, which RKC2 needs more of
    """
    dear = (1.0 + _STAGE / n) / (1.0 + _PRODUCT / n) if python else 1.0
    return float(_IMPLICIT_FROM * _MOVING**shaken * (n / 100.0) ** 0.25 / dear**2)


def _shaken(system: Mechanics, position: FloatArray, rate: float, tolerance: float) -> float:
    """Return 0 where there are no fast modes to follow, up to 1 where there are."""
    fast = max(_fastest(system, position) / rate / tolerance, _QUIET)
    return min(math.log(fast / _QUIET) / math.log(_SHAKEN / _QUIET), 1.0)


def _fastest(system: Mechanics, position: FloatArray) -> float:
    """Return the speed of the fastest cell, µm/s; zero where it cannot be evaluated."""
    from multicell.mechanics.motion import StateRejected

    velocity = np.empty_like(position)
    try:
        system.velocity(system.motion.begin, position, velocity)
    except StateRejected:
        return 0.0
    return float(np.sqrt(squares(velocity).max())) if len(position) else 0.0


def largest_rate(system: Mechanics, position: FloatArray) -> tuple[float, bool]:
    """Return an estimate of the largest |eigenvalue| of J, 1/s, and whether it is one of growth.

    By power iteration in the scalar product of the drag coefficients, in which J is symmetric;
    the start is fixed. The estimate is from below: a random start of 3n numbers finds the upper
    end of a dense spectrum to a tenth or so.
    """
    from multicell.mechanics.motion import StateRejected

    if len(system) < 2 and system.walls is None:
        return 0.0, False
    weight = system.motion.radius[:, None]
    vector = np.random.default_rng(0).normal(size=position.shape)
    image, rate, along = np.empty_like(vector), 0.0, 0.0
    try:
        system.linearise(system.motion.begin, position)
        for _ in range(_ITERATIONS):
            vector /= math.sqrt(float((weight * vector * vector).sum()))
            system.jacobian_product(vector, image)
            rate = math.sqrt(float((weight * image * image).sum()))
            if rate == 0.0:
                return 0.0, False
            along = float((weight * vector * image).sum())
            vector, image = image, vector
    except StateRejected:
        return 0.0, False
    return rate, along > 0.0
