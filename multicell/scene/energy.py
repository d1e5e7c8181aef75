"""ATP made from the fields that cells take up, and states of cells that make too little."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import SceneError
from multicell.scene.checks import FIELD_HINT, check_names
from multicell.scene.nutrient import Nutrient, check_order
from multicell.schema import parameters, quantities, quantity

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_rate = partial(quantity, "mM/s", default=None, above=0, at_most=1e6)


@final
@parameters
class Energy:
    """ATP that a proliferating cell makes at a place, for each volume of it (mM/s).

    It is P = Σ yield_f q_f(c) over the fields of ``yields``, with the uptake q_f per volume at the
    concentrations there. So one substance may stand in for another. A resting or dead cell is
    judged by what a proliferating one would make in its place, whatever its type.
    """

    yields: Mapping[str, float] | None = quantities(
        "", at_least=0, at_most=1e3, doc="ATP made for each molecule taken up, by field"
    )
    growth_half_saturation: float | None = _rate(
        doc="ATP made at half the largest growth (Monod); absent: no effect"
    )
    quiescence: float | None = _rate(doc="ATP made, below: quiescent; absent: never")
    necrosis: float | None = _rate(doc="ATP made, below: necrotic; absent: never")

    def fields(self, nutrients: Mapping[str, Nutrient]) -> set[str]:
        """Return the names of the fields that ATP depends on, out of those of the scene.

        They are those of ``yields``, and those that the uptake of these depends on.
        """
        used = self.yields or {}
        return {*used, *(other for name in used for other in nutrients[name].uptake_on)}

    def supply(
        self,
        nutrients: Mapping[str, Nutrient],
        concentrations: Mapping[str, NDArray[np.float64]],
    ) -> NDArray[np.float64]:
        """Return the ATP made at places with these concentrations.

        - ``nutrients``: the fields of the scene
        - ``concentrations``, name -> (n,), mM

        Returns (n,) mM/s.
        """
        made = np.zeros(())
        for name, gain in (self.yields or {}).items():
            field, c = nutrients[name], np.asarray(concentrations[name])
            rate = gain * (field.uptake_per_volume or 0.0) * c / (field.half_saturation + c)
            for other, law in field.uptake_on.items():
                rate = rate * law.factor(np.asarray(concentrations[other]))
            made = made + rate
        return np.asarray(made)


def check_energy(scene: Scene) -> None:
    """Raise ``SceneError`` for energy that is made of nothing, has no effect, or fits no field.

    ATP is made per volume, and so must be what it is made from.
    """
    energy = scene.energy
    if energy is None:
        return
    check_names(energy.yields, scene.nutrients, "energy.yields", FIELD_HINT)
    for name in energy.yields or ():
        if scene.nutrients[name].uptake_per_volume is None:
            problem = "is a field whose uptake is that of a cell, not of a volume"
            hint = f"Give nutrients.{name}.uptake_per_volume in place of uptake."
            raise SceneError(f"energy.yields.{name}", problem, hint)
    if not any((energy.yields or {}).values()):
        hint = "yields = { oxygen = 5, glucose = 2 }, for example."
        raise SceneError("energy.yields", "name no field from which ATP is made", hint)
    rest, death = energy.quiescence, energy.necrosis
    if rest is None and death is None and energy.growth_half_saturation is None:
        hint = "Give growth_half_saturation, quiescence or necrosis."
        raise SceneError("energy.necrosis", "is missing: energy has no effect on the cells", hint)
    check_order(death, rest, "mM/s", "energy.necrosis")
