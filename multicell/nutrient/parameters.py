"""Parameters of a field, out of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, final

from multicell.scene.scales import _faces, _side, largest_spacing, layer_height, regime

if TYPE_CHECKING:
    from multicell.nutrient.equations.substance import Schedule
    from multicell.nutrient.grid import Layout
    from multicell.scene.nutrient import Nutrient, Side
    from multicell.scene.parts import Domain
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True)
class FieldParameters:
    """Parameters of :class:`multicell.nutrient.field.NutrientField`.

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
            nutrient,
            largest_spacing(scene, name),
            layer_height(scene, name),
            regime(scene, name),
            scene.dimensions,
            scene.box,
        )

    @property
    def geometry(self) -> str:
        """``"box"``, ``"radial"`` or ``"auto"``; a box in two dimensions and in a domain."""
        fixed = self.dimensions == 2 or self.domain is not None
        return "box" if fixed else self.nutrient.layout

    @cached_property
    def open_medium(self) -> bool:
        """Whether stirred medium is all round: cells beyond the grid then find its concentration.

        Not so in a domain, with conditions of its own on a side, and with a finite medium.
        """
        nutrient = self.nutrient
        return self.domain is None and not nutrient.sides and nutrient.finite_medium is None

    @property
    def follows_tissue(self) -> bool:
        """Whether the medium begins at one distance from the tissue, and not where a grid ends."""
        return self.nutrient.margin_shape == "tissue"

    @cached_property
    def schedule(self) -> Schedule:
        """The medium over time, as the scene has it."""
        from multicell.nutrient.equations.substance import Schedule

        return Schedule.of(self.nutrient)

    def conditions(self, layout: Layout, level: float) -> dict[str, Any]:
        """Return the conditions on a layout's sides in py-pde's terms, the medium at ``level``."""
        key = layout.kind, level
        if key not in self._conditions:
            self._conditions.clear()
            faces = ("r+",) if layout.kind == "radial" else _faces(self.dimensions)
            found = {face: _condition(_side(self.nutrient, face), level) for face in faces}
            for axis in () if self.domain is None else self.domain.periodic:
                # no side; what stands here is not looked at
                found[axis + "-"] = found[axis + "+"] = {"derivative": 0.0}
            self._conditions[key] = found["r+"] if layout.kind == "radial" else found
        return self._conditions[key]

    @cached_property
    def _conditions(self) -> dict[tuple[str, float], dict[str, Any]]:
        """The last conditions that were asked for."""
        return {}


def _condition(side: Side, level: float) -> dict[str, float]:
    """Return the condition on a side in py-pde's terms, where the medium is at ``level`` (mM)."""
    if side.type == "derivative":
        return {"derivative": side.derivative or 0.0}
    return {"value": level if side.value is None else side.value}
