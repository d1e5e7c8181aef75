"""From settings of PhysiCell to a scene, its cells and an account of what became of all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Final

from multicell.errors import DataError, SceneError
from multicell.importing.files import Element, read_xml
from multicell.importing.imported import Account, Fate, Imported
from multicell.importing.physicell import run
from multicell.importing.physicell.cycle import read_cycle
from multicell.importing.physicell.death import read_death
from multicell.importing.physicell.fields import name_fields, read_fields, read_secretion
from multicell.importing.physicell.mechanics import read_mechanics
from multicell.importing.physicell.model import MINUTE, Kind, Model, read_kinds
from multicell.importing.physicell.motility import read_motility
from multicell.importing.physicell.rules import (
    Rule,
    account_for_rules,
    read_rules,
    rules_of,
    set_behaviour,
)
from multicell.importing.physicell.start import read_start
from multicell.scene.scene import Scene
from multicell.scene.start_table import with_cells

_OfType = Callable[[Kind, Element], bool]
_TRANSFORMATIONS: Final = "cell_transformations", "transformation_rates/transformation_rate"


def _acts(element: Element) -> bool:
    return bool(element.word()) and element.number() != 0.0


def _enabled(element: Element) -> bool:
    return element.says("enabled")


def _written(element: Element) -> bool:
    found = element.find("enable")
    return found is None or found.flag()


def _joins(kind: Kind, _: Element) -> bool:
    return kind.number_of("mechanics/attachment_rate", 0.0) > 0.0


def _attacks(kind: Kind, element: Element) -> bool:
    """Return whether a number of interactions does something: how cells attack, if they do."""
    rates = kind.listed("cell_interactions", "attack_rates/attack_rate", own=True)
    return _acts(element) and (element.tag not in _ATTACKS or any(map(_acts, rates)))


_CODE = "read by C++ code of the model only"
_ATTACKS: Final = ("attack_damage_rate", "attack_duration", "damage_rate")
_INSIDE = "there are no models inside cells"
_PICTURES = "pictures and reports are made of the results of any run"
_SPRINGS = "cells are not joined by springs"
_FIELDS = "microenvironment_setup/options"
_OMITTED: Final[Sequence[tuple[str, bool | Callable[[Element], bool], str]]] = (
    ("parallel/omp_num_threads", True,
     "of this machine, not of the model: multicell run --threads"),
    ("overall/dt_diffusion", True,
     "fields are solved to a tolerance, in a steady state where they settle"),
    ("overall/dt_mechanics", True, "the method of integration chooses its steps by their error"),
    ("overall/dt_intracellular", True, _INSIDE),
    ("save/folder", True, "multicell run -o names the folder"),
    ("save/SVG", _written, _PICTURES),
    ("save/legacy_data", _written, _PICTURES),
    ("save/intracellular_data", _written, _PICTURES),
    ("options/legacy_random_points_on_sphere_in_divide", Element.flag,
     "divisions have random directions on a sphere"),
    ("options/legacy_cell_defaults_copy", Element.flag,
     "types take over what PhysiCell has taken over since 1.10"),
    (f"{_FIELDS}/track_internalized_substrates_in_each_agent", Element.flag,
     "what a cell has taken up is not kept"),
    (f"{_FIELDS}/initial_condition", _enabled, "a field starts with one concentration everywhere"),
    (f"{_FIELDS}/dirichlet_nodes", _enabled,
     "concentrations are held on sides of the box, not inside"),
    ("user_parameters", True, _CODE),
)  # fmt: skip
"""What has no counterpart here, whether it does something in the model, and why it has none."""
_OMITTED_OF_TYPES: Final[Sequence[tuple[str, str, _OfType | None, str]]] = (
    ("", "custom_data", None, _CODE),
    ("phenotype", "intracellular", None, _INSIDE),
    ("phenotype", "molecular", lambda _, one: _acts(one), _CODE),
    ("phenotype", "cell_integrity", lambda _, one: _acts(one), "cells have no damage"),
    ("phenotype", "cell_interactions", _attacks,
     "cells do not eat, attack or fuse with each other"),
    ("phenotype/mechanics", "attachment_elastic_constant attachment_rate detachment_rate "
     "maximum_number_of_attachments", _joins, _SPRINGS),
    ("phenotype/mechanics", "cell_BM_adhesion_strength cell_BM_repulsion_strength", None,
     "used by C++ code of a model only"),
    ("phenotype/volume", "fluid_fraction nuclear fluid_change_rate nuclear_biomass_change_rate",
     None, "a cell has one volume"),
    ("phenotype/volume", "calcified_fraction calcification_rate", lambda _, one: _acts(one),
     "no calcium"),
    ("phenotype/death/model/parameters", "calcification_rate", lambda _, one: _acts(one),
     "no calcium"),
)  # fmt: skip
"""The same of a type: where, elements there, whether a number in them acts (None: yes), and why."""


def read_others(model: Model) -> None:
    """Account for what has no counterpart here."""
    account = model.account
    _read_changes(model)
    for path in ("cell_rules/settings", "options/disable_automated_spring_adhesions"):
        account.take_all(model.root.all(path), Fate.OFF)
    found, note = model.root.all(f"{_FIELDS}/calculate_gradients"), "where chemotaxis asks for them"
    account.take_all(found, Fate.MAPPED, note=note)
    for path, acts, why in _OMITTED:
        account.leave_out(model.root.all(path), why, acts=acts)
    for kind in model.kinds:
        _account_for_changes(model, kind)
        for one in kind.element.all("initial_parameter_distributions"):
            _read_distributions(model, one)
        for where, tags, of_type, why in _OMITTED_OF_TYPES:
            for tag in tags.split():
                leaves = chain(*(e.leaves() for e in kind.element.all(f"{where}/{tag}".strip("/"))))
                account.leave_out(leaves, why, acts=of_type is None or partial(of_type, kind))


def _changes(kind: Kind) -> dict[str, float]:
    """Return the rates at which cells of a type become others, 1/min by their names."""
    found = kind.listed(*_TRANSFORMATIONS)
    return {one.attributes.get("name", ""): one.number(at_least=0.0) for one in found}


def _read_changes(model: Model) -> None:
    """Read ``transformation_rates`` of all types, and rules that change them."""
    for to in model.kinds:
        rates = {kind: _changes(kind).get(to.name, 0.0) for kind in model.kinds if kind is not to}

        def value(kind: Kind, rule: Rule | None, rates: dict[Kind, float] = rates) -> float:
            return (rates[kind] if rule is None else rule.end) / MINUTE

        rules = rules_of(model, f"transform to {to.name}", rates)
        set_behaviour(model, f"change to {to.key}", 0.0, value, rates, rules)


def _account_for_changes(model: Model, kind: Kind) -> None:
    for one in kind.listed(*_TRANSFORMATIONS, own=True):
        to = model.kind_named(one.attributes.get("name", ""))
        if to is None or to is kind or one.number() == 0.0:
            model.account.take(one, Fate.OFF)
        else:
            model.account.take(one, Fate.MAPPED, f"responses.change_to_{to.key}_of_{kind.key}")


def _read_distributions(model: Model, table: Element) -> None:
    off = "enabled" in table.attributes and not table.says("enabled")
    for one in table.all("distribution"):
        quiet = off or ("enabled" in one.attributes and not one.says("enabled"))
        note = "cells of one type are alike at the start, but for cells.csv"
        model.account.leave_out([one], note, acts=not quiet)
    model.account.take_all([table], Fate.OFF)


_ROOT = "PhysiCell_settings"
_BESIDE = (
    (
        "C++ code of the model", Fate.LEFT_OUT,
        "no code is read: what custom modules do to cells (oxygen that decides on the cycle, "
        "contacts, placement) is not in the settings",
    ),
    (
        "uptake of dead cells", Fate.APPROXIMATED,
        "dead cells take up nothing here, a tenth in PhysiCell",
    ),
)  # fmt: skip


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
    for name, fate, note in _BESIDE:
        model.account.add(name, "", fate, "", note)
    entries = model.account.close(root)
    try:
        scene = with_cells(Scene.from_dict(model.scene), start)
    except (SceneError, DataError) as error:
        place = error.path if isinstance(error, SceneError) else error.place
        raise SceneError(f"{source.name} as a scene: {place}", error.problem, error.hint) from None
    return Imported(scene, start, entries, model.scene)


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
    read_cycle(model)
    read_fields(model)
    read_death(model)
    read_mechanics(model)
    read_motility(model)
    run.account_for_step(model)
    run.account_for_voxels(model)
    read_secretion(model)
    read_others(model)
    account_for_rules(model)
    return model
