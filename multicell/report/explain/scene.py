"""Explanation of a scene: its parts, and the numbers that follow from it before a run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from multicell.behaviours.catalogue import behaviour_named, signal_unit
from multicell.biology.draws import malthusian_rate
from multicell.integrators.base import MethodInfo
from multicell.integrators.registry import METHODS
from multicell.report.explain.contact import contact_notes, contact_numbers, contact_parts
from multicell.report.explain.cost import Prediction, cost_notes, cost_numbers, predict
from multicell.report.explain.items import ExplainedPart, Number, hours, part
from multicell.report.explain.networks import network_words
from multicell.report.explain.nutrient import nutrient_notes, nutrient_numbers, nutrient_parts
from multicell.report.explain.stiffness import place_of, stiffness_numbers
from multicell.scene.domain import sides
from multicell.scene.pairs import drag, explicit_limit
from multicell.scene.parts import CYCLE_PHASES
from multicell.scene.responses import Effect, effects
from multicell.scene.scene import Scene
from multicell.scene.sizes import birth_radius
from multicell.scene.start_checks import deep_overlaps
from multicell.scene.steps import longest_coupling_step, step_plan, usual_coupling_step
from multicell.simulation.start_check import check_population


def explain(scene: Scene) -> dict[str, Any]:
    """Return the parts of a scene that are used and the numbers that follow from it.

    Returns dict: ``title``; ``parts``: list of ``part``, ``used``, ``what``; ``numbers``: list of
    ``name``, ``value``, ``unit``, ``meaning``; ``notes``: list of remarks on settings that do not
    fit together. Only plain values, so that it can be written as JSON. Raises SceneError where a
    run would end at its first moment.
    """
    check_population(scene)
    expected = predict(scene)
    numbers = [*_run(scene), *contact_numbers(scene), *stiffness_numbers(scene), *_growth(scene)]
    numbers += [*cost_numbers(scene, expected), *nutrient_numbers(scene)]
    return {
        "title": scene.title,
        "parts": [asdict(part) for part in _parts(scene, expected)],
        "numbers": [asdict(number) for number in numbers],
        "notes": [*_notes(scene), *cost_notes(expected), *nutrient_notes(scene)],
    }


def _parts(scene: Scene, expected: Prediction) -> list[ExplainedPart]:
    known = effects(scene) if scene.responses else ()
    method = scene.integrator.method
    info = METHODS.get(method) or MethodInfo(method)
    integrator = f"{method}: {info.words}"
    if info.control == "tolerance":
        integrator += f"; absolute tolerance {scene.integrator.tolerance:g} um"
    return [
        part("initial", _start_words(scene)),
        *contact_parts(scene),
        part("growth", _growth_words(scene)),
        part("death", _death_words(scene)),
        *(ExplainedPart(e.key, True, _sentence(scene, e)) for e in known if not e.short),
        part("radiation", "; ".join(_radiation_words(scene))),
        *(
            ExplainedPart(f"networks.{name}", True, network_words(scene, name))
            for name in scene.networks
        ),
        *_taxis(scene),
        ExplainedPart("domain", scene.domain is not None, _domain_words(scene)),
        *nutrient_parts(scene),
        part("integrator", integrator + place_of(scene, float(expected.course.cells[-1]))),
        part("output", f"a frame every {hours(scene.output.every)}"),
    ]


def _start_words(scene: Scene) -> str:
    start = scene.initial
    if start.cells is not None:
        name = Path(start.cells.file).name or "cells given in memory"
        columns = ", ".join(start.cells.given.columns)
        return (
            f"{start.count:,} cell(s) of the table '{name}', which gives {columns}{_stage(scene)}"
        )
    shape = "row along x" if start.shape == "row" else "ball"
    if scene.dimensions == 2:
        shape = "plane, where they stay" if shape == "ball" else f"{shape}, in a plane"
    each = scene.cells.represents
    many = "" if each is None else f", each for {each:g} of the tissue,"
    return f"{start.count:,} cell(s){many} in a {shape}{_stage(scene)}"


def _stage(scene: Scene) -> str:
    growth, stage = scene.growth, scene.initial.stage
    if growth is None or stage == "birth":
        return ""
    if stage == "uniform":
        return "; spread evenly over their cycle"
    rate = 3600.0 * malthusian_rate(growth)
    return f"; ages of a population that has long grown without limits, by {rate:.4g} 1/h"


def _growth_words(scene: Scene) -> str:
    growth = scene.growth
    if growth is None:
        return ""
    words = f"cells double their volume in {hours(growth.mean_cycle)} and divide"
    if growth.volume_doubling_time is not None:
        doubling = hours(growth.volume_doubling_time)
        words = (
            f"cells divide after {hours(growth.mean_cycle)}, and double their volume in {doubling}"
        )
    if growth.law != "linear":
        words += f"; growth is {growth.law}"
    given = ", ".join(f"{name} = {x:g}" for name, x in (growth.parameters or {}).items())
    words += f" ({given})" if given else ""
    if growth.phases:
        lengths = ", ".join(
            f"{name} {hours(growth.phases[name].duration)}" for name in CYCLE_PHASES
        )
        rest = "at the end of G1 only" if growth.restriction else "in any phase"
        words += f"; phases {lengths}, rest {rest}"
        for name in CYCLE_PHASES:
            if after := growth.phases[name].after:
                starts = "division" if name == "G1" else name
                words += f"; {starts} once {after}"
        words += "" if growth.hypertrophy else "; none grows beyond the volume of division"
    return words


def _death_words(scene: Scene) -> str:
    death = scene.death
    if death is None:
        return ""
    words = ""
    if death.necrosis_rate is not None:
        words = f"starved cells die after {hours(1.0 / death.necrosis_rate)} on average; "
    if death.damage_time is not None:
        words = f"cells beyond a threshold of necrosis die after {hours(death.damage_time)} of it; "
    if any(effect.behaviour == "damage rate" for effect in effects(scene)):
        healing = death.repair_rate
        words += f"damage heals in about {hours(1.0 / healing)}; " if healing else "damage stays; "
    words += "necrotic cells "
    if death.swelling > 1.0:
        words += f"swell to {death.swelling:g} times their volume in {hours(death.swelling_time)}, "
    words += f"lose their volume in about {hours(death.lysis_time)}"
    if death.inflow:
        words += "; the medium flows in to what they lose"
    if death.apoptosis_rate > 0.0:
        life = hours(1.0 / death.apoptosis_rate)
        words += f"; cells live {life} on average until they die by themselves"
    return words


def _sentence(scene: Scene, effect: Effect) -> str:
    """Return a response as a sentence with its numbers."""
    behaviour = behaviour_named(effect.behaviour, "")[0]
    whose = f" of {' and '.join(effect.types)} cells" if effect.types else ""
    what = f"the {effect.behaviour}{whose}"
    if behaviour.is_factor and not effect.law.gives_values:
        what += ", as a factor,"

    def value(number: float) -> str:
        return "death at once" if math.isinf(number) else _amount(number, behaviour.unit)

    signal = " and ".join(effect.signals)
    known = len(effect.signals) == 1
    unit = signal_unit(effect.signals[0], scene.nutrients, "") if known else ""
    law = effect.law.words(lambda level: _amount(level, unit))
    end = f"{value(effect.low)} to {value(effect.high)}"
    if not effect.law.has_signal:
        return f"{what} is {value(effect.high)}"
    if effect.law.gives_values:
        return f"{what} follows a table over {signal}: {law}"
    if effect.falls:
        end = f"{value(effect.high)} to {value(effect.low)}"
    return f"as {signal} rises, {what} goes from {end} ({law})"


def _amount(number: float, unit: str) -> str:
    """Return a number with its unit, rates per hour."""
    if unit == "1/s":
        return f"{3600.0 * number:.4g} 1/h"
    return f"{number:.4g} {unit}".strip()


def _radiation_words(scene: Scene) -> Iterator[str]:
    for name, law in scene.radiation.items():
        times, whom = law.schedule, f"cells of type {law.cells}" if law.cells else "cells"
        given = sum(time <= scene.duration for time in times)
        words = f"{name}: {len(times)} x {law.dose:g} Gy from {hours(times[0])} on"
        words += f" ({given} within the run)" if given < len(times) else ""
        words += f"; each leaves {100.0 * law.survival():.3g} % of {whom}"
        if law.oxygen:
            words += f" with plenty of {law.oxygen}, {100.0 * law.survival(0.0):.3g} % without"
        when = (
            f"in place of division {law.mitotic_divisions}" if law.mitotic_divisions else "at once"
        )
        yield f"{words}; the others die {when}"


def _taxis(scene: Scene) -> list[ExplainedPart]:
    """Return the forces along gradients, with the drift of a free cell."""
    resistance = drag(scene, birth_radius(scene))
    parts = []
    for name, law in scene.chemotaxis.items():
        speed = 3600.0 * abs(law.force) / resistance
        way = "up" if law.force >= 0.0 else "down"
        what = f"a free cell drifts {way} a steep gradient at {speed:.3g} um/h"
        factors = [
            f"{kind} {kinds.chemotaxis_of[name]:g}"
            for kind, kinds in scene.types.items()
            if kinds.chemotaxis_of and name in kinds.chemotaxis_of
        ]
        what += f"; times, of {', '.join(factors)}" if factors else ""
        parts.append(part(f"chemotaxis.{name}", what))
    if scene.surface is not None:
        what = f"{scene.surface.tension:g} nN/um, which presses on a ball of 300 um radius"
        parts.append(part("surface", f"{what} with {scene.surface.tension / 0.15:.3g} Pa"))
    return parts


def _domain_words(scene: Scene) -> str:
    domain = scene.domain
    names = ", ".join(scene.nutrients)
    if domain is None:
        return f"absent: no walls; fields that follow the cells: {names or 'none'}"
    if domain.radius is not None:
        words = f"a sphere of {domain.radius:g} um about the origin, which fields pass"
        if domain.stiffness is not None:
            most = domain.stiffness * 2.5 / 3.0
            words += f"; the cavity of a gel of {domain.stiffness:g} kPa, which presses with at "
            return f"{words}most {most:.3g} kPa: from there on it widens without end"
    else:
        lengths = " x ".join(f"{length:g}" for length in sides(domain))
        words = f"a box of {lengths} um; fields that stand still on it: {names or 'none'}"
    if domain.periodic:
        words += f"; space repeats along {' and '.join(domain.periodic)}"
        if set("xyz"[: scene.dimensions]) <= set(domain.periodic):
            return f"{words}, and there are no walls"
    young = scene.cells.young if domain.young is None else domain.young
    return f"{words}; its sides are elastic walls of {young:g} kPa"


def _run(scene: Scene) -> list[Number]:
    plan = step_plan(scene)
    steps, words = plan.steps_after(0.0), f"of {plan.coupling_step:g} s each"
    if plan.tolerance is not None:
        steps = plan.steps_after(0.0, usual_coupling_step(scene))
        words = f"chosen for an error of {100 * plan.tolerance:g} % of the volume, up to "
        words += f"{plan.coupling_step:g} s long"
    added = sum(time < scene.duration for time in plan.added)
    if added:
        words += f"; {added:,} of them because steps also end where something scheduled changes"
    # frames are saved between coupling steps, so that there are no more than those and one
    frames = math.floor(scene.duration / scene.output.every * (1.0 + 1e-12)) + 1
    frames = min(frames, steps + 1)
    return [
        Number("duration", scene.duration, "s", f"simulated time: {hours(scene.duration)}"),
        Number("coupling steps", steps, "", words),
        Number("frames", frames, "", "saved in a full run, the first and the last included"),
    ]


def _growth(scene: Scene) -> list[Number]:
    if scene.growth is None:
        return []
    cycle = scene.growth.mean_cycle
    generations = scene.duration / cycle
    numbers = [
        Number("cycle time", cycle, "s", f"{hours(cycle)} where nothing limits growth"),
        Number("generations", generations, "", "in the whole run where nothing limits growth"),
    ]
    if generations < 60.0:
        most = scene.initial.count * math.exp(malthusian_rate(scene.growth) * scene.duration)
        numbers.append(Number("cells at most", most, "", "if nothing limited growth"))
    return numbers


def _notes(scene: Scene) -> list[str]:
    notes = []
    if scene.death is not None and not scene.nutrients and not scene.radiation:
        notes.append("Without a nutrient no cell becomes necrotic: [death] has no effect.")
    deep = 0 if scene.initial.cells is None or not scene.contact.acts else deep_overlaps(scene)
    if deep:
        notes.append(
            f"{deep:,} pair(s) of cells in the table are nearer than half the sum of their radii: "
            "they will part in the first minutes, as just divided ones do. Check radii and units."
        )
    notes += contact_notes(scene)
    entries = [e for e in effects(scene) if e.behaviour.startswith("entry into")]
    slowed = [e.behaviour for e in entries if e.law.least(e.low, e.high) < 1.0]
    growth = scene.growth
    if growth is not None and growth.waits.any():
        slowed += [f"condition ({text})" for x in growth.phases.values() if (text := x.after)]
    if slowed and growth is not None and growth.hypertrophy:
        notes.append(
            f"Cells that wait for their {slowed[0]} keep growing, beyond the volume of division "
            "where that takes long. growth.hypertrophy = false stops them there."
        )
    if scene.growth is not None and longest_coupling_step(scene) > 0.05 * scene.growth.mean_cycle:
        notes.append(
            "The coupling step is above a twentieth of the cycle time: divisions come late. "
            "Take a smaller coupling_step."
        )
    limit = explicit_limit(scene)
    name, inner = scene.integrator.method, scene.integrator.step
    method = METHODS.get(name) or MethodInfo(name)
    limit *= method.stable / 6.0
    if method.control == "step" and inner > limit:
        notes.append(
            f"The step of {inner:g} s of {method.name} is near or above its limit of stability "
            f"(about {limit:.2g} s in tissue). Take a smaller integrator.step or cvode."
        )
    return notes
