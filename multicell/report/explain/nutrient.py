"""Explanation of the nutrient fields of a scene: scales, regime, geometry, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from multicell.cells import SPHERE
from multicell.report.explain.items import ExplainedPart, Number, hours, part
from multicell.scene import domain as box
from multicell.scene import scales
from multicell.scene.dependences import solving_order
from multicell.scene.field_solvers import expected_step, expected_steps
from multicell.scene.initial_files import InitialFile
from multicell.scene.nutrient import OWN_SOLVERS, Nutrient
from multicell.scene.reactions import Reaction, group_of
from multicell.scene.responses import relevant_fields, type_thresholds
from multicell.scene.scene import Scene
from multicell.scene.sizes import typical_radius
from multicell.scene.steps import usual_coupling_step


def nutrient_parts(scene: Scene) -> list[ExplainedPart]:
    """Return the regime of each field, and why, in the order in which they are solved."""
    if not scene.nutrients:
        return [part("nutrients", "")]
    order = solving_order(scene.nutrients, scene.reactions)
    fields = [part(f"nutrients.{name}", _what(scene, name)) for name in order]
    known = scene.reactions.items()
    fields += [part("energy", _energy_words(scene))] if scene.energy is not None else []
    return fields + [part(f"reactions.{name}", _reaction_words(r)) for name, r in known]


def _energy_words(scene: Scene) -> str:
    energy = scene.energy
    assert energy is not None
    made = " + ".join(f"{gain:g} per {name}" for name, gain in (energy.yields or {}).items())
    words = f"ATP: {made} taken up"
    effects = {
        "growth at half its rate at": energy.growth_half_saturation,
        "rest below": energy.quiescence,
        "death below": energy.necrosis,
    }
    rates = [f"{what} {value:g} mM/s" for what, value in effects.items() if value is not None]
    return "; ".join([words, *rates])


def _reaction_words(reaction: Reaction) -> str:
    def side(amounts: Mapping[str, float] | None) -> str:
        words = [f"{n:g} {name}" if n > 1.0 else name for name, n in (amounts or {}).items()]
        return " + ".join(words) or "nothing"

    words = f"{side(reaction.consumes)} -> {side(reaction.produces)}"
    rate = f"mass action, {reaction.rate:g} {reaction.unit}"
    place = "" if reaction.where == "everywhere" else f", in {reaction.where}"
    return f"{words}: {rate}{place}"


def _what(scene: Scene, name: str) -> str:
    """Return one sentence on regime, geometry, medium and dependences of a field."""
    nutrient = scene.nutrients[name]
    regime = f"{scales.regime(scene, name)} ({_regime_reason(scene, name)})"
    parts = [regime, _geometry(scene, nutrient, scales.largest_spacing(scene, name))]
    parts.append(_medium(nutrient))
    if nutrient.initial_file is not None:
        parts.append(_beginning(nutrient.initial_file, name))
    if nutrient.solver not in OWN_SOLVERS:
        parts.append(_solver(scene, name))
    together = [other for other in group_of(name, scene.reactions) if other != name]
    if together:
        parts.append(f"solved together with {', '.join(together)}, with which it reacts")
    for other, law in nutrient.uptake_on.items():
        trend = "rises" if law.effect > 0.0 else "falls"
        parts.append(f"uptake {trend} where {other} is short of {law.half:g} mM")
    for other, share in (nutrient.secretion_from or {}).items():
        parts.append(f"{share:g} secreted for each {other} taken up")
    return "; ".join(parts)


def _solver(scene: Scene, name: str) -> str:
    """Return which solver of py-pde's a field takes, and how long its steps are."""
    solver, longest = scene.nutrients[name].solver, expected_step(scene, name)
    if not math.isfinite(longest):
        return f"solved by {solver}, which chooses its steps"
    number = f"{expected_steps(scene, name):,}"
    steady = scales.regime(scene, name) == "steady"
    many = f"about {number} until it rests" if steady else f"{number} a coupling step"
    most = f"steps of {longest:.2g} s, the most that diffusion and uptake allow"
    return f"solved by {solver} in {most}: {many}"


def _regime_reason(scene: Scene, name: str) -> str:
    nutrient = scene.nutrients[name]
    if nutrient.regime != "auto":
        return "as the scene says"
    if group_of(name, scene.reactions):
        return "it takes part in reactions"
    if not scales.level_fixed(nutrient, scene.dimensions, scales.repeating(scene)):
        return "nothing fixes its level"
    settles = hours(scales.scales(scene, name).time)
    within = scales.regime(scene, name) == "steady"
    word = "within" if within else "later than"
    return f"diffusion settles in {settles}, {word} a coupling step"


def _geometry(scene: Scene, nutrient: Nutrient, spacing: float) -> str:
    if scene.box is not None:
        lengths = box.sides(scene.box)
        counts = box.filling(lengths, spacing) or ()
        edge = lengths[0] / counts[0] if counts else spacing
        kind = "squares" if scene.dimensions == 2 else "cubes"
        words = f"{' x '.join(map(str, counts))} {kind} of {edge:g} um that stand still"
        finer = box.finer(lengths, spacing)
        return f"{words} on the domain" + (f" ({finer})" if finer else "")
    ends = ""
    if nutrient.margin_shape == "tissue":
        ends = f", with medium from {nutrient.margin:g} um beyond the nearest cell on"
    if scene.dimensions == 2:
        return f"squares of {spacing:g} um that follow the cells, since the scene is flat{ends}"
    if nutrient.layout == "box":
        return f"a grid of cubes of {spacing:g} um that follows the cells{ends}"
    words = f"spherical shells of {spacing:g} um that follow the cells"
    if nutrient.layout == "auto":
        return f"{words} while the tissue is round within 0.1, else a grid of cubes{ends}"
    layer = nutrient.layer
    return (
        f"{words}{ends}"
        if layer is None
        else f"{words}, in a layer of {layer:g} um round the tissue"
    )


def _medium(nutrient: Nutrient) -> str:
    finite = nutrient.finite_medium
    if finite is not None:
        words = f"{finite.volume:g} um^3 of medium that the cells use up, "
        words += f"{nutrient.medium(0.0):g} mM"
        changes = sum(time > 0.0 for time, _ in nutrient.media or ())
        return f"{words}, replaced {changes} time(s)" if changes else words
    if nutrient.media is None:
        return f"{nutrient.boundary:g} mM in the medium"
    values = [nutrient.boundary, *(value for _, value in nutrient.media)]
    return f"medium of {min(values):g} to {max(values):g} mM, changed {len(nutrient.media)} time(s)"


def _beginning(part: InitialFile, name: str) -> str:
    """Return the file, shape and range of the values at the start, in words."""
    values = part.grid(name).values
    shape = " x ".join(map(str, values.shape))
    low, high = (part.scale * float(value) for value in (values.min(), values.max()))
    return f"starts from {shape} values of {Path(part.file).name}, {low:.4g} to {high:.4g} mM"


def nutrient_numbers(scene: Scene) -> list[Number]:
    """Return the scales of every field."""
    return [n for name in scene.nutrients for n in _numbers(scene, name)]


def _numbers(scene: Scene, name: str) -> list[Number]:
    """Return the sizes and times at which a field matters.

    With the uptake q of full strength everywhere (zeroth order), a ball of radius R and surface
    concentration c has c - q R² / (6 D) at its centre, and a thick layer is fed to the depth
    √(2 D c / q).
    """
    nutrient, found = scene.nutrients[name], scales.scales(scene, name)
    step = usual_coupling_step(scene)
    numbers = [
        Number(
            f"{name}: diffusion time",
            found.time,
            "s",
            f"to settle over {found.length:.3g} um; a coupling step is {step:g} s",
        )
    ]
    if nutrient.finite_medium is not None and nutrient.takes_up:
        volume = SPHERE * typical_radius(scene) ** 3
        most = nutrient.largest_uptake(volume) * scene.initial.count
        lasts = nutrient.finite_medium.volume * nutrient.highest / most
        meaning = "until the cells of the start would have used up a finite medium at full uptake"
        numbers.append(Number(f"{name}: medium lasts", lasts, "s", meaning))
    if not (math.isfinite(found.depth) and found.depth > 0.0):
        return numbers
    critical = math.sqrt(3.0) * found.depth
    return [
        *numbers,
        Number(
            f"{name}: largest uptake",
            found.demand,
            "mM/s",
            "of tissue without gaps"
            if scene.dimensions == 3
            else f"of a layer without gaps, {scales.layer_height(scene, name):g} um high",
        ),
        Number(f"{name}: diffusion length", found.depth, "um", "the depth to which tissue is fed"),
        Number(f"{name}: starving radius", critical, "um", "of a ball starved at its centre"),
        Number(
            f"{name}: Damköhler number",
            found.damkohler,
            "",
            "uptake over diffusion at the largest size; above 6 a ball starves inside",
        ),
    ]


def nutrient_notes(scene: Scene) -> list[str]:
    """Return remarks on settings of fields that are allowed but may not be meant."""
    notes, step = [], usual_coupling_step(scene)
    for name, nutrient in scene.nutrients.items():
        rests = type_thresholds(scene, name, "quiescence")
        if nutrient.highest < min(rests.values(), default=0.0):
            notes.append(f"The medium has too little {name} for growth: all cells are quiescent.")
        if name not in relevant_fields(scene):
            hint = "give thresholds such as quiescence, or a response to it"
            notes.append(f"{name} has no effect on the cells: {hint}.")
        if nutrient.regime == "steady" and scales.scales(scene, name).time > step:
            notes.append(
                f"{name} settles in {hours(scales.scales(scene, name).time)}, later than a "
                "coupling step, but is solved as steady: regime = 'auto' would make it transient."
            )
    return notes
