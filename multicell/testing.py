"""Conformance tests for parts of the user's own.

:func:`check_integrator` checks whether a method keeps the promises that runs and comparisons rely
on (:class:`multicell.Integrator`). It fits into any test suite:

>>> from multicell.testing import check_integrator
>>> def test_mine():
...     check_integrator(Midpoint)                                   # doctest: +SKIP

:func:`check_pair_law` does the same for a pair law (:func:`multicell.pair_law`),
:func:`check_growth_law` for a law of growth (:func:`multicell.growth_law`),
:func:`check_response` for a law of response (:func:`multicell.response`),
:func:`check_network` for a network inside cells (:func:`multicell.network`),
:func:`check_reaction` for a reaction between fields (:func:`multicell.reaction`), and
:func:`check_observable` for an observable (:func:`multicell.observable`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np

from multicell.behaviours.growth_laws.laws import GrowthLaw
from multicell.behaviours.laws import ResponseLaw
from multicell.cells import FloatArray, IntArray, State
from multicell.contact.hertz import Hertz
from multicell.contact.law import PairLaw, effective_modulus
from multicell.errors import SceneError
from multicell.integrators.base import Integrator, MethodInfo, Outcome, build_method
from multicell.integrators.own import method_info
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.results.observable import Observable, TissueState

if TYPE_CHECKING:
    from multicell.networks.network import Network
    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene

TRIED_BEGIN, TRIED_END = 30.0, 110.0
"""The interval of the problem that is solved, s."""
TRIED_STEPS = (4.0, 2.0, 1.0, 0.5)
"""Steps that a method with a fixed step is tried with, s."""
TRIED_TOLERANCES = (1e-3, 1e-4, 1e-5)
"""Tolerances that a method under error control is tried with, µm."""

_WORST = 100.0  # times its tolerance, for the error of the interval
_ORDER = 0.3  # what a measured order may lack
_ROUNDING = 1e-11  # µm, below which an error is none


def check_reaction(reaction: Any) -> None:
    """Check a reaction; raise ``AssertionError`` with every requirement that it violates.

    At points over six decades of concentrations up to its ``upto``, and where one of its fields or
    all are absent:

    - rates are finite, and so is their derivative, given or found by differences;
    - no field is consumed where there is none of it;
    - the derivative, integrated along lines, is the change of the rates;
    - compiled it has the rates of the Python function.

    Parameters
    ----------
    reaction
        Made by :func:`multicell.reaction`.
    """
    from multicell.nutrient.reactions.check import problems
    from multicell.nutrient.reactions.own import OwnReaction
    from multicell.nutrient.reactions.own_kernels import Cell

    if not isinstance(reaction, OwnReaction):
        raise AssertionError(f"{reaction!r} is not made by multicell.reaction")
    name = getattr(reaction.rate, "__name__", "the reaction")
    found = problems(reaction)
    if found:
        raise AssertionError(f"{name} {' '.join(found)}")
    rng = np.random.default_rng(3)
    for _ in range(20):
        c, tissue = reaction.upto * rng.random(len(reaction.fields)), float(rng.random())
        compiled = reaction.evaluate(c[:, None], np.array([tissue]))[0][:, 0]
        plain = reaction([float(x) for x in c], Cell(tissue))
        if not np.allclose(compiled, plain, rtol=1e-9, atol=0.0):
            raise AssertionError(f"{name}, compiled, has the rates {compiled} at {c}, not {plain}")


def check_growth_law(law: GrowthLaw) -> None:
    """Check a growth law; raise ``AssertionError`` with every requirement that it violates.

    For volumes from birth to division and shares of a cycle up to 1:

    - rates are above zero, volumes and shares are numbers, and arrays keep their shape;
    - a cell that nothing limits comes from birth to twice that volume in one cycle;
    - the share of a cycle is the inverse of the volume after it;
    - two steps one after the other are one step of their sum, and no step changes nothing;
    - the volume changes at the law's rate, and in any unit of volume by the same law.

    Parameters
    ----------
    law
        A law with its parameters, such as ``Bertalanffy(largest=2.2)``
        (:func:`multicell.growth_law`).
    """
    checks = (_check_numbers, _check_doubling, _check_inverse, _check_additivity, _check_rate)
    _carry_out(checks, law, type(law).__name__)


_VOLUMES, _SHARES = map(np.ravel, np.meshgrid(np.linspace(1.0, 2.0, 11), np.linspace(0.0, 0.1, 6)))
"""Volumes at the beginning, and shares of a cycle by which they end at 2.2 at most."""
_GROWTH_ROUNDING = 1e-9
"""How far volumes and shares of a growth law may be off, relative to the volume at birth."""


def _same(found: FloatArray, wanted: FloatArray, problem: str) -> None:
    off = float(np.max(np.abs(np.asarray(found) - wanted)))
    _require(off <= _GROWTH_ROUNDING, f"{problem}: off by {off:.2g}")


def _check_numbers(law: GrowthLaw) -> None:
    volume, share = _VOLUMES, _SHARES
    rate = law.rate(volume)
    _require(np.shape(rate) == volume.shape, "its rates are not one for each volume")
    _require(np.isfinite(rate).all(), "its rate is no number at some volume")
    _require((rate > 0.0).all(), "its rate is not above zero from birth to division")
    for found in (law.volume_after(volume, share), law.share_at(volume)):
        _require(np.shape(found) == volume.shape, "it does not return one number for each cell")
        _require(np.isfinite(found).all(), "it returns something that is no number")


def _check_doubling(law: GrowthLaw) -> None:
    after = law.volume_after(np.ones(1), np.ones(1))
    _same(after, np.full(1, 2.0), "a cycle does not double the volume")


def _check_inverse(law: GrowthLaw) -> None:
    share = np.linspace(0.0, 1.0, 21)
    found = law.share_at(law.volume_after(np.ones(21), share))
    _same(found, share, "its share of a cycle is not the inverse of its volume")


def _check_additivity(law: GrowthLaw) -> None:
    volume, share = _VOLUMES, _SHARES
    _same(law.volume_after(volume, 0.0 * share), volume, "no time changes its volume")
    halves = law.volume_after(law.volume_after(volume, 0.4 * share), 0.6 * share)
    _same(halves, law.volume_after(volume, share), "two steps are not one of their sum")


def _check_rate(law: GrowthLaw) -> None:
    volume, step = np.linspace(1.0, 2.0, 21), 1e-4
    ends = [law.volume_after(volume, np.full(21, sign * step)) for sign in (-1.0, 1.0)]
    slope, rate = (ends[1] - ends[0]) / (2.0 * step), law.rate(volume)
    off = float(np.abs(slope - rate).max() / np.abs(rate).max())
    _require(off <= _SLOPE, f"its volume does not change at its rate: off by {off:.2g} of it")
    birth = 261.8
    after = law.volume_after(volume * birth, np.full(21, 0.1), birth) / birth
    _same(after, law.volume_after(volume, np.full(21, 0.1)), "it depends on the unit of volume")


def check_response(law: ResponseLaw) -> None:
    """Check a response; raise ``AssertionError`` with every requirement that it violates.

    For signals that rise from 0 to 10:

    - shares are numbers from 0 to 1, one for each cell, in any order of the cells;
    - they are the same if asked twice, and signals are left as they were.

    Parameters
    ----------
    law
        A law with its parameters (:func:`multicell.response`).
    """
    _carry_out((_check_shares,), law, type(law).__name__)


def _check_shares(law: ResponseLaw) -> None:
    signal = np.linspace(0.0, 10.0, 201)
    count = getattr(law, "signals", 1)

    def share(values: FloatArray) -> FloatArray:
        given: Any = (values,) * count if count > 1 else values
        return np.asarray(law.share(given, falls=False))

    before, found = signal.copy(), share(signal)
    _require(np.shape(found) == signal.shape, "it does not return one share for each cell")
    _require(np.isfinite(found).all(), "it returns something that is no number")
    _require(bool(((found >= 0.0) & (found <= 1.0)).all()), "its shares are not from 0 to 1")
    _require(np.array_equal(found, share(signal)), "it does not give the same bits again")
    _require(np.array_equal(before, signal), "it writes into its signals")
    back = share(signal[::-1].copy())[::-1]
    _require(np.array_equal(back, found), "a share depends on the other cells")


def check_network(
    network: Network, *, invariants: Iterable[Mapping[str, float]] = (), duration: float = 1.0
) -> None:
    """Check a network; raise ``AssertionError`` with every requirement that it violates.

    At its start and at states around it, and over a time from there:

    - numba compiles it; rates and observed values are finite numbers, the same if asked twice, and
      states, inputs and parameters are left as they were;
    - compiled it gives what the function gives as plain Python;
    - rates have a derivative: differences of two lengths agree;
    - a Rosenbrock and an explicit method agree on the state after ``duration``;
    - sums that are stated not to change do not.

    Parameters
    ----------
    network
        Made by :func:`multicell.network`, or read from a file.
    invariants
        Name of a state -> its factor, for each sum over states that reactions leave as it is.
    duration
        Time over which it is solved, in its own unit.
    """
    from multicell.networks.conformance import faults_of

    faults = list(faults_of(network, invariants, duration))
    if faults:
        raise AssertionError(f"{network.name}: {'; '.join(faults)}")


def check_integrator(method: Any) -> None:
    """Check a method; raise ``AssertionError`` with every requirement that it violates.

    Four elastic spheres that touch and grow are followed for 80 s, a smooth problem that depends
    on time, and compared with SciPy's DOP853:

    - the end of the interval is reached, with positions that are numbers;
    - the error falls with the step, by the order that ``info`` claims, or follows the tolerance;
    - positions and what is known of the cells are left as they were;
    - evaluations go through the system and steps are counted in ``system.work``; with a fixed step
      as many as the interval needs, and none more for what rounding adds to it;
    - the same bits come out again, also after the object has solved something else;
    - a state that is no number ends with words in ``Outcome.problem``, not with an exception, at
      the time up to which all was well;
    - a single cell that nothing pushes stays where it is.

    Parameters
    ----------
    method
        A class, an integrator, ``"file.py:Name"`` or a name in
        :data:`multicell.integrators.registry.METHODS`. Step and tolerance are set by the checks.

    Raises
    ------
    AssertionError
        If a promise is not kept.
    SceneError
        If there is no such method, it is no integrator, or cannot be made.
    """
    info = method_info(method)
    wanted = "step" if info.control == "step" else "atol"
    if wanted not in info.settings:
        _fail(info.name, [f"it takes no {wanted!r}, which is how its accuracy is set"])
    checks = (_check_errors, _check_inputs, _check_counts, _check_repetition, _check_failures)
    _carry_out((*checks, _check_lone_cell), info, info.name)


@final
class _Broken(Exception):  # noqa: N818 - it names what happened to a promise
    """A promise that is not kept, in words."""


def _require(kept: object, problem: str) -> None:
    if not kept:
        raise _Broken(problem)


def _carry_out(checks: Iterable[Callable[[Any], None]], subject: Any, name: str) -> None:
    """Raise ``AssertionError`` with all promises that checks of a subject find broken."""
    problems = []
    for check in checks:
        try:
            check(subject)
        except _Broken as error:
            problems.append(str(error))
    _fail(name, problems)


def _fail(name: str, problems: Iterable[str]) -> None:
    found = "; ".join(dict.fromkeys(problems))
    if found:
        raise AssertionError(f"{name}: {found}")


def _instantiate(info: MethodInfo, setting: float) -> Integrator:
    """Return the method with a step in s or a tolerance in µm."""
    if info.control == "step":
        return build_method(info, step=setting, atol=1e-7, max_displacement=0.5)
    rtol = max(0.01 * setting, 1e-13)
    return build_method(info, rtol=rtol, atol=setting, max_steps=1_000_000, max_displacement=0.5)


def _usual(info: MethodInfo) -> float:
    return TRIED_STEPS[1] if info.control == "step" else TRIED_TOLERANCES[1]


def _spheres() -> tuple[Mechanics, FloatArray]:
    """Return four spheres that touch each other all the time, made ready, and their places."""
    corners = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    shift = np.array([[0.1, -0.2, 0.0], [0.0, 0.1, 0.2], [-0.1, 0.0, -0.2], [0.2, 0.1, 0.0]])
    radius = np.array([5.0, 4.6, 4.8, 5.2])
    system = Mechanics(Hertz(), 5.0)
    growth = np.array([2e-3, 1e-3, 0.0, 1.5e-3])
    young = np.array([1.0, 1.1, 0.9, 1.05])
    system.begin(Motion(radius, growth, young, np.full(4, 0.5), TRIED_BEGIN, TRIED_END))
    return system, 3.1 * corners + shift


def _lone(
    count: int = 1, begin: float = TRIED_BEGIN, end: float = TRIED_END
) -> tuple[Mechanics, FloatArray]:
    system = Mechanics(Hertz(), 5.0)
    ones = np.ones(count)
    system.begin(Motion(5.0 * ones, 0.0 * ones, ones, 0.5 * ones, begin, end))
    return system, 40.0 * np.arange(3.0 * count).reshape(count, 3)


@functools.cache
def _exact() -> FloatArray:
    from scipy.integrate import solve_ivp

    system, position = _spheres()

    def velocity(t: float, y: FloatArray) -> FloatArray:
        out = np.empty((4, 3))
        system.velocity(t, np.ascontiguousarray(y).reshape(4, 3), out)
        return out.ravel()

    found = solve_ivp(
        velocity,
        (TRIED_BEGIN, TRIED_END),
        position.ravel(),
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
    )
    return np.asarray(found.y[:, -1].reshape(4, 3))


def _solved(method: Integrator, problem: tuple[Mechanics, FloatArray]) -> tuple[Outcome, Mechanics]:
    """Return how a solve ended; an exception is a promise that is not kept."""
    system, position = problem
    try:
        outcome = method.integrate(system, position)
    except Exception as error:
        raise _Broken(f"it raises {type(error).__name__}: {error}") from error
    _require(isinstance(outcome, Outcome), "it does not return an Outcome")
    return outcome, system


def _finished(
    info: MethodInfo, setting: float, problem: tuple[Mechanics, FloatArray]
) -> tuple[FloatArray, Mechanics]:
    """Return where a solve ended, which must reach the end."""
    outcome, system = _solved(_instantiate(info, setting), problem)
    at = f"with {'step' if info.control == 'step' else 'tolerance'} {setting:g}"
    _require(outcome.done, f"{at} it does not reach the end: {outcome.problem}")
    _require(
        outcome.time == TRIED_END, f"{at} it ends at {outcome.time!r} s, not at {TRIED_END!r} s"
    )
    _require(
        np.shape(outcome.position) == problem[1].shape and np.isfinite(outcome.position).all(),
        f"{at} it does not return numbers for all cells",
    )
    return outcome.position, system


def _check_errors(info: MethodInfo) -> None:
    settings: Sequence[float] = TRIED_STEPS if info.control == "step" else TRIED_TOLERANCES
    errors = np.array(
        [np.abs(_finished(info, value, _spheres())[0] - _exact()).max() for value in settings]
    )
    pairs = zip(settings, errors, strict=True)
    listed = ", ".join(f"{error:.2g} um at {setting:g}" for setting, error in pairs)
    if info.control == "tolerance":
        _require(
            (errors <= _WORST * np.array(settings)).all(),
            f"its errors do not follow the tolerance: {listed}",
        )
        return
    seen = errors > _ROUNDING
    if seen.sum() < 2:
        return
    order = float(np.polyfit(np.log(np.array(settings)[seen]), np.log(errors[seen]), 1)[0])
    claimed = 1.0 if info.order is None else info.order
    _require(order >= claimed - _ORDER, f"its order is {order:.2f}, not {claimed:g}: {listed}")


def _check_inputs(info: MethodInfo) -> None:
    system, position = _spheres()
    motion, before = system.motion, position.copy()
    known = {f.name: np.array(getattr(motion, f.name)) for f in fields(motion)}
    outcome, _ = _solved(_instantiate(info, _usual(info)), (system, position))
    _require((position == before).all(), "it changes the positions that it was given")
    same = system.motion is motion and all(
        np.array_equal(value, np.array(getattr(motion, name))) for name, value in known.items()
    )
    _require(same, "it changes what is known of the cells (system.motion)")
    _require(
        not np.shares_memory(outcome.position, position),
        "it returns the array that it was given, and not one of its own",
    )


def _check_counts(info: MethodInfo) -> None:
    _, system = _finished(info, _usual(info), _spheres())
    work = system.work
    _require(work.evaluations > 0, "its evaluations do not go through the system")
    _require(work.steps > 0, "it does not count its steps in system.work.steps")
    if info.control == "step":
        count = math.ceil((TRIED_END - TRIED_BEGIN) / _usual(info))
        _require(work.steps == count, f"it counts {work.steps} steps where there are {count}")
        # 1.0 - 0.7 is a little more than three steps of 0.1
        _, system = _solved(_instantiate(info, 0.1), _lone(begin=0.7, end=1.0))
        taken = system.work.steps
        _require(taken == 3, f"it takes {taken} steps of 0.1 s from 0.7 s to 1 s, and not 3")


def _check_repetition(info: MethodInfo) -> None:
    method = _instantiate(info, _usual(info))
    first, _ = _solved(method, _spheres())
    _solved(method, _lone(3))
    again, _ = _solved(method, _spheres())
    same = np.array_equal(first.position, again.position, equal_nan=True)
    _require(same, "it does not give the same bits again")


def _check_failures(info: MethodInfo) -> None:
    system, position = _spheres()
    position[2, 1] = np.nan
    outcome, _ = _solved(_instantiate(info, _usual(info)), (system, position))
    _require(not outcome.done, "it calls a state done that is no number")
    _require(outcome.time == TRIED_BEGIN, "it reports progress from a state that is not a number")


def _check_lone_cell(info: MethodInfo) -> None:
    found, _ = _finished(info, _usual(info), _lone())
    _require((found == _lone()[1]).all(), "it moves a single cell that nothing pushes")


OBSERVED: Mapping[str, Any] = {
    "duration": "1 h",
    "coupling_step": "10 min",
    "initial": {"count": 30, "stage": "asynchronous"},
    "growth": {"critical_pressure": 0.1},
    "death": {},
    "types": {"soft": {"young": 0.5}, "stiff": {"young": 2.0}},
    "nutrients": {"oxygen": {"boundary": 0.07, "quiescence": 0.06, "necrosis": 0.01}},
}
"""The scene of :func:`check_observable` where none is given."""


def check_observable(observable: Observable, scene: Scene | None = None) -> None:
    """Check an observable; raise ``AssertionError`` with every requirement that it violates.

    In a scene at its start and after two coupling steps, with a single cell, without cells and
    with dead cells only, and in a scene without any optional part unless it ``needs`` one:

    - it is one finite number, or NaN if it states when it is ``absent``;
    - it is not negative unless it is ``signed``;
    - it is the same if asked twice, and if the cells have another order;
    - it writes into no array of the state.

    Parameters
    ----------
    observable
        Made by :func:`multicell.observable`.
    scene
        One that has what it needs; by default a small one with two types and oxygen.
    """
    from multicell.scene.scene import Scene

    bare = Scene.from_dict({"duration": "1 h", "coupling_step": "10 min", "initial": {"count": 9}})
    tried = 0
    problems: list[str] = []
    for place, one in (("", scene or Scene.from_dict(OBSERVED)), (" in a bare scene", bare)):
        try:
            keys = observable.keys(one)
        except SceneError as error:
            problems += [] if one is bare else [f"{error}: give check_observable a scene with it"]
            continue
        for case, frame in _frames(one):
            for key in keys:
                tried += 1
                found = _observed(observable, TissueState(frame, one), key)
                problems += [f"{case}{place} it {problem}" for problem in found]
    if not (tried or problems):
        problems = ["it does not exist in the scene: give check_observable one that has it"]
    _fail(observable.name, problems)


def _frames(scene: Scene) -> Iterator[tuple[str, Frame]]:
    from multicell.simulation import Simulation

    simulation = Simulation(scene, threads=1)
    yield "at the start", simulation.frame()
    for _ in range(2):
        simulation.step()
    frame = simulation.frame()
    yield "after two steps", frame
    yield "with a single cell", _taken(frame, np.arange(1))
    yield "without cells", _taken(frame, np.arange(0))
    dead = frame.cells.copy()
    dead.state[:] = State.NECROTIC
    yield "with dead cells only", replace(frame, cells=dead)


def _taken(frame: Frame, index: IntArray) -> Frame:
    """Return a frame with some of its cells, in another order."""
    known = {name: values[index] for name, values in frame.concentrations.items()}
    return replace(frame, cells=frame.cells.take(index), concentrations=known)


def _observed(observable: Observable, state: TissueState, key: str) -> Iterator[str]:
    """Yield the faults of an observable in a state."""
    order = np.random.default_rng(7).permutation(len(state.cells))
    turned = TissueState(_taken(state.frame, order), state.scene)
    states = (state, state, turned)
    try:
        value, again, other = (float(observable.value(s.sealed, key)) for s in states)
    except Exception as error:
        yield f"fails: {error}"
        return
    if not math.isfinite(value) and not (math.isnan(value) and observable.absent):
        yield f"is {value}, and does not state when it is absent"
    if value < 0.0 and not observable.signed:
        yield f"is {value:g}, which is negative, and is not signed"
    if not np.array_equal(value, again, equal_nan=True):
        yield f"is {value!r}, and {again!r} if asked again"
    if not np.isclose(value, other, rtol=1e-9, atol=0.0, equal_nan=True):
        yield f"is {value!r}, and {other!r} with the cells in another order"


def check_pair_law(law: PairLaw) -> None:
    """Check a pair law; raise ``AssertionError`` with every requirement that it violates.

    Pairs of three sizes and three moduli are taken through overlaps from beyond the reach to
    nine tenths of a radius:

    - force, stiffness and energy are numbers, and zero where the law does not act;
    - the force is the slope of the energy and the stiffness that of the force, away from
      kinks: to 1e-5 of the largest, by central differences;
    - the reach is at least zero, falls neither with the radius nor with the sum of the radii, and
      does not rise with the modulus;
    - at the equilibrium overlap the force vanishes;
    - compiled, two cells have the force, energy and stiffness that the law's function gives.

    Parameters
    ----------
    law
        A law with its parameters, such as ``Cubic(stiffness=2.0)``.
    """
    _carry_out((_check_slopes, _check_reach, _check_rest, _check_compiled), law, type(law).__name__)


_SIZES = (2.0, 5.0, 8.0)  # radii r_ij at which laws are tried, µm: small to large cells
_MODULI = (0.2, 1.0, 5.0)  # moduli E_ij at which laws are tried, kPa
_PAIRS = [(e, 0.5 * r, 2.0 * r) for e in _MODULI for r in _SIZES]
"""E_ij, r_ij and the sum of the radii of some pairs of equal cells."""
_SLOPE = 1e-5
"""How far slopes may be off, of the largest."""


def _check_slopes(law: PairLaw) -> None:
    for modulus, radius, rest in _PAIRS:
        begin = -float(law.reach(modulus, radius, rest=rest))
        overlap = np.linspace(begin - 0.1 * rest, 0.45 * rest, 301)
        step = 1e-6 * rest
        low, here, high = (
            np.stack(law.evaluate(overlap + s * step, modulus, radius, rest=rest, touching=True))
            for s in (-1.0, 0.0, 1.0)
        )
        at = f"at E = {modulus:g} kPa and r = {radius:g} um"
        _require(np.isfinite(here).all(), f"{at} it gives something that is no number")
        _require(
            not here[:, overlap < begin - step].any(),
            f"{at} it acts beyond its reach of {-begin:g} um",
        )
        # where it begins to act and where adhesion sets in a law may have a kink
        smooth = np.minimum(np.abs(overlap - begin), np.abs(overlap)) > 0.02 * rest
        found = (high - low)[[2, 0]] / (2.0 * step)
        names = ("force is not the slope of the energy", "stiffness is not the slope of the force")
        for name, slope, claimed in zip(names, found, here[:2], strict=True):
            off = float(np.abs(slope - claimed)[smooth].max())
            most = float(np.abs(claimed).max())
            _require(off <= _SLOPE * most, f"{at} its {name}: off by {off:.2g} of {most:.2g}")


def _check_reach(law: PairLaw) -> None:
    grid = np.array(
        [
            [[float(law.reach(e, r, rest=4.0 * r * s)) for s in (1.0, 2.0)] for r in _SIZES]
            for e in _MODULI
        ]
    )
    _require((grid >= 0.0).all(), "its reach is below zero")
    _require((np.diff(grid, axis=0) <= 0.0).all(), "its reach rises with the modulus")
    _require((np.diff(grid, axis=1) >= 0.0).all(), "its reach falls with the radius")
    _require((np.diff(grid, axis=2) >= 0.0).all(), "its reach falls with the sum of the radii")


def _check_rest(law: PairLaw) -> None:
    for modulus, radius, rest in _PAIRS:
        overlap = float(law.equilibrium_overlap(modulus, radius))
        around = np.linspace(overlap, max(1.1 * overlap, 0.1 * rest), 9)
        force = law.evaluate(around, modulus, radius, rest=rest, touching=True)[0]
        small = 1e-6 * float(np.abs(force).max())
        _require(
            abs(float(force[0])) <= small or overlap >= rest,
            f"at its equilibrium overlap of {overlap:.3g} um the force is {float(force[0]):.2g} nN",
        )


def _check_compiled(law: PairLaw) -> None:
    """Compare two cells in the kernels with the function as Python calls it."""
    rest, poisson = 10.0, 0.5
    modulus = float(effective_modulus(1.0, poisson, 1.0, poisson))
    for overlap in (0.02, 0.3, 1.5, 4.0):
        system, ones, touching = Mechanics(law, 5.0), np.ones(2), np.array([[0, 1]])
        motion = (5.0 * ones, 0.0 * ones, ones, poisson * ones, TRIED_BEGIN, TRIED_END)
        system.begin(Motion(*motion, touching=touching))
        position = np.array([[0.0, 0.0, 0.0], [rest - overlap, 0.0, 0.0]])
        wanted = law.evaluate(overlap, modulus, 2.5, rest=rest, touching=True)
        v, out = np.array([[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]), np.empty((2, 3))
        system.linearise(TRIED_BEGIN, position)
        system.jacobian_product(v, out)
        force = float(system.force(TRIED_BEGIN, position)[1, 0])
        found = force, float(out[1, 0]) * system.drag * 5.0, system.energy(TRIED_BEGIN, position)
        for name, got, value in zip(("force", "stiffness", "energy"), found, wanted, strict=True):
            _require(
                math.isclose(got, float(value), rel_tol=1e-9, abs_tol=1e-12),
                f"compiled, its {name} at an overlap of {overlap:g} um is {got!r}, not {value!r}",
            )
