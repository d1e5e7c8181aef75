"""From settings of PhysiCell to a scene, its cells and an account of what became of all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from multicell.errors import DataError, SceneError
from multicell.importing.account import Account, Fate
from multicell.importing.imported import Imported
from multicell.importing.physicell import run
from multicell.importing.physicell.cycle import read_cycle
from multicell.importing.physicell.death import read_death
from multicell.importing.physicell.fields import name_fields, read_fields
from multicell.importing.physicell.kinds import read_kinds
from multicell.importing.physicell.mechanics import read_mechanics
from multicell.importing.physicell.model import Model
from multicell.importing.physicell.motility import read_motility
from multicell.importing.physicell.others import read_others
from multicell.importing.physicell.rules import account_for_rules, read_rules
from multicell.importing.physicell.secretion import read_secretion
from multicell.importing.physicell.start import read_start
from multicell.importing.xml import read_xml
from multicell.scene.scene import Scene
from multicell.scene.start_table import with_cells

if TYPE_CHECKING:
    from multicell.importing.xml import Element

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
