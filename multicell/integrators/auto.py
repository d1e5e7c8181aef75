"""The method that should cost least for a coupling step, by a model of counted work.

A step is judged by λΔt, λ being the largest decay rate, by its motion in tolerances, and by the
number of cells (:mod:`multicell.integrators.costs`); the cheapest of these methods takes it:

- ``ab2-adaptive``, one evaluation for each of its own steps, up to its limit of stability;
- ``rk4-adaptive``, where order pays: at tolerances that are small beside the motion;
- ``rkc2``, whose stages grow as √(λΔt);
- ``rosenbrock`` or ``cvode``, where λΔt is large beside what moves.

Costs are compared at about the same accuracy (:meth:`Choice.part`): implicit methods get a tenth of
the tolerances where fast modes move cells, the whole in quiet tissue, and CVODE less the larger λΔt
is, as its errors over its tolerance grow.

Where the order of magnitude of λ, which is known without any evaluation, leaves no doubt with the
motion that was seen last, or with any, nothing is measured. Otherwise one evaluation gives the
motion, and six products λ, unless its order of magnitude or an earlier one of this run is good
enough for the choice. In small tissue a look costs as much as many evaluations, and is taken less.
What coupling steps count corrects the model, and now and then the second choice is tried, as its
extra cost is a fiftieth of what was spent since.

What leaves no doubt is given to the same explicit method for some coupling steps, and in small
tissue what was looked at, as long as none takes more than it could by what is known. A method that
cannot continue, or finds a mild step to be none, leaves the coupling step to the next one, from its
beginning. Only methods that can hold the scene, by their own ``info``, are chosen from. The choice
depends on the state at the beginning of the coupling step, on the options and on the lessons of
the run, which are counted and stored in its frames: a run that is resumed chooses as the
uninterrupted one. A step that is repeated, as from a shifted start, is left to the method that took
it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, make_dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar, NamedTuple, final

import numpy as np

from multicell.integrators.adams_bashforth import AdaptiveAdams
from multicell.integrators.base import ErrorControl, Integrator, MethodInfo, Outcome
from multicell.integrators.costs import FAINTEST, LOOK, CouplingStep, Learnt
from multicell.integrators.cvode import Cvode
from multicell.integrators.rkc import Rkc2
from multicell.integrators.rosenbrock import Rosenbrock
from multicell.integrators.runge_kutta import AdaptiveRungeKutta4
from multicell.mechanics.motion import Work
from multicell.vectors import squares

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

PATIENCE, _LONGER = 300, 3.0
"""Evaluations that Adams-Bashforth may expect to take, by many cells, and over what the model
expects, before the step is left to another method."""
_PASSES, _CALLS = 8.0, 3.0e3
"""Evaluations, and evaluations times cells by calls of Python, above which it pays to measure λ: a
third of its cost in small tissue, as it is used again in later coupling steps."""
_LOOK = 4.0e3  # evaluations times cells above which it pays to judge a step by its motion
_HELD, _SMALL, _DEARER = 7.0, 600.0, 1.5
"""Coupling steps after one without any doubt that are given to its method; number of cells up to
which one is after Adams-Bashforth was chosen by a look, and with fewer cells more; and passes over
the expected ones at which that ends."""
_LEAST, _MOST = 0.3, 3.0
"""λ over its order of magnitude: of tissue in which it was not measured."""
_NEAR, _OLD = 1.4, 8.0
"""Factor by which λ may differ from one that was measured so many coupling steps ago."""
_NONE = 1e-15  # λ of one cell alone, 1/s
_TYPICAL, _FURTHEST = 0.1, 1.0
"""Motion of mildly stiff tissue over λΔt, µm: usually, and of cells that were placed anew."""
_QUIET, _SHAKEN = 1e-3, 0.3
"""The way that fast modes carry the fastest cell, its speed over λ in tolerances: up to which there
are no fast modes to follow, and from which on there are."""
_AS_EXACT = 0.1
"""Tolerance at which implicit methods are about as exact as RKC2 where there are fast modes to
follow, over that of RKC2."""
_EXACT_TO, _STIFFEST = 1e4, 1e6
"""λΔt up to which CVODE is as exact as Rosenbrock's method at the same tolerance, and as far as its
errors were compared: they grow with λΔt, in the tiles of docs/which-integrator.md, so that it needs
a tenth of the tolerance at 10⁵ and a hundredth at 10⁶."""
_PRESSED = 3.0  # products of Rosenbrock's solves over CVODE's where tissue resists compression
_FAILED = 3.0  # passes of a method that could not continue over the expected ones, at least
_TRIALS, _RARELY = 0.02, 8
"""Part of the cost that trials of the second choice may add, and coupling steps between two."""


@final
@dataclass(frozen=True)
class Choice:
    """The chosen method and the reasons for it.

    - ``stiffness``, float: λ times the length of the coupling step
    - ``order``, tuple of str: the methods that can hold the scene, in the order they are tried in
    - ``finer``, float: part of the tolerances that Rosenbrock's method is given
    - ``step``: the properties that its cost follows from; None where nothing was measured
    - ``ratio``, float: λ over its order of magnitude as measured here; 0 where it was not
    - ``trial``, bool: whether it is the second choice, to learn its cost
    - ``hold``, float: how many coupling steps after this one are given to the same method
    - ``limit``, float: passes of one above which no more are
    """

    stiffness: float
    order: tuple[str, ...]
    finer: float = 1.0
    step: CouplingStep | None = None
    ratio: float = 0.0
    trial: bool = False
    hold: float = 0.0
    limit: float = math.inf

    @property
    def method(self) -> str:
        """The one that should cost least."""
        return self.order[0]

    def part(self, name: str) -> float:
        """Return the part of the tolerances that a method is given."""
        return _part(name, self.finer, self.stiffness)


@final
@dataclass(frozen=True)
class Auto(ErrorControl):
    """Chooses for each coupling step between explicit methods, RKC2 and implicit methods.

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
        known, motion, work = Learnt(*system.learnt), system.motion, system.work
        again = known.of(motion.begin, motion.end, self.atol)
        held = not again and known.holds(motion.begin, motion.end, self.atol)
        if again or held:
            name = tuple(CANDIDATES)[int(known.taken)]
            choice = Choice(known.stiffness, (name,), known.finer, limit=known.limit)
        else:
            choice = self.choose(system, position)
        patience = 0 if again else self._patience(choice, len(system))
        taught, spent = choice.step, 0.0
        total = before = _passes(work)
        for name in _in_turn(choice.method, system):
            taken = work.steps
            outcome = self.method(name, choice.part(name), patience).integrate(system, position)
            _count(system, name, taken)
            if taught is not None:
                passes, number = _passes(work) - before, _NUMBER[name]
                expected = taught.work(name, choice.part(name))
                expected *= _dearer(name, system.compression is not None)
                spent += passes * taught.unit(name)
                if not outcome.done:  # its end would have taken more
                    passes = max(passes, _FAILED * expected * math.exp(known.excess[number]))
                implicit = CANDIDATES[name].info.implicit
                known = known.counted(number, passes, expected, implicit=implicit)
            if outcome.done:
                break
            before = _passes(work)
        if not again:
            step, speed, length = choice.step, known.speed, motion.end - motion.begin
            hold = known.hold - 1.0 if held else choice.hold
            if step is not None:
                speed = step.motion / length if length > 0.0 else 0.0
            if name != choice.method or _passes(work) - total > choice.limit:
                hold = LOOK
            system.learnt = Learnt(
                choice.ratio or known.ratio,
                0.0 if choice.ratio else known.age + 1.0,
                speed,
                0.0 if step is not None else known.seen + 1.0,
                0.0 if choice.trial else known.saved + spent,
                0.0 if choice.trial else known.steps + 1.0,
                motion.begin,
                motion.end,
                self.atol,
                float(_NUMBER[name]),
                choice.finer,
                choice.stiffness,
                hold,
                choice.limit if hold > 0.0 else 0.0,
                *known.excess,
            )
        return outcome

    def choose(self, system: Mechanics, position: FloatArray) -> Choice:
        """Choose a method for the coupling step of ``system``, as at its beginning.

        Nothing is measured where what is known leaves no doubt about an explicit method.
        """
        glance = self._glance(system)
        if glance.low > 0.0 and glance.known.hold != LOOK:
            z = math.sqrt(glance.low * glance.high)
            motions = glance.known.motions(system.motion.end - system.motion.begin)
            usual, most = motions or (_TYPICAL * z, _FURTHEST * z)
            about = glance.low, glance.high, 0.0, usual, most  # tissue may be at rest in any step
            name, limit = _sure(glance.seen, *map(_rounded, about))
            if name and not CANDIDATES[name].info.implicit:
                return Choice(z, _first(name, glance.seen.able), limit=limit, hold=_HELD)
        return self.by_motion(system, position, glance)

    def _glance(self, system: Mechanics) -> _Glance:
        known, length = Learnt(*system.learnt), system.motion.end - system.motion.begin
        low, high = _between(system, known)
        seen = _seen(system, known, _tolerance(system, self.rtol, self.atol))
        return _Glance(known, seen, low * length, high * length)

    def by_motion(
        self, system: Mechanics, position: FloatArray, glance: _Glance | None = None
    ) -> Choice:
        """Return the method that is cheapest for the motion at the beginning of the step.

        λ is measured where what is known of it leaves a doubt.
        """
        from multicell.integrators.limits import stiffness_scale

        known, seen, low, high = glance or self._glance(system)
        tolerance = _tolerance(system, self.rtol, self.atol)
        length = system.motion.end - system.motion.begin
        motion, furthest = (speed * length for speed in _speeds(system, position))
        z, ratio, name = math.sqrt(low * high), 0.0, ""
        if low > 0.0:
            name, _ = _sure(seen, *map(_rounded, (low, high, motion, motion, motion, furthest)))
        if not name:
            rate, scale = measured_rate(system, position), stiffness_scale(system)
            z, ratio = rate * length, rate / scale if scale > 0.0 else 0.0
        step = CouplingStep(z, motion, tolerance, len(system), seen.python)
        finer, trial = _finer(furthest, z, tolerance), False
        if not name or known.steps >= _RARELY:
            found = _costs(seen, step, finer, known.excess)
            name, *others = sorted(seen.able, key=found.__getitem__)
            if others and known.steps >= _RARELY:
                trial = found[others[0]] - found[name] <= _TRIALS * known.saved
                name = others[0] if trial else name
        hold, limit = 0.0, math.inf
        if name == MILD and not trial:
            hold = min(_HELD, _SMALL // max(len(system), 1))
            limit = _DEARER * step.work(name) * math.exp(max(known.excess[_NUMBER[name]], 0.0))
        return Choice(z, _first(name, seen.able), finer, step, ratio, trial, hold, limit)

    def method(self, name: str, part: float = 1.0, patience: int = PATIENCE) -> Integrator:
        """Return a candidate with these options and a part of the tolerances."""
        kind = CANDIDATES[name]
        options = part * self.rtol, part * self.atol, self.max_steps, self.max_displacement
        if kind is AdaptiveAdams:
            return AdaptiveAdams(*options, patience)
        return kind(*options)

    def _patience(self, choice: Choice, cells: int) -> int:
        """Return how many evaluations Adams-Bashforth may expect to take."""
        expected = 0.0 if choice.step is None else _LONGER * choice.step.work(MILD)
        return int(max(PATIENCE, expected) + _CALLS / max(cells, 1))


METHODS = (Auto,)
CANDIDATES: dict[
    str,
    type[AdaptiveAdams] | type[AdaptiveRungeKutta4] | type[Rkc2] | type[Rosenbrock] | type[Cvode],
] = {kind.info.name: kind for kind in (AdaptiveAdams, AdaptiveRungeKutta4, Rkc2, Rosenbrock, Cvode)}
"""What is chosen from."""
_NUMBER = {name: k for k, name in enumerate(CANDIDATES)}
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


def candidates(system: Mechanics) -> tuple[str, ...]:
    """Return the names of those methods that can hold a system, by their own ``info``."""
    n, friction = len(system), max(system.friction) > 0.0
    every = CANDIDATES.items()
    return tuple([name for name, kind in every if not kind.info.refusal(n, friction=friction)])


@final
class _Seen(NamedTuple):
    """Facts of a coupling step at a glance; logarithms are those of :func:`_rounded`.

    - ``able``: names of the methods that can hold it
    - ``tolerance``, ``cells``: logarithms
    - ``python``: whether evaluations go through Python
    - ``pressed``: whether the tissue resists compression
    - ``excess``: four times log(counted / expected) of each method
    """

    able: tuple[str, ...]
    tolerance: int
    cells: int
    python: bool
    pressed: bool
    excess: tuple[int, ...]


def _seen(system: Mechanics, known: Learnt, tolerance: float) -> _Seen:
    from multicell.integrators.driver import needs_python

    excess = tuple(round(4.0 * x) for x in known.excess)
    n, python, pressed = len(system), needs_python(system), system.compression is not None
    return _Seen(candidates(system), _rounded(tolerance), _rounded(n), python, pressed, excess)


class _Glance(NamedTuple):
    """Facts of a coupling step without an evaluation: ``low`` and ``high`` are bounds of λΔt."""

    known: Learnt
    seen: _Seen
    low: float
    high: float


def _rounded(value: float) -> int:
    """Return four times the logarithm of base 2: what costs are looked up by."""
    return round(4.0 * math.log2(max(value, 1e-9)))


def _costs(
    seen: _Seen, step: CouplingStep, finer: float, excess: Sequence[float]
) -> dict[str, float]:
    """Return the expected cost of each method, in evaluations of all cells."""
    costs = {}
    for name in seen.able:
        work = step.work(name, _part(name, finer, step.stiffness)) * _dearer(name, seen.pressed)
        costs[name] = work * step.unit(name) * math.exp(excess[_NUMBER[name]])
    return costs


def _dearer(name: str, pressed: bool) -> float:
    """Return the work of a method over that of the model, where ``_Seen`` says why."""
    return _PRESSED if pressed and CANDIDATES[name] is Rosenbrock else 1.0


def _part(name: str, finer: float, stiffness: float) -> float:
    """Return the part of the tolerances at which a method is about as exact as the others.

    - ``finer``: that of Rosenbrock's method, by :func:`_finer`
    - ``stiffness``: λΔt
    """
    if not CANDIDATES[name].info.implicit:
        return 1.0
    if CANDIDATES[name] is not Cvode:
        return finer
    return finer * _EXACT_TO / min(max(stiffness, _EXACT_TO), _STIFFEST)


@lru_cache(maxsize=4096)
def _sure(
    seen: _Seen,
    low: int,
    high: int,
    slow: int,
    usual: int,
    fast: int,
    furthest: int | None = None,
) -> tuple[str, float]:
    """Return the method that is cheapest but for the cost of a closer look, or nothing.

    It is the cheapest in the middle, and dearer than another by no more than that at the ends. All
    arguments are logarithms of :func:`_rounded`. Returns too how many passes it takes at most.

    - ``low``, ``high``: what λΔt is between
    - ``slow``, ``usual``, ``fast``, µm: root mean square motion, what it is between
    - ``furthest``, µm: largest motion; None where no look at the motion has been taken
    """
    excess = [0.25 * x for x in seen.excess]
    tolerance, n = 2.0 ** (0.25 * seen.tolerance), max(round(2.0 ** (0.25 * seen.cells)), 1)

    def cases(z: int, *ways: int) -> list[dict[str, float]]:
        stiffness, moved = 2.0 ** (0.25 * z), [2.0 ** (0.25 * x) for x in dict.fromkeys(ways)]
        far = 1.0 if furthest is None else _finer(2.0 ** (0.25 * furthest), stiffness, tolerance)
        steps = [CouplingStep(stiffness, way, tolerance, n, seen.python) for way in moved]
        return [_costs(seen, step, far, excess) for step in steps]

    (middle,) = cases(round(0.5 * (low + high)), usual)
    best = min(seen.able, key=middle.__getitem__)
    every = [middle, *cases(low, slow, fast), *cases(high, slow, fast)]
    regret = max(costs[best] - min(costs.values()) for costs in every)
    closer = 1.0 + _LOOK / n if furthest is None else _PASSES + _CALLS / n
    if regret > closer:
        return "", math.inf
    unit = CouplingStep(1.0, 1.0, tolerance, n, seen.python).unit(best)
    return best, max(costs[best] for costs in every) / unit


def _first(name: str, able: Collection[str]) -> tuple[str, ...]:
    """Return a method and those that are tried after it, as far as they can hold the scene."""
    return tuple(n for n in dict.fromkeys((name, *_STABLE, EXACT, MILD)) if n in able)


def _in_turn(name: str, system: Mechanics) -> Iterator[str]:
    """Yield a method and those after it, which are only asked for where it cannot continue."""
    yield name
    yield from _first(name, candidates(system))[1:]


def _passes(work: Work) -> float:
    """Return the passes over all cells so far, but for those that solve for friction."""
    return float(work.effort - work.friction_iterations)


def _count(system: Mechanics, name: str, before: int) -> None:
    """Count the steps since ``before`` as those of a method."""
    counts = vars(system.work)
    counts[COUNTERS[name]] = counts.get(COUNTERS[name], 0) + system.work.steps - before


def _tolerance(system: Mechanics, rtol: float, atol: float) -> float:
    """Return the tolerance of a cell of mean radius, µm."""
    return atol + rtol * (system.motion.mean_radius if len(system) else 1.0)


def _between(system: Mechanics, known: Learnt) -> tuple[float, float]:
    """Return bounds of λ, 1/s; zeros where only a measurement gives them.

    In gels and against compression λ does not follow its order of magnitude: a measured one counts
    for some coupling steps.
    """
    from multicell.integrators.limits import stiffness_scale

    if len(system) < 2 and system.walls is None:
        return _NONE, _NONE
    scale, near = stiffness_scale(system), _NEAR ** min(known.age / _OLD, FAINTEST)
    gel = system.walls is not None and system.walls.shear is not None
    if gel or system.compression is not None:
        rate = known.ratio * scale if known.age < _OLD else 0.0
        return rate / near, rate * near
    if not known.ratio:
        return _LEAST * scale, _MOST * scale
    low = max(known.ratio / near, min(known.ratio, _LEAST))
    return low * scale, min(known.ratio * near, max(known.ratio, _MOST)) * scale


def _finer(furthest: float, stiffness: float, tolerance: float) -> float:
    """Return the part of the tolerance that an implicit method is given.

    The whole where there are no fast modes to follow, down to a tenth where there are.

    - ``furthest``, µm: speed of the fastest cell times the length of the step
    """
    fast = max(furthest / stiffness / tolerance, _QUIET) if stiffness else _SHAKEN
    shaken = min(math.log(fast / _QUIET) / math.log(_SHAKEN / _QUIET), 1.0)
    return float(_AS_EXACT**shaken)


def _speeds(system: Mechanics, position: FloatArray) -> tuple[float, float]:
    """Return the root mean square and the largest speed of the cells, µm/s.

    Both are zero where they cannot be evaluated.
    """
    from multicell.mechanics.motion import StateRejected

    velocity = np.empty_like(position)
    try:
        system.velocity(system.motion.begin, position, velocity)
    except StateRejected:
        return 0.0, 0.0
    if not len(position):
        return 0.0, 0.0
    found = squares(velocity)
    if not math.isfinite(float(found.sum())):
        return 0.0, 0.0
    return math.sqrt(float(found.sum()) / len(found)), math.sqrt(float(found.max()))


def measured_rate(system: Mechanics, position: FloatArray) -> float:
    """Return the largest decay rate λ, 1/s, as it should be expected in the coupling step.

    The end of the spectrum with its residual, which few products find to a tenth. Where growth is
    faster, as of contacts that are just forming, it is about to change: then the order of magnitude
    counts, if that is higher. Growth itself limits no explicit step.
    """
    from multicell.integrators.limits import stiffness_scale
    from multicell.mechanics.decay_rate import spectrum_ends
    from multicell.mechanics.motion import StateRejected

    if len(system) < 2 and system.walls is None:
        return 0.0
    try:
        decay, residual, growth = spectrum_ends(system, system.motion.begin, position)
    except StateRejected:
        return 0.0
    rate = max(decay + residual, 0.0)
    return max(rate, stiffness_scale(system)) if growth > decay else rate
