"""Cells as the tables that OpenVT's frameworks exchange (https://www.openvt.org).

``openvt.csv`` has the columns of the workshop of 2026, and where cells grow each frame is also a
file ``data000000.csv`` with its time in ``timeline.txt``, as in the study of growing monolayers.
OpenVT's tables are of a plane: in three dimensions ours have one more column, z, at the end.

Sources: https://github.com/jmosborne/OpenVt2026Workshop (schema and data of six frameworks) and
https://github.com/rheiland/OpenVT_monolayer_PhysiCell (``analysis/gen_time_series.py``).
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from multicell.report.tables import Frames
from multicell.scene.sizes import birth_radius

if TYPE_CHECKING:
    from multicell.report.result import Result

NAME: Final = "openvt.csv"
TIMELINE: Final = "timeline.txt"


def write(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write the tables into a folder and return the names of the files.

    Lengths are diameters of a newborn cell in ``openvt.csv`` and radii of one in the files of each
    frame, time is h in the one and cycles in the others. ``simID`` is the seed of the run.
    """
    scene, born = run.scene, birth_radius(run.scene)
    axes = "xyz"[: scene.dimensions]
    names, timeline = [NAME], []
    with (folder / NAME).open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["simID", "time", "cellID", "cellType", *axes])
        for number, frame in frames():
            cells = frame.cells
            place = cells.position[:, : scene.dimensions] / born
            who = zip(cells.id.tolist(), cells.kind.tolist(), (0.5 * place).tolist(), strict=True)
            hours = frame.time / 3600.0
            table.writerows([scene.seed, hours, id, kind, *x] for id, kind, x in who)
            if scene.growth is not None:
                names.append(f"data{number:06d}.csv")
                timeline.append([number, frame.time / scene.growth.mean_cycle])
                rows = np.column_stack([place[:, :2], cells.radius / born, place[:, 2:]])
                title = ["x", "y", "r", *axes[2:]]
                _write_table(folder / names[-1], [title, *rows.tolist()])
    if timeline:
        names.append(TIMELINE)
        _write_table(folder / TIMELINE, [["index", "t"], *timeline])
    return names


def _write_table(path: Path, rows: Sequence[Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
