"""The protocol of all integrators, what they hand back, and what is known of each method.

A method of the user's own is a class with :meth:`Integrator.integrate`, most simply a frozen
dataclass:

>>> @dataclass(frozen=True)
... class Midpoint:
...     step: float
...     info: ClassVar = MethodInfo("midpoint", "explicit midpoint rule", order=2, stable=2.0)
...
...     def integrate(self, system, position): ...

Constructor arguments called ``step``, ``rtol``, ``atol``, ``max_steps`` and ``max_displacement``
are filled from the scene's ``[integrator]`` where the class is named on the command line. ``info``
may be left out. :func:`multicell.testing.check_integrator` checks whether a method keeps the
promises that the rest of the package relies on.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Protocol, final

from multicell.errors import SceneError

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.mechanics.system import Mechanics

Control = Literal["tolerance", "step"]


@final
@dataclass(frozen=True)
class Outcome:
    """Result of an integration.

    Attributes
    ----------
    time : float
        Time reached, s.
    position : (n, 3)
        Positions at that time, µm.
    problem : str
        Why it stopped early, in words; empty if it reached the end.
    hint : str
        What to try then.
    cell : int or None
        Index of the cell that shows the problem most.
    """

    time: float
    position: FloatArray
    problem: str = ""
    hint: str = ""
    cell: int | None = None

    @property
    def done(self) -> bool:
        """Whether the end of the interval was reached."""
        return not self.problem


class Integrator(Protocol):
    """A method that carries positions over one coupling step.

    Implementations are frozen dataclasses that carry nothing from one coupling step to the next.
    They may define ``info``, a :class:`MethodInfo`.
    """

    def integrate(self, system: Mechanics, position: FloatArray) -> Outcome:
        """Integrate from ``system.motion.begin`` to ``system.motion.end``.

        Parameters
        ----------
        system
            Made ready for the coupling step. ``system.velocity(time, position, out)`` writes
            dx/dt, (n, 3) µm/s; ``system.linearise(time, position)`` and then
            ``system.jacobian_product(vector, out)`` write J v. Evaluations are counted there;
            the method adds its accepted and refused steps to ``system.work.steps`` and
            ``system.work.rejections``.
        position
            (n, 3) µm at the beginning; it must be left as it is.

            Cells whose motion is prescribed stand still to a method: their velocity is zero, and
            where it leaves them does not count.

        Returns
        -------
        Outcome
            With ``time`` equal to ``system.motion.end``, or with ``problem`` set. The exception
            :class:`~multicell.mechanics.motion.StateRejected`, which evaluations raise at states
            without meaning, must become such a problem.
        """


@dataclass(frozen=True)
class EqualSteps:
    """Options of the methods with a fixed step; abstract.

    - ``step``: largest step, s; a coupling step is cut into equal steps no longer than this
    - ``max_displacement``: fraction of its radius that a cell may move in one step. The step is
      fixed, so a cell that would move further ends the integration.
    """

    step: float
    max_displacement: float = 0.5


USUAL_ATOL = 0.1  # absolute tolerance of methods whose worst cell is safe with it, µm
OUT_OF_STEPS_HINT = "Raise integrator.max_steps, loosen integrator.atol or shorten coupling_step"


def move_words(dt: float, moved: float, allowed: float) -> str:
    """Return the words for a step, s, that would move a cell too far, both in its radius."""
    return (
        f"a step of {dt:.3g} s would move the cell by {moved:.3g} of its radius "
        f"(allowed: {allowed:g})"
    )


def count_equal_steps(length: float, longest: float) -> int:
    """Return how many equal steps no longer than ``longest`` make up an interval; both in s."""
    return max(1, math.ceil(length / longest * (1.0 - 1e-12)))


@dataclass(frozen=True)
class ErrorControl:
    """Options of the methods under error control; abstract.

    - ``rtol``, ``atol``: relative tolerance, and absolute tolerance in µm, by default
      :attr:`MethodInfo.atol` of the method
    - ``max_steps``: largest number of steps in a coupling step
    - ``max_displacement``: fraction of its radius that a cell may move in one step; a step that
      moves a cell further is refused and tried shorter

    Raises ValueError for a negative ``rtol``, or an ``atol`` that is not positive.
    """

    rtol: float = 1e-6
    atol: float = USUAL_ATOL
    max_steps: int = 10_000
    max_displacement: float = 0.5

    def __post_init__(self) -> None:
        if not (self.rtol >= 0.0 and self.atol > 0.0):
            raise ValueError(
                f"rtol is {self.rtol} and atol {self.atol}, must be 0 or above, and above 0"
            )


@final
@dataclass(frozen=True)
class MethodInfo:
    """Properties of a method that the rest of the package uses.

    Attributes
    ----------
    name : str
        Name in scenes, tables and charts.
    words : str
        What it is, in one line.
    control : "tolerance" or "step" or ""
        Whether its accuracy is set by a tolerance or by the length of its equal steps; empty: a
        step if the constructor takes one, else a tolerance.
    order : int or None
        Formal order; None where it varies.
    implicit : bool
        Whether it solves equations in each step.
    stable : float
        Largest stable step times the largest decay rate, on the negative real axis; infinite for
        implicit methods, NaN where error control finds the limit or nothing is known.
    remembers : bool
        Whether a step depends on those before it in the coupling step.
    colour, marker : str
        Looks in charts, as matplotlib names them; an empty colour is chosen by the chart.
    outside : bool
        Whether it is an outside reference, drawn with a broken line.
    friction : bool
        Whether it can solve scenes with friction between cells, where J is a full matrix.
    atol : float, µm
        Absolute tolerance where a scene, or a caller of the class, names none: a class with another
        one than usual has ``atol: float = info.atol``. ``docs/programs/tolerances.py`` measures its
        effect on single cells.
    most_cells : int or None
        Most cells that it holds; None for any number.
    why_no_more : str
        Why it holds no more.
    make : callable or None
        Makes the integrator; called with those of ``step``, ``rtol``, ``atol``, ``max_steps`` and
        ``max_displacement`` that it takes. None: the class that this belongs to.
    variant : callable or None
        Number in a name such as ``"rkc2-5"`` -> what is known of that variant, None if there is
        none.
    meant : tuple of str
        Words by which others know it, for the hint of an error.
    source : str
        Key of the paper that a methods section cites for it (:mod:`multicell.report.citation`).
    """

    name: str
    words: str = "a method of the user's own"
    control: Control | Literal[""] = ""
    order: int | None = None
    implicit: bool = False
    stable: float = math.nan
    remembers: bool = False
    colour: str = ""
    marker: str = "h"
    outside: bool = False
    friction: bool = True
    atol: float = USUAL_ATOL
    most_cells: int | None = None
    why_no_more: str = ""
    make: Callable[..., Integrator] | None = None
    variant: Callable[[int], MethodInfo | None] | None = None
    meant: tuple[str, ...] = ()
    source: str = ""

    @property
    def settings(self) -> set[str]:
        """Names of the method's settings."""
        return set() if self.make is None else set(inspect.signature(self.make).parameters)

    def refusal(self, cells: int, *, friction: bool) -> tuple[str, str] | None:
        """Return why the method cannot run a scene, and a hint, or None if it can."""
        if friction and not self.friction:
            return (
                f"is {self.name!r}, which needs the Jacobian as a sparse matrix; friction between "
                "cells makes it a full one",
                "Choose 'cvode', or leave the friction out",
            )
        if self.most_cells is not None and cells > self.most_cells:
            return (
                f"is {self.name!r}, which holds at most {self.most_cells} cells, not {cells}: "
                f"{self.why_no_more}",
                "Choose 'cvode'",
            )
        return None


def hold(info: MethodInfo, system: Mechanics) -> None:
    """Raise ``SceneError`` if a method cannot hold the cells of a system."""
    refused = info.refusal(len(system), friction=max(system.friction) > 0.0)
    if refused is not None:
        raise SceneError("integrator.method", *refused)


def info_of(method: Any) -> MethodInfo:
    """Return the information on a method: a class, an integrator, or the information itself.

    A class without ``info`` is known by its name and the first line of its docstring. What an
    integrator is made with again is what it was made with.
    """
    if isinstance(method, MethodInfo):
        return method
    kind: Any = method if isinstance(method, type) else type(method)
    info = getattr(method, "info", None)
    if not isinstance(info, MethodInfo):
        # of a dataclass without docstring the first line is its signature
        line = (inspect.getdoc(kind) or "").partition("\n")[0].strip()
        own = line and not line.startswith(f"{kind.__name__}(")
        info = MethodInfo(kind.__name__, line if own else MethodInfo.words)
    if kind is not method:
        taken = [name for name in inspect.signature(kind).parameters if hasattr(method, name)]
        info = replace(info, make=partial(kind, **{name: getattr(method, name) for name in taken}))
    info = info if info.make else replace(info, make=kind)
    if info.control:
        return info
    return replace(info, control="step" if "step" in info.settings else "tolerance")


def build_method(info: MethodInfo, **options: Any) -> Integrator:
    """Return the integrator with those of the options that it takes.

    Raises SceneError if it cannot be made with them.
    """
    settings = info.settings
    made = {name: value for name, value in options.items() if name in settings}
    try:
        return info.make(**made)  # type: ignore[misc]
    except (TypeError, ValueError) as error:
        raise SceneError("integrator", f"{info.name!r} cannot be made: {error}") from error
