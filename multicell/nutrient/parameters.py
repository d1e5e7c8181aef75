"""What a field is made from, out of a scene."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, final

from multicell.scene.scales import _faces, _side, height, regime, spacing

if TYPE_CHECKING:
    from multicell.nutrient.equations.schedule import Schedule
    from multicell.nutrient.grid import Layout
    from multicell.scene.nutrient import Nutrient, Side
    from multicell.scene.parts import Domain
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True)
class FieldParameters:
    """What :class:`multicell.nutrient.field.NutrientField` is made from.

    - ``nutrient``: the substance as the scene has it
    - ``spacing``, float, µm: largest spacing of the grid
    - ``height``, float, µm: of the layer in two dimensions
    - ``regime``: ``"steady"`` or ``"transient"``
    - ``dimensions``: 2 or 3
    - ``domain``: the box that the field lives on; None: it follows the cells
    """

    nutrient: Nutrient
    spacing: float
    height: float
    regime: str
    dimensions: int
    domain: Domain | None = None

    @classmethod
    def of(cls, scene: Scene, name: str) -> FieldParameters:
        """Return the parameters of a field of a scene."""
        nutrient = scene.nutrients[name]
        return cls(
            nutrient, spacing(scene, name), height(scene, name), regime(scene, name),
            scene.dimensions, scene.box,
        )  # fmt: skip

    @property
    def geometry(self) -> str:
        """``"box"``, ``"radial"`` or ``"auto"``; a box in two dimensions and in a domain."""
        fixed = self.dimensions == 2 or self.domain is not None
        return "box" if fixed else self.nutrient.layout

    @cached_property
    def open_medium(self) -> bool:
        """Whether stirred medium is all round: cells beyond the grid then find its concentration.

        Not so in a domain, with conditions of its own on a side, with sources or regions that
        stand somewhere, and where a finite medium has an unstirred layer of its own.
        """
        nutrient = self.nutrient
        shaped = nutrient.sides or nutrient.sources or nutrient.regions
        return self.domain is None and not shaped and nutrient.finite_medium is None

    @cached_property
    def schedule(self) -> Schedule:
        """The medium over time, as the scene has it."""
        from multicell.nutrient.equations.schedule import Schedule

        return Schedule.of(self.nutrient)

    def sides(self, medium: float) -> dict[str, Side]:
        """Return the condition on every face, with the medium's value (mM) filled in."""
        return {
            face: side if side.type == "derivative" or side.value is not None else _at(side, medium)
            for face, side in self._faces.items()
        }

    def conditions(self, layout: Layout, level: float) -> dict[str, Any]:
        """Return the conditions on a layout's sides in py-pde's terms, the medium at ``level``."""
        key = layout.kind, level
        if key not in self._conditions:
            self._conditions.clear()
            self._conditions[key] = layout.conditions(self.sides(level))
        return self._conditions[key]

    @cached_property
    def _conditions(self) -> dict[tuple[str, float], dict[str, Any]]:
        """The last conditions that were asked for."""
        return {}

    @cached_property
    def _faces(self) -> dict[str, Side]:
        """The conditions as the scene has them."""
        return {face: _side(self.nutrient, face) for face in ("r+", *_faces(self.dimensions))}


def _at(side: Side, medium: float) -> Side:
    """Return a side with the value of the medium, which no bounds of scene files hold any more."""
    made = copy(side)
    object.__setattr__(made, "value", medium)
    return made
