"""Cost of a coupling step by each method: a model of counted work, which a run corrects.

With m accuracy steps of a method, z = λΔt, and the motion W of the step, the root mean square of
the velocities at its beginning times its length, in tolerances,

    m = steps (1 + onset W)^power (1 + z / 100)^-relief (n / 100)^cells

of n cells, and the counted work, in passes over all cells (:attr:`.motion.Work.effort`), is

    start + √(m² + (rate z)²)                 of methods whose steps are limited by stability
    start + √(m² + rate (1 + m / 3) z)        of a stabilised one, whose stages grow as √z
    start + m (1 + rate (z / m)^growth)       of implicit ones, by products in each step

A pass costs ``cell`` + ``call`` / n of a compiled evaluation, ``python`` in place of ``call`` where
evaluations go through Python. The numbers are in ``costs.toml``, measured by the program that is
named there.

A run corrects the model by what its coupling steps have counted: the running mean of log(counted /
expected) of each method (``gain``), in which a step that was dearer than expected by one method is
taken to be dearer by the others, too (``alike``). One that was more than twice as dear is learnt at
once, so that it is not taken again for want of lessons.
"""

from __future__ import annotations

import math
from functools import cache
from importlib import resources
from typing import Any, Final, NamedTuple, final

_SURE: Final = 2.5
"""Largest |log(counted / expected)| that is learnt from one step: one that jams says little."""
_SURPRISE: Final = 0.7
"""Log(counted / expected) from which on a dear step is learnt at once."""
_SHARED: Final = (0.8, 0.6)
"""Part of that which other methods get: after an explicit method, and after an implicit one, of
which only the solves may have jammed."""
_NEAR: Final = 2.0
"""Factor by which the motion may differ from the last that was seen."""
_FORGETS: Final = 8.0
"""Coupling steps after which it may differ by the square of that."""

FAINTEST: Final = 64.0
"""Times of forgetting after which nothing is known any more: powers of it stay numbers."""
LOOK: Final = -1.0
"""In place of steps to hold: the next one is judged by its motion, whatever is known."""


@cache
def constants() -> dict[str, Any]:
    """Return the measured constants; each method has a table."""
    import tomllib

    text = resources.files("multicell.integrators").joinpath("costs.toml").read_text("utf-8")
    return tomllib.loads(text)


@final
class CouplingStep(NamedTuple):
    """Properties of a coupling step from which its cost follows.

    - ``stiffness``: λ times its length
    - ``motion``, µm: root mean square of the velocities at its beginning, times its length
    - ``tolerance``, µm
    - ``cells``: number of cells
    - ``python``: whether evaluations go through Python
    """

    stiffness: float
    motion: float
    tolerance: float
    cells: int
    python: bool

    def work(self, name: str, finer: float = 1.0) -> float:
        """Return the passes over all cells that a method is expected to take.

        - ``finer``: part of the tolerance that the method is given
        """
        c = constants()[name]
        z = max(self.stiffness, 1e-6)
        motion = self.motion / (self.tolerance * finer)
        m = c["steps"] * (1.0 + c["onset"] * motion) ** c["power"]
        m *= (0.01 * self.cells) ** c["cells"] / (1.0 + 0.01 * z) ** c["relief"]
        rate, start = c["rate"], c["start"]
        if c["kind"] == "stability":
            return float(start + math.hypot(m, rate * z))
        if c["kind"] == "stabilised":
            return float(start + math.sqrt(m * m + rate * (1.0 + m / 3.0) * z))
        return float(start + m * (1.0 + rate * (z / m) ** c["growth"]))

    def unit(self, name: str) -> float:
        """Return the cost of a pass by a method, over a compiled evaluation of all cells."""
        c = constants()[name]
        return float(c["cell"] + c["python" if self.python else "call"] / self.cells)


@final
class Learnt(NamedTuple):
    """Lessons of the coupling steps so far; all entries are floats, as frames store them.

    - ``ratio``: λ as last measured over its order of magnitude, 0 before
    - ``age``: coupling steps since then
    - ``speed``, µm/s: root mean square of the velocities as last seen, 0 before
    - ``seen``: coupling steps since then
    - ``saved``: cost of the coupling steps since the second choice was last tried, in evaluations
    - ``steps``: how many these were
    - ``begin``, ``end``, s, ``atol``, µm, ``taken``, ``finer``, ``stiffness``: the last coupling
      step, the number of the method that it was given to, the part of the tolerance, and λΔt
    - ``hold``: how many of the next ones are left to that method; :data:`LOOK` where the next one
      is to be judged by its motion
    - ``limit``: passes above which they are not
    - ``first`` to ``fifth``: log(counted / expected) of each method
    """

    ratio: float = 0.0
    age: float = 0.0
    speed: float = 0.0
    seen: float = 0.0
    saved: float = 0.0
    steps: float = 0.0
    begin: float = -1.0
    end: float = -1.0
    atol: float = 0.0
    taken: float = 0.0
    finer: float = 1.0
    stiffness: float = 0.0
    hold: float = 0.0
    limit: float = 0.0
    first: float = 0.0
    second: float = 0.0
    third: float = 0.0
    fourth: float = 0.0
    fifth: float = 0.0

    def of(self, begin: float, end: float, atol: float) -> bool:
        """Return whether the last coupling step was this one."""
        return self.begin == begin and self.end == end and self.atol == atol

    def holds(self, begin: float, end: float, atol: float) -> bool:
        """Return whether a coupling step is left to the method of the last one, if it is alike."""
        length = self.end - self.begin
        same = abs(end - begin - length) <= 1e-6 * length
        return self.hold > 0.0 and same and self.atol == atol

    @property
    def excess(self) -> tuple[float, ...]:
        """Log(counted / expected) of each method."""
        return self[-5:]

    def motions(self, length: float) -> tuple[float, float] | None:
        """Return the motion in a coupling step as last seen, and at most, µm; or None."""
        near = _NEAR ** (1.0 + min(self.seen / _FORGETS, FAINTEST))
        return (self.speed * length, self.speed * length * near) if self.speed else None

    def counted(self, method: int, counted: float, expected: float, *, implicit: bool) -> Learnt:
        """Return it after a coupling step by a method, given by its number.

        - ``counted``, ``expected``: its passes, the latter without correction
        - ``implicit``: whether the method is
        """
        known = constants()
        found = max(-_SURE, min(_SURE, math.log(max(counted, 1.0) / expected)))
        change, alike = found - self.excess[method], known["alike"]
        if change > _SURPRISE:
            alike = _SHARED[implicit]
        else:
            change *= known["gain"]
        excess = [
            x + (change if k == method else alike * change) for k, x in enumerate(self.excess)
        ]
        return Learnt(*self[:-5], *excess)
