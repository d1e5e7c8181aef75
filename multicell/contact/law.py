"""The base class of pair laws between two elastic, sticky spheres.

Conventions (equation numbers of the thesis that the model page cites): the overlap is
``h = r_i + r_j - distance`` (3.1) and a positive force pushes the cells apart. Hertz and
approximate JKR are zero for ``h <= 0``; :class:`~multicell.contact.exact_jkr.ExactJKR` and the
springs of :mod:`multicell.contact.springs` may act beyond.

A law is written once, as a scalar function of bare floats that returns force, stiffness and
energy; its file holds that function, the declared parameters and the closed forms that are known.
The kernels compile the function (:mod:`multicell.mechanics.pairs`), the methods here call it as
it is for arrays of any shape. See :mod:`multicell.contact.constants` for its arguments.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from multicell.contact.constants import SHARED, function_of
from multicell.schema import specs

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.contact.scaled import ScaledAttraction
    from multicell.scene.scene import Scene


_NEAR_CONTACT = 1e-3  # overlap, µm


def compliance(young: ArrayLike, poisson: ArrayLike) -> FloatArray:
    """Return ¾ (1 - ν²) / E in 1/kPa: the sum over a pair is 1 / E_ij (eq. 3.3)."""
    return np.asarray(0.75 * (1.0 - np.square(poisson)) / np.asarray(young, dtype=float))


def effective_modulus(
    young_i: ArrayLike, poisson_i: ArrayLike, young_j: ArrayLike, poisson_j: ArrayLike
) -> FloatArray:
    """Return E_ij in kPa (eq. 3.3), which is 4/3 of the modulus E* of textbooks."""
    return np.asarray(1.0 / (compliance(young_i, poisson_i) + compliance(young_j, poisson_j)))


def effective_radius(radius_i: ArrayLike, radius_j: ArrayLike) -> FloatArray:
    """Return r_ij = r_i r_j / (r_i + r_j) in µm (eq. 3.4)."""
    ri, rj = np.asarray(radius_i, dtype=float), np.asarray(radius_j, dtype=float)
    return np.asarray(ri * rj / (ri + rj))


class PairLaw(ABC):
    """A pair law with its parameters; laws are frozen dataclasses.

    Shapes broadcast. Overlaps and lengths are in µm, ``modulus`` is E_ij in kPa (eq. 3.3),
    ``radius`` r_ij in µm (eq. 3.4). ``rest`` is r_i + r_j in µm, which only some laws need, and
    ``touching`` says whether the pair was in contact before, which only laws with a memory ask.

    A law declares its properties here; nobody else asks for its class or attributes.

    - ``surface_energy``: σ, nN/µm; zero for laws that have no parameter of this name
    - ``scales``: whether larger cells with parameters scaled by their dimensions follow the same
      law, F(f h, f r) = f² F
    - ``without_adhesion``: in words, what the law becomes where nothing attracts
    - ``acts``: whether cells act on each other at all; where not, there are no lists of pairs
    """

    surface_energy: float = 0.0
    scales: ClassVar[bool] = True
    without_adhesion: ClassVar[str] = ""
    acts: ClassVar[bool] = True
    _constants: ClassVar[Any]
    """Type of the constants of the law's function, made by ``constants_of``."""

    @property
    def is_sticky(self) -> bool:
        """Whether it has a surface energy, which may differ between the types of cells."""
        return "surface_energy" in specs(self)

    def for_pair(self, entry: float) -> Self:
        """Return the law of two types by their entry in a table: a surface energy, nN/µm.

        A law without a surface energy is returned as it is.
        """
        if not self.is_sticky:
            return self
        return replace(self, surface_energy=entry)  # type: ignore[type-var]

    def scaled_by_pairs(self) -> ScaledAttraction | None:
        """Return a law whose attraction is in proportion to a factor of each pair of types.

        None for a law that has a surface energy to scale, and for one that never attracts.
        """
        return None

    def check_scene(self, scene: Scene) -> None:
        """Raise ``SceneError`` where parameters of the law contradict other parts of a scene."""
        return

    def refuse_uncompilable(self) -> None:
        """Raise ``SceneError`` with file and line if numba cannot compile the law."""
        return

    def constants(self) -> Any:
        """Return the constants of the law's function: its parameters of the same names."""
        own = self._constants
        return own(*(float(getattr(self, name)) for name in own._fields[: -len(SHARED)]))

    @abstractmethod
    def describe(self, energy: str) -> str:
        """Return the law in words; ``energy`` states its surface energy."""

    def equilibrium_overlap(self, modulus: ArrayLike, radius: ArrayLike) -> FloatArray:
        """Return the overlap without force in µm; zero for laws that rest at first contact."""
        return np.zeros(np.broadcast_shapes(np.shape(modulus), np.shape(radius)))

    def reach(
        self, modulus: ArrayLike, radius: ArrayLike, *, rest: ArrayLike | None = None
    ) -> FloatArray:
        """Return how far beyond first contact the law can act, µm, at least zero.

        It never falls with ``radius`` and ``rest`` and never rises with ``modulus``, so that the
        extremes of a population bound it for all pairs.
        """
        return np.zeros(np.broadcast(modulus, radius).shape)

    def list_radius(self, radius: FloatArray, modulus: float) -> FloatArray:
        """Return half of the distance within which each cell matters to others, (n,) µm.

        Two cells act on each other only while they are closer than the sum of both.

        - ``radius``, (n,), µm: of the cells
        - ``modulus``, kPa: the least E_ij of a pair
        """
        largest = float(radius.max())
        reach = self.reach(modulus, 0.5 * largest, rest=2.0 * largest)
        return np.asarray(radius + 0.5 * float(reach))

    def contact_radius(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> FloatArray:
        """Return the radius of the contact disc in µm: √(r_ij h) in the Hertz picture."""
        return np.asarray(np.sqrt(np.maximum(overlap, 0.0) * np.asarray(radius, dtype=float)))

    def pair_memory(
        self, adhesion: ArrayLike, modulus: ArrayLike, radius: ArrayLike, touching: ArrayLike
    ) -> tuple[Any, Any]:
        """Return the law's unit of overlap in µm, and the overlap in it from which a pair acts.

        Called only for a law that ``remembers``. ``adhesion`` is √(6πσ_ij) of the pairs.
        """
        raise TypeError(f"{type(self).__name__} has no memory of contacts")

    @cached_property
    def adhesion(self) -> float:
        """√(6πσ) of the law's surface energy in (nN/µm)^½, zero for a law that has none."""
        return float(self.adhesion_of(self.surface_energy))

    @cached_property
    def snaps(self) -> bool:
        """Whether attraction sets in where two cells meet, so that they pull each other closer."""
        before, after = (
            float(self.force(h, 1.0, 2.5, rest=10.0)) for h in (-_NEAR_CONTACT, _NEAR_CONTACT)
        )
        return after < before

    def adhesion_of(self, surface_energy: ArrayLike) -> FloatArray:
        """Return √(6πσ) in (nN/µm)^½ of surface energies in nN/µm."""
        return np.asarray(np.sqrt(6.0 * np.pi * np.asarray(surface_energy, dtype=float)))

    def force(
        self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, **further: Any
    ) -> FloatArray:
        """Return the pair force in nN, positive where it pushes apart; see :meth:`evaluate`."""
        return self.evaluate(overlap, modulus, radius, **further)[0]

    def stiffness(
        self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, **further: Any
    ) -> FloatArray:
        """Return dF/dh in nN/µm; see :meth:`evaluate`."""
        return self.evaluate(overlap, modulus, radius, **further)[1]

    def energy(
        self, overlap: ArrayLike, modulus: ArrayLike, radius: ArrayLike, **further: Any
    ) -> FloatArray:
        """Return the pair energy in fJ: its slope dU/dh is the force; see :meth:`evaluate`."""
        return self.evaluate(overlap, modulus, radius, **further)[2]

    def evaluate(
        self,
        overlap: ArrayLike,
        modulus: ArrayLike,
        radius: ArrayLike,
        *,
        rest: ArrayLike | None = None,
        touching: ArrayLike = False,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return force (nN), stiffness (nN/µm) and energy (fJ) at once.

        The law's function is called as it is, once for each element.
        """
        constants = self.constants()
        function = function_of(constants)
        if rest is None and self.needs_rest:
            raise TypeError(f"{type(self).__name__} needs rest=..., the sum r_i + r_j in µm")
        further: dict[str, Any] = {"rest": np.nan if rest is None else rest}
        further["adhesion"] = self.adhesion
        if self.remembers:
            memory = self.pair_memory(self.adhesion, modulus, radius, touching)
            further |= zip(("unit", "onset"), memory, strict=True)

        def one(overlap: float, modulus: float, radius: float, *own: float) -> Any:
            return function.whole(overlap, modulus, radius, constants, *own)

        arrays = [overlap, modulus, radius, *(further[name] for name in function.further)]
        if {*map(type, arrays)} == {float}:  # of one pair: the machinery costs tenfold
            force, stiffness, energy = one(*map(float, arrays))
        else:
            columns = [np.asarray(column, dtype=float) for column in arrays]
            force, stiffness, energy = np.frompyfunc(one, len(columns), 3)(*columns)
        return _floats(force), _floats(stiffness), _floats(energy)

    @cached_property
    def remembers(self) -> bool:
        """Whether it matters if a pair was in contact before: the function asks for an onset."""
        return "onset" in function_of(self.constants()).further

    @property
    def needs_rest(self) -> bool:
        """Whether the law asks for the sum of the radii."""
        return "rest" in function_of(self.constants()).further


def _floats(values: Any) -> FloatArray:
    return np.asarray(values, dtype=float)
