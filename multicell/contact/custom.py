"""Pair laws of the user's own: a Python function with declared parameters becomes a law.

>>> import multicell as mc
>>> @mc.pair_law(parameters={"stiffness": "nN/um"})
... def square(overlap, modulus, radius, p):
...     return p.stiffness * overlap * overlap / radius
>>> float(square(stiffness=2.0).force(0.5, 1.0, 2.5))
0.2
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature
from numbers import Real
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np
from numpy.typing import ArrayLike

from multicell.contact.constants import constants_of, further_arguments
from multicell.contact.derived import (
    Scalar,
    force_alone,
    rest_search,
    whole_law,
    with_arguments,
    without_energy,
)
from multicell.contact.law import PairLaw
from multicell.contact.registry import CONTACT_LAWS
from multicell.contact.scaled import ScaledAttraction
from multicell.errors import SceneError
from multicell.plugins.fingerprints import helpers_of
from multicell.plugins.laws import OwnLaw
from multicell.plugins.named import own_code
from multicell.plugins.user_laws import law_of, refuse_names
from multicell.schema import specs
from multicell.units import shown

if TYPE_CHECKING:
    from multicell.cells import FloatArray


_POINTS = 401  # overlaps at which a law is tried for a place of rest; steps of 1/400 of the range
_HIDDEN = ("force", "stiffness", "energy", "surface_energy")


class UserLaw(OwnLaw, PairLaw):
    """A law made by :func:`pair_law`; its parameters are the fields of the dataclass.

    A parameter named ``force``, ``stiffness`` or ``energy`` hides the method of that name;
    ``evaluate`` gives all three.
    """

    _reach: ClassVar[Scalar | None]
    _asks_rest: ClassVar[bool]
    _rest_overlap: ClassVar[Scalar]
    _parts: ClassVar[Mapping[str, Scalar]]
    scales: ClassVar[bool] = False

    def describe(self, energy: str) -> str:
        """Return the law in words: its name and its parameters."""
        given = {name: f"{getattr(self, name):g} {spec.unit}" for name, spec in specs(self).items()}
        if "surface_energy" in given:
            given["surface_energy"] = energy
        parts = [f"{name.replace('_', ' ')} {value.strip()}" for name, value in given.items()]
        return f"{self.source}, a law of your own: {', '.join(parts) or 'no parameters'}"

    def evaluate(self, *given: Any, **named: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return force (nN), stiffness (nN/µm) and energy (fJ) as :meth:`PairLaw.evaluate`."""
        with own_code("contact.law"):
            try:
                return super().evaluate(*given, **named)
            except TypeError as error:
                self._check_results(error)
                raise

    def _check_results(self, error: TypeError) -> None:
        """Raise ``SceneError`` from an error if a function of the law returns what is no number."""
        given = {"overlap": 0.1, "modulus": 1.0, "radius": 2.5, "rest": 10.0, "adhesion": 1.0}
        for what, part in self._parts.items():
            asked = {name: given.get(name, self.constants()) for name in signature(part).parameters}
            found = part(**asked)
            if not isinstance(found, Real):
                code = part.__code__
                place = f"'{code.co_filename}', line {code.co_firstlineno}"
                problem = f"{place}, '{part.__name__}' returns {shown(found)}"
                hint = f"The {what} is one number."
                raise SceneError("contact.law", problem, hint) from error

    def refuse_uncompilable(self) -> None:
        """Raise ``SceneError`` with file and line if numba cannot compile a function of the law."""
        from numba import njit, typeof, types
        from numba.extending import register_jitable

        for part in self._parts.values():
            for helper in helpers_of(part):
                register_jitable(helper)
            own = typeof(self.constants())  # type: ignore[no-untyped-call]
            names = signature(part).parameters
            given = tuple(own if name == "p" else types.float64 for name in names)
            with own_code("contact.law", part):
                made = njit(given)(part)
            kind = made.nopython_signatures[0].return_type
            if not isinstance(kind, types.Number | types.Boolean):
                code = part.__code__
                problem = f"'{code.co_filename}', line {code.co_firstlineno}, returns {kind}"
                hint = "NumPy's where gives an array: write 'a if condition else b' of numbers."
                raise SceneError("contact.law", f"{problem}, must return a number", hint)

    def scaled_by_pairs(self) -> ScaledAttraction | None:
        """Return a law whose attraction is in proportion to a factor of each pair of types."""
        return None if self.is_sticky else ScaledAttraction(self, self._rest_overlap)

    @property
    def needs_rest(self) -> bool:
        """Whether the law asks for the sum of the radii."""
        return self._asks_rest

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return how far beyond first contact the law acts, µm; zero where nothing was given.

        Without ``rest`` (µm) the two cells are alike, r_i + r_j = 4 r_ij.
        """
        if self._reach is None:
            return super().reach(modulus, radius)
        p, reach = self.constants(), self._reach
        length = 4.0 * np.asarray(radius, dtype=float) if rest is None else rest
        found = np.frompyfunc(lambda e, r, s: float(reach(e, r, s, p)), 3, 1)
        return np.asarray(found(modulus, radius, length), dtype=float)

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the largest overlap without force in µm by bisection, for two cells alike.

        Zero where nothing attracts.
        """
        found = np.frompyfunc(self._equilibrium, 2, 1)
        return np.asarray(found(modulus, radius), dtype=float)

    def _equilibrium(self, modulus: float, radius: float) -> float:
        rest = 4.0 * radius
        begin = -float(self.reach(modulus, radius, rest=rest))
        overlap = np.linspace(begin, rest, _POINTS)[1:-1]
        attracts = self.evaluate(overlap, modulus, radius, rest=rest)[0] < 0.0
        if not attracts.any():
            return 0.0
        last = int(np.flatnonzero(attracts)[-1])
        low, high = float(overlap[last]), float([*overlap, rest][last + 1])
        for _ in range(60):
            middle = 0.5 * (low + high)
            force = self.evaluate(middle, modulus, radius, rest=rest)[0]
            low, high = (middle, high) if force < 0.0 else (low, middle)
        return 0.5 * (low + high)


def pair_law(
    *,
    parameters: Mapping[str, Any],
    stiffness: Scalar | None = None,
    energy: Scalar | None = None,
    reach: Scalar | None = None,
) -> Callable[[Scalar], type[UserLaw]]:
    """Make a pair law of a function of bare floats that returns the force in nN.

    The function is called as ``force(overlap, modulus, radius, p)``, with ``rest`` or ``adhesion``
    or both after these if it has arguments of these names; see
    :mod:`multicell.contact.constants` for their meaning and units. ``p`` has the parameters as
    attributes, in base units. It is compiled: arithmetic on floats, :mod:`math` and other such
    functions are what it may use. It is called only where the law acts: for an overlap above
    zero, or above minus the reach.

    Parameters
    ----------
    parameters
        Name -> base unit of each parameter, ``""`` for a number without; or a declaration of
        :mod:`multicell.schema` such as ``quantity("nN/um", default=1.0, above=0.0)``. A parameter
        ``surface_energy`` in nN/µm may differ between cell types: the function then takes
        ``adhesion`` = √(6πσ) of the pair.
    stiffness, energy
        dF/dh in nN/µm and ∫F dh in fJ, called like the force. What is not given is derived: the
        stiffness by a central difference, the energy by Gauss–Legendre integration.
    reach
        ``reach(modulus, radius, rest, p)``: how far beyond first contact the law acts, µm. It
        must not fall with ``radius`` and ``rest`` nor rise with ``modulus``.

    Returns
    -------
    A class of laws: ``law(stiffness=2.0)`` is what a scene takes as ``contact``.

    Raises
    ------
    TypeError
        For a function without these arguments, or a parameter whose name is taken.
    SceneError
        When a law is made with a value that is refused.
    """

    def make(force: Scalar) -> type[UserLaw]:
        refuse_names(UserLaw, parameters, hidden=_HIDDEN)
        parts = {"force": force, "stiffness": stiffness, "energy": energy, "reach": reach}
        push = with_arguments(force)
        slope = None if stiffness is None else with_arguments(stiffness)
        work = None if energy is None else with_arguments(energy)
        whole = whole_law(push, slope, work, reach)
        constants = constants_of(
            whole,
            *parameters,
            without_energy=without_energy(push, slope, reach),
            force_alone=force_alone(push, reach),
        )
        own = {
            "_constants": constants,
            "_reach": None if reach is None else staticmethod(reach),
            "_rest_overlap": staticmethod(rest_search(push, reach)),
            "_parts": {name: part for name, part in parts.items() if part is not None},
            "_asks_rest": reach is not None or "rest" in further_arguments(force),
        }
        return law_of(UserLaw, force, parameters, CONTACT_LAWS, [whole], own)

    return make


@final
class Compiling:
    """A context that names the line of a user's law where numba cannot compile kernels with it."""

    def __init__(self, law: PairLaw) -> None:
        self._law = law

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        failed = kind is not None and kind.__module__.startswith("numba.")
        if failed:
            self._law.refuse_uncompilable()
