"""From settings of PhysiCell to a scene, its cells and an account of what became of all."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from multicell.errors import DataError, SceneError
from multicell.importing.files import Element, read_xml
from multicell.importing.imported import Account, Fate, Imported
from multicell.importing.physicell import run
from multicell.importing.physicell.cycle import read_cycle
from multicell.importing.physicell.death import read_death
from multicell.importing.physicell.fields import name_fields, read_microenvironment, read_secretion
from multicell.importing.physicell.inside import read_inside
from multicell.importing.physicell.mechanics import read_mechanics
from multicell.importing.physicell.model import MINUTE, CellDefinition, Model, read_kinds
from multicell.importing.physicell.motility import read_motility
from multicell.importing.physicell.rules import (
    account_for_rules,
    read_rules,
    rules_of,
    set_behaviour,
)
from multicell.importing.physicell.start import read_start
from multicell.scene.scene import Scene
from multicell.scene.start_table import with_cells

_CODE = "read by C++ code of the model only"
_INSIDE = "only networks with rates (roadrunner) are read"
_SOLVED = "networks take their own steps, by tolerances"
_SATURATES = "uptake saturates, a thousand times above the largest concentration that is named"
_FALLS = (
    "volumes of the dead fall exponentially, in the mean time of water, cytoplasm and nucleus, "
)
_FALLS += "after necrosis from the volume of bursting"
_MAPPED, _NEAR, _LEFT, _OFF = Fate.MAPPED, Fate.APPROXIMATED, Fate.LEFT_OUT, Fate.OFF
_SETTINGS: Final[Sequence[tuple[str, Fate, str, str]]] = (
    (r"domain/[xyz]_", _MAPPED, "domain", ""),
    (r"domain/use_2D", _MAPPED, "dimensions", ""),
    (r"domain/d", _MAPPED, "nutrients.*.spacing", ""),
    (r"overall/max_time", _MAPPED, "duration", ""),
    (r"overall/(time|space)_units", _MAPPED, "", "numbers are taken in min and um, as there"),
    (r"overall/dt_phenotype", _MAPPED, "coupling_step", ""),
    (r"overall/dt_(diffusion|mechanics)", _LEFT, "", "tolerances choose the steps here"),
    (r"(overall/dt_intracellular|intracellular/intracellular_dt)", _LEFT, "", _SOLVED),
    (r"parallel", _LEFT, "", "of this machine, not of the model: multicell run --threads"),
    (r"save/full_data", _MAPPED, "output.every", ""),
    (r"save/folder", _LEFT, "", "multicell run -o names the folder"),
    (r"save", _LEFT, "", "pictures and reports are made of the results of any run"),
    (
        r"options/virtual_wall",
        _NEAR,
        "domain",
        "elastic walls; PhysiCell's push is quadratic, and cells without walls stop outside",
    ),
    (r"options/(disable_automated|legacy)|cell_rules/settings", _OFF, "", ""),
    (
        r"(options|user_parameters)/random_seed",
        _MAPPED,
        "seed",
        "the same seed gives other random numbers than in PhysiCell",
    ),
    (r"user_parameters|custom_data|molecular|mechanics/cell_BM", _LEFT, "", _CODE),
    (r"microenvironment_setup/variable/.*diffusion", _MAPPED, "nutrients.*.diffusion", ""),
    (r"microenvironment_setup/variable/.*decay", _MAPPED, "nutrients.*.decay", ""),
    (r"microenvironment_setup/variable/initial", _MAPPED, "nutrients.*.boundary", ""),
    (r"microenvironment_setup/variable/Dirichlet", _MAPPED, "nutrients.*.sides", ""),
    (r"options/mechanics_voxel", _OFF, "", "the search for neighbours chooses its own"),
    (r"microenvironment_setup/options/track", _OFF, "", "a count, which code alone reads"),
    (r"microenvironment_setup/options/calculate", _MAPPED, "", "where chemotaxis asks for them"),
    (
        r"microenvironment_setup/options",
        _LEFT,
        "",
        "fields start even, are held on sides of the box only, and are not counted inside cells",
    ),
    (r"cycle/standard_asymmetric_division", _MAPPED, "responses.asymmetric_division_to_*", ""),
    (r"cycle", _MAPPED, "growth.phases, responses.entry_into_*", ""),
    (r"death/model/(death_)?rate", _MAPPED, "death, responses.*_rate_of_*", ""),
    (r"death/model/.*calcification|volume/calcif", _LEFT, "", "no calcium"),
    (r"death/model", _NEAR, "death", _FALLS),
    (r"volume/total", _MAPPED, "cells.division_radius, radius in cells.csv", ""),
    (
        r"volume/(cytoplasmic_biomass|nuclear|fluid)",
        _NEAR,
        "growth.volume_doubling_time, growth.parameters.target",
        "V' = r (K - V) of the whole cell, in the mean time of nucleus, cytoplasm and water",
    ),
    (r"volume/relative_rupture", _OFF, "", "that of each model of death counts"),
    (r"volume", _LEFT, "", "a cell has one volume"),
    (r"mechanics/cell_cell_repulsion", _MAPPED, "cells.young", ""),
    (r"mechanics/relative_maximum_adhesion", _MAPPED, "contact.cutoff", ""),
    (
        r"mechanics/(cell_cell_adhesion|cell_adhesion_affinities|options/set_)",
        _MAPPED,
        "contact.surface_energy",
        "",
    ),
    (r"mechanics", _LEFT, "", "cells are not joined by springs"),
    (r"motility/speed", _NEAR, "motility.force", "a force that gives cells of this type the speed"),
    (r"motility/persistence_time", _MAPPED, "motility.persistence", ""),
    (
        r"motility/migration_bias",
        _NEAR,
        "motility.bias",
        "along the gradient of the moment, not that of the last change of direction",
    ),
    (r"motility/options/use_2D", _LEFT, "", "motion in a plane within three dimensions"),
    (r"motility", _MAPPED, "motility.towards", ""),
    (r"secretion/.*uptake_rate", _NEAR, "nutrients.*.uptake_per_volume", _SATURATES),
    (
        r"secretion/.*secretion_rate",
        _NEAR,
        "nutrients.*.secretion",
        "S T given off, of a cell of its type's volume, and S c taken up",
    ),
    (r"secretion", _MAPPED, "nutrients.*.secretion", ""),
    (r"cell_transformations", _MAPPED, "responses.change_to_*", ""),
    (
        r"cell_interactions|cell_integrity",
        _LEFT,
        "",
        "cells do not eat, attack, damage or fuse with each other",
    ),
    (r"intracellular", _LEFT, "", _INSIDE),
    (
        r"initial_parameter_distributions",
        _LEFT,
        "",
        "cells of one type are alike at the start, but for cells.csv",
    ),
    (r"", _LEFT, "", "not known to this import"),
)
"""What becomes of settings where the readers of the parts state nothing else, by their tags.

The first pattern that fits counts; those of a type stand without what is above them.
"""
_OF_TYPES: Final = ("transformation_rate", "cell_adhesion_affinity")
"""Tags of what names another type."""
_NEEDED: Final = {
    "mechanics/(attachment_elastic|maximum_number_of_att|detachment)": "attachment_rate",
    "cell_interactions/(attack_d|damage_rate)": "attack_rates/attack_rate",
}
"""What means nothing where all elements at a path beside it are zero."""
_ZEROS: Final = (
    "domain|save|options/(virtual|random)|user_parameters|microenvironment_setup/variable|custom_|"
    "intracellular|cycle/phase|mechanics/(cell_(cell|adhesion)|relative)|motility/persistence"
)
"""What means something where it is zero, false or empty."""


def _account_for_rest(model: Model) -> None:
    """Account for all settings that have no entry yet; without effect in the model they are off."""
    names = {kind.name for kind in model.kinds}
    is_zero: dict[tuple[Element, str], bool] = {}  # one answer for all leaves beside each other
    for leaf in model.root.leaves():
        if leaf in model.account:
            continue
        where = re.sub("^cell_definitions/cell_definition/(phenotype/)?", "", leaf.tags)
        fate, key, note = next(row[1:] for row in _SETTINGS if re.match(row[0], where))
        acts = bool(re.match(_ZEROS, where)) or not _says_nothing(leaf)
        acts = acts and not (leaf.tag in _OF_TYPES and leaf.attributes.get("name") not in names)
        for pattern, path in _NEEDED.items():
            if acts and re.match(pattern, where) and leaf.above is not None:
                asked = leaf.above, path
                if asked not in is_zero:
                    is_zero[asked] = all(map(_says_nothing, leaf.above.all(path)))
                acts = not is_zero[asked]
        if leaf.is_off() or not acts:
            fate, key, note = _OFF, "", ""
        model.account.take(leaf, fate, key, note)


def _says_nothing(leaf: Element) -> bool:
    """Return whether an element is empty, false or zero."""
    word = leaf.word()
    if word.lower() in ("", "false"):
        return not (word == "" and leaf.attributes)
    try:
        return float(word) == 0.0
    except ValueError:
        return False


def _chances(kind: CellDefinition, table: str, tag: str) -> dict[str, float]:
    """Return the numbers of a table of a type by the names of other types."""
    found = kind.given(table)
    if found is None or found.is_off():
        return {}
    return {one.attributes.get("name", ""): one.number(at_least=0.0) for one in found.all(tag)}


def _read_changes(model: Model) -> None:
    """Read how cells become others, by rates and by division, and rules about it."""
    _read_way(
        model,
        "cell_transformations",
        "transformation_rates/transformation_rate",
        "transform to",
        "change to",
        MINUTE,
    )
    if "growth" in model.scene:
        _read_way(
            model,
            "cycle/standard_asymmetric_division",
            "asymmetric_division_probability",
            "asymmetric division to",
            "asymmetric division to",
            1.0,
        )


def _read_way(model: Model, table: str, tag: str, theirs: str, ours: str, unit: float) -> None:
    for to in model.kinds:
        own = {
            kind: _chances(kind, table, tag).get(to.name, 0.0) / unit
            for kind in model.kinds
            if kind is not to
        }
        rules = rules_of(model, f"{theirs} {to.name}", own)
        set_behaviour(model, f"{ours} {to.key}", 0.0, own, rules, lambda r: r.end / unit)


_ROOT = "PhysiCell_settings"


def import_physicell(path: str | Path) -> Imported:
    """Return the model that a file of settings of PhysiCell describes, as a scene.

    Versions 1.8 to 1.14 are read, with the tables of cells and of rules that the settings name.
    Nothing is executed; C++ code beside the settings is not read.

    Parameters
    ----------
    path
        A ``PhysiCell_settings.xml``.

    Returns
    -------
    Imported
        The scene, the cells at its start, and what became of each element: mapped, approximated,
        left out, or off.

    Raises
    ------
    SceneError
        With file, line and element: for a file that is no XML or no such settings, for a number
        that is none, and for a model that no scene can hold.
    """
    source = Path(path).expanduser()
    root = read_xml(source)
    if root.tag != _ROOT:
        problem = f"is of '{root.tag}', must be settings of PhysiCell ('{_ROOT}')"
        raise SceneError(f"{source.name}, line {root.line}", problem)
    model = _read(root, source)
    assert model.cells is not None
    start = model.cells.columns(phases="growth" in model.scene)
    note = "no code is read: effects of custom modules on cells (oxygen that decides on the cycle, "
    note += "contacts, placement) is not in the settings"
    model.account.add("C++ code of the model", "", _LEFT, "", note)
    note = "dead cells take up nothing here, a tenth in PhysiCell"
    model.account.add("uptake of dead cells", "", _NEAR, "", note)
    try:
        scene = with_cells(Scene.from_dict(model.scene), start)
    except (SceneError, DataError) as error:
        place = error.path if isinstance(error, SceneError) else error.place
        raise SceneError(f"{source.name} as a scene: {place}", error.problem, error.hint) from None
    return Imported(scene, start, model.account.in_order(), model.scene)


def _read(root: Element, source: Path) -> Model:
    """Return all that the settings say, part by part, each after those that it builds on."""
    folder = source.parent
    account = Account()
    model = Model(root, account, read_kinds(root, account))
    model.scene["title"] = f"Imported from PhysiCell: {source.name}"
    run.read_run(model)
    model.cells = read_start(model, folder)
    if len(model.kinds) > 1:
        for kind in model.kinds:
            model.part("types", kind.key)["fraction"] = kind.count / len(model.cells.kinds)
    name_fields(model)
    read_rules(model, folder)
    read_inside(model, folder)
    read_cycle(model)
    read_microenvironment(model)
    read_death(model)
    read_mechanics(model)
    read_motility(model)
    run.account_for_steps(model)
    read_secretion(model)
    _read_changes(model)
    account_for_rules(model)
    _account_for_rest(model)
    return model
