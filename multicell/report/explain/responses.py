"""The responses of a scene in sentences."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from multicell.behaviours.catalogue import behaviour_named, signal_unit
from multicell.behaviours.laws import Constant, Hill, Linear, Monod, Table, Threshold
from multicell.report.explain.items import Part
from multicell.scene.responses import Effect, effects

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


def response_parts(scene: Scene) -> list[Part]:
    """Return each response of a scene that is no short form, with its sentence."""
    return [
        Part(effect.key, True, sentence(scene, effect))
        for effect in (effects(scene) if scene.responses else ())
        if not effect.short
    ]


def sentence(scene: Scene, effect: Effect) -> str:
    """Return a response as a sentence with its numbers."""
    behaviour = behaviour_named(effect.behaviour, "")[0]
    whose = f" of {' and '.join(effect.types)} cells" if effect.types else ""
    what = f"the {effect.behaviour}{whose}"
    if behaviour.is_factor and not isinstance(effect.law, Table):
        what += ", as a factor,"

    def value(number: float) -> str:
        return "death at once" if math.isinf(number) else _amount(number, behaviour.unit)

    signal = " and ".join(effect.signals)
    law, end = _law_words(scene, effect), f"{value(effect.low)} to {value(effect.high)}"
    if isinstance(effect.law, Constant):
        return f"{what} is {value(effect.high)}"
    if isinstance(effect.law, Table):
        return f"{what} follows a table over {signal}: {law}"
    if effect.falls:
        end = f"{value(effect.high)} to {value(effect.low)}"
    return f"as {signal} rises, {what} goes from {end} ({law})"


def _law_words(scene: Scene, effect: Effect) -> str:
    law = effect.law
    known = len(effect.signals) == 1
    unit = signal_unit(effect.signals[0], scene.nutrients, scene.signals, "") if known else ""
    if isinstance(law, Threshold):
        return f"at once at {_amount(law.half, unit)}"
    if isinstance(law, Hill):
        return f"half way at {_amount(law.half, unit)}, Hill's exponent {law.power:g}"
    if isinstance(law, Monod):
        return f"half way at {_amount(law.half, unit)}"
    if isinstance(law, Linear):
        return f"in a line from {_amount(law.begin, unit)} to {_amount(law.end, unit)}"
    if isinstance(law, Table):
        return ", ".join(f"{y:.4g} at {_amount(x, unit)}" for x, y in law.points)
    return f"by {type(law).__name__}"


def _amount(number: float, unit: str) -> str:
    """Return a number with its unit, rates per hour."""
    if unit == "1/s":
        return f"{3600.0 * number:.4g} 1/h"
    return f"{number:.4g} {unit}".strip()
