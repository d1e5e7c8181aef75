"""What a field is made from, out of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from multicell.scene.scales import _faces, _side, regime, spacing

if TYPE_CHECKING:
    from multicell.scene.nutrient import Nutrient, Side
    from multicell.scene.parts import Domain
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True)
class FieldParameters:
    """What :class:`multicell.nutrient.field.NutrientField` asks for, from a scene."""

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
        height = nutrient.height or 2.0 * scene.cells.division_radius
        return cls(
            nutrient, spacing(scene, name), height, regime(scene, name), scene.dimensions,
            scene.domain,
        )  # fmt: skip

    @property
    def diffusion(self) -> float:
        """Diffusion coefficient in tissue, µm²/s."""
        return self.nutrient.diffusion

    @property
    def diffusion_medium(self) -> float | None:
        """Diffusion coefficient outside tissue, µm²/s; None: as inside."""
        return self.nutrient.diffusion_medium

    @property
    def half_saturation(self) -> float:
        """Michaelis constant of uptake, mM."""
        return self.nutrient.half_saturation

    @property
    def margin(self) -> float:
        """Least distance from a cell's centre to the faces, µm."""
        return self.nutrient.margin

    @property
    def layer(self) -> float | None:
        """Distance of the shells' surface from the tissue's, µm; None: by the margin."""
        return self.nutrient.layer

    @property
    def decay(self) -> float:
        """Rate of decay, 1/s."""
        return self.nutrient.decay

    @property
    def perfusion(self) -> float:
        """Rate of exchange with the medium, 1/s."""
        return self.nutrient.perfusion

    @property
    def geometry(self) -> str:
        """``"box"``, ``"radial"`` or ``"auto"``; always a box in two dimensions."""
        return self.nutrient.geometry if self.dimensions == 3 else "box"

    @property
    def roundness_limit(self) -> float:
        """Departure from a ball up to which shells are enough."""
        return self.nutrient.roundness_limit

    @property
    def time_tolerance(self) -> float:
        """Error of a transient step over the concentration."""
        return self.nutrient.time_tolerance

    @property
    def initial(self) -> str:
        """Where a transient field starts from: ``"medium"`` or ``"steady"``."""
        return self.nutrient.initial

    @property
    def highest(self) -> float:
        """The highest concentration that medium and sides ever have, mM."""
        return self.nutrient.highest

    def medium(self, time: float) -> float:
        """Return the concentration of the medium at a time in s, mM."""
        return self.nutrient.medium(time)

    def switches(self, begin: float, end: float) -> list[float]:
        """Return the times strictly between two times at which the medium is changed, s."""
        return self.nutrient.switches(begin, end)

    def sides(self, time: float) -> dict[str, Side]:
        """Return the condition on every face at a time, with the medium's value filled in."""
        from dataclasses import replace

        medium = self.medium(time)
        faces = ("r+", *_faces(self.dimensions))
        found = {face: _side(self.nutrient, face) for face in faces}
        return {
            face: side
            if side.type == "derivative" or side.value is not None
            else replace(side, value=medium)
            for face, side in found.items()
        }
