"""Runs as trajectories of Simularium (https://simularium.github.io), by simulariumio."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from multicell.cells import State
from multicell.errors import OutputError
from multicell.report.tables import Frames

if TYPE_CHECKING:
    from multicell.report.result import Result

_SPHERE: Final = 1000.0  # what Simularium calls the type of an agent that is a sphere
_LARGEST: Final = 50_000_000  # cells of all frames: the text has some 100 bytes for each


def write_simularium(run: Result, frames: Frames, folder: Path) -> list[str]:
    """Write ``cells.simularium`` and return its name.

    Cells are spheres with their radii in µm, named by type and state; times are in s. Raises
    OutputError without a cell, and for more cells than a viewer could load.
    """
    from simulariumio import AgentData, MetaData, TrajectoryConverter, TrajectoryData, UnitData

    chosen = [frame.within(run.scene.domain) for _, frame in frames()]
    counts = np.array([len(frame.cells) for frame in chosen])
    most = int(counts.max(initial=0))
    if most == 0:
        raise OutputError("there are no cells in the frames that are chosen")
    if most * len(chosen) > _LARGEST:
        raise OutputError(
            f"{len(chosen)} frames of up to {most:,} cells are too much for Simularium: choose one "
            "(--frame)"
        )
    shape = len(chosen), most
    ids, radii, places = np.zeros(shape), np.zeros(shape), np.zeros((*shape, 3))
    names: list[list[str]] = []
    kinds = list(run.scene.types) or ["cell"]
    states = {int(state): state.name.lower() for state in State}
    for row, frame in enumerate(chosen):
        cells, n = frame.cells, len(frame.cells)
        ids[row, :n], radii[row, :n], places[row, :n] = cells.id, cells.radius, cells.position
        # "#" parts a name from its state
        pairs = zip(cells.kind.tolist(), cells.state.tolist(), strict=True)
        names.append([f"{kinds[kind]}#{states[state]}" for kind, state in pairs])
    agents = AgentData(
        times=np.array([frame.time for frame in chosen]),
        n_agents=counts,
        viz_types=np.full(shape, _SPHERE),
        unique_ids=ids,
        types=names,
        positions=places,
        radii=radii,
    )
    reach = 2.0 * float(np.abs(places).max() + radii.max())
    about: Any = MetaData(
        box_size=np.full(3, reach), trajectory_title=run.scene.title or "multicell"
    )
    data = TrajectoryData(about, agents, UnitData("s"), UnitData("um"))
    TrajectoryConverter(data).save(str(folder / "cells"), binary=False)
    return ["cells.simularium"]
