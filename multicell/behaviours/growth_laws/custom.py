"""Laws of growth of the user's own: a Python function of the volume becomes a law.

>>> import multicell as mc
>>> @mc.growth_law(parameters={"exponent": ""})
... def power(volume, p):
...     return volume**p.exponent
>>> law = power(exponent=0.75)
>>> round(float(law.volume_after(1.0, 1.0)), 9)
2.0
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from multicell.behaviours.growth_laws.laws import GROWTH_LAWS, GrowthLaw
from multicell.errors import SceneError
from multicell.plugins.laws import OwnLaw
from multicell.plugins.named import own_code
from multicell.plugins.user_laws import law_of, refuse_names

if TYPE_CHECKING:
    from multicell.cells import FloatArray

    Rate = Callable[[FloatArray, Any], Any]

# Gauss-Legendre nodes of a time to a volume: exact for polynomials of degree 39
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)
_PLACES: Final = 65  # volumes from birth to division at which the sign of a rate is looked at
_SUBSTEPS: Final = 8  # Runge–Kutta steps that find a first guess of a volume
_CORRECTIONS: Final = 3  # Newton steps that bring the guess to rounding


class UserGrowthLaw(OwnLaw, GrowthLaw):
    """A law made by :func:`growth_law`; its parameters are the fields of the dataclass.

    The rate is scaled so that the volume doubles in a cycle. Shares of a cycle are found by
    Gauss–Legendre integration of 1/g, volumes as the root of their share.
    """

    _function: ClassVar[Callable[..., Any]]

    def check(self) -> None:
        """Raise ``SceneError`` for parameters with which no cell comes from birth to division."""
        volume = np.linspace(1.0, 2.0, _PLACES)
        rate = self._shape(volume)
        poor = np.flatnonzero(~(np.isfinite(rate) & (rate > 0.0)))
        if poor.size:
            at = f"at {volume[poor[0]]:g} times the volume at birth"
            problem = f"make the rate of growth {rate[poor[0]]:g} {at}, must be above zero up to 2"
            raise SceneError("", problem, "A cell never reaches the division volume otherwise.")

    def rate(self, volume: FloatArray, birth: float | FloatArray = 1.0) -> FloatArray:
        """Return g(V) T."""
        return np.asarray(birth * self._cycle() * self._shape(np.asarray(volume) / birth))

    def volume_after(
        self, volume: FloatArray, share: FloatArray, birth: float | FloatArray = 1.0
    ) -> FloatArray:
        """Return the volumes after a share of a cycle without limits, (n,)."""
        begin, given = np.broadcast_arrays(np.asarray(volume, dtype=float) / birth, share)
        after, dt = begin, given * (self._cycle() / _SUBSTEPS)
        for _ in range(_SUBSTEPS):
            first = self._shape(after)
            second = self._shape(after + 0.5 * dt * first)
            third = self._shape(after + 0.5 * dt * second)
            fourth = self._shape(after + dt * third)
            after = after + dt / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        for _ in range(_CORRECTIONS):
            missing = given * self._cycle() - self._time(begin, after)
            after = after + missing * self._shape(after)
        return np.asarray(birth * after)

    def share_at(self, ratio: FloatArray) -> FloatArray:
        """Return the share of a cycle from birth to a volume, (n,)."""
        ratio = np.asarray(ratio, dtype=float)
        return np.asarray(self._time(np.ones_like(ratio), ratio) / self._cycle())

    def _cycle(self) -> float:
        """Return how long growth from birth to division takes by the user's function."""
        return float(self._time(np.array(1.0), np.array(2.0)))

    def _time(self, begin: FloatArray, end: FloatArray) -> FloatArray:
        """Return ∫ dV/g from one volume to another, (n,)."""
        middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
        points = middle[..., None] + half[..., None] * _NODES
        return np.asarray(half * (_WEIGHTS / self._shape(points)).sum(axis=-1))

    def _shape(self, ratio: FloatArray) -> FloatArray:
        """Call the user's function and return its values as an array of the argument's shape."""
        with own_code("growth.law"):
            found = type(self)._function(ratio, self)
            return np.broadcast_to(np.asarray(found, dtype=float), ratio.shape)


def growth_law(*, parameters: Mapping[str, Any]) -> Callable[[Rate], type[UserGrowthLaw]]:
    """Make a law of growth of a function that returns how fast a cell of a volume grows.

    The function is called as ``rate(volume, p)``: ``volume`` is an array of volumes over that at
    birth, so that cells divide at 2, and ``p`` has the parameters as attributes. It returns an
    array of rates above zero, in any unit: they are scaled so that a cell that nothing limits
    doubles its volume in its cycle time.

    Parameters
    ----------
    parameters
        Name -> ``""`` for each parameter, all numbers without unit; or a declaration of
        :mod:`multicell.schema` such as ``number(default=0.75, above=0.0)``.

    Returns
    -------
    A class of laws: ``scene.with_changes({"growth.law": law(exponent=0.75)})`` takes one of them.
    :func:`multicell.testing.check_growth_law` reports broken promises.

    Raises
    ------
    TypeError
        For a function without these arguments, or a parameter whose name is taken.
    SceneError
        When a law is made with a value that is refused.
    """

    def make(rate: Rate) -> type[UserGrowthLaw]:
        refuse_names(UserGrowthLaw, parameters)
        if list(signature(rate).parameters) != ["volume", "p"]:
            raise TypeError(f"{rate.__qualname__!r} must have the arguments volume, p")
        own = {"_function": staticmethod(rate)}
        return law_of(UserGrowthLaw, rate, parameters, GROWTH_LAWS, [rate], own)

    return make
