"""Explanation of the contacts of a scene's cells."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from multicell.contact.pair import Pair
from multicell.report.explain.items import ExplainedPart, Number, hours, pair_label, part
from multicell.scene.packing import collapse_notes, strongest_attraction
from multicell.scene.pairs import drag, explicit_limit, type_pairs
from multicell.scene.parts import Motility
from multicell.scene.scene import Scene
from multicell.scene.sizes import (
    birth_radius,
    brownian_paths,
    mean_scale,
    radius_scales,
    typical_radius,
)


def contact_parts(scene: Scene) -> list[ExplainedPart]:
    """Return contact law and what else acts between and on cells, used or absent."""
    active, load = scene.motility, scene.pull
    given = any(kind.surface_energy is not None for kind in scene.types.values())
    energy = f"{scene.contact.surface_energy:g} nN/um"
    factors = [f for kind in scene.types.values() for f in (kind.adhesion_with or {}).values()]
    ends = f"{min(factors, default=1.0):g} to {max(factors, default=1.0):g}"
    scaled = f"; adhesion of some types times {ends}" if factors else ""
    total = sum(kind.fraction for kind in scene.types.values())
    shares = [f"{100.0 * kind.fraction / total:.3g} % {n}" for n, kind in scene.types.items()]
    motions = [
        f"{name}: {math.hypot(*law.velocity):.3g} um/s" for name, law in scene.motions.items()
    ]
    return [
        part("contact", scene.contact.describe("by type" if given else energy) + scaled),
        part("types", ", ".join(shares)),
        part("adhesion", _adhesion(scene)),
        part("drag", f"Stokes drag in a medium of {scene.drag.viscosity:g} kPa s"),
        part(
            "friction",
            scene.friction
            and "touching cells rub: Gamma(x) v = F is solved in every right-hand side",
        ),
        part(
            "compression",
            scene.compression
            and "cells that are compressed by all their neighbours resist with a bulk modulus of "
            f"{scene.compression.bulk_modulus:g} kPa above a volume fraction of "
            f"{scene.compression.onset:g}",
        ),
        part("motility", active and _motility_words(active)),
        part(
            "pull",
            load
            and f"outwards with {load.force:g} nN and {load.rate:g} nN/s more; the run ends when "
            "the last contact breaks",
        ),
        part("motions", "; ".join(motions)),
    ]


def _motility_words(law: Motility) -> str:
    when = "every" if law.renewal == "regular" else "at random moments, on average every"
    words = "" if law.diffusion is None else f"living cells diffuse with {law.diffusion:g} um^2/s"
    if not law.pushes:
        return words
    words += "; " if words else ""
    words += f"each living cell pushes itself with {law.force:g} nN, in a new direction {when} "
    words += hours(law.persistence)
    if not law.bias:
        return words
    along = f"the gradient of {law.towards}" if law.towards else f"{list(law.direction or ())}"
    return f"{words}; biased by {law.bias:g} along {along}"


def contact_numbers(scene: Scene) -> list[Number]:
    """Return the numbers of a contact of two typical cells, for every two types."""
    radius = typical_radius(scene)
    fixed = birth_radius(scene) == radius
    meaning = "as at birth: no cell grows" if fixed else "half-way between birth and division"
    numbers = [
        Number("birth radius", birth_radius(scene), "um", "of half the division volume"),
        *_sizes(scene),
        Number("typical radius", radius, "um", meaning),
        Number("drag", drag(scene, radius), "nN s/um", "6 pi eta r of a typical cell"),
    ]
    if not scene.contact.acts:
        return [*numbers, *_motility(scene)]
    for label, pair in type_pairs(scene, radius):
        numbers += _pair_numbers(scene, label, pair)
    meaning = "for two fresh daughters alone; several times less in tissue"
    numbers.append(Number("explicit step limit", explicit_limit(scene), "s", meaning))
    return [*numbers, *_packing(scene), *_motility(scene), *_pull(scene)]


def _sizes(scene: Scene) -> list[Number]:
    """Return the birth radius of each type, where they differ."""
    scales = radius_scales(scene)
    if len(set(scales)) == 1:
        return []
    newborn = birth_radius(scene) / mean_scale(scene)
    return [
        Number(pair_label("birth radius", name), newborn * scale, "um", "of cells of this type")
        for name, scale in zip(scene.types, scales, strict=True)
    ]


def contact_notes(scene: Scene) -> Iterator[str]:
    """Yield remarks on contact and motion that are allowed but may not be meant."""
    yield from collapse_notes(scene)
    own = list(type_pairs(scene, typical_radius(scene)))
    if scene.contact.without_adhesion and all(pair.deepest()[0] == 0.0 for _, pair in own):
        yield scene.contact.without_adhesion
    active = scene.motility
    if active is not None and active.pushes:
        weakest = min(pair.deepest()[0] for _, pair in own)
        if 0.0 < weakest < active.force:
            yield (
                f"Motility of {active.force:g} nN is stronger than the weakest contact "
                f"({weakest:.3g} nN): cells leave the tissue."
            )


def _adhesion(scene: Scene) -> str:
    if scene.adhesion is None:
        return ""
    courses = [points for kind in scene.types.values() for points in (kind.receptor, kind.ligand)]
    changing = any(len({value for _, value in points}) > 1 for points in courses)
    course = "change in the course of the run" if changing else "are constant"
    return f"bonds of {scene.adhesion.strength:g} kPa of contact area; receptors, ligands {course}"


def _pair_numbers(scene: Scene, label: str, pair: Pair) -> list[Number]:
    whom = f"of two typical {label} cells" if label else "of two typical cells"
    if pair.bonds > 0.0:
        whom += ", bonds as at the start"
    rest = pair.equilibrium_overlap()
    # spheres that do not stick are not stiff at first contact: take a tenth of the radius
    overlap = rest if pair.stiffness(rest) > 0.0 else 0.05 * pair.rest
    touching = overlap if overlap > 0.0 else 0.05 * pair.rest
    where = "at rest" if overlap == rest else "at an overlap of a tenth of the radius"
    friction = drag(scene, 0.5 * pair.rest)
    normal = 0.0
    if scene.friction is not None:
        normal = scene.friction.normal * math.pi * pair.radius * touching
    settle = (friction + 2.0 * normal) / (2.0 * pair.stiffness(overlap))
    numbers = [
        Number("equilibrium distance", pair.distance(), "um", whom),
        Number("relaxation time", settle, "s", f"{whom} {where}"),
    ]
    if (load := pair.deepest()[0]) > 0.0:
        numbers.append(Number("pull-off force", load, "nN", whom))
    return [replace(number, name=pair_label(number.name, label)) for number in numbers]


def _packing(scene: Scene) -> list[Number]:
    """Return how strongly cells attract each other against collapse; nothing where none does."""
    meaning = "of newborn cells, integrated over space: tissue collapses above 1"
    return [
        Number(pair_label("attraction / repulsion", label), ratio, "", meaning)
        for label, (ratio, _) in strongest_attraction(scene).items()
        if 0.0 < ratio < math.inf
    ]


def _motility(scene: Scene) -> list[Number]:
    """Return how far motility carries a cell on its own.

    Steps of v τ in independent directions give a mean square displacement v² τ t, which is
    2 d D t in d dimensions. Exponential times with the mean τ give twice that.
    """
    law = scene.motility
    if law is None:
        return []
    own = []
    if (paths := brownian_paths(scene)) is not None:
        meaning = "for which a force of diffusion is constant"
        own = [Number("internal step of diffusion", paths.dt, "s", meaning)]
    if not law.pushes:
        return own
    speed = law.force / drag(scene, typical_radius(scene))
    run = speed * law.persistence
    spread = speed * run / (2.0 * scene.dimensions)
    numbers = [
        *own,
        Number("speed of motility", speed, "um/s", "of a cell without neighbours"),
        Number("run length of motility", run, "um", "of such a cell in one direction"),
    ]
    if law.bias:
        return numbers
    if law.renewal == "random":
        spread *= 2.0
    meaning = "of such a cell over many runs"
    return [*numbers, Number("diffusion by motility", spread, "um^2/s", meaning)]


def _pull(scene: Scene) -> list[Number]:
    if scene.pull is None:
        return []
    newborn = scene.initial.stage == "birth" and scene.initial.cells is None
    radius = birth_radius(scene) if newborn else typical_radius(scene)
    meaning = "that separates two cells as they are at the start"
    return [
        Number(pair_label("critical load", label), pair.deepest()[0], "nN", meaning)
        for label, pair in type_pairs(scene, radius)
    ]
