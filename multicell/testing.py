"""Conformance tests for parts of the user's own.

:func:`check_integrator` checks whether a method keeps the promises that runs and comparisons rely
on (:class:`multicell.Integrator`). It fits into any test suite:

>>> from multicell.testing import check_integrator
>>> def test_mine():
...     check_integrator(Midpoint)                                   # doctest: +SKIP

:func:`check_pair_law` does the same for a pair law (:func:`multicell.pair_law`), and
:func:`check_reaction` for a reaction between fields (:func:`multicell.reaction`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, final

import numpy as np

from multicell.cells import FloatArray
from multicell.contact.hertz import Hertz
from multicell.contact.law import PairLaw, effective_modulus
from multicell.integrators.base import Integrator, MethodInfo, Outcome, build
from multicell.integrators.own import method_info
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

BEGIN, END = 30.0, 110.0
"""The interval of the problem that is solved, s."""
STEPS = (4.0, 2.0, 1.0, 0.5)
"""Steps that a method with a fixed step is tried with, s."""
TOLERANCES = (1e-3, 1e-4, 1e-5)
"""Tolerances that a method under error control is tried with, µm."""

_WORST = 100.0  # times its tolerance, for the error of the interval
_ORDER = 0.3  # what a measured order may lack
_ROUNDING = 1e-11  # µm, below which an error is none


def check_reaction(reaction: Any) -> None:
    """Raise ``AssertionError``, with what is wrong, unless a reaction keeps its promises.

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


def check_integrator(method: Any) -> None:
    """Raise ``AssertionError``, with all that is wrong, unless a method keeps its promises.

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
    problems = []
    if wanted not in info.settings:
        problems.append(f"it takes no {wanted!r}, which is how its accuracy is set")
    else:
        for check in _CHECKS:
            try:
                check(info)
            except _Broken as error:
                problems.append(str(error))
    if problems:
        raise AssertionError(f"{info.name}: " + "; ".join(dict.fromkeys(problems)))


@final
class _Broken(Exception):  # noqa: N818 - it names what happened to a promise
    """A promise that is not kept, in words."""


def _require(kept: object, problem: str) -> None:
    if not kept:
        raise _Broken(problem)


def _instantiate(info: MethodInfo, setting: float) -> Integrator:
    """Return the method with a step in s or a tolerance in µm."""
    if info.control == "step":
        return build(info, step=setting, atol=1e-7, max_displacement=0.5)
    rtol = max(0.01 * setting, 1e-13)
    return build(info, rtol=rtol, atol=setting, max_steps=1_000_000, max_displacement=0.5)


def _usual(info: MethodInfo) -> float:
    return STEPS[1] if info.control == "step" else TOLERANCES[1]


def _spheres() -> tuple[Mechanics, FloatArray]:
    """Return four spheres that touch each other all the time, made ready, and their places."""
    corners = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    shift = np.array([[0.1, -0.2, 0.0], [0.0, 0.1, 0.2], [-0.1, 0.0, -0.2], [0.2, 0.1, 0.0]])
    radius = np.array([5.0, 4.6, 4.8, 5.2])
    system = Mechanics(Hertz(), 5.0)
    growth = np.array([2e-3, 1e-3, 0.0, 1.5e-3])
    young = np.array([1.0, 1.1, 0.9, 1.05])
    system.begin(Motion(radius, growth, young, np.full(4, 0.5), BEGIN, END))
    return system, 3.1 * corners + shift


def _lone(count: int = 1, begin: float = BEGIN, end: float = END) -> tuple[Mechanics, FloatArray]:
    """Return spheres far from each other."""
    system = Mechanics(Hertz(), 5.0)
    ones = np.ones(count)
    system.begin(Motion(5.0 * ones, 0.0 * ones, ones, 0.5 * ones, begin, end))
    return system, 40.0 * np.arange(3.0 * count).reshape(count, 3)


@functools.cache
def _exact() -> FloatArray:
    """Return where the four spheres end, by SciPy's DOP853."""
    from scipy.integrate import solve_ivp

    system, position = _spheres()

    def velocity(t: float, y: FloatArray) -> FloatArray:
        out = np.empty((4, 3))
        system.velocity(t, np.ascontiguousarray(y).reshape(4, 3), out)
        return out.ravel()

    found = solve_ivp(
        velocity, (BEGIN, END), position.ravel(), method="DOP853", rtol=1e-13, atol=1e-13
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
    _require(outcome.time == END, f"{at} it ends at {outcome.time!r} s, not at {END!r} s")
    _require(
        np.shape(outcome.position) == problem[1].shape and np.isfinite(outcome.position).all(),
        f"{at} it does not return numbers for all cells",
    )
    return outcome.position, system


def _check_errors(info: MethodInfo) -> None:
    settings: Sequence[float] = STEPS if info.control == "step" else TOLERANCES
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
        count = math.ceil((END - BEGIN) / _usual(info))
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
    _require(outcome.time == BEGIN, "it reports progress from a state that is not a number")


def _check_lone_cell(info: MethodInfo) -> None:
    found, _ = _finished(info, _usual(info), _lone())
    _require((found == _lone()[1]).all(), "it moves a single cell that nothing pushes")


_CHECKS: tuple[Callable[[MethodInfo], None], ...] = (
    _check_errors,
    _check_inputs,
    _check_counts,
    _check_repetition,
    _check_failures,
    _check_lone_cell,
)


def check_pair_law(law: PairLaw) -> None:
    """Raise ``AssertionError``, with all that is wrong, unless a pair law keeps its promises.

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

    Raises
    ------
    AssertionError
        If a promise is not kept.
    """
    problems = []
    for check in (_check_slopes, _check_reach, _check_rest, _check_compiled):
        try:
            check(law)
        except _Broken as error:
            problems.append(str(error))
    if problems:
        raise AssertionError(f"{type(law).__name__}: " + "; ".join(dict.fromkeys(problems)))


_SIZES = (2.0, 5.0, 8.0)
_MODULI = (0.2, 1.0, 5.0)
_SLOPE = 1e-5
"""How far slopes may be off, of the largest."""


def _pairs() -> list[tuple[float, float, float]]:
    """Return E_ij, r_ij and the sum of the radii of some pairs of equal cells."""
    return [(e, 0.5 * r, 2.0 * r) for e in _MODULI for r in _SIZES]


def _check_slopes(law: PairLaw) -> None:
    for modulus, radius, rest in _pairs():
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
        [[[float(law.reach(e, r, rest=4.0 * r * s)) for s in (1.0, 2.0)] for r in _SIZES]
         for e in _MODULI]
    )  # fmt: skip
    _require((grid >= 0.0).all(), "its reach is below zero")
    _require((np.diff(grid, axis=0) <= 0.0).all(), "its reach rises with the modulus")
    _require((np.diff(grid, axis=1) >= 0.0).all(), "its reach falls with the radius")
    _require((np.diff(grid, axis=2) >= 0.0).all(), "its reach falls with the sum of the radii")


def _check_rest(law: PairLaw) -> None:
    for modulus, radius, rest in _pairs():
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
        system = Mechanics(law, 5.0)
        ones = np.ones(2)
        touching = np.array([[0, 1]])
        system.begin(
            Motion(5.0 * ones, 0.0 * ones, ones, poisson * ones, BEGIN, END, touching=touching)
        )
        position = np.array([[0.0, 0.0, 0.0], [rest - overlap, 0.0, 0.0]])
        force, slope, energy = law.evaluate(overlap, modulus, 2.5, rest=rest, touching=True)
        v, out = np.array([[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]), np.empty((2, 3))
        system.linearise(BEGIN, position)
        system.jacobian_product(v, out)
        found = (
            float(system.force(BEGIN, position)[1, 0]),
            float(out[1, 0]) * system.drag * 5.0,
            system.energy(BEGIN, position),
        )
        for name, got, wanted in zip(
            ("force", "stiffness", "energy"), found, (force, slope, energy), strict=True
        ):
            same = math.isclose(got, float(wanted), rel_tol=1e-9, abs_tol=1e-12)
            _require(
                same,
                f"compiled, its {name} at an overlap of {overlap:g} um is {got!r}, not {wanted!r}",
            )
