"""Cells between which no force acts: they may share a place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, final

from multicell.contact.constants import constants_of
from multicell.contact.law import PairLaw
from multicell.errors import SceneError
from multicell.schema import parameters

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


def nothing(overlap: float, modulus: float, radius: float, p: Any) -> tuple[float, float, float]:
    """Return no force, stiffness and energy."""
    return 0.0, 0.0, 0.0


_BETWEEN_CELLS = ("adhesion", "friction", "compression", "pull")
"""Parts of a scene that mean something only where cells that touch act on each other."""


@final
@parameters
class NoContact(PairLaw):
    """No force between cells, and no pairs of cells: what does not push itself stays in place."""

    acts: ClassVar[bool] = False
    _constants: ClassVar[Any] = constants_of(nothing)

    def describe(self, energy: str) -> str:
        """Return the law in words."""
        return "none: cells do not act on each other and may share a place"

    def check_scene(self, scene: Scene) -> None:
        """Raise ``SceneError`` for parts of the scene that act where cells touch."""
        for name in _BETWEEN_CELLS:
            if getattr(scene, name) is not None:
                hint = f"Leave out {name}, or choose another contact.law."
                raise SceneError(name, "has no effect where contact.law = 'none'", hint)
