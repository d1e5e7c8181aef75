"""From settings of PhysiCell to a scene, its cells and an account of what became of all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from multicell.errors import DataError, SceneError
from multicell.importing.files import read_xml
from multicell.importing.imported import Account, Fate, Imported
from multicell.importing.physicell import run
from multicell.importing.physicell.cycle import read_cycle
from multicell.importing.physicell.death import read_death
from multicell.importing.physicell.fields import name_fields, read_fields
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
from multicell.importing.physicell.secretion import read_secretion
from multicell.importing.physicell.start import read_start
from multicell.scene.scene import Scene
from multicell.scene.start_table import with_cells

if TYPE_CHECKING:
    from multicell.importing.files import Element

_CODE = "read by C++ code of the model only"
_ATTACKS: Final = ("attack_damage_rate", "attack_duration", "damage_rate")
_TRANSFORMATIONS: Final = "cell_transformations", "transformation_rates/transformation_rate"
_PARTS: Final = {
    "cell_interactions": "cells do not eat, attack or fuse with each other",
    "cell_integrity": "cells have no damage",
    "molecular": _CODE,
}


def read_others(model: Model) -> None:
    """Account for what has no counterpart here."""
    account = model.account
    _read_changes(model)
    for kind in model.kinds:
        for part, why in _PARTS.items():
            if (found := kind.own(part)) is not None:
                _leave(model, found, why)
        _account_for_changes(model, kind)
        inside = kind.element.all("phenotype/intracellular")
        account.leave_out(inside, "there are no models inside cells")
        account.leave_out(kind.element.all("custom_data"), _CODE)
        for one in kind.element.all("initial_parameter_distributions"):
            _read_distributions(model, one)
    account.take_all(model.root.all("cell_rules/settings"), Fate.OFF)
    account.leave_out(model.root.all("user_parameters"), _CODE)


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


def _leave(model: Model, part: Element, why: str) -> None:
    """Account for the numbers of a part: those that are zero do nothing in the model either."""
    peaceful = not any(_acts(one) for one in part.all("attack_rates/attack_rate"))
    for leaf in part.leaves():
        idle = peaceful and leaf.tag in _ATTACKS and part.tag == "cell_interactions"
        model.account.leave_out([leaf], why, acts=_acts(leaf) and not idle)


def _acts(element: Element) -> bool:
    return bool(element.word()) and element.number() != 0.0


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
