"""Cells as spheres for the Simularium viewer: one trajectory file, written a frame at a time.

The layout is version 3 of ``file_format.md`` of https://github.com/simularium/simulariumio. What
describes the trajectory follows the frames, since it is known only after them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.cells import State
from multicell.report.plots.style import COLOURS
from multicell.report.tables import Frames

if TYPE_CHECKING:
    from multicell.cells import FloatArray
    from multicell.report.result import Result
    from multicell.scene.scene import Scene

NAME: Final = "run.simularium"
_SPHERE: Final = 1000.0
_ROWS: Final = 10_000
"""Cells whose numbers are text at a time."""


def write(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Write the cells of all frames into one file and return its name."""
    times: list[float] = []
    seen: set[int] = set()
    largest = np.zeros(3)
    with (folder / NAME).open("w", encoding="ascii") as file:
        file.write('{"spatialData": {"version": 1, "msgType": 1, "bundleStart": 0, "bundleData": [')
        for k, (_, frame) in enumerate(frames()):
            cells = frame.cells
            sort = cells.kind.astype(np.int64) * len(State) + cells.state
            seen.update(np.unique(sort).tolist())
            extent = np.abs(cells.position) + cells.radius[:, None]
            largest = np.maximum(largest, extent.max(axis=0, initial=0.0))
            head = f'"frameNumber": {k}, "time": {json.dumps(frame.time)}, "data": ['
            file.write(f"{', ' if k else ''}{{{head}")
            for first in range(0, len(cells), _ROWS):
                rows = slice(first, first + _ROWS)
                table = np.zeros((len(sort[rows]), 11))  # three angles, and no further points
                table[:, 0], table[:, 1], table[:, 2] = _SPHERE, cells.id[rows], sort[rows]
                table[:, 3:6], table[:, 9] = cells.position[rows], cells.radius[rows]
                file.write((", " if first else "") + json.dumps(table.ravel().tolist())[1:-1])
            file.write("]}")
            times.append(frame.time)
        file.write(f'], "bundleSize": {len(times)}}}, "trajectoryInfo": ')
        json.dump(_info(run.scene, times, 2.0 * largest, seen), file)
        file.write(', "plotData": {"version": 1, "data": []}}\n')
    return [NAME]


def _info(scene: Scene, times: Sequence[float], size: FloatArray, seen: set[int]) -> dict[str, Any]:
    """Return what the format holds of a trajectory; ``seen``: its numbers of type and state."""
    names, kinds = {}, list(scene.types) or ["cell"]
    for number in sorted(seen):
        kind, state = divmod(number, len(State))
        word = State(state).name.lower()
        look = {"displayType": "SPHERE", "color": COLOURS[word]}
        names[str(number)] = {"name": f"{kinds[kind]}#{word}", "geometry": look}

    def vector(x: float, y: float, z: float) -> dict[str, float]:
        return {"x": float(x), "y": float(y), "z": float(z)}

    return {
        "version": 3,
        "trajectoryTitle": scene.title,
        "timeUnits": {"magnitude": 1.0, "name": "s"},
        "timeStepSize": times[1] - times[0] if len(times) > 1 else 0.0,
        "totalSteps": len(times),
        "spatialUnits": {"magnitude": 1.0, "name": "um"},
        "size": vector(*size),
        "cameraDefault": {
            "position": vector(0.0, 0.0, 1.2 * size.max()),  # sees the box at 75 degrees
            "lookAtPosition": vector(0.0, 0.0, 0.0),
            "upVector": vector(0.0, 1.0, 0.0),
            "fovDegrees": 75.0,
        },
        "typeMapping": names,
    }
