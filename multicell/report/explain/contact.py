"""What a scene's cells do to each other, for :mod:`multicell.report.explain.scene`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.jkr import JKR
from multicell.contact.pair import Pair
from multicell.report.explain.items import Number, Part, hours, pair_label, part
from multicell.scene.driven import PrescribedMotion
from multicell.scene.packing import collapse_notes, strongest_attraction
from multicell.scene.pairs import daughters_stiffness, drag, pairs
from multicell.scene.parts import Motility
from multicell.scene.scene import Scene
from multicell.scene.sizes import birth_radius, typical_radius


def contact_parts(scene: Scene) -> list[Part]:
    """Return contact law and what else acts between and on cells, used or absent."""
    active, load = scene.motility, scene.pull
    given = any(kind.surface_energy is not None for kind in scene.types.values())
    energy = f"{getattr(scene.contact, 'surface_energy', 0.0):g} nN/um"
    total = sum(kind.fraction for kind in scene.types.values())
    shares = [f"{100.0 * kind.fraction / total:.3g} % {n}" for n, kind in scene.types.items()]
    motions = [
        f"{name}: {_whom(law)} "
        + (f"moved at {speed:.3g} um/s" if speed else "held where they are")
        + _when(law)
        for name, law in scene.motions.items()
        for speed in [math.hypot(*law.velocity)]
    ]
    return [
        part("contact", scene.contact.describe("by type" if given else energy)),
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
    words = f"each living cell pushes itself with {law.force:g} nN, in a new direction {when} "
    words += hours(law.persistence)
    if not law.bias:
        return words
    along = f"the gradient of {law.towards}" if law.towards else f"{list(law.direction or ())}"
    return f"{words}; biased by {law.bias:g} along {along}"


def contact_numbers(scene: Scene) -> list[Number]:
    """Return what two cells of typical size do, for every two types."""
    radius = typical_radius(scene)
    limit = drag(scene, birth_radius(scene)) / daughters_stiffness(scene)
    fixed = birth_radius(scene) == radius
    meaning = "as at birth: no cell grows" if fixed else "half-way between birth and division"
    numbers = [
        Number("birth radius", birth_radius(scene), "um", "of half the division volume"),
        Number("typical radius", radius, "um", meaning),
        Number("drag", drag(scene, radius), "nN s/um", "6 pi eta r of a typical cell"),
    ]
    for label, pair in pairs(scene, radius):
        numbers += _pair_numbers(scene, label, pair)
    meaning = "for two fresh daughters alone; several times less in tissue"
    numbers.append(Number("explicit step limit", limit, "s", meaning))
    return [*numbers, *_packing(scene), *_motility(scene), *_pull(scene)]


def contact_notes(scene: Scene) -> Iterator[str]:
    """Yield remarks on contact and motion that are allowed but may not be meant."""
    yield from collapse_notes(scene)
    own = list(pairs(scene, typical_radius(scene)))
    if isinstance(scene.contact, JKR) and all(_surface_energy(pair) == 0.0 for _, pair in own):
        yield "A surface energy of zero makes JKR the same as Hertz."
    elif isinstance(scene.contact, JKR):
        rest = min(_jkr_overlap(pair) for _, pair in own if _surface_energy(pair) > 0.0)
        if scene.contact.smoothing > rest:
            yield (
                f"The smoothing of {scene.contact.smoothing:g} um is longer than the equilibrium "
                f"overlap of {rest:.3g} um: cells then rest elsewhere than eq. 3.6 says."
            )
    if scene.friction and not scene.friction.normal + scene.friction.tangential > 0.0:
        yield "Both coefficients of [friction] are zero: it costs time and has no effect."
    active = scene.motility
    if active is not None:
        weakest = min(pair.deepest()[0] for _, pair in own)
        if 0.0 < weakest < active.force:
            yield (
                f"Motility of {active.force:g} nN is stronger than the weakest contact "
                f"({weakest:.3g} nN): cells leave the tissue."
            )
        if active.persistence < scene.coupling_step:
            yield (
                "The directions of motility change at the ends of coupling steps only: take a "
                "coupling_step below motility.persistence."
            )
    if scene.pull is not None:
        most = scene.pull.load(scene.duration)
        load = min(load for _, load in _loads(scene))
        if load == 0.0:
            yield "Nothing sticks: the pull meets no resistance but drag."
        elif most < load:
            yield f"The pull ends at {most:.3g} nN: too little for one contact, {load:.3g} nN."


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
    area = math.pi * pair.radius * touching
    normal = 0.0 if scene.friction is None else scene.friction.normal * area
    settle = (friction + 2.0 * normal) / (2.0 * pair.stiffness(overlap))
    numbers = [
        Number("equilibrium distance", pair.distance(), "um", whom),
        Number("relaxation time", settle, "s", f"{whom} {where}"),
    ]
    if (load := pair.deepest()[0]) > 0.0:
        numbers.append(Number("pull-off force", load, "nN", whom))
    if isinstance(pair.law, ExactJKR):
        breaking = pair.rest - float(pair.law.breaking_overlap(pair.modulus, pair.radius))
        numbers.append(Number("breaking distance", breaking, "um", f"{whom}, held there"))
    numbers += [*_smoothing(pair), *_friction(scene, area, friction)]
    return [replace(number, name=pair_label(number.name, label)) for number in numbers]


def _smoothing(pair: Pair) -> list[Number]:
    length = getattr(pair.law, "smoothing", 0.0)
    if length == 0.0 or _surface_energy(pair) == 0.0:
        return []
    ratio = length / _jkr_overlap(pair)
    numbers = [Number("smoothing / equilibrium overlap", ratio, "", "h_s / h0")]
    if ratio <= 1.0:
        lost = 100.0 * 25.0 / 144.0 * ratio**1.75
        numbers.append(Number("binding energy lost", lost, "%", "by the smoothing"))
    return numbers


def _friction(scene: Scene, area: float, stokes: float) -> list[Number]:
    if scene.friction is None:
        return []
    both = {way: getattr(scene.friction, way) * area for way in ("normal", "tangential")}
    meaning = f"of one contact of {area:.3g} um^2, {{:.3g}} nN s/um"
    return [
        Number(f"{way} friction / drag", value / stokes, "", meaning.format(value))
        for way, value in both.items()
    ]


def _packing(scene: Scene) -> list[Number]:
    """Return how strongly cells attract each other against collapse; nothing where none does."""
    meaning = "of newborn cells, integrated over space: tissue collapses above 1"
    return [
        Number(pair_label("attraction / repulsion", label), ratio, "", meaning)
        for label, (ratio, _, _) in strongest_attraction(scene).items()
        if 0.0 < ratio < math.inf
    ]


def _motility(scene: Scene) -> list[Number]:
    """Return how far motility carries a cell on its own.

    Steps of v τ in independent directions give a mean square displacement v² τ t, which is
    2 d D t in d dimensions. Exponential times with the mean τ give twice that.
    """
    if scene.motility is None:
        return []
    speed = scene.motility.force / drag(scene, typical_radius(scene))
    run = speed * scene.motility.persistence
    spread = speed * run / (2.0 * scene.dimensions)
    numbers = [
        Number("speed of motility", speed, "um/s", "of a cell without neighbours"),
        Number("run length of motility", run, "um", "of such a cell in one direction"),
    ]
    if scene.motility.bias:
        share = drift(scene.motility.bias, scene.dimensions)
        return [*numbers, Number("drift by motility", share * speed, "um/s", "of such a cell")]
    if scene.motility.renewal == "random":
        spread *= 2.0
    meaning = "of such a cell over many runs"
    return [*numbers, Number("diffusion by motility", spread, "um^2/s", meaning)]


def _loads(scene: Scene) -> list[tuple[str, float]]:
    """Return the load that separates two cells as they are at the start, for every two types."""
    newborn = scene.initial.stage == "birth" and scene.initial.cells is None
    radius = birth_radius(scene) if newborn else typical_radius(scene)
    return [(label, pair.deepest()[0]) for label, pair in pairs(scene, radius)]


def _pull(scene: Scene) -> list[Number]:
    if scene.pull is None:
        return []
    numbers = []
    for label, load in _loads(scene):
        name = pair_label("critical load", label)
        numbers.append(Number(name, load, "nN", "that separates two cells"))
        if scene.pull.rate > 0.0 and load > scene.pull.force:
            when = (load - scene.pull.force) / scene.pull.rate
            meaning = f"the pull reaches it after {hours(when)}"
            numbers.append(Number(f"time to the {name}", when, "s", meaning))
    return numbers


def _surface_energy(pair: Pair) -> float:
    return float(getattr(pair.law, "surface_energy", 0.0))


def _jkr_overlap(pair: Pair) -> float:
    """Return h₀ of eq. 3.6 in µm."""
    law = JKR(surface_energy=_surface_energy(pair))
    return float(law.equilibrium_overlap(pair.modulus, pair.radius))


def drift(bias: float, dimensions: int) -> float:
    """Return the mean part of a cell's speed along its bias, from -1 to 1.

    With c = 1 - |b|, in space (2/3) |b|/c for |b| < c, else 1 - c²/(3 b²): the derivative of the
    mean distance from a sphere of radius c. In the plane by the midpoint rule, which converges
    exponentially unless |b| = c.
    """
    b, c = abs(bias), 1.0 - abs(bias)
    if dimensions == 3:
        share = 2.0 * b / (3.0 * c) if b < c else 1.0 - c * c / (3.0 * b * b)
        return math.copysign(share, bias)
    angles = (2.0 * math.pi * (k + 0.5) / 1000 for k in range(1000))
    parts = (b + c * math.cos(a) for a in angles)
    # |b u + c e|² = b² + c² + 2 b c cos = 2 b (b + c cos) + c² - b²
    total = sum(x / math.sqrt(max(2.0 * b * x + c * c - b * b, 1e-300)) for x in parts)
    return math.copysign(total / 1000, bias)


def _whom(driver: PrescribedMotion) -> str:
    words = []
    if driver.cells is not None:
        few = ", ".join(map(str, driver.cells[:5])) + (", ..." if len(driver.cells) > 5 else "")
        words.append(f"cell(s) {few}")
    if driver.type:
        words.append(f"type {driver.type}")
    for axis in "xyz":
        span = getattr(driver, axis)
        if span is not None:
            words.append(f"{axis} from {span[0]:g} to {span[1]:g} um")
    return " with ".join(words) or "all cells"


def _when(driver: PrescribedMotion) -> str:
    if driver.begin == 0.0 and driver.end is None:
        return ""
    end = "the end" if driver.end is None else hours(driver.end)
    return f", from {hours(driver.begin)} to {end}"
