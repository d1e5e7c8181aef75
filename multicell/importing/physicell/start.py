"""The cells at the start: PhysiCell's tables of cells in both forms."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import SPHERE, FloatArray
from multicell.errors import SceneError
from multicell.importing.files import elsewhere, found_file, read_rows
from multicell.importing.imported import Fate
from multicell.importing.physicell.model import CellDefinition, Model

_MAX_LINES = 10**7  # cells to place: it bounds memory
_CROWDED = 50  # pairs for each cell; more than a few coincide in no model that has run
_NEAR, _AWAY = 0.021, 0.1
"""How near two cells are taken to coincide, and by how much one of them is moved, in radii."""


@final
@dataclass(frozen=True)
class Start:
    """The cells at the start: (n, 3) µm, their types, and (n,) µm³.

    ``begun``: of each type how long its cells have been in G1, s; 0 where it is not there.
    """

    position: FloatArray
    kinds: list[CellDefinition]
    volume: FloatArray
    begun: dict[CellDefinition, float] = field(default_factory=dict)

    def columns(self, *, phases: bool) -> dict[str, NDArray[np.generic]]:
        """Return the columns of the table of cells that a scene starts from, by their titles.

        With ``phases`` all are at the beginning of PhysiCell's first one.
        """
        made: dict[str, NDArray[np.generic]] = {
            f"position_{axis}_um": self.position[:, k] for k, axis in enumerate("xyz")
        }
        made["radius_um"] = np.cbrt(self.volume / SPHERE)
        if len({kind.key for kind in self.kinds}) > 1:
            made["kind"] = np.array([kind.key for kind in self.kinds], dtype=object)
        if phases:
            made["phase"] = np.full(len(self.kinds), "G1", dtype=object)
            made["progress_s"] = np.array([self.begun.get(kind, 0.0) for kind in self.kinds])
        return made


def read_start(model: Model, folder: Path) -> Start:
    """Return the cells at the start, and count those of each type."""
    given = model.root.find("initial_conditions/cell_positions")
    if given is not None and given.says("enabled"):
        path = found_file(given, folder)
        start, note = _from_table(model, path), elsewhere(given, folder, path)
        for tag in ("folder", "filename"):
            model.account.take_all(given.all(tag), Fate.MAPPED, "initial.cells", note)
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
        return _move_apart(model, "cells at random", _start(position, kinds))
    note = f"one cell of '{model.kinds[0].name}' in the middle: C++ code of the model places them"
    model.account.add("initial_conditions", "no table", Fate.LEFT_OUT, "initial.cells", note)
    return _start(0.5 * (low + high)[None], [model.kinds[0]])


def _start(position: FloatArray, kinds: list[CellDefinition]) -> Start:
    return Start(position, kinds, np.array([kind.volume for kind in kinds]))


def _from_table(model: Model, path: Path) -> Start:
    rows = read_rows(path)
    titled = bool(rows) and _number(rows[0][1][0]) is None
    labels = [word.lower() for word in rows.pop(0)[1]] if titled else ["x", "y", "z", "type"]
    if labels[:3] != ["x", "y", "z"] or len(labels) < 4:
        problem = f"begins with '{','.join(labels[:4])[:60]}'"
        hint = "The first columns are x, y, z and the type, with or without a line of titles."
        raise SceneError(f"{path.name}, line 1", problem, hint)
    if not rows and not titled:
        raise SceneError(path.name, "has no cells")
    if not rows:
        model.account.add(path.name, "", Fate.OFF, "", "has no cells: as if there were no table")
        return _without_table(model)
    cells = []
    for line, row in rows:
        place, number = f"{path.name}, line {line}", _number(row[3] if len(row) > 3 else "")
        if len(row) < 4 or (not titled and len(row) != 4):
            raise SceneError(place, f"has {len(row)} columns, must have x, y, z and the type")
        where = [x for x in map(_number, row[:3]) if x is not None]
        if len(where) < 3:
            raise SceneError(place, "has a coordinate that is no finite number")
        volume = _number(dict(zip(labels, row, strict=False)).get("volume", ""))
        if volume is not None and not volume > 0.0:
            raise SceneError(place, f"has a volume of {volume:g}, must be above 0")
        named = (k for k in model.kinds if number is not None and k.number == int(number))
        kind = model.kind_named(row[3]) if titled else next(named, None)
        if kind is not None:
            cells.append((where, kind, volume or kind.volume))
    _account_for_columns(model, path, [row for _, row in rows], labels)
    if len(cells) < len(rows):
        note = f"{len(rows) - len(cells)} cells of types that there are not, as in PhysiCell"
        model.account.add(path.name, "", Fate.LEFT_OUT, "", note)
    position = np.array([cell[0] for cell in cells]).reshape(-1, 3)
    keep = _inside(model, path, position)
    if not keep.any():
        note = "has no cell of a type of the model in its box: as if there were no table"
        model.account.add(path.name, "", Fate.LEFT_OUT, "", note)
        return _without_table(model)
    if model.scene["dimensions"] == 2:
        if position[:, 2].any():
            note = "all are 0: a scene of two dimensions is the plane there"
            model.account.add(f"{path.name}, z", "", Fate.APPROXIMATED, "initial.cells", note)
        position[:, 2] = 0.0
    kinds = [cell[1] for cell, kept in zip(cells, keep, strict=True) if kept]
    start = Start(position[keep], kinds, np.array([cell[2] for cell in cells])[keep])
    return _move_apart(model, path.name, start)


def _number(word: str) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _account_for_columns(
    model: Model, path: Path, rows: list[list[str]], labels: list[str]
) -> None:
    add = model.account.add
    add(f"{path.name}, x, y, z, type", f"{len(rows)} cells", Fate.MAPPED, "initial.cells")
    for place, label in enumerate(labels[4:], start=4):
        words = [row[place] for row in rows if place < len(row)]
        if not any(word and word[0] not in "sS" for word in words):
            add(f"{path.name}, {label}", "", Fate.OFF)
        elif label == "volume":
            add(f"{path.name}, {label}", "", Fate.MAPPED, "radius in cells.csv")
        else:
            note = "cells of one type behave alike"
            add(f"{path.name}, {label}", "", Fate.LEFT_OUT, "", note)


def _inside(model: Model, path: Path, position: FloatArray) -> NDArray[np.bool_]:
    """Return which cells are in the box: PhysiCell takes no part in those outside either."""
    keep = np.asarray(_within(model, position).all(axis=1))
    if not keep.all():
        note = f"{int((~keep).sum())} cells outside the box"
        model.account.add(path.name, "", Fate.LEFT_OUT, "", note)
    return keep


def _within(model: Model, position: FloatArray) -> NDArray[np.bool_]:
    """Return whether each coordinate is between the sides of the box, those without sides too."""
    within = np.ones(position.shape, dtype=bool)
    for k, axis in enumerate("xyz"[: position.shape[1]]):
        if axis in model.scene["domain"]:
            low, high = model.scene["domain"][axis]
            within[:, k] = (position[:, k] >= low) & (position[:, k] <= high)
    return within


def _coinciding(source: str, position: FloatArray, distance: float) -> NDArray[np.int64]:
    """Return the pairs of cells no further apart than a distance in µm; refuse a crowd of them."""
    from scipy.spatial import KDTree

    tree, most = KDTree(position), _CROWDED * len(position) + 10**5
    if (tree.count_neighbors(tree, distance) - len(position)) // 2 > most:
        problem = f"has more than {most:,} pairs of cells that lie on top of each other"
        raise SceneError(source, problem, "Check the unit of their places: it is um.")
    return np.asarray(tree.query_pairs(distance, output_type="ndarray"))


def _move_apart(model: Model, source: str, start: Start) -> Start:
    """Return cells of which no two coincide: one of each two that do is moved."""
    position, radius = start.position, float(np.cbrt(start.volume.max() / SPHERE))
    random, moved = np.random.default_rng(0), 0
    while (near := _coinciding(source, position, _NEAR * radius)).size:
        again = np.unique(near[:, 1])
        moved += again.size
        angle = 2.0 * np.pi * random.random(again.size)
        step = _AWAY * radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        # back into the box where it would lead out
        back = ~_within(model, position[again, :2] + step)
        position[again, :2] += np.where(back, -step, step)
    if moved:
        note = f"{moved} cells at the place of another one are moved by {_AWAY * radius:.2g} um"
        model.account.add(source, "", Fate.APPROXIMATED, "initial.cells", note)
    return start
