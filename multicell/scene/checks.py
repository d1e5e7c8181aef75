"""Check whether the parts of a scene fit together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from multicell.cells import Phase
from multicell.contact.law import effective_modulus
from multicell.errors import SceneError
from multicell.integrators.registry import METHODS
from multicell.scene import domain as box
from multicell.scene.dependences import solving_order
from multicell.scene.field_solvers import check_solver
from multicell.scene.nutrient import LEVELS, MAX_CONCENTRATION, Nutrient
from multicell.scene.oxygen import check_dissolves, is_oxygen, most_dissolved
from multicell.scene.reactions import groups
from multicell.scene.scales import (
    MAX_NODES,
    largest_spacing,
    layer_height,
    level_fixed,
    regime,
    repeating,
    touches_medium,
)
from multicell.scene.sizes import division_radius, internal_step, radius_scales
from multicell.schema import below, leaves, near_miss, separated

if TYPE_CHECKING:
    from multicell.scene.parts import CellType
    from multicell.scene.scene import Scene


def check_names(names: Iterable[str] | None, known: Iterable[str], path: str, what: str) -> None:
    """Raise ``SceneError`` for a name below ``path`` that is not one of the known ones."""
    known = list(known)
    for name in names or ():
        if name not in known:
            raise SceneError(f"{path}.{name}", f"is not {what}", near_miss(name, known))


def check_kinds(scene: Scene, path: str, text: str | None) -> None:
    """Raise ``SceneError`` for the name of a type, in a list with commas, that is none."""
    for kind in separated(text):
        if kind not in scene.types:
            problem = f"names {kind!r}, which is no type of this scene"
            raise SceneError(path, problem, near_miss(kind, scene.types))


FIELD_HINT = "a field of this scene"


def check_types(scene: Scene) -> None:
    """Raise ``SceneError`` for types that do not fit together or to the rest of the scene."""
    types = scene.types
    if types and not sum(kind.fraction for kind in types.values()) > 0.0:
        raise SceneError("types", "have fractions that add up to 0, must have some cells")
    for name, kind in types.items():
        shared = None if scene.growth is None else scene.growth.volume_doubling_time
        if kind.volume_doubling_time is not None and shared is None:
            path, hint = f"types.{name}.volume_doubling_time", "cycle_scale scales cycles of types."
            raise SceneError(path, "needs growth.volume_doubling_time", hint)
        if kind.surface_energy is not None:
            _check_energies(scene, f"types.{name}.surface_energy", kind)
        if kind.adhesion_with:
            _check_adhesion(scene, name, kind.adhesion_with)
        path, known = f"types.{name}.chemotaxis_of", "a field with chemotaxis"
        check_names(kind.chemotaxis_of, scene.chemotaxis, path, known)
        for key in ("uptake_of", "secretion_of"):
            check_names(getattr(kind, key), scene.nutrients, f"types.{name}.{key}", FIELD_HINT)
        _check_thresholds(scene, name, kind)
        if kind.sticks and scene.adhesion is None:
            path = f"types.{name}.{'receptor' if any(v for _, v in kind.receptor) else 'ligand'}"
            hint = "An [adhesion] table says how strongly receptors bind."
            raise SceneError(path, "has no effect: the scene has no adhesion", hint)
    _check_sizes_of_types(scene)
    if scene.adhesion is not None and not any(kind.sticks for kind in types.values()):
        hint = "Give types.<name>.receptor and types.<name>.ligand."
        raise SceneError("adhesion", "has no effect: no type carries receptors or ligands", hint)


def check_method(scene: Scene) -> None:
    """Raise ``SceneError`` for a method that cannot hold the scene."""
    info = METHODS.get(scene.integrator.method)
    refused = info and info.refusal(scene.initial.count, friction=scene.friction is not None)
    if refused:
        raise SceneError("integrator.method", *refused)


def check_towards(scene: Scene) -> None:
    """Raise ``SceneError`` for motility towards a field that the scene does not have."""
    towards = "" if scene.motility is None else scene.motility.towards
    if towards and towards not in scene.nutrients:
        problem = f"is {towards!r}, which is not {FIELD_HINT}"
        raise SceneError("motility.towards", problem, near_miss(towards, scene.nutrients))


_MOST_INTERNAL: Final = 1e6
"""Internal steps of diffusion in a coupling step: a quarter of an hour for few cells."""


def check_diffusion(scene: Scene) -> None:
    """Raise ``SceneError`` where diffusion has more internal steps than a run would end."""
    law = scene.motility
    axes = set("xyz"[: scene.dimensions])
    walled = scene.domain is not None and set(scene.domain.periodic) != axes
    # without contacts and walls the path is followed exactly
    if law is None or law.diffusion is None or not (scene.contact.acts or walled):
        return
    step = internal_step(scene)
    if scene.coupling_step > _MOST_INTERNAL * step:
        key = "diffusion" if law.diffusion_step is None else "diffusion_step"
        steps = scene.coupling_step / step
        problem = f"has {steps:.2g} internal steps in a coupling step, more than a million"
        hint = "Shorten coupling_step, or lengthen motility.diffusion_step."
        raise SceneError(f"motility.{key}", problem, hint)


def check_flat(scene: Scene) -> None:
    """Raise ``SceneError`` for what a scene of 2 dimensions does not have."""
    scene_of = "a scene of 2 dimensions"
    stiffness = None if scene.domain is None else scene.domain.stiffness
    for key, part, hint in (
        ("compression", scene.compression, "A layer of cells yields out of its plane."),
        ("surface", scene.surface, ""),
        ("domain.stiffness", stiffness, "A gel surrounds cells in space."),
    ):
        if part is not None:
            raise SceneError(key, f"has no meaning in {scene_of}", hint)
    for path, value, spec in leaves(scene):
        where = ".".join(path)
        if path[-1] == "z" and spec.kind in ("interval", "quantity"):
            hint = "The cells lie in the plane z = 0; leave z out."
            raise SceneError(where, f"does not exist in {scene_of}", hint)
        if path[2:3] == ("sides",) and path[3] in ("z", "z-", "z+", "r+"):
            hint = "Use 'x-' to 'y+' or '*'."
            raise SceneError(".".join(path[:4]), f"does not exist in {scene_of}", hint)
        if spec.kind == "vector" and value[2] != 0.0:
            raise SceneError(where, f"points out of the plane of {scene_of}")
        if (path[-1], value) == ("geometry", "radial"):
            raise SceneError(where, f"is {value!r} in {scene_of}")


def _check_sizes_of_types(scene: Scene) -> None:
    """Refuse changes between types of other sizes that cells would never have."""
    if len(set(radius_scales(scene))) == 1 or scene.growth is None:
        return
    if not scene.growth.phases or scene.growth.law != "exponential":
        return
    for name, part in scene.responses.items():
        if " to " in part.behaviour:
            hint = "Take law = 'linear' or 'relaxation', or the same division_radius_scale."
            problem = "changes to a size that cells never reach where growth is exponential"
            raise SceneError(f"responses.{name}.behaviour", problem, hint)


def _check_thresholds(scene: Scene, name: str, kind: CellType) -> None:
    """Refuse factors on thresholds that a field does not have, and cells that die before rest."""
    for key in ("quiescence", "necrosis"):
        having = [x for x, field in scene.nutrients.items() if getattr(field, key) is not None]
        factors, path = getattr(kind, f"{key}_of"), f"types.{name}.{key}_of"
        check_names(factors, having, path, f"a field with {key}")
    for own in {**(kind.quiescence_of or {}), **(kind.necrosis_of or {})}:
        field = scene.nutrients[own]
        if field.quiescence is None or field.necrosis is None:
            continue
        rest = field.quiescence * (kind.quiescence_of or {}).get(own, 1.0)
        death = field.necrosis * (kind.necrosis_of or {}).get(own, 1.0)
        if 0.0 < rest <= death:
            key = "necrosis_of" if own in (kind.necrosis_of or ()) else "quiescence_of"
            problem = (
                f"lets cells die below {death:g} mM and rest below {rest:g} mM: thresholds in the "
                "wrong order"
            )
            hint = "Starving cells first rest, then die."
            raise SceneError(f"types.{name}.{key}.{own}", problem, hint)


def _check_energies(scene: Scene, path: str, kind: CellType) -> None:
    """Check one row of the matrix of surface energies: names, completeness, symmetry."""
    assert kind.surface_energy is not None
    own = path.split(".")[1]
    if not scene.contact.is_sticky:
        raise SceneError(path, "needs a contact law with a surface energy", "Such as law = 'jkr'.")
    check_names(kind.surface_energy, scene.types, path, "a type of this scene")
    for other, partner in scene.types.items():
        back = (partner.surface_energy or {}).get(own)
        there = kind.surface_energy.get(other)
        if there is None or back is None:
            missing = f"{path}.{other}" if there is None else f"types.{other}.surface_energy.{own}"
            raise SceneError(missing, "is missing", "Every pair of types needs a surface energy.")
        if there != back:
            problem = (
                f"is {there:g} nN/um, but types.{other}.surface_energy.{own} is {back:g} nN/um: "
                "surface energies must be symmetric"
            )
            raise SceneError(f"{path}.{other}", problem)


def _check_adhesion(scene: Scene, name: str, factors: Mapping[str, float]) -> None:
    """Check one row of the factors of adhesion: names, symmetry, and that the law attracts."""
    path = f"types.{name}.adhesion_with"
    check_names(factors, scene.types, path, "a type of this scene")
    if any(kind.surface_energy is not None for kind in scene.types.values()):
        hint = "Multiply surface energies by the factors."
        raise SceneError(path, "is given, and so are surface energies of types", hint)
    for other, factor in factors.items():
        back = (scene.types[other].adhesion_with or {}).get(name, factor)
        if back != factor:
            problem = f"is {factor:g}, but types.{other}.adhesion_with.{name} is {back:g}"
            raise SceneError(f"{path}.{other}", problem, "One of the two types may state it.")
    law, radius = scene.contact.scaled_by_pairs(), division_radius(scene)
    if law is not None:
        modulus = effective_modulus(*(scene.cells.young, scene.cells.poisson) * 2)
        problem = law.problem(float(modulus), 0.5 * radius, 2.0 * radius)
    else:
        problem = "" if scene.contact.surface_energy > 0.0 else "attracts nowhere"
    if problem:
        hint = "Adhesion of pairs is a factor of the attraction up to the overlap at rest."
        raise SceneError(path, f"has no meaning: contact.law {problem}", hint)


def check_phases(scene: Scene, path: str, phases: Mapping[str, float] | None) -> None:
    """Raise ``SceneError`` unless factors by phase name phases, of which the scene has some."""
    check_names(phases, Phase.__members__, path, "a phase of the cycle")
    if phases and (scene.growth is None or not scene.growth.phases):
        hint = "growth.phases gives them."
        raise SceneError(path, "has no effect: the scene has no phases", hint)


_DEEP = 2000.0
"""Usual depth of medium over cells in a dish, µm: 2 ml in a dish of 35 mm."""

_FINEST = 0.001
"""Least spacing of a grid over the radius of a dividing cell: below, cells are points to it."""


def check_nutrients(scene: Scene) -> None:
    """Raise ``SceneError`` for fields that do not fit together or to the rest of the scene."""
    check_names(scene.chemotaxis, scene.nutrients, "chemotaxis", FIELD_HINT)
    for name, reaction in scene.reactions.items():
        for key in ("consumes", "produces"):
            check_names(
                getattr(reaction, key), scene.nutrients, f"reactions.{name}.{key}", FIELD_HINT
            )
    for name, nutrient in scene.nutrients.items():
        path = f"nutrients.{name}"
        _check_names(scene, path, nutrient)
        if is_oxygen(name):
            _check_oxygen(path, nutrient)
        _check_spacing(scene, path, nutrient)
        _check_sides(scene, path, nutrient)
        _check_beginning(scene, name, path, nutrient)
        if nutrient.media is not None and nutrient.media[0][0] < 0.0:
            problem = f"begins at {nutrient.media[0][0]:g} s, before the run"
            raise SceneError(f"{path}.media", problem)
        _check_finite(scene, path, nutrient)
        check_solver(scene, name)
        _check_layer(scene, path, nutrient)
        if scene.box is not None:
            _check_in_domain(scene, name)
    solving_order(scene.nutrients, scene.reactions, scene.responses)
    if scene.dimensions == 2:
        for name in scene.nutrients:
            _check_plane(scene, name)


def _check_names(scene: Scene, path: str, nutrient: Nutrient) -> None:
    """Check that fields which a field refers to exist."""
    for key in ("uptake_on", "secretion_from"):
        check_names(getattr(nutrient, key), scene.nutrients, f"{path}.{key}", FIELD_HINT)
    if nutrient.uptake_on and not nutrient.takes_up:
        hint = "Give an uptake, or remove uptake_on."
        raise SceneError(f"{path}.uptake_on", "has no effect: uptake is zero", hint)
    for other in nutrient.secretion_from or ():
        if not scene.nutrients[other].takes_up:
            hint = "What is secreted from a field's uptake needs that uptake."
            raise SceneError(f"{path}.secretion_from.{other}", "is a field with no uptake", hint)


def _check_beginning(scene: Scene, name: str, path: str, nutrient: Nutrient) -> None:
    """Check that initial values and releases of a field have an effect."""
    given = [f"release.{key}" for key in nutrient.release]
    given += [key for key in ("initial_formula", "initial_file") if getattr(nutrient, key)]
    if given and regime(scene, name) == "steady":
        hint = "Let the field be 'transient'."
        raise SceneError(f"{path}.{given[0]}", "has no effect: the field is steady", hint)
    if nutrient.initial_file is not None:
        with below(f"{path}.initial_file"):
            _check_initial_file(scene, name)
    for key, release in nutrient.release.items():
        if release.type:
            check_names([release.type], scene.types, f"{path}.release.{key}.type", "a type")
        ends = (None if scene.box is None else getattr(scene.domain, axis) for axis in "xyz")
        for x, side in zip(release.place or (), ends, strict=False):
            if side is not None and not side[0] <= x <= side[1]:
                problem = f"is {list(release.place or ())} um, outside the domain"
                hint = "Look at domain.x, domain.y and domain.z."
                raise SceneError(f"{path}.release.{key}.place", problem, hint)


def _check_initial_file(scene: Scene, name: str) -> None:
    """Check that a file has a concentration of the field for each place of a grid."""
    nutrient = scene.nutrients[name]
    part = nutrient.initial_file
    assert part is not None
    grid = part.grid(name)
    if part.column and grid.ends is None:
        raise SceneError("column", "has no meaning: the file is no table", "Leave it out.")
    if grid.values.ndim != scene.dimensions:
        shape = " x ".join(map(str, grid.values.shape))
        problem = f"has {shape} values, but the scene has {scene.dimensions} dimensions"
        raise SceneError("file", problem, f"Its axes are {', '.join('xyz'[: scene.dimensions])}.")
    most = most_dissolved(nutrient.temperature) if is_oxygen(name) else MAX_CONCENTRATION
    largest = float(grid.values.max()) * part.scale
    if not largest <= most:
        problem = f"makes the file's largest value {largest:.4g} mM, must be at most {most:.4g} mM"
        raise SceneError("scale", problem, "It is the concentration where the file has 1.")
    part.ends(grid.ends, scene.dimensions, None if scene.box is None else scene.box.corners())


def _check_oxygen(path: str, nutrient: Nutrient) -> None:
    """Check that nowhere is more oxygen than water dissolves, nor does it matter to cells there.

    A half saturation may be more: then uptake is in proportion to the concentration.
    """
    levels = {key: getattr(nutrient, key) for key in LEVELS if key != "half_saturation"}
    levels["media"] = max((value for _, value in nutrient.media or ()), default=None)
    levels |= {f"sides.{face}.value": side.value for face, side in nutrient.sides.items()}
    for key, level in levels.items():
        check_dissolves(level or 0.0, nutrient.temperature, f"{path}.{key}")


def _check_spacing(scene: Scene, path: str, nutrient: Nutrient) -> None:
    """Check that a grid is neither coarser nor far finer than the cells."""
    given, radius = nutrient.spacing, division_radius(scene)
    widest, finest = 4.0 * radius, _FINEST * radius
    if given is None or finest <= given <= widest:
        return
    problem = f"is {given:g} um, must be at least {finest:g} um: finer than any cell"
    if given > widest:
        problem = (
            f"is {given:g} um, must be at most {widest:g} um "
            "(two diameters of a dividing cell): grid too coarse for its cells"
        )
    raise SceneError(f"{path}.spacing", problem, "Take about one diameter.")


def _check_sides(scene: Scene, path: str, nutrient: Nutrient) -> None:
    """Check that something fixes the level, and that shells have one condition all round."""
    if not level_fixed(nutrient, scene.dimensions, repeating(scene)):
        if nutrient.regime == "steady":
            hint = "Give one side a value, or a perfusion, or let the field be 'transient'."
            raise SceneError(f"{path}.sides", "fix no level: no steady state is defined", hint)
        if nutrient.initial == "steady":
            problem = "is 'steady', but the sides fix no level: there is no steady state"
            hint = "Start from 'medium', or give one side a value, or a perfusion."
            raise SceneError(f"{path}.initial", problem, hint)
    shaped = {face for face in nutrient.sides if face not in ("*", "r+")}
    if nutrient.geometry == "auto" and shaped:
        hint = "Take geometry = 'box', or only '*'."
        raise SceneError(f"{path}.sides.{min(shaped)}", "is not the same all round", hint)


def _check_finite(scene: Scene, path: str, nutrient: Nutrient) -> None:
    """Check that a finite medium is all that a field exchanges with, and that it does."""
    finite = nutrient.finite_medium
    if finite is None:
        return
    for face, side in nutrient.sides.items():
        for key in ("value", "derivative"):
            if getattr(side, key):
                problem = "supplies from elsewhere, but the medium is finite: nothing would add up"
                hint = "Leave it out (the medium's value), or let the side be a wall of slope 0."
                raise SceneError(f"{path}.sides.{face}.{key}", problem, hint)
    if nutrient.perfusion == 0.0 and not touches_medium(
        nutrient, scene.dimensions, repeating(scene)
    ):
        hint = "Let one side be of type 'value', or give a perfusion."
        raise SceneError(f"{path}.finite_medium", "touches no side: all are walls", hint)
    if nutrient.media_change == "linear":
        problem = "is 'linear', but a finite medium changes by itself and is replaced at times"
        raise SceneError(f"{path}.media_change", problem, "Leave it out.")
    if scene.box is not None:
        height = nutrient.height or 2.0 * division_radius(scene)
        flat = height if scene.dimensions == 2 else 1.0
        covered = math.prod(box.sides(scene.box)) * flat
        if not finite.volume > covered:
            problem = f"is {finite.volume:g} um^3, no more than the domain ({covered:g} um^3) holds"
            hint = "It is the volume of all medium, in the domain and beyond it."
            raise SceneError(f"{path}.finite_medium.volume", problem, hint)


def _check_layer(scene: Scene, path: str, nutrient: Nutrient) -> None:
    """Check that a layer lies round shells, and that a margin with a shape has an effect."""
    if nutrient.margin_shape == "tissue":
        other = {
            "domain": scene.box is not None,
            f"{path}.sides": bool(nutrient.sides),
            f"{path}.finite_medium": nutrient.finite_medium is not None,
            f"{path}.layer": nutrient.layer is not None,
        }
        for key, given in other.items():
            if given:
                problem = f"is 'tissue', but {key} states where the medium begins"
                raise SceneError(f"{path}.margin_shape", problem, "Leave out one of them.")
    if nutrient.layer is not None and nutrient.geometry != "radial":
        problem = f"has no meaning with geometry = '{nutrient.layout}'"
        hint = (
            "The layer of a ball needs geometry = 'radial'; with margin_shape = 'tissue' that of "
            "any tissue is as thick as 'margin' everywhere."
        )
        raise SceneError(f"{path}.layer", problem, hint)


def _check_plane(scene: Scene, name: str) -> None:
    """Check that cells in a plane that take something up have medium over them."""
    nutrient = scene.nutrients[name]
    if not nutrient.takes_up or nutrient.height is not None or nutrient.perfusion > 0.0:
        return
    exchange = nutrient.diffusion / (layer_height(scene, name) * _DEEP)
    problem = (
        f"is missing: in a plane cells take up {name}, and a layer as high as one cell would feed "
        "them from its rim alone"
    )
    hint = (
        f"height = '{_DEEP / 1000.0:g} mm' is medium of that depth over the cells, mixed from top "
        f"to bottom; perfusion = '{exchange:.2g} 1/s' is supply from above through that much still "
        "medium, diffusion / (depth x height of the layer of cells). For cells between two plates "
        "height is the gap."
    )
    raise SceneError(f"nutrients.{name}.height", problem, hint)


def _check_in_domain(scene: Scene, name: str) -> None:
    """Check that a field can live on the box that the scene fixes."""
    path, nutrient, domain = f"nutrients.{name}", scene.nutrients[name], scene.box
    assert domain is not None
    if nutrient.geometry not in (None, "box"):
        problem = f"is '{nutrient.geometry}' in a scene with a domain, which is a box"
        raise SceneError(f"{path}.geometry", problem, "Take geometry = 'box', or leave domain out.")
    wanted, lengths = largest_spacing(scene, name), box.sides(domain)
    if math.prod(max(length / wanted, 2.0) for length in lengths) > MAX_NODES:
        problem = f"is {wanted:g} um: the domain would need more than {MAX_NODES} nodes"
        raise SceneError(f"{path}.spacing", problem, "Take a larger spacing or a smaller domain.")
    found = box.filling(lengths, wanted)
    if found is None:
        whole = [abs(length / wanted - round(length / wanted)) for length in lengths]
        axis = "xyz"[whole.index(max(whole))]
        given = " x ".join(f"{length:g}" for length in lengths)
        problem = (
            f"makes a box of {given} um, which no cubes of {0.25 * wanted:.3g} to {wanted:.3g} um "
            f"fill (the spacing of {name})"
        )
        fit = max(round(lengths["xyz".index(axis)] / wanted), 2) * wanted
        hint = f"Take lengths that are multiples of one spacing, here for example {fit:.6g} um."
        raise SceneError(f"domain.{axis}", problem, hint)
    if math.prod(found) > MAX_NODES:
        problem = f"makes a grid of {math.prod(found)} nodes, more than the {MAX_NODES} allowed"
        hint = "Take lengths that are multiples of one larger spacing."
        raise SceneError("domain", problem, hint)


_SHARED = (
    "margin",
    "margin_shape",
    "layer",
    "height",
    "initial",
)
"""Keys of fields that are the same for all that react with each other, as grid and geometry are."""


def check_own(scene: Scene, reactions: Mapping[str, Any]) -> None:
    """Raise ``SceneError`` for reactions of the user's own that do not fit the scene's fields."""
    for name, reaction in reactions.items():
        path = f"reactions.{name}"
        if name in scene.reactions:
            raise SceneError(path, "is a reaction of the scene already", "Give it another name.")
        for field in reaction.fields:
            if field not in scene.nutrients:
                problem = f"depends on {field}, which is not {FIELD_HINT}"
                raise SceneError(path, problem, near_miss(field, scene.nutrients))
    check_reactions(scene, {**scene.reactions, **reactions})


def check_reactions(scene: Scene, reactions: Mapping[str, Any]) -> None:
    """Raise ``SceneError`` for reactions that do not fit the fields of the scene."""
    for group in groups(scene.nutrients, reactions):
        _check_grid(scene, group)
        _check_regime(scene, group)
        _check_dependences(scene, group)
        finite = [name for name in group if scene.nutrients[name].finite_medium is not None]
        if len(finite) > 1:
            problem = f"is given, but {finite[0]}, with which it reacts, has one already"
            raise SceneError(f"nutrients.{finite[1]}.finite_medium", problem, "Leave one out.")


def _check_grid(scene: Scene, group: list[str]) -> None:
    """Check that fields which react with each other live on one grid."""
    first = group[0]
    for name in group:
        nutrient = scene.nutrients[name]
        keys: dict[str, tuple[Any, Any]] = {
            key: (getattr(nutrient, key), getattr(scene.nutrients[first], key)) for key in _SHARED
        }
        keys["geometry"] = nutrient.layout, scene.nutrients[first].layout
        keys["spacing"] = largest_spacing(scene, name), largest_spacing(scene, first)
        for key, (own, other) in keys.items():
            if own != other:
                shown = [x if isinstance(x, str) or x is None else f"{x:g}" for x in (own, other)]
                problem = f"is {shown[0]}, but that of {first} is {shown[1]}, with which it reacts"
                hint = (
                    "Fields that react with each other share one grid: give them the same "
                    f"spacing, geometry and {', '.join(_SHARED)}."
                )
                raise SceneError(f"nutrients.{name}.{key}", problem, hint)


def _check_regime(scene: Scene, group: list[str]) -> None:
    """Check that fields which react are all steady or all transient, by one solver."""
    for name in group:
        own, other = scene.nutrients[name].solver, scene.nutrients[group[0]].solver
        if own != other:
            problem = f"is '{own}', but that of {group[0]}, with which it reacts, is '{other}'"
            raise SceneError(f"nutrients.{name}.solver", problem, "Make both the same.")
    given = {scene.nutrients[name].regime: name for name in group}
    if "steady" not in given:
        return
    if "transient" in given:
        problem = f"is 'steady', but {given['transient']}, with which it reacts, is 'transient'"
        raise SceneError(f"nutrients.{given['steady']}.regime", problem, "Make both the same.")
    for name in group:
        if not level_fixed(scene.nutrients[name], scene.dimensions, repeating(scene)):
            problem = f"is 'steady', but nothing fixes the level of {name}, with which it reacts"
            hint = "Let them be 'transient', or give a side a value, a perfusion or a decay."
            raise SceneError(f"nutrients.{given['steady']}.regime", problem, hint)


def _check_dependences(scene: Scene, group: list[str]) -> None:
    """Check that fields which react do not depend on each other through the cells as well."""
    for name in group:
        for key in ("uptake_on", "secretion_from"):
            for other in getattr(scene.nutrients[name], key) or ():
                if other in group:
                    problem = f"is a field that {name} reacts with, directly or over others"
                    hint = "Both are solved for together, and neither is known before the other."
                    raise SceneError(f"nutrients.{name}.{key}.{other}", problem, hint)
