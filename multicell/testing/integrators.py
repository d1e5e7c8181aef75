"""Promises of methods of integration."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from multicell.cells import FloatArray
from multicell.contact.hertz import Hertz
from multicell.integrators.base import Integrator, MethodInfo, Outcome, build_method
from multicell.integrators.own import method_info
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.testing.promises import BrokenPromise, carry_out_tests, fail_with, require

TRIED_BEGIN, TRIED_END = 30.0, 110.0
"""The interval of the problem that is solved, s."""
TRIED_STEPS = (4.0, 2.0, 1.0, 0.5)
"""Steps that a method with a fixed step is tried with, s."""
TRIED_TOLERANCES = (1e-3, 1e-4, 1e-5)
"""Tolerances that a method under error control is tried with, µm."""

_WORST = 100.0  # times its tolerance, for the error of the interval
_ORDER = 0.3  # what a measured order may lack
_ROUNDING = 1e-11  # µm, below which an error is none


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
    carry_out_tests(IntegratorTests(), method, settable(method).name)


class IntegratorTests:
    """Tests of a method of integration; a subclass gives the method by a fixture of pytest.

    Each promise of :func:`check_integrator` is a test of its own, and the fixture gives what that
    takes: a class, an integrator, ``"file.py:Name"`` or a name of the registry::

        class TestMidpoint(IntegratorTests):
            @pytest.fixture
            def method(self):
                return Midpoint
    """

    def test_errors_fall_as_claimed(self, method: Any) -> None:
        """The error falls with the step by the claimed order, or follows the tolerance."""
        info = settable(method)
        settings: Sequence[float] = TRIED_STEPS if info.control == "step" else TRIED_TOLERANCES
        errors = np.array(
            [np.abs(_finished(info, value, _spheres())[0] - _exact()).max() for value in settings]
        )
        pairs = zip(settings, errors, strict=True)
        listed = ", ".join(f"{error:.2g} um at {setting:g}" for setting, error in pairs)
        if info.control == "tolerance":
            require(
                (errors <= _WORST * np.array(settings)).all(),
                f"its errors do not follow the tolerance: {listed}",
            )
            return
        seen = errors > _ROUNDING
        if seen.sum() < 2:
            return
        order = float(np.polyfit(np.log(np.array(settings)[seen]), np.log(errors[seen]), 1)[0])
        claimed = 1.0 if info.order is None else info.order
        require(order >= claimed - _ORDER, f"its order is {order:.2f}, not {claimed:g}: {listed}")

    def test_inputs_are_left_as_they_were(self, method: Any) -> None:
        """Positions and what is known of the cells are left as they were."""
        info = settable(method)
        system, position = _spheres()
        motion, before = system.motion, position.copy()
        known = {f.name: np.array(getattr(motion, f.name)) for f in fields(motion)}
        outcome, _ = _solved(_instantiate(info, _usual(info)), (system, position))
        require((position == before).all(), "it changes the positions that it was given")
        same = system.motion is motion and all(
            np.array_equal(value, np.array(getattr(motion, name))) for name, value in known.items()
        )
        require(same, "it changes what is known of the cells (system.motion)")
        require(
            not np.shares_memory(outcome.position, position),
            "it returns the array that it was given, and not one of its own",
        )

    def test_work_is_counted(self, method: Any) -> None:
        """Evaluations and steps are counted, and no step is taken for rounding alone."""
        info = settable(method)
        _, system = _finished(info, _usual(info), _spheres())
        work = system.work
        require(work.evaluations > 0, "its evaluations do not go through the system")
        require(work.steps > 0, "it does not count its steps in system.work.steps")
        if info.control == "step":
            count = math.ceil((TRIED_END - TRIED_BEGIN) / _usual(info))
            require(work.steps == count, f"it counts {work.steps} steps where there are {count}")
            # 1.0 - 0.7 is a little more than three steps of 0.1
            _, system = _solved(_instantiate(info, 0.1), _lone(begin=0.7, end=1.0))
            taken = system.work.steps
            require(taken == 3, f"it takes {taken} steps of 0.1 s from 0.7 s to 1 s, and not 3")

    def test_it_gives_the_same_bits_again(self, method: Any) -> None:
        """The same bits come out again, also after the object has solved something else."""
        info = settable(method)
        method = _instantiate(info, _usual(info))
        first, _ = _solved(method, _spheres())
        _solved(method, _lone(3))
        again, _ = _solved(method, _spheres())
        same = np.array_equal(first.position, again.position, equal_nan=True)
        require(same, "it does not give the same bits again")

    def test_failures_end_with_words(self, method: Any) -> None:
        """A state that is no number ends with words and not with an exception."""
        info = settable(method)
        system, position = _spheres()
        position[2, 1] = np.nan
        outcome, _ = _solved(_instantiate(info, _usual(info)), (system, position))
        require(not outcome.done, "it calls a state done that is no number")
        require(
            outcome.time == TRIED_BEGIN, "it reports progress from a state that is not a number"
        )

    def test_a_lone_cell_stays(self, method: Any) -> None:
        """A single cell that nothing pushes stays where it is."""
        info = settable(method)
        found, _ = _finished(info, _usual(info), _lone())
        require((found == _lone()[1]).all(), "it moves a single cell that nothing pushes")


def settable(method: Any) -> MethodInfo:
    """Return the record of a method whose step or tolerance can be set."""
    info = method_info(method)
    wanted = "step" if info.control == "step" else "atol"
    if wanted not in info.settings:
        fail_with(info.name, [f"it takes no {wanted!r}, which is how its accuracy is set"])
    return info


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
        raise BrokenPromise(f"it raises {type(error).__name__}: {error}") from error
    require(isinstance(outcome, Outcome), "it does not return an Outcome")
    return outcome, system


def _finished(
    info: MethodInfo, setting: float, problem: tuple[Mechanics, FloatArray]
) -> tuple[FloatArray, Mechanics]:
    """Return where a solve ended, which must reach the end."""
    outcome, system = _solved(_instantiate(info, setting), problem)
    at = f"with {'step' if info.control == 'step' else 'tolerance'} {setting:g}"
    require(outcome.done, f"{at} it does not reach the end: {outcome.problem}")
    require(
        outcome.time == TRIED_END, f"{at} it ends at {outcome.time!r} s, not at {TRIED_END!r} s"
    )
    require(
        np.shape(outcome.position) == problem[1].shape and np.isfinite(outcome.position).all(),
        f"{at} it does not return numbers for all cells",
    )
    return outcome.position, system
