"""The cells at the start: PhysiCell's tables of cells in both forms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import SPHERE, FloatArray
from multicell.errors import SceneError
from multicell.importing.files import found_file, read_rows
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import Kind, Model

if TYPE_CHECKING:
    from pathlib import Path

_MAX_LINES = 10**7
_NEAR, _AWAY = 0.021, 0.1
"""How near two cells are taken to coincide, and by how much one of them is moved, in radii."""
_READ = ("x", "y", "z", "type", "cell_type", "volume")


@final
@dataclass(frozen=True)
class Start:
    """The cells at the start: (n, 3) µm, their types, and (n,) µm³ where given, else NaN."""

    position: FloatArray
    kinds: list[Kind]
    volume: FloatArray

    def volumes(self) -> FloatArray:
        """Return the volumes of the cells, (n,) µm³: their own or those of their types."""
        usual = np.array([kind.volume for kind in self.kinds])
        return np.where(np.isnan(self.volume), usual, self.volume)

    def columns(self, *, phases: bool) -> dict[str, NDArray[np.generic]]:
        """Return the columns of the table of cells that a scene starts from, by their titles.

        With ``phases`` all begin with their first one, as in PhysiCell.
        """
        made: dict[str, NDArray[np.generic]] = {
            f"position_{axis}_um": self.position[:, k] for k, axis in enumerate("xyz")
        }
        made["radius_um"] = np.cbrt(self.volumes() / SPHERE)
        if len({kind.key for kind in self.kinds}) > 1:
            made["kind"] = np.array([kind.key for kind in self.kinds], dtype=object)
        if phases:
            made["phase"] = np.full(len(self.kinds), "G1", dtype=object)
            made["progress_s"] = np.zeros(len(self.kinds))
        return made


def read_start(model: Model, folder: Path) -> Start:
    """Return the cells at the start, and count those of each type."""
    given = model.root.find("initial_conditions/cell_positions")
    if given is not None and given.says("enabled"):
        start = _from_table(model, found_file(given, folder))
        for tag in ("folder", "filename"):
            model.account.take_all(given.all(tag), Fate.MAPPED, "initial.cells")
    else:
        if given is not None:
            model.account.take_all([given], Fate.OFF)
        start = _without_table(model)
    for kind in start.kinds:
        kind.count += 1
    return start


def _without_table(model: Model) -> Start:
    """Return cells at random in the box, as many as the model says, or one in the middle."""
    low, high = (
        np.array([model.scene["domain"].get(axis, (0.0, 0.0))[end] for axis in "xyz"])
        for end in (0, 1)
    )
    number = model.root.find("user_parameters/number_of_cells")
    count = 0 if number is None else int(number.number())
    if number is not None and 0 < count * len(model.kinds) <= _MAX_LINES:
        note = (
            "so many of each type, at random in the box: PhysiCell's template does so, another "
            "model's C++ code may not"
        )
        model.account.take(number, Fate.APPROXIMATED, "initial.cells", note)
        kinds = [kind for kind in model.kinds for _ in range(count)]
        random = np.random.default_rng(model.scene.get("seed", 0))
        position = low + (high - low) * random.random((len(kinds), 3))
        return _move_apart(model, None, Start(position, kinds, np.full(len(kinds), np.nan)))
    note = f"one cell of '{model.kinds[0].name}' in the middle: C++ code of the model places them"
    model.account.add("initial_conditions", "no table", Fate.LEFT_OUT, "initial.cells", note)
    return Start(0.5 * (low + high)[None], [model.kinds[0]], np.full(1, np.nan))


def _from_table(model: Model, path: Path) -> Start:
    rows = read_rows(path)
    if len(rows) > _MAX_LINES:
        raise SceneError(path.name, f"has more than {_MAX_LINES:,} lines")
    if not rows:
        raise SceneError(path.name, "has no cells")
    labels = None if _number(rows[0][1][0]) is not None else [w.lower() for w in rows.pop(0)[1]]
    if labels is not None and (labels[:3] != ["x", "y", "z"] or len(labels) < 4):
        problem = f"begins with '{','.join(labels[:4])[:60]}'"
        hint = "The first columns are x, y, z and the type, with or without a line of titles."
        raise SceneError(f"{path.name}, line 1", problem, hint)
    if not rows:
        model.account.add(path.name, "", Fate.OFF, "", "has no cells: as if there were no table")
        return _without_table(model)
    found = [_cell(model, path, n, row, labels) for n, row in rows]
    _account_for_columns(model, path, rows, labels)
    cells = [cell for cell in found if cell is not None]
    position = np.array([cell[0] for cell in cells]).reshape(-1, 3)
    keep = _inside(model, path, position)
    if not keep.any():
        raise SceneError(path.name, "has no cell of a type of the model in its box")
    if model.scene["dimensions"] == 2:
        _flatten(model, path, position)
    kinds = [cell[1] for cell, kept in zip(cells, keep, strict=True) if kept]
    if len(cells) < len(found):
        note = f"{len(found) - len(cells)} cells of types that there are not, as in PhysiCell"
        model.account.add(path.name, "", Fate.LEFT_OUT, "", note)
    start = Start(position[keep], kinds, np.array([cell[2] for cell in cells])[keep])
    return _move_apart(model, path, start)


def _cell(
    model: Model, path: Path, line: int, row: list[str], labels: list[str] | None
) -> tuple[list[float], Kind, float] | None:
    """Return place, type and volume (NaN if not given) of a cell; None for an unknown type."""
    place = f"{path.name}, line {line}"
    if len(row) < 4 or (labels is None and len(row) != 4):
        raise SceneError(place, f"has {len(row)} columns, must have x, y, z and the type")
    position = [_number(word) for word in row[:3]]
    if any(value is None for value in position):
        raise SceneError(place, "has a coordinate that is no finite number")
    if labels is None:
        number = _number(row[3])
        kind = next(
            (k for k in model.kinds if number is not None and k.number == int(number)), None
        )
    else:
        kind = model.kind_named(row[3])
    volume = _extra(row, labels, "volume")
    if volume is not None and not volume > 0.0:
        raise SceneError(place, f"has a volume of {volume:g}, must be above 0")
    if kind is None:
        return None
    return [x for x in position if x is not None], kind, np.nan if volume is None else volume


def _extra(row: list[str], labels: list[str] | None, label: str) -> float | None:
    """Return a number of a column that a table may have; None where it is skipped."""
    if labels is None or label not in labels:
        return None
    place = labels.index(label)
    word = row[place] if place < len(row) else ""
    return None if not word or word[0] in "sS" else _number(word)


def _number(word: str) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _account_for_columns(
    model: Model, path: Path, rows: list[tuple[int, list[str]]], labels: list[str] | None
) -> None:
    add = model.account.add
    add(f"{path.name}, x, y, z, type", f"{len(rows)} cells", Fate.MAPPED, "initial.cells")
    for place, label in enumerate(labels or ()):
        words = [row[place] for _, row in rows if place < len(row)]
        on = any(word and word[0] not in "sS" for word in words)
        name = f"{path.name}, {label}"
        if label == "volume":
            add(name, "", Fate.MAPPED if on else Fate.OFF, "radius in cells.csv" if on else "")
        elif label not in _READ:
            note = "cells of one type behave alike" if on else ""
            add(name, "", Fate.LEFT_OUT if on else Fate.OFF, "", note)


def _inside(model: Model, path: Path, position: FloatArray) -> NDArray[np.bool_]:
    """Return which cells are in the box: PhysiCell takes no part in those outside either."""
    keep = np.ones(len(position), dtype=bool)
    for k, axis in enumerate("xyz"):
        if axis in model.scene["domain"]:
            low, high = model.scene["domain"][axis]
            keep &= (position[:, k] >= low) & (position[:, k] <= high)
    if not keep.all():
        note = f"{int((~keep).sum())} cells outside the box"
        model.account.add(path.name, "", Fate.LEFT_OUT, "", note)
    return keep


def _move_apart(model: Model, path: Path | None, start: Start) -> Start:
    """Return cells of which no two coincide: one of each two that do is moved."""
    from scipy.spatial import KDTree

    position, radius = start.position, float(np.cbrt(start.volumes().max() / SPHERE))
    random, moved = np.random.default_rng(0), 0
    while (near := KDTree(position).query_pairs(_NEAR * radius, output_type="ndarray")).size:
        again = np.unique(near[:, 1])
        moved += again.size
        angle = 2.0 * np.pi * random.random(again.size)
        position[again, :2] += _AWAY * radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if moved:
        note = f"{moved} cells at the place of another one are moved by {_AWAY * radius:.2g} um"
        source = "cells at random" if path is None else path.name
        model.account.add(source, "", Fate.APPROXIMATED, "initial.cells", note)
    return start


def _flatten(model: Model, path: Path, position: FloatArray) -> None:
    """Put all cells into the plane z = 0."""
    if position[:, 2].any():
        note = "all are 0: a scene of two dimensions is the plane there"
        model.account.add(f"{path.name}, z", "", Fate.APPROXIMATED, "initial.cells", note)
    position[:, 2] = 0.0
