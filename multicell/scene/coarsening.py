"""Scenes of fewer, larger cells with the same tissue.

Lengths of cells grow by a factor f, lengths of the tissue stay. A continuum does not notice if
stress, friction per volume, uptake per volume and all times stay: with r the radius of a cell and
r⁻³ cells in a volume, a force between cells must grow as r² (stress F r / r³), a force or an uptake
of a cell as r³. From this follow the powers of f in :data:`SCALING_EXPONENTS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from multicell.errors import SceneError
from multicell.schema import Tables, specs
from multicell.units import finite

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

LARGEST: Final = 10.0
"""Largest factor: 1,000 cells in one."""

_ROUNDING: Final = 0.05
"""Part by which the number of cells at the start may be rounded."""

_SIGNALS: Final = {"volume": 3, "radius": 1}
"""Signals that are a size of the cell -> power of the factor; all others stay."""

_SAME: Final[Mapping[str, str]] = {
    "surface": "tension",
    "domain": "radius x y z",
    "motions.*": "x y z velocity",
    "chemotaxis.*": "half",
    "nutrients.*": "diffusion diffusion_medium spacing margin layer height",
    "nutrients.*.finite_medium": "volume",
    "nutrients.*.sides.*": "derivative",
    "nutrients.*.release.*": "amount place radius",
    "nutrients.*.initial_file": "x y z",
}
"""Keys with lengths of the tissue and of its fields, which stay."""

SCALING_EXPONENTS: Final[Mapping[str, int | str]] = {
    # sizes and numbers of cells
    "cells.division_radius": 1,
    "cells.represents": 3,
    "initial.count": -3,
    "stop_cells": -3,
    # F ~ r² g(h / r): E stays, what is force per length grows as r
    "contact.surface_energy": 1,
    "types.*.surface_energy": 1,
    "contact.smoothing": 1,
    "contact.stiffness_at_rest": 1,
    "contact.length": 1,
    # friction of a volume with the medium, 6πηr / r³; of layers that shear, γ A r² / r³
    "drag.viscosity": 2,
    "friction.normal": -1,
    "friction.tangential": -1,
    # forces and rates of a cell, per volume of it
    "motility.force": 3,
    "chemotaxis.*.force": 3,
    "nutrients.*.uptake": 3,
    "nutrients.*.secretion": 3,
    # errors of positions are judged by the size of cells
    "integrator.atol": 1,
    # what has no law
    "initial.cells": "gives the places of single cells",
    "pull": "breaks single contacts, which a continuum does not have",
    "motility.diffusion": "moves single cells at random, which a continuum does not have",
    "motions.*.cells": "names single cells; choose them by type or region",
    **{f"{table}.{key}".lstrip("."): 0 for table, keys in _SAME.items() for key in keys.split()},
}
"""Keys with stars for names -> power of the factor, or why the key cannot be scaled.

All that have units of length, force or amount are here. Other keys stay as they are: times, ratios,
stresses, concentrations.
"""


def coarsen(scene: Scene | str | Path, factor: float) -> Scene:
    """Return a scene of fewer, larger cells with the same tissue.

    Cells are ``factor`` times as wide, and there are factor³ times fewer of them. What the tissue
    is as a continuum stays: its size, times, stresses, friction and uptake per volume. The laws are
    those of ``docs/coarse.md``. Counts of cells in the results of the coarse scene are those of the
    tissue (``cells.represents``).

    Parameters
    ----------
    scene
        A scene, the name of a built-in one, or the path of a file.
    factor
        By which cells are wider, 1 to 10.

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        For a factor outside this range, fewer cells at the start than the coarse scene can stand
        for, and any key of the scene that cannot be scaled, by name.
    """
    from multicell.scene.scene import Scene, load_scene

    fine = scene if isinstance(scene, Scene) else load_scene(scene)
    factor = finite(factor, "factor", "a number")
    if not 1.0 <= factor <= LARGEST:
        raise SceneError("factor", f"is {factor:g}, must be from 1 to {LARGEST:g}")
    _refuse(fine)
    entries = _scaled(fine, "", factor)
    represented = entries["cells"]["represents"] = (fine.cells.represents or 1.0) * factor**3
    entries["initial"]["count"] = _fewer(fine.initial.count, factor)
    if fine.stop_cells is not None:
        entries["stop_cells"] = max(1, round(fine.stop_cells / factor**3))
    _scale_signals(fine, entries, factor)
    entries["title"] = f"{fine.title} (a cell stands for {represented:g})".lstrip()
    return Scene.from_dict(entries)


def _refuse(scene: Scene) -> None:
    """Refuse what no law scales and is no single key; raises SceneError."""
    if scene.dimensions == 2:
        problem = "is 2: larger cells would make a thicker layer, not the same tissue"
        raise SceneError("dimensions", problem, "Only scenes in space can be made coarse.")
    if scene.initial.shape == "row":
        raise SceneError("initial.shape", "is 'row', which fewer cells would make shorter")
    if not scene.contact.scales:
        problem = "is a law of your own, of which nobody knows how it scales"
        raise SceneError("contact.law", problem, "Scale its parameters so that F(f h, f r) = f² F.")
    for name, part in scene.responses.items():
        if ":" in part.law and set(part.signals) & set(_SIGNALS):
            problem = "takes the size of the cell, of which nobody knows how it scales"
            raise SceneError(f"responses.{name}.law", problem)


def _fewer(count: int, factor: float) -> int:
    """Return the number of coarse cells at the start; raises SceneError where none fits."""
    wanted = count / factor**3
    number = round(wanted)
    if abs(number - wanted) > _ROUNDING * wanted:
        problem = f"is {count:,}: {wanted:.3g} coarse cells cannot stand for them"
        hint = f"Begin with {round(factor**3):,} cells or more, or choose a smaller factor."
        raise SceneError("initial.count", problem, hint)
    return number


def _scaled(part: Any, where: str, factor: float) -> dict[str, Any]:
    """Return a part as plain values, scaled; ``where`` is its key with stars for names."""
    made = {}
    for name, spec in specs(part).items():
        value, key = getattr(part, name), f"{where}.{name}" if where else name
        if value is None or (isinstance(value, Tables) and not value):
            continue
        law = SCALING_EXPONENTS.get(key, 0)
        if isinstance(law, str):
            raise SceneError(key, f"cannot be made coarse: it {law}")
        plain = spec.plain(value)
        if isinstance(value, Tables) and all(map(is_dataclass, value.values())):
            plain = {k: _scaled(entry, f"{key}.*", factor) for k, entry in value.items()}
        elif is_dataclass(value):
            plain = {**plain, **_scaled(value, key, factor)}  # a law's name is no field of it
        else:
            plain = _times(plain, factor**law) if law else plain
        made[name] = plain
    return made


def _times(value: Any, by: float) -> Any:
    """Return a number, or all numbers of a list or a table, multiplied."""
    if isinstance(value, Mapping):
        return {name: _times(entry, by) for name, entry in value.items()}
    return [_times(x, by) for x in value] if isinstance(value, list | tuple) else value * by


def _scale_signals(scene: Scene, entries: dict[str, Any], factor: float) -> None:
    """Scale levels of signals that are the size of a cell."""
    for name, part in scene.responses.items():
        by = factor ** _SIGNALS.get(part.signals[0] if part.signals else "", 0)
        plain = entries["responses"][name]
        for key in {"half", "begin", "end"} & set(plain):
            plain[key] *= by
        points: Any = part.points  # numbers, as they are in a scene that was read
        if points is not None:
            plain["points"] = [[x * by, y] for x, y in points]
