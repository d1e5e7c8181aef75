"""Methods with the one number that is turned in a comparison: a tolerance or a step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np

from multicell.comparison.null_methods import NULL_METHODS
from multicell.comparison.replay import ReplayProblem, Trajectory
from multicell.errors import SceneError
from multicell.integrators import registry
from multicell.integrators.base import Control, Integrator, MethodInfo, build_method
from multicell.integrators.own import method_info
from multicell.integrators.registry import METHODS
from multicell.mechanics.motion import Work
from multicell.scene.scene import Scene

Ladder = Mapping[str, Sequence[float]]

SMALLEST_TOLERANCE: Final = 1e-13
"""Below, a tolerance is lost in the rounding of coordinates that are some radii large."""

LADDER_TOLERANCES: Final = tuple(10.0 ** (-0.5 * k) for k in range(2, 15))
"""Default ladder of tolerances, 1e-1 to 1e-7 in half decades."""

# a step far beyond the limit of stability to one far below it, in units of that limit
_COARSEST, _HALVINGS = 4.0, 11
_MAX_STEPS = 1_000_000  # of a solve: time ends it before its count of steps does
_SOLVED = 1e-6  # tolerance of implicit equations, in radii: below the error of any step


@final
@dataclass(frozen=True)
class Method:
    """A method of integration with its setting.

    - ``name``, str: name in tables and charts
    - ``control``, "tolerance", "step" or "none": meaning of its setting: a tolerance in mean
      radii, or a step in s; or that it has none
    - ``make``, callable: setting -> integrator
    - ``info``, MethodInfo: what is known of it; by default what the registry knows by that name
    """

    name: str
    control: Control | Literal["none"]
    make: Callable[[float], Integrator]
    info: MethodInfo = None  # type: ignore[assignment]  # set below

    def __post_init__(self) -> None:
        if self.info is None:
            object.__setattr__(self, "info", registry.find(self.name) or MethodInfo(self.name))


def find_method(method: Any, scene: Scene, radius: float) -> Method:
    """Return a method of any kind, ready to be turned.

    With a tolerance t the absolute tolerance is t ``radius``. The relative one is t / 100, so
    that it matters little how far from the origin of coordinates a cell lies. What kind of
    setting a method has is part of what is known of it (:class:`MethodInfo`).

    - ``method``: a :class:`Method`; a name in :data:`multicell.integrators.registry.METHODS`, a
      variant of one, or in :data:`multicell.comparison.null_methods.NULL_METHODS`, or
      ``"file.py:Name"``; a class; or an integrator, of which all but the tolerance or step stays
      as it is. What takes neither is compared as it is.
    - ``scene``: its ``integrator.max_displacement`` holds for all methods

    Raises SceneError if there is no such method.
    """
    if isinstance(method, Method):
        return method
    known = NULL_METHODS.get(method) if isinstance(method, str) else None
    info = known or method_info(method, "methods")
    allowed = scene.integrator.max_displacement
    limits: dict[str, Any] = {"max_displacement": allowed, "max_steps": _MAX_STEPS}

    def by_tolerance(tolerance: float) -> Integrator:
        rtol = max(0.01 * tolerance, SMALLEST_TOLERANCE)
        return build_method(info, rtol=rtol, atol=tolerance * radius, **limits)

    def by_step(dt: float) -> Integrator:
        # an implicit one solves its equations far more exactly than its step is exact
        return build_method(info, step=dt, atol=_SOLVED * radius, **limits)

    if ("step" if info.control == "step" else "atol") not in info.settings:
        return Method(info.name, "none", lambda _: build_method(info, **limits), info)
    if info.control == "step":
        return Method(info.name, "step", by_step, info)
    return Method(info.name, "tolerance", by_tolerance, info)


def select_methods(methods: Sequence[Any] | str, scene: Scene, radius: float) -> list[Method]:
    """Return some methods, of which no two may have one name (see :func:`find_method`).

    A text has their names with commas between them.
    """
    if isinstance(methods, str):  # as the command line has them
        methods = [name.strip() for name in methods.split(",") if name.strip()]
    found = [find_method(method, scene, radius) for method in methods]
    if not found:
        raise ValueError("methods is empty: there is nothing to compare")
    for k, method in enumerate(found):
        if method.name in [other.name for other in found[:k]]:
            raise SceneError("methods", f"two methods are called {method.name!r}")
    return found


def capable_methods(scene: Scene) -> list[str]:
    """Return the names of all methods that can run a scene, judged by its start."""
    cells, friction = scene.initial.count, scene.friction is not None
    return [name for name, m in METHODS.items() if m.refusal(cells, friction=friction) is None]


def settings(
    method: Method, ladder: Ladder | None, problem: ReplayProblem, stiffness: float
) -> list[float]:
    """Return the settings of a method from coarse to fine.

    - ``ladder``: settings by name of the method, or by ``"tolerance"`` and ``"step"`` for all
      methods of a kind; None, or what it lacks, means the default
    - ``problem``: its coupling steps bound the steps
    - ``stiffness``: largest decay rate, 1/s (:func:`stiffness`): default steps start at eight over
      it, four times what Euler's method can take; those of implicit methods at the coupling step

    Raises SceneError for a setting that makes no sense.
    """
    given = None if ladder is None else ladder.get(method.name, ladder.get(method.control))
    if method.control == "none":
        return [math.nan]
    if given is None:
        if method.control == "tolerance":
            return list(LADDER_TOLERANCES)
        return _steps(problem, 0.0 if method.info.implicit else stiffness)
    path = f"ladder.{method.name if method.name in (ladder or {}) else method.control}"
    if len(given) == 0:
        raise SceneError(path, "is empty, must hold at least one value")
    lowest = SMALLEST_TOLERANCE if method.control == "tolerance" else 0.0
    for value in given:
        if not (math.isfinite(value) and value > 0.0 and value >= lowest):
            allowed = f"at least {lowest:g}" if lowest else "above 0 s"
            hint = "Double precision carries no more." if lowest and value > 0.0 else ""
            raise SceneError(path, f"is {value!r}, must be {allowed}", hint)
    return sorted(map(float, given), reverse=True)


def stiffness(problem: ReplayProblem, trajectory: Trajectory, samples: int = 40) -> float:
    """Return the largest bound on decay rates along a trajectory, 1/s.

    Taken at the beginnings of up to ``samples`` coupling steps, those after events first: a
    fresh division is stiffest.
    """
    system = problem.system()
    shocked = [k for k, step in enumerate(problem.steps) if k == 0 or step.before is not None]
    spread = np.linspace(0, len(problem.steps) - 1, samples).round().astype(int)
    chosen = [*shocked[:: -(-len(shocked) // samples)], *spread.tolist()]
    largest = 0.0
    for k in sorted(set(chosen)):
        motion = problem.steps[k].motion
        reached = problem.start if k == 0 else trajectory.positions[k - 1]
        system.begin(motion)
        bound = system.stiffness_bound(motion.begin, problem.beginning(k, reached))
        largest = max(largest, bound)
    return largest


def _steps(problem: ReplayProblem, stiffness: float) -> list[float]:
    """Return steps that halve, each a whole part of the longest coupling step."""
    length = max(step.motion.end - step.motion.begin for step in problem.steps)
    count = max(1, math.ceil(length * stiffness / (2.0 * _COARSEST)))
    return [length / (count * 2**k) for k in range(_HALVINGS)]


def weighted_cost(work: Work) -> float:
    """Return the cost of some work in evaluations of the right-hand side.

    Measured on JKR cells, 1,000 and 10,000 of them, in one thread: a linearisation takes as
    long as two evaluations, a Jacobian-vector product as 0.65.
    """
    return work.evaluations + 2.0 * work.linearisations + 0.65 * work.jacobian_products
